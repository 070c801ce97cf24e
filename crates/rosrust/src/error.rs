//! Why the program ends on its own.

use crate::pipe::PipeError;

/// Ends the program; the site restarts it.
#[derive(Debug, thiserror::Error)]
pub enum RosrustError {
    #[error(transparent)]
    Pipe(#[from] PipeError),
    #[error("the ROS master refuses rosrust ({0}); check that roscore answers there")]
    Join(String),
    #[error("another process shut the node down, such as rosnode kill or a node of the same name")]
    ShutDown,
    #[error("rosrust closed the connection that counts its messages of {0}")]
    Deaf(String),
    #[error("cannot {action} ({reason}); free some memory and threads")]
    System { action: &'static str, reason: String },
}

/// Characters of another library's words.
const LONGEST: usize = 300;

pub(crate) fn told(error: &rosrust::error::Error) -> String {
    let causes: Vec<String> = error.iter().map(ToString::to_string).collect();
    causes.join(": ").chars().take(LONGEST).collect()
}
