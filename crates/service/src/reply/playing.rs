//! What playing shared records answers.

use serde::{Deserialize, Serialize};

/// What ended the playing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlayEnd {
    /// All there was has been played.
    Whole,
    /// Somebody asked for the end, or the connection that played is gone.
    Asked,
    /// No grant is left: the last was revoked.
    Revoked,
    /// No grant is left: the last has expired, or the reader is suspended.
    Expired,
    /// The keyring was locked.
    Locked,
    /// The site ended.
    Site,
}

impl PlayEnd {
    /// Its word in answers.
    pub fn word(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Asked => "asked",
            Self::Revoked => "revoked",
            Self::Expired => "expired",
            Self::Locked => "locked",
            Self::Site => "site",
        }
    }

    /// Whether a right to read ended it.
    pub fn is_by_right(self) -> bool {
        matches!(self, Self::Revoked | Self::Expired | Self::Locked)
    }
}

/// What was played.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlayedView {
    /// Messages published, each checked first.
    pub published: u64,
    /// Records that a check refused, or that a ROS 1 graph cannot take; none of them was published.
    pub refused: u64,
    /// Records whose bytes are gone from the vault.
    pub missing: u64,
    /// Times a subscriber did not get a message because it read too slowly.
    pub dropped: u64,
    /// How long it took.
    pub seconds: f64,
    /// What ended it.
    pub ended_by: PlayEnd,
    /// Why records were refused, with how many; the first 20 reasons.
    pub reasons: Vec<(String, u64)>,
    /// The topics as they were played, with their messages.
    pub topics: Vec<(String, u64)>,
}
