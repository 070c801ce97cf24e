//! The kinds of error a user can meet; each has its own exit code.

use serde::{Deserialize, Serialize};

/// The kind of failure. It determines the command line's exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorKind {
    /// A fault of the program itself.
    Internal,
    /// The command was used incorrectly.
    Usage,
    /// A value or file is invalid.
    Input,
    /// A peer (ROS master, node, Redis, gateway) does not answer.
    Unreachable,
    /// A peer, the chain or a check refused.
    Refused,
    /// Stored data differs from what was anchored, or is missing.
    Tampered,
    /// The home is locked by another process or cannot be written.
    Home,
    /// The work ended before it was complete.
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
