//! What requests choose from: keys, epochs, records, recordings, playback, acts of the administrator.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::model::{IncidentName, Party, RecordKind, RecordState, Timestamp, TopicName, TopicPattern, TypeName, clean};
use crate::reply::{Result, input};
use crate::ros::recording::{ChunkCompression, RecordingFormat};

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

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GrantFrom {
    /// A new epoch: nothing that was captured before.
    Now,
    /// The current epoch, with what is sealed in it already.
    #[default]
    Current,
    /// This epoch; the first is 1.
    Epoch(u64),
    /// The first epoch with a record captured at this time or later.
    Time(Timestamp),
}

impl GrantFrom {
    /// `now`, `epoch` for the current one, `start`, an epoch's number, or a time as `back` reads it.
    pub fn read<E: fmt::Display>(text: &str, back: impl FnOnce(&str) -> Result<Timestamp, E>) -> Result<Self> {
        match text.trim() {
            "now" => Ok(Self::Now),
            "epoch" => Ok(Self::Current),
            "start" => Ok(Self::Epoch(1)),
            text => match text.parse() {
                Ok(epoch) if !text.starts_with('+') => Ok(Self::Epoch(epoch)),
                Ok(_) | Err(_) => {
                    let wrong = |error| input(format!("enter now, epoch, start or a time: {error}"));
                    back(text).map(Self::Time).map_err(wrong)
                }
            },
        }
    }
}

impl fmt::Display for GrantFrom {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Now => formatter.write_str("now"),
            Self::Current => formatter.write_str("epoch"),
            Self::Epoch(1) => formatter.write_str("start"),
            Self::Epoch(epoch) => write!(formatter, "{epoch}"),
            Self::Time(moment) => write!(formatter, "{moment}"),
        }
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UploadQuery {
    pub owner: Option<Party>,
    pub topic: Option<TopicPattern>,
    /// An enrolled robot, or the first part of its topics.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// `None` = captured messages.
    pub kind: Option<RecordKind>,
    pub type_name: Option<TypeName>,
    /// Words that the name of the topic or type must contain.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub words: Vec<String>,
    /// Names and values in the sealed head; all must match.
    pub tags: Vec<(String, String)>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub incident: Option<IncidentName>,
    pub state: Option<RecordState>,
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    /// `next` of the previous page.
    pub after: Option<String>,
    /// 1 to 1,000.
    pub limit: usize,
    /// Otherwise oldest first.
    pub newest_first: bool,
}

/// Quarantined messages: all of the topics that match, or some.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    pub topic: Option<TopicPattern>,
    /// Only without a topic.
    pub ids: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImportWishes {
    /// Absolute file or folder; read by the site, which runs as the same user.
    pub path: PathBuf,
    /// Empty = all.
    pub topics: Vec<TopicPattern>,
    pub tags: Vec<(String, String)>,
    /// Import again what was imported before.
    pub again: bool,
}

/// A folder whose recordings are sealed while a recorder writes them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FollowWishes {
    /// Absolute; need not exist yet. Read by the site, which runs as the same user.
    pub folder: PathBuf,
    /// Empty = all.
    pub topics: Vec<TopicPattern>,
    pub tags: Vec<(String, String)>,
    /// End when the recording is closed and its proofs are written.
    pub until_closed: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportWishes {
    /// Absolute; must not exist. Written by the site, which runs as the same user.
    pub path: PathBuf,
    pub format: RecordingFormat,
    pub compression: ChunkCompression,
    pub owner: Option<Party>,
    /// Empty = all.
    pub topics: Vec<TopicPattern>,
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    /// Also records not confirmed on the chain.
    pub unanchored: bool,
}

/// Slowest and fastest playback, as multiples of the recorded pace.
const RATES: std::ops::RangeInclusive<f64> = 0.001..=1000.0;

/// When messages are played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// Stored records, one after the other, as fast as they are checked and read.
    #[default]
    AtOnce,
    /// Stored records, at this multiple of the captured pace.
    Rated {
        /// Thousandths; 1000 = as captured.
        thousandths: u64,
    },
    /// Records verified from now on, immediately.
    Follow,
}

impl Pace {
    pub const AS_CAPTURED: Self = Self::Rated { thousandths: 1000 };

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

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remap {
    pub from: TopicName,
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

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PlayWishes {
    pub owner: Option<Party>,
    /// Empty = all.
    pub topics: Vec<TopicPattern>,
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    pub pace: Pace,
    /// Also publish the captured time as `/clock`.
    pub clock: bool,
    /// For every name.
    pub prefix: Option<TopicName>,
    /// Replace names; the prefix does not apply to these.
    pub remaps: Vec<Remap>,
    /// ROS master; `None` = this site's own.
    pub master: Option<String>,
    /// ROS 2 domain, instead of a ROS 1 graph.
    pub domain: Option<u16>,
}

/// What the contract's administrator does.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "act")]
pub enum Administration {
    /// Lets an account register while registration is closed.
    Admit { account: Party },
    /// Withdraws an admission.
    Dismiss { account: Party },
    /// Blocks all changes by an account except those that take rights away.
    Suspend { account: Party },
    /// Frees a suspended account.
    Restore { account: Party },
    /// Opens registration to all, or closes it.
    Open { open: bool },
    /// Blocks all changes except those that take rights away, for a day unless `seconds` are given, or allows them.
    Pause { paused: bool, seconds: Option<u64> },
    /// Proposes the account that continues for a lost one.
    Propose { lost: Party, successor: Party },
    /// Stops a pending succession; the recovery account may do so too.
    Cancel { lost: Party },
    /// Completes a succession whose delay is over; anybody may.
    Complete { lost: Party },
    /// Names the next administrator.
    HandOver { account: Party },
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

#[cfg(test)]
mod grant_tests {
    use super::*;
    use crate::model::{Clock, ErrorKind};

    #[test]
    fn from_when_on_is_written_as_it_is_read() {
        let clock = Clock { now: Timestamp::from_seconds(1_700_000_000), ..Clock::default() };
        let read = |text: &str| GrantFrom::read(text, |text| clock.back(text));
        let hour_ago = Timestamp::from_seconds(1_700_000_000 - 3_600);
        for (text, from) in [
            ("now", GrantFrom::Now),
            (" epoch ", GrantFrom::Current),
            ("start", GrantFrom::Epoch(1)),
            ("7", GrantFrom::Epoch(7)),
            ("1h", GrantFrom::Time(hour_ago)),
            ("2023-11-14T21:13:20Z", GrantFrom::Time(hour_ago)),
        ] {
            assert_eq!(read(text).expect(text), from);
            assert_eq!(read(&from.to_string()).expect("written"), from);
        }
        for wrong in ["", "soon", "-1", "epoch 2"] {
            let failure = read(wrong).expect_err(wrong);
            assert_eq!(failure.kind, ErrorKind::Input);
            assert!(failure.message.starts_with("enter now, epoch, start or a time: "), "{failure}");
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairKind {
    Signing,
    Envelope,
}
