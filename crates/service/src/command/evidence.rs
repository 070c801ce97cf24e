//! What a bundle of evidence is to contain.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::model::{IncidentName, Timestamp, TopicName};

/// Own records for a bundle; all if nothing narrows it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EvidenceWishes {
    /// The file, absolute; must not exist. Written by the site, which runs as the same user.
    pub file: PathBuf,
    /// These records, by their ids.
    pub records: Vec<String>,
    /// Those of this topic.
    pub topic: Option<TopicName>,
    /// Those in this incident.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub incident: Option<IncidentName>,
    /// Captured at or after.
    pub since: Option<Timestamp>,
    /// Captured before.
    pub until: Option<Timestamp>,
    /// The ids of records to disclose.
    pub reveal: Vec<String>,
}
