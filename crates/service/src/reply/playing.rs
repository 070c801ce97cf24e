//! Answers about playing shared records.

use serde::{Deserialize, Serialize};

/// Why playing ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlayEnd {
    /// Everything there was has been played.
    Whole,
    /// Somebody ended it, or the connection that requested it is gone.
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

    /// What ended it, if nobody asked for that and not everything was played.
    pub fn cut_short(self) -> Option<&'static str> {
        match self {
            Self::Whole | Self::Asked => None,
            Self::Revoked => Some("the grant was revoked"),
            Self::Expired => Some("the grant has expired"),
            Self::Locked => Some("the keyring was locked"),
            Self::Site => Some("the site stopped"),
        }
    }

    /// Whether it ended for want of a right to read.
    pub fn is_by_right(self) -> bool {
        matches!(self, Self::Revoked | Self::Expired | Self::Locked)
    }
}

/// The result of playing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlayedView {
    /// Messages published, each checked first. In ROS 2 every subscriber that acknowledges has acknowledged them.
    pub published: u64,
    /// Records refused by a check, or that the graph or domain cannot take; none of them was published.
    pub refused: u64,
    /// Records whose bytes are missing in the store.
    pub missing: u64,
    /// Messages that a subscriber missed because it read too slowly; in ROS 2 also those that it never acknowledged.
    pub dropped: u64,
    /// Published messages of which nobody knows whether all subscribers got them: best-effort ones do not acknowledge.
    pub unconfirmed: u64,
    /// The time it took.
    pub seconds: f64,
    /// Why it ended.
    pub ended_by: PlayEnd,
    /// The reasons for refusing records, with counts; the first 20.
    pub reasons: Vec<(String, u64)>,
    /// The topics as played, with their messages.
    pub topics: Vec<(String, u64)>,
}
