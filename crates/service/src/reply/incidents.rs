//! Answers about incidents.

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

/// An incident's records of one topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpanCoverageView {
    /// The topic. Cleaned.
    pub topic: String,
    /// Captured messages that are records, without quarantined ones.
    pub records: u64,
    /// Bytes of these messages.
    pub bytes: u64,
    /// When the first of them was captured.
    pub first: Option<Timestamp>,
    /// When the last was.
    pub last: Option<Timestamp>,
    /// How many of them retention had already deleted.
    pub deleted: u64,
    /// Messages in quarantine.
    pub quarantined: u64,
    /// Messages lost in stretches of time that overlap the span.
    pub lost: u64,
}

/// An incident and its records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncidentView {
    /// Its name.
    pub name: IncidentName,
    /// Whether it is still open.
    pub open: bool,
    /// Holds records captured at this time or later.
    pub since: Timestamp,
    /// And before this time; `None` = it is still open.
    pub until: Option<Timestamp>,
    /// When it was opened.
    pub opened_at: Timestamp,
    /// When it was closed.
    pub closed_at: Option<Timestamp>,
    /// Its topics; empty = all. Cleaned.
    pub topics: Vec<String>,
    /// Oldest first.
    pub notes: Vec<IncidentNoteView>,
    /// Its records, of all topics.
    pub records: u64,
    /// Bytes of their messages.
    pub bytes: u64,
    /// Its records by topic.
    pub coverage: Vec<SpanCoverageView>,
}
