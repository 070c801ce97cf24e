//! What a site answers: the very structures that `--json` prints.

mod audit;
mod chain;
mod forging;
mod parties;
mod tasks;

use serde::{Deserialize, Serialize};

pub use self::audit::{AuditCheck, AuditView};
pub use self::chain::{ChainView, DeployedView, GatewayView, ServedView};
pub use self::forging::{AlarmView, DecidedView, HeldView, PinView, PinsView, QuarantineView};
pub use self::parties::{AdministrationView, CompareView, ContactRow, DeviceRow, GrantRow, SuccessionView};
pub use self::tasks::{TaskState, TaskView};
use super::command::SecretBytes;
use crate::model::{Address, Digest, ErrorKind, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token, Verdict};

/// Why a command failed, as a person reads it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// Decides the exit code.
    pub kind: ErrorKind,
    /// What happened, to what, and what to do next. Cleaned.
    pub message: String,
}

impl Failure {
    /// A failure of `kind`.
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into() }
    }
}

/// The public side of a profile.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdentityView {
    /// Its name on this machine.
    pub profile: ProfileName,
    /// Whether it has keys yet.
    pub exists: bool,
    /// Whether its keyring is open in this site.
    pub unlocked: bool,
    /// Whether it is registered on the chain in use.
    pub registered: bool,
    /// Its EOA.
    pub address: Option<Address>,
    /// Current epoch on the chain.
    pub epoch: Option<u64>,
    /// P_C.
    pub signing_key: Option<PublicKey>,
    /// P_C for the eye.
    pub fingerprint: Option<String>,
    /// P_E.
    pub envelope_key: Option<PublicKey>,
}

/// One epoch of a profile's keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpochView {
    /// Its number.
    pub epoch: u64,
    /// Its token on the chain.
    pub token: Token,
    /// Whether new records are sealed under it.
    pub current: bool,
}

/// A profile's keys, without any secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeysView {
    /// EOA.
    pub address: Address,
    /// P_C.
    pub signing_key: PublicKey,
    /// P_C for the eye.
    pub signing_fingerprint: String,
    /// P_E.
    pub envelope_key: PublicKey,
    /// P_E for the eye.
    pub envelope_fingerprint: String,
    /// Epochs on the chain in use.
    pub epochs: Vec<EpochView>,
}

/// One topic of the graph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TopicRow {
    /// Its name, cleaned.
    pub topic: String,
    /// Its type, cleaned, where known.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Node names, cleaned.
    pub publishers: Vec<String>,
    /// Whether this profile watches it.
    pub watched: bool,
    /// Whether a simulated robot of this site publishes it.
    pub simulated: bool,
    /// Messages a second over the last 5 s; `None` = not measured.
    pub hz: Option<f64>,
    /// Bytes a second over the last 5 s; `None` = not measured.
    pub bytes_per_second: Option<f64>,
    /// Messages of it that this profile has captured.
    pub messages: u64,
    /// Lost before capture (header.seq gaps).
    pub lost_in_transport: u64,
    /// Dropped by the recorder.
    pub lost_in_recorder: u64,
    /// Arrival of the last message.
    pub last_message: Option<Timestamp>,
    /// Messages of it that this profile holds in quarantine.
    #[serde(default)]
    pub quarantined: u64,
    /// Whether an alarm about a publisher of it is open.
    #[serde(default)]
    pub alarm: bool,
}

/// One record in a list.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordView {
    /// Short stable id (beginning of the digest).
    pub id: String,
    /// Whose it is (shared lists).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner: Option<Address>,
    /// The owner's name in the address book.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner_name: Option<String>,
    /// Per recorder and topic, from 1.
    pub seq: u64,
    /// Topic name, cleaned.
    pub topic: String,
    /// Message type, cleaned.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Kind of record in one word.
    pub kind: String,
    /// State in one word.
    pub state: String,
    /// SM3 of the stored bytes.
    pub digest: Digest,
    /// Length of the message, bytes.
    pub bytes: u64,
    /// When it was captured.
    pub captured_at: Timestamp,
    /// The epoch that seals it.
    pub epoch: u64,
    /// Sent by a simulated robot.
    pub simulated: bool,
    /// The anchoring transaction.
    pub transaction: Option<Hash>,
    /// Its block.
    pub block: Option<u64>,
}

/// A page of records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordPage {
    /// The records.
    pub records: Vec<RecordView>,
    /// Cursor of the next page.
    pub next: Option<String>,
}

/// One record with where it came from and where it stands.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// The record.
    #[serde(flatten)]
    pub record: RecordView,
    /// Steps from message to verified, each with a word and its evidence.
    pub steps: Vec<(String, String)>,
}

/// A file to be written by the caller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportedFile {
    /// Its name, no path.
    pub name: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// What the opening of a record showed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OpenedView {
    /// The record.
    #[serde(flatten)]
    pub record: RecordView,
    /// What the checks found; nothing below is filled unless it is `verified` or `unanchored`.
    pub verdict: Verdict,
    /// The publisher's node name, cleaned.
    pub caller_id: String,
    /// Tags, cleaned.
    pub tags: Vec<(String, String)>,
    /// Field paths and values in order, cleaned, for screens.
    pub fields: Vec<(String, String)>,
    /// The message as JSON; long arrays summarised.
    pub message: serde_json::Value,
    /// The message's bytes as captured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub body: Option<Vec<u8>>,
    /// A picture's own bytes (JPEG, PNG) where the message is one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub picture: Option<Vec<u8>>,
}

/// What a check of one record found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CheckView {
    /// The record's id.
    pub id: String,
    /// What was found.
    pub verdict: Verdict,
    /// SM3 of the vault's bytes.
    pub digest: Digest,
    /// The anchoring transaction.
    pub transaction: Option<Hash>,
    /// Its block.
    pub block: Option<u64>,
}

/// A robot that was enrolled.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EnrolledView {
    /// N.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// The gateway.
    pub gateway: String,
    /// SM3 of the gateway's identity key.
    pub gateway_key: SignerId,
    /// The enrolment file, sealed.
    pub file: SecretBytes,
}

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
    /// Background tasks and how they are.
    #[serde(default)]
    pub tasks: Vec<TaskView>,
}

/// Figures of one topic in a capture's summary.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TopicSummary {
    /// Topic.
    pub topic: String,
    /// Type, where a message was seen.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Messages captured.
    pub captured: u64,
    /// Of these verified.
    pub verified: u64,
    /// Of these held back: their publisher is not a pinned one.
    #[serde(default)]
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
}

/// What a capture did.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CaptureSummary {
    /// Messages captured.
    pub captured: u64,
    /// Of these verified: re-read from the vault, digest equal to the chain, signature valid.
    pub verified: u64,
    /// Of these held back: their publisher is not a pinned one.
    #[serde(default)]
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
    /// Left out on purpose (bag import).
    pub skipped: u64,
    /// Per topic.
    pub topics: Vec<TopicSummary>,
}

/// What a transaction of the profile did (register, grant, revoke, rotate).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransactionView {
    /// Its hash; `None` = nothing had to be sent.
    pub transaction: Option<Hash>,
    /// Its block.
    pub block: Option<u64>,
    /// The profile's epoch after it.
    pub epoch: u64,
    /// What was done, in words.
    pub text: String,
}

/// The answer to a command.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "reply", content = "with")]
pub enum Reply {
    /// Done, nothing to tell.
    Done,
    /// To identity commands.
    Identity(IdentityView),
    /// To `ListKeys` and `LoadKey`.
    Keys(KeysView),
    /// To `ExportKey`.
    Key(SecretBytes),
    /// To `ListTopics`.
    Topics(Vec<TopicRow>),
    /// To `Capture`.
    Captured(CaptureSummary),
    /// To lists of records.
    Records(RecordPage),
    /// To `ShowUpload`.
    Provenance(Provenance),
    /// To `ExportUpload` and `ExportAudit`.
    Files(Vec<ExportedFile>),
    /// To commands that send a transaction.
    Transaction(TransactionView),
    /// To `ListGrants`.
    Grants(Vec<GrantRow>),
    /// To `ListDevices`.
    Devices(Vec<DeviceRow>),
    /// To `EnrolDevice`.
    Enrolled(EnrolledView),
    /// To `CompareFingerprint`.
    Compared(CompareView),
    /// To commands of the address book.
    Contacts(Vec<ContactRow>),
    /// To `CheckShared`.
    Check(CheckView),
    /// To `OpenShared`.
    Opened(Box<OpenedView>),
    /// To commands about pins.
    Pins(PinsView),
    /// To `ListQuarantine`.
    Quarantine(QuarantineView),
    /// To `ReleaseHeld` and `DiscardHeld`.
    Decided(DecidedView),
    /// To `ChainStatus`.
    Chain(ChainView),
    /// To `DeployContract`.
    Deployed(DeployedView),
    /// To `ServeChain`.
    Served(ServedView),
    /// A gateway is served.
    Gateway(GatewayView),
    /// To `SiteStatus`.
    Site(SiteView),
    /// To `ListAudit`.
    Audit(Vec<AuditView>),
    /// To `VerifyAudit`.
    AuditChecked(AuditCheck),
}
