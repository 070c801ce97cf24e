//! Why the program ends by itself.

use crate::pipe::PipeError;

/// An error that ends the program; the site starts it anew.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    /// The pipe to the site.
    #[error(transparent)]
    Pipe(#[from] PipeError),
    /// The network could not be joined.
    #[error("cannot join ROS 2 domain {domain} ({reason}); look whether UDP ports from {port} on are free")]
    Join {
        /// The domain.
        domain: u16,
        /// What was said.
        reason: String,
        /// The first port of the domain.
        port: u32,
    },
    /// The network threads are gone, as after the process was stopped.
    #[error("the threads that read the network ended, as they do after the process was stopped; they are started anew")]
    Threads,
    /// The operating system did not give what was needed.
    #[error("cannot {action} ({reason}); free some memory and sockets")]
    System {
        /// What was tried.
        action: &'static str,
        /// What the system said.
        reason: String,
    },
}

impl Ros2Error {
    pub(crate) fn system(action: &'static str, reason: &dyn std::fmt::Display) -> Self {
        Self::System { action, reason: reason.to_string() }
    }
}
