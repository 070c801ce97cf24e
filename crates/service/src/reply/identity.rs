//! Answers about profiles, their keys and transactions, and their readers.

pub use crate::pipeline::directory::GrantState;

use serde::{Deserialize, Serialize};

use crate::command::SecretBytes;
use crate::model::{Address, ContactName, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token};

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdentityView {
    pub profile: ProfileName,
    pub exists: bool,
    /// Its keyring is open in this site.
    pub unlocked: bool,
    /// On the chain in use.
    pub registered: bool,
    pub address: Option<Address>,
    pub epoch: Option<u64>,
    /// What is sealed in that epoch already, as far as this home knows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epoch_records: Option<EpochRecords>,
    pub signing_key: Option<PublicKey>,
    pub fingerprint: Option<String>,
    pub envelope_key: Option<PublicKey>,
}

/// Messages sealed in an epoch so far: a grant of the epoch opens them too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpochRecords {
    pub records: u64,
    /// Capture of the first.
    pub since: Option<Timestamp>,
}

impl EpochRecords {
    /// From when a grant of the epoch opens records; `of` qualifies the count: ` of all topics` or nothing.
    pub fn words(self, of: &str) -> String {
        let Some(since) = self.since else { return "from now on (this epoch has no record yet)".to_owned() };
        let moment = since.to_string();
        let moment = moment.get(..19).unwrap_or(&moment).replace('T', " ");
        let plural = if self.records == 1 { "" } else { "s" };
        format!("since {moment} UTC (this epoch; {} record{plural}{of})", self.records)
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpochView {
    pub epoch: u64,
    pub token: Token,
    pub current: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeysView {
    pub address: Address,
    pub signing_key: PublicKey,
    pub signing_fingerprint: String,
    pub envelope_key: PublicKey,
    pub envelope_fingerprint: String,
    pub epochs: Vec<EpochView>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyChangeView {
    pub readers: Vec<Address>,
    pub sharers: Vec<Address>,
    pub robots: Vec<ProfileName>,
    pub keeps_gateway: bool,
    pub joined: Option<String>,
    /// The effects, in words.
    pub lines: Vec<String>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EnrolledView {
    /// N, its name at the gateway.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub gateway: RobotGatewayView,
    pub file: SecretBytes,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotGatewayView {
    /// Host:port, in the order in which the robot tries them; cleaned.
    pub addresses: Vec<String>,
    /// SM3 of its identity key.
    pub key: SignerId,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceAddressesView {
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub gateway: RobotGatewayView,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceTopicsView {
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub added: Vec<String>,
    pub topics: Vec<String>,
}

/// Result of a transaction of the profile.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransactionView {
    /// `None` = nothing had to be sent.
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    pub epoch: u64,
    pub text: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactRow {
    pub name: ContactName,
    pub address: Address,
    /// As noted.
    pub fingerprint: Option<String>,
    /// Noted by a person, not by the chain.
    pub given: bool,
    /// Fingerprint of the registered key.
    pub registered: Option<String>,
    /// `same`, `differs`, `not registered` or `not noted`.
    pub state: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompareView {
    pub account: Address,
    pub name: Option<String>,
    pub fingerprint: String,
    /// In the same form.
    pub given: String,
    pub equal: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SuccessionView {
    pub lost: Address,
    pub lost_name: Option<String>,
    pub successor: Address,
    pub successor_name: Option<String>,
    pub block: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProposalView {
    pub lost: Address,
    pub lost_name: Option<String>,
    pub successor: Address,
    pub successor_name: Option<String>,
    /// Who may stop it, besides the administrator.
    pub recovery: Option<Address>,
    /// When it can be completed.
    pub due: Timestamp,
    pub block: u64,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecoveryView {
    pub account: Option<Address>,
    /// Named last, not in effect yet.
    pub next: Option<Address>,
    pub from: Option<Timestamp>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdministrationView {
    pub administrator: Option<Address>,
    pub nominee: Option<Address>,
    pub open: bool,
    /// All changes are blocked now except those that take rights away.
    pub paused: bool,
    /// `None` = no pause.
    pub paused_until: Option<Timestamp>,
    /// Delay of a succession, seconds.
    pub delay: u64,
    pub proposals: Vec<ProposalView>,
    /// Who may stop a succession of the profile's account.
    pub recovery: RecoveryView,
    pub suspended: Vec<Address>,
    pub successions: Vec<SuccessionView>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    Given,
    Received,
}

impl Direction {
    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GrantRow {
    pub direction: Direction,
    pub owner: Address,
    pub grantee: Address,
    /// First epoch it opens, or the only ones once revoked.
    pub epoch: u64,
    /// Whether it also opens earlier epochs; `None` = not known here.
    pub earlier: Option<bool>,
    pub expires: Option<Timestamp>,
    /// Names if known, otherwise ids; empty = all topics.
    pub topics: Vec<String>,
    pub state: GrantState,
    pub block: u64,
    pub transaction: Hash,
    pub name: Option<String>,
    /// Of the other side's registered SM2 key.
    pub fingerprint: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceRow {
    pub device: SignerId,
    /// As the device shows it.
    pub fingerprint: String,
    /// `lent`, `expired` or `recalled`.
    pub state: String,
    pub from: u64,
    pub until: Option<Timestamp>,
    pub recalled: Option<u64>,
}
