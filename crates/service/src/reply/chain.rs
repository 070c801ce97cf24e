//! Answers about the chain, checks of records, and publishers.

use serde::{Deserialize, Serialize};

pub use crate::pipeline::record_audit::{FindingKind, RecordAudit, RecordFinding};

use super::{AdministrationView, AlarmView, RecordView};
use crate::chain::{Pin, Sealing, Shortfall};
use crate::model::{
    Address, Digest, Domain, ErrorKind, Hash, PinMode, ProfileName, Publisher, SignerId, Timestamp, Wei, clean,
};
use crate::pipeline::LaneState;
use crate::store::CacheState;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainView {
    /// `embedded`, `node` or `relay`.
    pub kind: String,
    /// `poa`, `pow`, `unknown`.
    pub consensus: String,
    pub chain_id: u64,
    pub genesis: Hash,
    pub block: u64,
    /// Once deployed or configured.
    pub contract: Option<Address>,
    /// Wei, decimal.
    pub balance: String,
    pub nonce: u64,
    /// Own transactions that are in no block.
    pub pending: u64,
    /// The node's own name; cleaned.
    pub client: String,
    /// Whose word must be trusted, if the chain is not the site's own node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub through: Option<String>,
    pub waiting: Vec<WaitingView>,
    /// What the account lacks to pay for its next anchor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lacks: Option<Shortfall>,
    pub prices: PricesView,
    pub gas: GasView,
    /// First the account's own, then the extra ones.
    pub lanes: Vec<LaneState>,
    pub administration: AdministrationView,
    #[serde(flatten)]
    pub sealing: Sealing,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WaitingView {
    pub account: Address,
    /// For `chain cancel`.
    pub nonce: u64,
    pub purpose: String,
    /// Offered price per gas.
    pub price: Wei,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PricesView {
    #[serde(rename = "chain.min_price")]
    pub min_price: Wei,
    #[serde(rename = "chain.max_fee")]
    pub max_fee: Option<Wei>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct GasView {
    /// At most 100.
    pub transactions: u64,
    pub gas: u64,
    /// Records that they anchored.
    pub records: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeployedView {
    /// Chain, contract, code and block.
    #[serde(flatten)]
    pub pin: Pin,
    pub administrator: Address,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServedView {
    pub url: String,
    pub chain_id: u64,
    pub contract: Option<Address>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayView {
    pub address: String,
    /// SM3 of its identity key: the pin of robots and operators.
    pub gateway: SignerId,
    /// The same, for comparison by eye.
    pub fingerprint: String,
    /// Anchors the records.
    pub account: Address,
    pub domain: Domain,
    /// Where robots and owners reach it and the other workers, if the settings say so.
    pub addresses: Vec<String>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BackupView {
    pub file: String,
    /// Files of the home in it.
    pub files: u64,
    pub bytes: u64,
    pub profiles: Vec<String>,
    /// What it does not contain.
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JoinStanding {
    /// The home is new.
    Joined,
    /// It has a newer join key.
    Renewed,
    /// It had this join key already.
    Unchanged,
}

/// A home that is a worker of a gateway.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JoinedView {
    pub standing: JoinStanding,
    pub profile: ProfileName,
    pub account: Address,
    pub gateway: SignerId,
    /// The database, without user and password.
    pub store: String,
    /// Where robots and owners reach the gateway, if the settings say so.
    pub addresses: Vec<String>,
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckStatus {
    Ok,
    /// Works, but something should be done.
    Warn,
    Fail,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorCheck {
    pub name: String,
    pub status: CheckStatus,
    /// Cleaned.
    pub detail: String,
    /// Empty if nothing has to be done.
    pub advice: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorView {
    pub ok: bool,
    /// The worst that is wrong; decides the exit code.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<ErrorKind>,
    pub checks: Vec<DoctorCheck>,
}

/// What erasing would remove, or removed.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ErasureView {
    /// Messages that can be erased.
    pub records: u64,
    pub bytes: u64,
    pub topics: Vec<String>,
    /// Chosen, but not verified yet: they stay for now.
    pub waiting: u64,
    /// Chosen, and already deleted or erased.
    pub gone: u64,
    /// Chosen, but quarantined, discarded or altered: they stay.
    pub other: u64,
    /// Incidents that hold some of them and so prevent erasing.
    pub held: Vec<String>,
    /// Named in signed retention records; 0 = only shown.
    pub named: u64,
    /// Not named, because their bytes are missing or altered.
    pub missing: u64,
    /// Whether their bytes are gone; otherwise they go when the retention records are confirmed.
    pub deleted: bool,
    /// What erasing does not reach.
    pub stays: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinView {
    pub topic: String,
    #[serde(flatten)]
    pub publisher: Publisher,
    /// `first` (seen first), `operator` or `settings`.
    pub source: String,
    pub at: Option<Timestamp>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinsView {
    pub mode: PinMode,
    pub pins: Vec<PinView>,
    pub alarms: Vec<AlarmView>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldView {
    #[serde(flatten)]
    pub record: RecordView,
    /// One word.
    pub reason: String,
    pub publisher: String,
    /// The quarantine record that counts it.
    pub report: Option<Digest>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantineView {
    pub messages: u64,
    /// The oldest, of the requested topic.
    pub records: Vec<HeldView>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecidedView {
    /// `released` or `discarded`.
    pub decision: String,
    pub messages: u64,
    /// Quarantine records on the chain that count the discarded messages.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub reports: Vec<Digest>,
    pub text: String,
}

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
