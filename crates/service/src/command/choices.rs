//! What a command chooses from: a key, epochs, records, quarantined messages.

use serde::{Deserialize, Serialize};

use crate::model::{IncidentName, Party, RecordKind, RecordState, Timestamp, TopicName, TypeName};

/// Which key a key file holds.
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

/// Which epochs a grant opens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Epochs {
    /// From the current epoch on.
    #[default]
    Current,
    /// Also every earlier one.
    All,
}

/// Which records to list.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UploadQuery {
    /// Only of this owner (shared records).
    pub owner: Option<Party>,
    /// Only of this topic.
    pub topic: Option<TopicName>,
    /// Only of this kind; `None` = captured messages.
    pub kind: Option<RecordKind>,
    /// Only of this message type.
    pub type_name: Option<TypeName>,
    /// Only if the name of the topic or type contains each of these.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub words: Vec<String>,
    /// Only with all of these tags (name, value) in the sealed head.
    pub tags: Vec<(String, String)>,
    /// Only in this incident of the profile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub incident: Option<IncidentName>,
    /// Only in this state.
    pub state: Option<RecordState>,
    /// Captured at or after.
    pub since: Option<Timestamp>,
    /// Captured before.
    pub until: Option<Timestamp>,
    /// Continue after this cursor (`next` of the previous page).
    pub after: Option<String>,
    /// At most this many, 1 to 1,000.
    pub limit: usize,
    /// Newest first (console) instead of oldest first.
    pub newest_first: bool,
}

/// Which quarantined messages: all of a topic, or these.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// All of this topic.
    pub topic: Option<TopicName>,
    /// Ids; only if no topic is given.
    pub ids: Vec<String>,
}

/// A pair of SM2 keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairKind {
    /// (d_C, P_C).
    Signing,
    /// (d_E, P_E).
    Envelope,
}
