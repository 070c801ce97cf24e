//! What is told of pinned publishers and of what is held back.

use serde::{Deserialize, Serialize};

use crate::model::{Digest, PinMode, Publisher, Timestamp};

use super::RecordView;

/// A pinned publisher.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinView {
    /// The topic, cleaned.
    pub topic: String,
    /// Who may publish it, cleaned.
    #[serde(flatten)]
    pub publisher: Publisher,
    /// `first` (seen first), `operator`, or `settings`.
    pub source: String,
    /// Since when; `None` for the settings.
    pub at: Option<Timestamp>,
}

/// An alarm about a publisher.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlarmView {
    /// The topic, cleaned.
    pub topic: String,
    /// Whom it is about, cleaned: a publisher as `topics pin` takes it, or a URI.
    pub publisher: String,
    /// `new`, `host`, `type`, `replaced`, `undecided` or `unconfirmed`.
    pub reason: String,
    /// When it was raised.
    pub at: Timestamp,
    /// Whether nobody has decided about the topic since.
    pub open: bool,
}

/// A profile's pins and alarms.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinsView {
    /// How topics come to their pins.
    pub mode: PinMode,
    /// Pinned publishers.
    pub pins: Vec<PinView>,
    /// Alarms about others.
    pub alarms: Vec<AlarmView>,
}

/// A message that is held back.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldView {
    /// The record.
    #[serde(flatten)]
    pub record: RecordView,
    /// Why, in one word.
    pub reason: String,
    /// Who sent it, cleaned.
    pub publisher: String,
    /// The quarantine record that counts it.
    pub report: Option<Digest>,
}

/// What is held back, oldest first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantineView {
    /// Messages in quarantine in all.
    pub messages: u64,
    /// The oldest of them, of the topic asked for.
    pub records: Vec<HeldView>,
}

/// What was decided about held messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecidedView {
    /// `released` or `discarded`.
    pub decision: String,
    /// Messages decided about.
    pub messages: u64,
    /// Quarantine records that count what was discarded; they stand on the chain.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub reports: Vec<Digest>,
    /// In words.
    pub text: String,
}
