//! Answers about pinned publishers and quarantined messages.

use serde::{Deserialize, Serialize};

use crate::model::{Digest, PinMode, Publisher, Timestamp};

use super::RecordView;

/// A pinned publisher.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinView {
    /// The topic, cleaned.
    pub topic: String,
    /// The publisher, cleaned.
    #[serde(flatten)]
    pub publisher: Publisher,
    /// `first` (seen first), `operator`, or `settings`.
    pub source: String,
    /// Pinned since; `None` for the settings.
    pub at: Option<Timestamp>,
}

/// An alarm about a publisher.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlarmView {
    /// The topic, cleaned.
    pub topic: String,
    /// Its subject, cleaned: a publisher as `topics pin` takes it, or a URI.
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
    /// How topics get their pins.
    pub mode: PinMode,
    /// Pinned publishers.
    pub pins: Vec<PinView>,
    /// Alarms about others.
    pub alarms: Vec<AlarmView>,
}

/// A quarantined message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldView {
    /// The record.
    #[serde(flatten)]
    pub record: RecordView,
    /// The reason, in one word.
    pub reason: String,
    /// Its sender, cleaned.
    pub publisher: String,
    /// The quarantine record that counts it.
    pub report: Option<Digest>,
}

/// Quarantined messages, oldest first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantineView {
    /// The total of quarantined messages.
    pub messages: u64,
    /// The oldest of them, for the requested topic.
    pub records: Vec<HeldView>,
}

/// A decision about quarantined messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecidedView {
    /// `released` or `discarded`.
    pub decision: String,
    /// Messages decided about.
    pub messages: u64,
    /// Quarantine records that count the discarded messages; they are on the chain.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub reports: Vec<Digest>,
    /// In words.
    pub text: String,
}
