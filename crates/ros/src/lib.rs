//! ROS: the embedded master, the graph, simulated robots, capture of topics, decoding of messages, recordings.
//! All network code uses timeouts and caps; peers are untrusted.
#![doc = include_str!("../README.md")]

pub mod bag;
pub mod capture;
mod child;
pub mod graph;
pub mod master;
pub mod mcap;
pub mod message;
mod publisher;
pub mod readable;
pub mod recording;
pub mod robot;
pub mod ros2;
pub mod rosbag2;
mod tcpros;
mod xmlrpc;

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate as ros;
use authros_crypto as crypto;
use authros_model as model;
use authros_pipe as pipe;

use crate::model::{ErrorKind, clean};

pub use capture::{Capture, CaptureNotice, CaptureOptions, Message, MessageSink, Origin, Rival, TopicCapture};
pub use child::UNCONFINED;
pub use graph::{Graph, LastLook, TopicInfo};
pub use master::EmbeddedMaster;
pub use message::{Definition, Limits, Value, md5sum};
pub use publisher::{Advertised, GraphPublisher, Publisher, RosrustPublisher};
pub use robot::{DomainFleet, Fleet, FleetOptions, MOST_ROBOTS};

/// A lock that survives a panicking thread: the data are plain counters and lists.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

// Errors of ROS; texts from peers are cleaned before they enter one.

pub(crate) type Result<T, E = RosError> = std::result::Result<T, E>;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RosError {
    #[error(
        "the ROS master at {uri} does not answer ({reason}); start roscore there or correct ros.master (--ros-master, \
         ROS_MASTER_URI)"
    )]
    Unreachable { uri: String, reason: String },
    #[error("'{0}' is not a ROS address; use http://HOST:PORT, as in http://127.0.0.1:11311")]
    Address(String),
    #[error(
        "cannot listen for ROS peers on '{host}' ({reason}); set ROS_IP to an address of this machine that the other \
         nodes can reach"
    )]
    OwnHost { host: String, reason: String },
    #[error("the ROS master at {uri} refused {call}: {reason}; check the master's log")]
    Refused { uri: String, call: &'static str, reason: String },
    /// The peer is not a ROS master, or a broken one.
    #[error("{uri} answers, but is not a ROS master ({reason}); check that ros.master has roscore's port")]
    Protocol { uri: String, reason: String },
    #[error("the embedded ROS master did not start ({0}); use a running one with --ros-master instead")]
    EmbeddedMaster(String),
    #[error(
        "the program that speaks ROS 2 is not at {0}; install the package authros-ros2 (from source: cargo build -p \
         authros-ros2), or set ros.ros2_program"
    )]
    NoReader(String),
    #[error("cannot publish in ROS 2 domain {domain}: {reason}; check this machine's ports and memory, then try again")]
    NotPublished { domain: u16, reason: String },
    #[error(
        "the program in which rosrust runs is not at {0}; install the package authros-rosrust (from source: cargo build -p \
         authros-rosrust), set ros.rosrust_program, or do without: ros.publisher = \"own\", --robots-by own"
    )]
    NoRosrust(String),
    #[error(
        "rosrust cannot publish at {uri}: {reason}; check that roscore answers there, and ros.host, or do without: \
         ros.publisher = \"own\", --robots-by own"
    )]
    NotPublishedByRosrust { uri: String, reason: String },
    /// Under root, a program that speaks with the network runs as `nobody`.
    #[error(
        "{program} does not start as the user nobody, which is how root runs it ({reason}); install it where every \
         user may execute it, such as /usr/bin with mode 755, or run authros as another user"
    )]
    NotAsNobody { program: String, reason: String },
    #[error("cannot {action} ({reason}); free some threads, sockets or memory and try again")]
    System { action: &'static str, reason: String },
    #[error("cannot simulate {0}; the limit is {most} robots", most = crate::ros::MOST_ROBOTS)]
    Robots(u16),
    #[error("{0} Hz is not a valid publishing rate; use a number above 0 and up to 1000")]
    Rate(String),
    /// A definition that is invalid, or exceeds the limits.
    #[error("the definition of {type_name} cannot be used: {reason}; the publisher sends a bad definition")]
    Definition { type_name: String, reason: String },
    #[error("messages of {type_name} are kept, but their fields cannot be shown: {reason}")]
    NoFields { type_name: String, reason: String },
    #[error("the recording cannot be used: {0}")]
    Recording(String),
    #[error("a message of {type_name} does not match its definition: {reason}; show its raw bytes instead")]
    Body { type_name: String, reason: String },
}

impl RosError {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Unreachable { .. } | Self::NotPublished { .. } | Self::NotPublishedByRosrust { .. } => {
                ErrorKind::Unreachable
            }
            Self::Refused { .. } => ErrorKind::Refused,
            Self::Address(_) | Self::Robots(_) | Self::Rate(_) => ErrorKind::Usage,
            Self::OwnHost { .. }
            | Self::NoReader(_)
            | Self::NoRosrust(_)
            | Self::NotAsNobody { .. }
            | Self::Protocol { .. }
            | Self::Definition { .. }
            | Self::NoFields { .. }
            | Self::Recording(_)
            | Self::Body { .. } => ErrorKind::Input,
            Self::EmbeddedMaster(_) | Self::System { .. } => ErrorKind::Internal,
        }
    }

    pub(crate) fn not_as_nobody(path: &std::path::Path, reason: &std::io::Error) -> Self {
        Self::NotAsNobody { program: clean(&path.display().to_string(), 200), reason: reason.to_string() }
    }

    pub(crate) fn system(action: &'static str, reason: &std::io::Error) -> Self {
        Self::System { action, reason: reason.to_string() }
    }

    pub(crate) fn definition(type_name: &str, reason: impl AsRef<str>) -> Self {
        Self::Definition { type_name: clean(type_name, 120), reason: clean(reason.as_ref(), 200) }
    }

    pub(crate) fn no_fields(type_name: &str, reason: &str) -> Self {
        Self::NoFields { type_name: clean(type_name, 120), reason: clean(reason, 300) }
    }

    pub(crate) fn recording(reason: &str) -> Self {
        Self::Recording(clean(reason, 300))
    }

    pub(crate) fn unreadable(error: std::io::Error) -> Self {
        Self::recording(&format!("it cannot be read ({error})"))
    }

    pub(crate) fn unwritable(error: std::io::Error) -> Self {
        Self::recording(&format!("it cannot be written ({error})"))
    }

    pub(crate) fn body(type_name: &str, reason: impl AsRef<str>) -> Self {
        Self::Body { type_name: clean(type_name, 120), reason: clean(reason.as_ref(), 200) }
    }
}

#[cfg(test)]
mod readme_tests;

#[cfg(test)]
mod tests;

#[cfg(test)]
mod error_tests {
    use super::*;

    #[test]
    fn messages_say_what_and_what_next_and_defuse_foreign_text() {
        let error = crate::ros::tcpros::Endpoint::of_master("http://\u{1b}[2Jx").expect_err("no address");
        assert_eq!(error.kind(), ErrorKind::Usage);
        assert!(!error.to_string().contains('\u{1b}'));
        let error = RosError::Unreachable { uri: "http://127.0.0.1:1/".into(), reason: "refused".into() };
        assert_eq!(error.kind().exit_code(), 4);
        assert!(error.to_string().contains("roscore"));
        assert!(RosError::Robots(900).to_string().contains("64"));
    }
}
