//! What a bundle of evidence is to hold.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::model::{IncidentName, Timestamp, TopicName};

/// Own records for a bundle; all where nothing narrows it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EvidenceWishes {
    /// The file, absolute; must not exist. Written by the site, which is of the same user.
    pub file: PathBuf,
    /// These records, by their ids.
    #[serde(default)]
    pub records: Vec<String>,
    /// Those of this topic.
    #[serde(default)]
    pub topic: Option<TopicName>,
    /// Those in this incident.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub incident: Option<IncidentName>,
    /// Captured at or after.
    #[serde(default)]
    pub since: Option<Timestamp>,
    /// Captured before.
    #[serde(default)]
    pub until: Option<Timestamp>,
    /// These are disclosed, by their ids.
    #[serde(default)]
    pub reveal: Vec<String>,
}
