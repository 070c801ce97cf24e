//! What is told of incidents.

use serde::{Deserialize, Serialize};

use crate::model::{IncidentName, Timestamp};

/// A note about an incident.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncidentNoteView {
    /// When it was written.
    pub at: Timestamp,
    /// Its text. Cleaned.
    pub text: String,
}

/// What an incident holds of one topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpanCoverageView {
    /// The topic. Cleaned.
    pub topic: String,
    /// Captured messages that are records, without those held back.
    pub records: u64,
    /// Bytes of these messages.
    pub bytes: u64,
    /// When the first of them was captured.
    pub first: Option<Timestamp>,
    /// When the last was.
    pub last: Option<Timestamp>,
    /// How many of them retention had deleted before.
    pub deleted: u64,
    /// Messages that are held back in quarantine.
    pub quarantined: u64,
    /// Messages that were lost in stretches of time that touch the span.
    pub lost: u64,
}

/// An incident and what it holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncidentView {
    /// Its name.
    pub name: IncidentName,
    /// Whether it was not closed yet.
    pub open: bool,
    /// Holds records captured then or later.
    pub since: Timestamp,
    /// And before then; `None` = it goes on.
    pub until: Option<Timestamp>,
    /// When it was opened.
    pub opened_at: Timestamp,
    /// When it was closed.
    pub closed_at: Option<Timestamp>,
    /// The topics it is about; empty = all. Cleaned.
    pub topics: Vec<String>,
    /// Oldest first.
    pub notes: Vec<IncidentNoteView>,
    /// Records in it, of all topics.
    pub records: u64,
    /// Bytes of their messages.
    pub bytes: u64,
    /// What there is of each topic.
    pub coverage: Vec<SpanCoverageView>,
}
