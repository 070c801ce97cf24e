//! Topics of the graph, and the results of capturing them.

use serde::{Deserialize, Serialize};

use super::UnreachedView;
use crate::model::{Timestamp, TopicName};
use crate::store::CoveragePart;

/// Why a watched topic is not captured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeldUp {
    /// The profile's keys have not been unlocked in this site.
    WaitsForKey,
    /// A console has paused capture, or the disk is full.
    Paused,
}

/// One topic of the graph.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TopicRow {
    /// Its name, cleaned.
    pub topic: String,
    /// Its type, cleaned, if known.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Its version of ROS: 1 or 2.
    pub ros: u8,
    /// The type's hash (`RIHS01_…`), cleaned, if a ROS 2 publisher gave it.
    pub type_hash: Option<String>,
    /// What all ROS 2 publishers offer, such as `reliable volatile`; `None` in ROS 1.
    pub qos: Option<String>,
    /// Node names, cleaned.
    pub publishers: Vec<String>,
    /// Of the publishers of a captured topic, those that cannot be read.
    pub unreached: Vec<UnreachedView>,
    /// Whether this profile watches it.
    pub watched: bool,
    /// Why it is watched but not captured; `None` = it is captured, or not watched.
    pub held_up: Option<HeldUp>,
    /// Whether a simulated robot of this site publishes it.
    pub simulated: bool,
    /// Messages a second over the last 5 s; `None` = not measured.
    pub hz: Option<f64>,
    /// Bytes a second over the last 5 s; `None` = not measured.
    pub bytes_per_second: Option<f64>,
    /// Messages of it that this profile has captured.
    pub messages: u64,
    /// Lost before capture (header.seq gaps).
    pub lost_in_transport: u64,
    /// Dropped by the recorder.
    pub lost_in_recorder: u64,
    /// Left out by the rate or sampling of the topic's rule; these are not lost.
    pub left_out: u64,
    /// Arrival of the last message.
    pub last_message: Option<Timestamp>,
    /// Publishers pinned to it; 0 = none yet.
    pub pins: u64,
    /// Of `publishers`, those that are not pinned, if any is.
    pub unpinned: Vec<String>,
    /// Messages of it that this profile holds in quarantine.
    pub quarantined: u64,
    /// Whether an alarm about a publisher of it is open.
    pub alarm: bool,
}

/// When there are records of a topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoverageView {
    /// The topic.
    pub topic: TopicName,
    /// The robot whose records alone are shown, if one was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Robots that recorded something of the topic, by name. What they lost is sealed in their reports, so it is in no
    /// part.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub robots: Vec<String>,
    /// Beginning of the span.
    pub since: Timestamp,
    /// Its end.
    pub until: Timestamp,
    /// Capture of the first record ever.
    pub first: Option<Timestamp>,
    /// Capture of the last.
    pub last: Option<Timestamp>,
    /// The parts of the span, oldest first, all of the same length.
    pub parts: Vec<CoveragePart>,
}

impl CoverageView {
    /// A sign for each part.
    pub fn strip(&self) -> String {
        self.parts.iter().map(CoveragePart::sign).collect()
    }

    /// The meaning of the signs that occur.
    pub fn legend(&self) -> String {
        const MEANINGS: [(char, &str); 5] =
            [('█', "recorded"), ('·', "nothing"), ('L', "messages lost"), ('Q', "quarantined"), ('T', "tampered")];
        let strip = self.strip();
        let there = MEANINGS.iter().filter(|(sign, _)| strip.contains(*sign));
        there.map(|(sign, text)| format!("{sign} {text}")).collect::<Vec<_>>().join("  ")
    }
}

/// Figures of one topic in a capture's summary.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TopicSummary {
    /// Topic.
    pub topic: String,
    /// Type, if a message was seen.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Messages captured.
    pub captured: u64,
    /// Of these, verified.
    pub verified: u64,
    /// Of these, quarantined: their publisher is not a pinned one.
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
    /// Publishers that were listed at its end and could not be read.
    pub unreached: Vec<UnreachedView>,
}

/// The result of a capture.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CaptureSummary {
    /// Messages captured.
    pub captured: u64,
    /// Of these, verified: re-read from the store, digest equal to the chain, signature valid.
    pub verified: u64,
    /// Of these, quarantined: their publisher is not a pinned one.
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
    /// Left out on purpose (bag import).
    pub skipped: u64,
    /// Per topic.
    pub topics: Vec<TopicSummary>,
}
