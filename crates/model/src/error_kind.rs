//! Kinds of error a person can meet; each has one exit code.

use serde::{Deserialize, Serialize};

/// What sort of failure it was. The command line's exit code follows from it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorKind {
    /// A fault of the program itself.
    Internal,
    /// The command was called wrongly.
    Usage,
    /// A value or file is not what it should be.
    Input,
    /// A peer (ROS master, node, Redis, gateway) does not answer.
    Unreachable,
    /// A peer, the chain or a check said no.
    Refused,
    /// Stored data differs from what was anchored, or is gone.
    Tampered,
    /// The home is locked by another process or cannot be written.
    Home,
    /// The work ended before all of it was done.
    Incomplete,
}

impl ErrorKind {
    /// The process exit code.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Internal => 1,
            Self::Usage => 2,
            Self::Input => 3,
            Self::Unreachable => 4,
            Self::Refused => 5,
            Self::Tampered => 6,
            Self::Home => 7,
            Self::Incomplete => 8,
        }
    }
}
