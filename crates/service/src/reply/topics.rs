//! Topics of the graph, and what captures of them did.

use serde::{Deserialize, Serialize};

use crate::model::{Timestamp, TopicName, TypeName};

/// Why a watched topic is not captured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeldUp {
    /// The profile's keys have not been opened in this site.
    WaitsForKey,
    /// A console holds capture back, or the disk is full.
    Paused,
}

/// One topic of the graph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TopicRow {
    /// Its name, cleaned.
    pub topic: String,
    /// Its type, cleaned, where known.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Which ROS it is of: 1 or 2.
    #[serde(default = "first")]
    pub ros: u8,
    /// The type's hash (`RIHS01_…`), cleaned, where a publisher of ROS 2 told it.
    #[serde(default)]
    pub type_hash: Option<String>,
    /// What all publishers of ROS 2 offer, as `reliable volatile`; `None` in ROS 1.
    #[serde(default)]
    pub qos: Option<String>,
    /// Node names, cleaned.
    pub publishers: Vec<String>,
    /// Whether this profile watches it.
    pub watched: bool,
    /// Why it is not captured though it is watched; `None` = it is, or it is not watched.
    #[serde(default)]
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
    #[serde(default)]
    pub left_out: u64,
    /// Arrival of the last message.
    pub last_message: Option<Timestamp>,
    /// Publishers that are pinned to it; 0 = none yet.
    #[serde(default)]
    pub pins: u64,
    /// Of `publishers` those that are not pinned, where any is.
    #[serde(default)]
    pub unpinned: Vec<String>,
    /// Messages of it that this profile holds in quarantine.
    #[serde(default)]
    pub quarantined: u64,
    /// Whether an alarm about a publisher of it is open.
    #[serde(default)]
    pub alarm: bool,
}

/// What there is of one part of a span of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoveragePart {
    /// Its beginning.
    pub at: Timestamp,
    /// Whether there are records that are neither held back nor altered.
    pub data: bool,
    /// Whether there are records that are held back, or were and then discarded.
    pub quarantined: bool,
    /// Whether there are records whose stored bytes are wrong.
    pub tampered: bool,
    /// Messages that were noticed to be lost in it.
    pub lost: u64,
}

/// When there are records of a topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoverageView {
    /// The topic.
    pub topic: TopicName,
    /// Beginning of the span.
    pub since: Timestamp,
    /// Its end.
    pub until: Timestamp,
    /// Capture of the first record ever.
    pub first: Option<Timestamp>,
    /// Capture of the last.
    pub last: Option<Timestamp>,
    /// The parts of the span, oldest first, of one length.
    pub parts: Vec<CoveragePart>,
}

impl CoveragePart {
    /// The sign of a part: the worst that there is of it.
    pub fn sign(&self) -> char {
        match self {
            Self { tampered: true, .. } => 'T',
            Self { quarantined: true, .. } => 'Q',
            Self { lost: 1.., .. } => 'L',
            Self { data: true, .. } => '█',
            _ => '·',
        }
    }
}

impl CoverageView {
    /// A sign for each part.
    pub fn strip(&self) -> String {
        self.parts.iter().map(CoveragePart::sign).collect()
    }

    /// What the signs mean, of those that there are.
    pub fn legend(&self) -> String {
        const MEANINGS: [(char, &str); 5] =
            [('█', "recorded"), ('·', "nothing"), ('L', "messages lost"), ('Q', "quarantined"), ('T', "tampered")];
        let strip = self.strip();
        let there = MEANINGS.iter().filter(|(sign, _)| strip.contains(*sign));
        there.map(|(sign, text)| format!("{sign} {text}")).collect::<Vec<_>>().join("  ")
    }
}

/// Sites of before knew ROS 1 alone.
fn first() -> u8 {
    1
}

/// A topic that is watched.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WatchView {
    /// Its name.
    pub topic: TopicName,
    /// The type that is asked of it.
    #[serde(rename = "type")]
    pub type_name: Option<TypeName>,
}

/// Figures of one topic in a capture's summary.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TopicSummary {
    /// Topic.
    pub topic: String,
    /// Type, where a message was seen.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Messages captured.
    pub captured: u64,
    /// Of these verified.
    pub verified: u64,
    /// Of these held back: their publisher is not a pinned one.
    #[serde(default)]
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
}

/// What a capture did.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CaptureSummary {
    /// Messages captured.
    pub captured: u64,
    /// Of these verified: re-read from the vault, digest equal to the chain, signature valid.
    pub verified: u64,
    /// Of these held back: their publisher is not a pinned one.
    #[serde(default)]
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
    /// Left out on purpose (bag import).
    pub skipped: u64,
    /// Per topic.
    pub topics: Vec<TopicSummary>,
}
