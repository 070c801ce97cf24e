//! What can go wrong with a pipe.

/// An error of the pipe. The side that meets it ends the child and starts it again.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    /// The other side is gone or the pipe does not work.
    #[error("the pipe to the other process broke ({0}); the site restarts it")]
    Broken(#[from] std::io::Error),
    /// A frame that claims more than is ever sent.
    #[error(
        "a frame on the pipe claims {found} bytes of {part}, but {most} are allowed; use the same release of both \
         programs"
    )]
    TooLong { part: &'static str, found: u64, most: u32 },
    /// The pipe ended within a frame.
    #[error("the pipe closed in the middle of a frame; the other process was killed or crashed")]
    Cut,
    /// A head with an unknown content.
    #[error("a frame on the pipe is malformed ({0}); use the same release of both programs")]
    Head(String),
}
