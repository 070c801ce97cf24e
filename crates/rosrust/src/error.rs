//! Why the program ends on its own.

use crate::pipe::PipeError;

/// An error that ends the program; the site restarts it.
#[derive(Debug, thiserror::Error)]
pub enum RosrustError {
    /// The pipe to the site.
    #[error(transparent)]
    Pipe(#[from] PipeError),
    /// The graph could not be joined.
    #[error("the ROS master does not let rosrust in ({0}); check that roscore answers there")]
    Join(String),
    /// The master, or a person, ended the node.
    #[error("the node was shut down from outside, as by rosnode kill, or by another node of its name")]
    ShutDown,
    /// Nothing is known of a topic's messages any more.
    #[error("rosrust closed the connection by which its messages of {0} are counted")]
    Deaf(String),
    /// The operating system refused a resource.
    #[error("cannot {action} ({reason}); free some memory and threads")]
    System { action: &'static str, reason: String },
}

/// The longest reason in the words of another library, characters.
const LONGEST: usize = 300;

/// All that rosrust says about an error, from the outside in.
pub(crate) fn told(error: &rosrust::error::Error) -> String {
    let causes: Vec<String> = error.iter().map(ToString::to_string).collect();
    causes.join(": ").chars().take(LONGEST).collect()
}
