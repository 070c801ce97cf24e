//! The whole site at a glance: health of its parts, the life line of its records.

use serde::{Deserialize, Serialize};

use crate::model::ProfileName;

/// How a part of the site is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HealthLevel {
    /// Working.
    Ok,
    /// Starting, or trying again.
    Waiting,
    /// Not working; an operator is needed.
    Failed,
    /// Not part of this site.
    Absent,
}

/// Health of one part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartHealth {
    /// `ros`, `chain`, `vault` or `gateway`.
    pub part: String,
    /// How it is.
    pub level: HealthLevel,
    /// In words: `embedded master http://127.0.0.1:4711`, `retry in 4 s`.
    pub text: String,
}

/// How many records passed each station of the life line (data records of one profile).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LifeLine {
    /// Taken from the topic.
    pub captured: u64,
    /// Sealed and fsynced.
    pub sealed: u64,
    /// In the vault.
    pub stored: u64,
    /// In a block.
    pub anchored: u64,
    /// Deep enough.
    pub confirmed: u64,
    /// Re-read and checked.
    pub verified: u64,
    /// Not yet verified.
    pub pending: u64,
    /// Held back.
    pub quarantined: u64,
    /// Dropped before acknowledgement, counted, or discarded out of quarantine.
    pub dropped: u64,
    /// Of these discarded by the operator out of quarantine.
    #[serde(default)]
    pub discarded: u64,
    /// Differ from the chain.
    pub tampered: u64,
    /// Never arrived here (header.seq gaps).
    pub lost_in_transport: u64,
}

/// The whole site at a glance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SiteView {
    /// Parts and how they are.
    pub health: Vec<PartHealth>,
    /// This profile's records.
    pub life: LifeLine,
    /// Simulated robots running.
    pub robots: u16,
    /// Profiles open in this site.
    pub profiles: Vec<ProfileName>,
}
