//! What can go wrong with ROS; each message says what to do next. Texts from peers are cleaned before they enter a
//! message.

use crate::model::{ErrorKind, clean};

/// An error of the ros crate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RosError {
    /// The master does not answer.
    #[error(
        "the ROS master at {uri} does not answer ({reason}); start roscore there or correct ros.master (--ros-master, \
         ROS_MASTER_URI)"
    )]
    Unreachable { uri: String, reason: String },
    /// A text is not the URI of a master or node.
    #[error("'{0}' is not a ROS address; use http://HOST:PORT, as in http://127.0.0.1:11311")]
    Address(String),
    /// This machine's own host name or address cannot be used.
    #[error(
        "cannot listen for ROS peers on '{host}' ({reason}); set ROS_IP to an address of this machine that the other \
         nodes can reach"
    )]
    OwnHost { host: String, reason: String },
    /// The master answered with a refusal.
    #[error("the ROS master at {uri} refused {call}: {reason}; check the master's log")]
    Refused { uri: String, call: &'static str, reason: String },
    /// The peer is not a ROS master, or a broken one.
    #[error("{uri} answers, but is not a ROS master ({reason}); check that ros.master has roscore's port")]
    Protocol { uri: String, reason: String },
    /// The embedded master did not start.
    #[error("the embedded ROS master did not start ({0}); use a running one with --ros-master instead")]
    EmbeddedMaster(String),
    /// The program that speaks ROS 2 is not installed.
    #[error(
        "the program that speaks ROS 2 is not at {0}; install the package authros-ros2 (from source: cargo build -p \
         authros-ros2), or set ros.ros2_program"
    )]
    NoReader(String),
    /// The program that publishes into ROS 2 does not run.
    #[error(
        "ROS 2 domain {domain} cannot be published in: {reason}; look at the ports and the memory of this machine, and try again"
    )]
    NotPublished { domain: u16, reason: String },
    /// The program in which rosrust runs is not installed.
    #[error(
        "the program in which rosrust runs is not at {0}; install the package authros-rosrust (from source: cargo build -p \
         authros-rosrust), set ros.rosrust_program, or do without: ros.publisher = \"own\", --robots-by own"
    )]
    NoRosrust(String),
    /// The program in which rosrust runs does not publish.
    #[error(
        "rosrust cannot publish at {uri}: {reason}; check that roscore answers there, and ros.host, or do without: \
         ros.publisher = \"own\", --robots-by own"
    )]
    NotPublishedByRosrust { uri: String, reason: String },
    /// Under root, a program that speaks with the network runs as `nobody`, and that user cannot run it.
    #[error(
        "{program} does not start as the user nobody, as whom it runs under root ({reason}); install it so that every user may \
         execute it, as in /usr/bin with mode 755, or run authros as another user"
    )]
    NotAsNobody { program: String, reason: String },
    /// The operating system did not give what was needed.
    #[error("cannot {action} ({reason}); free some threads, sockets or memory and try again")]
    System { action: &'static str, reason: String },
    /// More simulated robots than allowed.
    #[error("cannot simulate {0} robots; the limit is {most}", most = crate::ros::MOST_ROBOTS)]
    Robots(u16),
    /// An invalid publishing rate.
    #[error("{0} Hz is not a valid publishing rate; use a number above 0 and up to 1000")]
    Rate(String),
    /// A message definition that is invalid, or exceeds the limits.
    #[error("the definition of {type_name} cannot be used: {reason}; the publisher sends a bad definition")]
    Definition { type_name: String, reason: String },
    /// A type whose messages are stored, but cannot be read field by field.
    #[error("messages of {type_name} are kept, but their fields cannot be shown: {reason}")]
    NoFields { type_name: String, reason: String },
    /// A recording that cannot be read or written.
    #[error("the recording cannot be used: {0}")]
    Recording(String),
    /// A message body that does not match its definition.
    #[error("a message of {type_name} does not match its definition: {reason}; show its raw bytes instead")]
    Body { type_name: String, reason: String },
}

impl RosError {
    /// The kind of failure.
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

    pub(super) fn address(text: &str) -> Self {
        Self::Address(clean(text, 120))
    }

    pub(super) fn no_reader(path: &std::path::Path) -> Self {
        Self::NoReader(clean(&path.display().to_string(), 200))
    }

    pub(super) fn no_rosrust(path: &std::path::Path) -> Self {
        Self::NoRosrust(clean(&path.display().to_string(), 200))
    }

    pub(super) fn not_as_nobody(path: &std::path::Path, reason: &std::io::Error) -> Self {
        Self::NotAsNobody { program: clean(&path.display().to_string(), 200), reason: reason.to_string() }
    }

    pub(super) fn system(action: &'static str, reason: &std::io::Error) -> Self {
        Self::System { action, reason: reason.to_string() }
    }

    pub(super) fn definition(type_name: &str, reason: impl AsRef<str>) -> Self {
        Self::Definition { type_name: clean(type_name, 120), reason: clean(reason.as_ref(), 200) }
    }

    pub(super) fn no_fields(type_name: &str, reason: &str) -> Self {
        Self::NoFields { type_name: clean(type_name, 120), reason: clean(reason, 300) }
    }

    pub(super) fn recording(reason: &str) -> Self {
        Self::Recording(clean(reason, 300))
    }

    pub(super) fn unreadable(error: &std::io::Error) -> Self {
        Self::recording(&format!("it cannot be read ({error})"))
    }

    pub(super) fn unwritable(error: &std::io::Error) -> Self {
        Self::recording(&format!("it cannot be written ({error})"))
    }

    pub(super) fn body(type_name: &str, reason: impl AsRef<str>) -> Self {
        Self::Body { type_name: clean(type_name, 120), reason: clean(reason.as_ref(), 200) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_what_and_what_next_and_defuse_foreign_text() {
        let error = RosError::address("http://\u{1b}[2Jx");
        assert_eq!(error.kind(), ErrorKind::Usage);
        assert!(!error.to_string().contains('\u{1b}'));
        let error = RosError::Unreachable { uri: "http://127.0.0.1:1/".into(), reason: "refused".into() };
        assert_eq!(error.kind().exit_code(), 4);
        assert!(error.to_string().contains("roscore"));
        assert!(RosError::Robots(900).to_string().contains("64"));
    }
}
