//! Publishes topics of ROS 1 for a site of AuthROS, in a process without keys: rosrust's HTTP has known advisories.

mod outlet;
mod publish;
mod queue;

use authros_pipe as pipe;

use crate::pipe::PipeError;

pub use publish::run;

// Why the program ends on its own.

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
