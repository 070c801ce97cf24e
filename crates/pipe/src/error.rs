//! Errors of a pipe.

/// The side that meets it ends the child and restarts it.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    #[error("the pipe to the other process broke ({0}); the site restarts it")]
    Broken(#[from] std::io::Error),
    #[error(
        "a frame on the pipe claims {found} bytes of {part}, but {most} are allowed; use the same release of both \
         programs"
    )]
    TooLong { part: &'static str, found: u64, most: u32 },
    #[error("the pipe closed in the middle of a frame; the other process was killed or crashed")]
    Cut,
    #[error("a frame on the pipe is malformed ({0}); use the same release of both programs")]
    Head(String),
}
