//! Answers about the chain, checks of records, and publishers.

pub use crate::pipeline::record_audit::{FindingKind, RecordAudit, RecordFinding};

use serde::{Deserialize, Serialize};

use super::{AdministrationView, AlarmView, RecordView};
use crate::chain::{Pin, Sealing, Shortfall};
use crate::model::{Address, Digest, Domain, Hash, PinMode, Publisher, SignerId, Timestamp, Wei};
use crate::pipeline::sender::LaneState;

/// The chain from this profile's point of view.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainView {
    /// `embedded`, `node` or `relay`.
    pub kind: String,
    /// `poa`, `pow`, `unknown`.
    pub consensus: String,
    pub chain_id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    pub block: u64,
    /// The contract, once deployed or configured.
    pub contract: Option<Address>,
    /// The profile's balance in wei, decimal.
    pub balance: String,
    /// The profile's next nonce.
    pub nonce: u64,
    /// Own transactions not yet in a block.
    pub pending: u64,
    /// The node's own name, cleaned.
    pub client: String,
    /// Whose word has to be trusted for all this, if it does not come from the site's own node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub through: Option<String>,
    /// The first of them, of all lanes.
    pub waiting: Vec<WaitingView>,
    /// What the account lacks to pay for its next anchor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lacks: Option<Shortfall>,
    /// The limits of the gas price, by the names of their settings.
    pub prices: PricesView,
    /// The cost of its newest anchoring transactions.
    pub gas: GasView,
    /// The state of this profile's lanes: first its own account's, then the extra ones'.
    pub lanes: Vec<LaneState>,
    /// The contract administrator's decisions.
    pub administration: AdministrationView,
    /// Who seals the blocks, and how often.
    #[serde(flatten)]
    pub sealing: Sealing,
}

/// A transaction that waits for a block.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WaitingView {
    pub account: Address,
    /// Its nonce, for `chain cancel`.
    pub nonce: u64,
    /// Its purpose, in a word.
    pub purpose: String,
    /// The price per gas that it offers.
    pub price: Wei,
}

/// The limits of the gas price, per gas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PricesView {
    /// `chain.min_price`.
    #[serde(rename = "chain.min_price")]
    pub min_price: Wei,
    /// `chain.max_fee`; `None` = no cap.
    #[serde(rename = "chain.max_fee")]
    pub max_fee: Option<Wei>,
}

/// The cost of anchoring, over the newest transactions of one profile's lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct GasView {
    /// Transactions counted, at most 100.
    pub transactions: u64,
    pub gas: u64,
    /// The records that they anchored.
    pub records: u64,
}

/// A contract that was deployed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeployedView {
    /// Chain, contract, code and block.
    #[serde(flatten)]
    pub pin: Pin,
    /// Its administrator: the account that deployed it.
    pub administrator: Address,
}

/// A chain served to other tools.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServedView {
    pub url: String,
    pub chain_id: u64,
    /// The contract, if there is one.
    pub contract: Option<Address>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayView {
    /// The address it listens on.
    pub address: String,
    /// SM3 of its identity key: the pin used by robots and operators.
    pub gateway: SignerId,
    /// The same, for comparison by eye.
    pub fingerprint: String,
    /// The account that anchors.
    pub account: Address,
    pub domain: Domain,
}

/// The content of a backup, or of what was restored from one.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BackupView {
    pub file: String,
    /// Files of the home in it.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Profiles whose keyrings are in it.
    pub profiles: Vec<String>,
    /// What it does not contain, in words.
    pub notes: Vec<String>,
}

/// The state of one thing checked by the doctor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckStatus {
    /// As it should be.
    Ok,
    /// Works, but something should be done.
    Warn,
    Fail,
}

/// One thing checked by the doctor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorCheck {
    pub name: String,
    pub status: CheckStatus,
    /// What was found, cleaned.
    pub detail: String,
    /// What to do; empty if nothing has to be done.
    pub advice: String,
}

/// All that the doctor checked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorView {
    pub ok: bool,
    pub checks: Vec<DoctorCheck>,
}

/// What erasing would take, or took.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ErasureView {
    /// Messages that can be erased.
    pub records: u64,
    /// Their bytes.
    pub bytes: u64,
    pub topics: Vec<String>,
    /// Chosen, but not verified yet: they stay for now.
    pub waiting: u64,
    /// Chosen, and deleted or erased earlier.
    pub gone: u64,
    /// Chosen, but quarantined, discarded or altered: they stay.
    pub other: u64,
    /// Incidents that hold some of them: nothing is erased while they do.
    pub held: Vec<String>,
    /// Named in signed retention records; 0 = it was only shown.
    pub named: u64,
    /// Not named, because their bytes are missing or altered.
    pub missing: u64,
    /// Whether the bytes of those named are gone; otherwise they go when the retention records are confirmed.
    pub deleted: bool,
    /// What erasing does not reach, in words.
    pub stays: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinView {
    pub topic: String,
    #[serde(flatten)]
    pub publisher: Publisher,
    /// `first` (seen first), `operator`, or `settings`.
    pub source: String,
    /// Pinned since; `None` for the settings.
    pub at: Option<Timestamp>,
}

/// A profile's pins and alarms.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinsView {
    /// How topics get their pins.
    pub mode: PinMode,
    pub pins: Vec<PinView>,
    pub alarms: Vec<AlarmView>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldView {
    #[serde(flatten)]
    pub record: RecordView,
    /// The reason, in one word.
    pub reason: String,
    pub publisher: String,
    /// The quarantine record that counts it.
    pub report: Option<Digest>,
}

/// Quarantined messages, oldest first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantineView {
    /// The total of quarantined messages.
    pub messages: u64,
    /// The oldest of them, for the requested topic.
    pub records: Vec<HeldView>,
}

/// A decision about quarantined messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecidedView {
    /// `released` or `discarded`.
    pub decision: String,
    pub messages: u64,
    /// Quarantine records that count the discarded messages; they are on the chain.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub reports: Vec<Digest>,
    pub text: String,
}
