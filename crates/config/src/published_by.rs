//! What publishes in a graph of ROS 1: our own publisher, or rosrust in a process without keys.

use std::str::FromStr;

/// What publishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PublishedBy {
    /// Our own publisher, in the site's process.
    #[default]
    Own,
    /// rosrust, in the program `authros-rosrust`.
    Rosrust,
}

/// A text is neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("choose own or rosrust")]
pub struct PublishedByError;

impl FromStr for PublishedBy {
    type Err = PublishedByError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "own" => Ok(Self::Own),
            "rosrust" => Ok(Self::Rosrust),
            _ => Err(PublishedByError),
        }
    }
}
