//! Requests about playing shared records into a ROS graph or domain.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::model::{Party, Timestamp, TopicName, TopicPattern, clean};

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
    /// As captured.
    pub const AS_CAPTURED: Self = Self::Rated { thousandths: 1000 };

    /// At this multiple of the pace of the capture.
    ///
    /// # Errors
    /// What to write instead.
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
    /// Captured before.
    pub until: Option<Timestamp>,
    /// When.
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
