//! The whole site at a glance: health of its parts, its records by state.

use serde::{Deserialize, Serialize};

use crate::model::{ProfileName, Timestamp};
use crate::store::CacheState;

/// The state of a part of the site.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HealthLevel {
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
    /// `ros`, `chain`, `store`, `cache` or `gateway`.
    pub part: String,
    pub level: HealthLevel,
    /// In words: `embedded master http://127.0.0.1:4711`, `retry in 4 s: …`.
    pub text: String,
    /// Since when it has not been well, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since: Option<Timestamp>,
    /// Seconds until the next attempt, if it is retried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry: Option<u64>,
}

/// How many records passed each stage (data records of one profile). At every moment captured = verified + pending +
/// right ended + quarantined + dropped + tampered, where captured has a counter of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LifeLine {
    /// Taken from the topic.
    pub captured: u64,
    /// Sealed and fsynced, row and ciphertext in one commit.
    pub stored: u64,
    pub anchored: u64,
    pub confirmed: u64,
    pub verified: u64,
    pub pending: u64,
    /// Their signer may not sign for their owner now; anchored when that right returns.
    pub right_ended: u64,
    pub quarantined: u64,
    /// Dropped before acknowledgement, counted, or discarded from quarantine.
    pub dropped: u64,
    /// Of these, never acknowledged: they came while memory or disk was full, or without a key.
    pub lost_in_recorder: u64,
    /// Of these, discarded from quarantine by the operator.
    pub discarded: u64,
    /// Different from the chain.
    pub tampered: u64,
    /// Never arrived here (header.seq gaps); not part of captured.
    pub lost_in_transport: u64,
    /// Messages of all profiles in memory that are not acknowledged yet; not part of captured.
    pub waiting: u64,
    /// Of the verified ones, those whose ciphertext retention has deleted; header, signature and proof remain.
    pub deleted: u64,
    /// Whether the counts balance, in total and for each topic.
    pub conserved: bool,
}

/// The whole site at a glance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SiteView {
    /// The parts and their state.
    pub health: Vec<PartHealth>,
    pub life: LifeLine,
    pub robots: u16,
    /// Profiles open in this site.
    pub profiles: Vec<ProfileName>,
    pub process: u32,
    /// Background tasks and their state.
    pub tasks: Vec<super::TaskView>,
    /// The cache in front of the store, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheState>,
    /// What waits to be sealed.
    pub queue: QueueView,
    /// How long records of this site took from capture to verified: upper bounds, microseconds, and the number of
    /// records within each.
    pub verified_after: Vec<(u64, u64)>,
    /// Active alerts, of all accounts; none if no site is running to judge them.
    pub alerts: Vec<super::AlertView>,
    /// Those that ended recently, newest first.
    pub alerts_over: Vec<super::EndedAlert>,
}

/// The ring between capture and sealer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct QueueView {
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Its capacity, bytes; beyond that, the newest message is dropped and counted.
    pub capacity: u64,
}
