//! What requests choose from and ask for: keys, epochs, records, recordings, playback, acts of the administrator.

use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::model::{IncidentName, Party, RecordKind, RecordState, Timestamp, TopicName, TopicPattern, TypeName, clean};
use crate::ros::recording::{ChunkCompression, RecordingFormat};

/// Which key a key file holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KeyKind {
    /// K_C: 16 bytes.
    Sm4,
    /// d_C: the SM2 signing key.
    Sm2,
    /// The secp256k1 key of the EOA.
    Eoa,
}

/// Which epochs a grant opens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Epochs {
    /// From the current epoch on.
    #[default]
    Current,
    /// Also every earlier one.
    All,
}

/// Which records to list.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UploadQuery {
    /// Only of this owner (shared records).
    pub owner: Option<Party>,
    /// Only of this topic.
    pub topic: Option<TopicName>,
    /// Only of this kind; `None` = captured messages.
    pub kind: Option<RecordKind>,
    /// Only of this message type.
    pub type_name: Option<TypeName>,
    /// Only if the name of the topic or type contains each of these.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub words: Vec<String>,
    /// Only with all of these tags (name, value) in the sealed head.
    pub tags: Vec<(String, String)>,
    /// Only in this incident of the profile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub incident: Option<IncidentName>,
    /// Only in this state.
    pub state: Option<RecordState>,
    /// Captured at or after.
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    /// Continue after this cursor (`next` of the previous page).
    pub after: Option<String>,
    /// At most this many, 1 to 1,000.
    pub limit: usize,
    /// Newest first (console) instead of oldest first.
    pub newest_first: bool,
}

/// Which quarantined messages: all of a topic, or these.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// All of this topic.
    pub topic: Option<TopicName>,
    /// Ids; only if no topic is given.
    pub ids: Vec<String>,
}

/// A pair of SM2 keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairKind {
    Signing,
    Envelope,
}

/// A recording to import.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImportWishes {
    /// The file or folder, absolute; read by the site, which runs as the same user.
    pub path: PathBuf,
    /// Only topics that match any of these patterns; empty = all.
    pub topics: Vec<TopicPattern>,
    /// Tags for the sealed heads.
    pub tags: Vec<(String, String)>,
    /// Import again what was imported before.
    pub again: bool,
}

/// A folder whose recordings are sealed while a recorder writes them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FollowWishes {
    /// The folder, absolute; it need not be there yet. Read by the site, which runs as the same user.
    pub folder: PathBuf,
    /// Only topics that match any of these patterns; empty = all.
    pub topics: Vec<TopicPattern>,
    /// Tags for the sealed heads.
    pub tags: Vec<(String, String)>,
    /// End when the recording is closed and its proofs are written.
    pub until_closed: bool,
    /// Also write a copy of each file with its proof as an attachment.
    pub attach: bool,
}

/// A recording to write from records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportWishes {
    /// The file, absolute, which must not exist; written by the site, which runs as the same user.
    pub path: PathBuf,
    pub format: RecordingFormat,
    /// The compression of chunks.
    pub compression: ChunkCompression,
    /// Only records of this owner.
    pub owner: Option<Party>,
    /// Only topics that match any of these patterns; empty = all.
    pub topics: Vec<TopicPattern>,
    /// Captured at or after.
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    /// Also records that are not confirmed on the chain.
    pub unanchored: bool,
}

/// The slowest and the fastest playback, thousandths of the recorded pace.
const RATES: std::ops::RangeInclusive<f64> = 0.001..=1000.0;

/// When messages are played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// Stored records, one after the other, as fast as they are checked and read.
    #[default]
    AtOnce,
    /// Stored records, at this multiple of the pace of their capture.
    Rated {
        /// Thousandths; 1000 = as captured.
        thousandths: u64,
    },
    /// Records verified from now on, as soon as they are.
    Follow,
}

impl Pace {
    pub const AS_CAPTURED: Self = Self::Rated { thousandths: 1000 };

    /// At this multiple of the pace of the capture.
    pub fn times(factor: f64) -> Result<Self, String> {
        if !RATES.contains(&factor) {
            let (slowest, fastest) = (RATES.start(), RATES.end());
            return Err(format!("{factor} is not a playback rate; use a number from {slowest} to {fastest}"));
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within RATES")]
        let thousandths = (factor * 1000.0).round() as u64;
        Ok(Self::Rated { thousandths })
    }
}

/// Another name for a topic, `A:=B`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remap {
    /// The name as captured.
    pub from: TopicName,
    /// The name as played.
    pub to: TopicName,
}

impl FromStr for Remap {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || format!("'{}' is not a remapping; use /captured/name:=/played/name", clean(text, 120));
        let (from, to) = text.split_once(":=").ok_or_else(wrong)?;
        Ok(Self { from: from.parse().map_err(|_| wrong())?, to: to.parse().map_err(|_| wrong())? })
    }
}

/// The shared records to be played, when, where, and under which names.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PlayWishes {
    /// Only records of this owner.
    pub owner: Option<Party>,
    /// Only topics that match any of these patterns; empty = all.
    pub topics: Vec<TopicPattern>,
    /// Captured at or after.
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    pub pace: Pace,
    /// Also the captured time, as `/clock`.
    pub clock: bool,
    /// Prefix for every name.
    pub prefix: Option<TopicName>,
    /// Replacements for names; the prefix is not applied to these.
    pub remaps: Vec<Remap>,
    /// The ROS master; `None` = this site's own.
    pub master: Option<String>,
    /// The ROS 2 domain, instead of a ROS 1 graph.
    pub domain: Option<u16>,
}

/// What the contract's administrator does.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "act")]
pub enum Administration {
    /// Lets an account register while registration is closed.
    Admit {
        account: Party,
    },
    Dismiss {
        account: Party,
    },
    /// Blocks all changes by an account except those that take rights away.
    Suspend {
        account: Party,
    },
    /// Frees a suspended account.
    Restore {
        account: Party,
    },
    /// Opens registration to all, or closes it.
    Open {
        /// Whether anyone may register.
        open: bool,
    },
    /// Blocks all changes except those that take rights away, or allows them again.
    Pause {
        /// Whether they are blocked.
        paused: bool,
        /// For how long, seconds; `None` = a day.
        seconds: Option<u64>,
    },
    /// Proposes the account that continues for a lost one.
    Propose {
        /// The account whose key is lost.
        lost: Party,
        successor: Party,
    },
    /// Stops a pending succession; the recovery account may do so, too.
    Cancel {
        lost: Party,
    },
    /// Completes a succession whose delay is over; anybody may.
    Complete {
        lost: Party,
    },
    /// Names the next administrator.
    HandOver {
        account: Party,
    },
    /// Takes over, as the account that was named.
    Accept,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_kept_in_thousandths_and_nonsense_is_refused() {
        assert_eq!(Pace::times(1.0), Ok(Pace::AS_CAPTURED));
        assert_eq!(Pace::times(0.25), Ok(Pace::Rated { thousandths: 250 }));
        for wrong in [0.0, -1.0, 1001.0, f64::NAN, f64::INFINITY] {
            assert!(Pace::times(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn remappings_are_two_graph_names() {
        let remap: Remap = "/odom:=/theirs/odom".parse().expect("two names");
        assert_eq!((remap.from.as_str(), remap.to.as_str()), ("/odom", "/theirs/odom"));
        for wrong in ["/odom", "odom:=/x", "/odom:=", "/odom:=/a b", ":=/x"] {
            assert!(wrong.parse::<Remap>().is_err(), "{wrong}");
        }
    }
}
