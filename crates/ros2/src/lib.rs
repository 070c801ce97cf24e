//! Reads and publishes ROS 2 topics by rustdds for a site of AuthROS, in a process without keys.

mod capture;
mod describing;
mod farewell;
mod graph;
mod member;
mod publish;
mod quality;
mod reading;

use authros_pipe as pipe;

use crate::pipe::PipeError;

pub use capture::run;
pub use farewell::bury;
pub use publish::run as publish;

// Why the program ends on its own.

/// Ends the program; the site restarts it.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    #[error(transparent)]
    Pipe(#[from] PipeError),
    #[error("cannot join ROS 2 domain {domain} ({reason}); check that the UDP ports from {port} up are free")]
    Join { domain: u16, reason: String, port: u32 },
    /// The network threads end when the process was suspended.
    #[error(
        "the threads that read the network ended, as they do after the process was suspended; they are being restarted"
    )]
    Threads,
    #[error("cannot {action} ({reason}); free some memory and sockets")]
    System { action: &'static str, reason: String },
}

impl Ros2Error {
    pub(crate) fn join(domain: u16, reason: &dyn std::fmt::Debug) -> Self {
        let port = 7400 + 250 * u32::from(domain);
        Self::Join { domain, reason: format!("{reason:?}"), port }
    }

    pub(crate) fn system(action: &'static str, reason: &dyn std::fmt::Display) -> Self {
        Self::System { action, reason: reason.to_string() }
    }
}
