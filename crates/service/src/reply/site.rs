//! The whole site at a glance: health of its parts, the life line of its records.

use serde::{Deserialize, Serialize};

use crate::model::{ProfileName, Timestamp};

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
    /// In words: `embedded master http://127.0.0.1:4711`, `retry in 4 s: …`.
    pub text: String,
    /// Since when it has not been well, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since: Option<Timestamp>,
    /// Seconds between two attempts, where it is tried again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry: Option<u64>,
}

/// How many records passed each station of the life line (data records of one profile). At every moment
/// captured = verified + pending + right ended + quarantined + dropped + tampered, where captured is counted by itself.
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
    /// Their signer may not sign for their owner now; anchored when that right is back.
    #[serde(default)]
    pub right_ended: u64,
    /// Held back.
    pub quarantined: u64,
    /// Dropped before acknowledgement, counted, or discarded out of quarantine.
    pub dropped: u64,
    /// Of these never acknowledged: they came while memory or disk was full, or without a key.
    #[serde(default)]
    pub lost_in_recorder: u64,
    /// Of these discarded by the operator out of quarantine.
    #[serde(default)]
    pub discarded: u64,
    /// Differ from the chain.
    pub tampered: u64,
    /// Never arrived here (header.seq gaps); no part of captured.
    pub lost_in_transport: u64,
    /// Messages of all profiles in memory that are not acknowledged yet; no part of captured.
    #[serde(default)]
    pub waiting: u64,
    /// Of the verified ones those whose ciphertext retention has deleted; header, signature and proof are there.
    #[serde(default)]
    pub deleted: u64,
    /// Whether the counts add up, in all and for each topic.
    #[serde(default)]
    pub conserved: bool,
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
    /// The process that the site runs in; 0 = one that does not tell.
    #[serde(default)]
    pub process: u32,
    /// Background tasks and how they are.
    #[serde(default)]
    pub tasks: Vec<super::TaskView>,
    /// What waits to be sealed.
    #[serde(default)]
    pub queue: QueueView,
    /// How long records of this site took from capture to verified: times of at most so many microseconds, and how many
    /// records took one of these.
    #[serde(default)]
    pub verified_after: Vec<(u64, u64)>,
    /// Alerts that stand, of all accounts; none where no site runs that judges.
    #[serde(default)]
    pub alerts: Vec<super::AlertView>,
    /// Those that were over lately, the newest first.
    #[serde(default)]
    pub alerts_over: Vec<super::EndedAlert>,
}

/// The ring between capture and sealer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct QueueView {
    /// Messages in it.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// The most bytes it takes; beyond, the newest message is dropped and counted.
    pub capacity: u64,
}
