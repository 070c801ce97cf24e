//! Answers about profiles, their keys, their transactions, and those they share with.

pub use crate::pipeline::directory::GrantState;

use serde::{Deserialize, Serialize};

use crate::command::SecretBytes;
use crate::model::{Address, ContactName, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token};

/// The public side of a profile.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdentityView {
    /// Its name on this machine.
    pub profile: ProfileName,
    /// Whether it has keys yet.
    pub exists: bool,
    /// Whether its keyring is open in this site.
    pub unlocked: bool,
    /// Whether it is registered on the chain in use.
    pub registered: bool,
    pub address: Option<Address>,
    /// Current epoch on the chain.
    pub epoch: Option<u64>,
    /// What is sealed in that epoch already, as far as this home has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epoch_records: Option<EpochRecords>,
    pub signing_key: Option<PublicKey>,
    /// P_C's fingerprint, for people.
    pub fingerprint: Option<String>,
    pub envelope_key: Option<PublicKey>,
}

/// The messages sealed in an epoch so far: a grant of the epoch opens them too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpochRecords {
    pub records: u64,
    /// When the first of them was captured.
    pub since: Option<Timestamp>,
}

impl EpochRecords {
    /// From which moment a grant of the epoch opens records, in words; `of` is of what these are all, ` of all topics` or
    /// nothing.
    pub fn words(self, of: &str) -> String {
        let Some(since) = self.since else { return "from now on (this epoch has no record yet)".to_owned() };
        let moment = since.to_string();
        let moment = moment.get(..19).unwrap_or(&moment).replace('T', " ");
        let plural = if self.records == 1 { "" } else { "s" };
        format!("since {moment} UTC (this epoch; {} record{plural}{of})", self.records)
    }
}

/// One epoch of a profile's keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpochView {
    pub epoch: u64,
    /// Its token on the chain.
    pub token: Token,
    /// Whether new records are sealed under it.
    pub current: bool,
}

/// A profile's keys, without any secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeysView {
    pub address: Address,
    pub signing_key: PublicKey,
    /// P_C's fingerprint, for people.
    pub signing_fingerprint: String,
    pub envelope_key: PublicKey,
    /// P_E's fingerprint, for people.
    pub envelope_fingerprint: String,
    /// Epochs on the chain in use.
    pub epochs: Vec<EpochView>,
}

/// Who is affected by a change of an SM2 key, and how.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyChangeView {
    /// Accounts with an active grant of this profile.
    pub readers: Vec<Address>,
    /// Accounts that share with this profile.
    pub sharers: Vec<Address>,
    /// Names of lent robots.
    pub robots: Vec<ProfileName>,
    /// Whether this profile keeps the gateway of this home.
    pub keeps_gateway: bool,
    /// The gateway that this home has joined.
    pub joined: Option<String>,
    /// The effects, in words.
    pub lines: Vec<String>,
}

/// A robot that was enrolled.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct EnrolledView {
    /// N, its name at the gateway.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub gateway: RobotGatewayView,
    /// The enrolment file, sealed.
    pub file: SecretBytes,
}

/// The gateway of an enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotGatewayView {
    /// Host:port each, in the order in which the robot tries them. Cleaned.
    pub addresses: Vec<String>,
    /// SM3 of its identity key.
    pub key: SignerId,
}

/// Where an enrolled robot finds its gateway from now on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceAddressesView {
    /// N, its name at the gateway.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    pub gateway: RobotGatewayView,
}

/// The current topics of an enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceTopicsView {
    /// N, its name at the gateway.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// Topics that were added.
    pub added: Vec<String>,
    pub topics: Vec<String>,
}

/// The result of a transaction of the profile (register, grant, revoke, rotate).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransactionView {
    /// Its hash; `None` = nothing had to be sent.
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    /// The profile's epoch after it.
    pub epoch: u64,
    /// The deed, in words.
    pub text: String,
}

/// One account of the address book.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactRow {
    pub name: ContactName,
    pub address: Address,
    /// The fingerprint of its SM2 key, as noted.
    pub fingerprint: Option<String>,
    /// Whether a person gave it, rather than the chain.
    pub given: bool,
    /// The fingerprint of its registered key.
    pub registered: Option<String>,
    /// `same`, `differs`, `not registered` or `not noted`.
    pub state: String,
}

/// Two fingerprints side by side.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompareView {
    pub account: Address,
    /// Its name in the address book.
    pub name: Option<String>,
    /// Its SM2 key's fingerprint.
    pub fingerprint: String,
    /// The given one, in the same form.
    pub given: String,
    /// Whether they are equal.
    pub equal: bool,
}

/// A lost account and its successor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SuccessionView {
    pub lost: Address,
    /// Its name in the address book.
    pub lost_name: Option<String>,
    pub successor: Address,
    /// Its name in the address book.
    pub successor_name: Option<String>,
    pub block: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProposalView {
    /// The account reported lost.
    pub lost: Address,
    /// Its name in the address book.
    pub lost_name: Option<String>,
    /// The successor to be.
    pub successor: Address,
    /// Its name in the address book.
    pub successor_name: Option<String>,
    /// Who may stop it, besides the administrator.
    pub recovery: Option<Address>,
    /// The time from which it can be completed.
    pub due: Timestamp,
    /// The block from which it waits.
    pub block: u64,
}

/// Who may stop a succession of the profile's account.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecoveryView {
    /// The account that may now.
    pub account: Option<Address>,
    /// The account named last, if that has not taken effect yet.
    pub next: Option<Address>,
    /// When it takes effect.
    pub from: Option<Timestamp>,
}

/// The contract administrator's decisions.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdministrationView {
    pub administrator: Option<Address>,
    /// The next administrator, once it accepts.
    pub nominee: Option<Address>,
    /// Whether anyone may register.
    pub open: bool,
    /// Whether all changes are blocked now except those that take rights away.
    pub paused: bool,
    /// When a pause ends; `None` = there is none.
    pub paused_until: Option<Timestamp>,
    /// The delay of a succession, seconds.
    pub delay: u64,
    pub proposals: Vec<ProposalView>,
    /// Who may stop a succession of the profile's account.
    pub recovery: RecoveryView,
    pub suspended: Vec<Address>,
    /// Lost accounts with their successors.
    pub successions: Vec<SuccessionView>,
}

/// The direction of a grant, as seen by one of its sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    Given,
    Received,
}

impl Direction {
    /// One word for screens and JSON.
    pub fn word(self) -> &'static str {
        self.into()
    }
}

/// One grant, given or received.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GrantRow {
    pub direction: Direction,
    pub owner: Address,
    pub grantee: Address,
    /// The first epoch it opens (or the only ones, once revoked).
    pub epoch: u64,
    /// Whether it opens epochs before that one too; `None` = not known here.
    pub earlier: Option<bool>,
    pub expires: Option<Timestamp>,
    /// Topic names if known, otherwise ids; empty = all topics.
    pub topics: Vec<String>,
    pub state: GrantState,
    /// Block of the grant.
    pub block: u64,
    pub transaction: Hash,
    /// The other side's name in the address book.
    pub name: Option<String>,
    /// The fingerprint of the other side's registered SM2 key.
    pub fingerprint: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceRow {
    /// SM3 of its public key.
    pub device: SignerId,
    /// Its fingerprint, as the device shows it.
    pub fingerprint: String,
    /// `lent`, `expired` or `recalled`.
    pub state: String,
    /// Block of the loan.
    pub from: u64,
    /// When the loan ends.
    pub until: Option<Timestamp>,
    /// Block of the recall.
    pub recalled: Option<u64>,
}
