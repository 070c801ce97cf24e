//! The whole site at a glance.

use serde::{Deserialize, Serialize};

use crate::model::{Address, ErrorKind, ProfileName, Timestamp, clean};
use crate::store::CacheState;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HealthLevel {
    Ok,
    /// Starting or retrying.
    Waiting,
    /// Needs an operator.
    Failed,
    /// Not part of this site.
    Absent,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartHealth {
    /// `ros`, `chain`, `store`, `cache` or `gateway`.
    pub part: String,
    pub level: HealthLevel,
    /// `embedded master http://127.0.0.1:4711`, `retry in 4 s: …`.
    pub text: String,
    /// Not well since then, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since: Option<Timestamp>,
    /// Seconds until the next attempt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry: Option<u64>,
    /// Accounts that it does not concern: they anchor while another's lane is paused.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unaffected: Vec<Address>,
}

impl PartHealth {
    /// What to do must not be cut.
    const LONGEST: usize = 600;

    pub fn new(part: &str, level: HealthLevel, text: &str) -> Self {
        let (part, text) = (part.to_owned(), clean(text, Self::LONGEST));
        Self { part, level, text, since: None, retry: None, unaffected: Vec::new() }
    }
}

/// Data records of one profile by stage. Always captured = verified + pending + unauthorised + quarantined + dropped +
/// tampered, where captured has its own counter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LifeLine {
    pub captured: u64,
    /// Sealed and fsynced, row and ciphertext in one commit.
    pub stored: u64,
    pub anchored: u64,
    pub confirmed: u64,
    pub verified: u64,
    pub pending: u64,
    /// Their signer may not sign now; anchored when that right returns.
    pub right_ended: u64,
    pub quarantined: u64,
    /// Dropped before acknowledgement, or discarded from quarantine.
    pub dropped: u64,
    /// Of these, never acknowledged: memory or disk was full, or there was no key.
    pub lost_in_recorder: u64,
    /// Of these, discarded from quarantine.
    pub discarded: u64,
    /// Different from the chain.
    pub tampered: u64,
    /// Never arrived (header.seq gaps); not part of captured.
    pub lost_in_transport: u64,
    /// In memory, of all profiles, not acknowledged yet; not part of captured.
    pub waiting: u64,
    /// Verified ones whose ciphertext retention has deleted.
    pub deleted: u64,
    /// Whether the counts balance, in total and for each topic.
    pub conserved: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SiteView {
    pub health: Vec<PartHealth>,
    pub life: LifeLine,
    pub robots: u16,
    /// Open in this site.
    pub profiles: Vec<ProfileName>,
    pub process: u32,
    pub tasks: Vec<super::TaskView>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheState>,
    pub queue: QueueView,
    /// From capture to verified: upper bounds, microseconds, and the records within each.
    pub verified_after: Vec<(u64, u64)>,
    /// Of all accounts; none if no site judges them.
    pub alerts: Vec<super::AlertView>,
    pub alerts_over: Vec<super::EndedAlert>,
}

impl SiteView {
    /// What `status` and `doctor` end with; `None` if all is well.
    pub fn worst(&self) -> Option<ErrorKind> {
        let is_well = |part: &PartHealth| matches!(part.level, HealthLevel::Ok | HealthLevel::Absent);
        if self.life.tampered > 0 || !self.life.conserved {
            return Some(ErrorKind::Tampered);
        }
        (!self.health.iter().all(is_well)).then_some(ErrorKind::Unreachable)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct QueueView {
    pub messages: u64,
    pub bytes: u64,
    /// Bytes; beyond it, the newest message is dropped and counted.
    pub capacity: u64,
}
