//! Answers about profiles, their keys, and their transactions.

use serde::{Deserialize, Serialize};

use crate::model::{Address, Hash, ProfileName, PublicKey, SignerId, Timestamp, Token};
use crate::service::command::SecretBytes;

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
    /// What is sealed in that epoch already, as far as this home has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epoch_records: Option<EpochRecords>,
    /// P_C.
    pub signing_key: Option<PublicKey>,
    /// P_C's fingerprint, for people.
    pub fingerprint: Option<String>,
    /// P_E.
    pub envelope_key: Option<PublicKey>,
}

/// The messages sealed in an epoch so far: a grant of the epoch opens them too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpochRecords {
    /// How many.
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
    /// P_C's fingerprint, for people.
    pub signing_fingerprint: String,
    /// P_E.
    pub envelope_key: PublicKey,
    /// P_E's fingerprint, for people.
    pub envelope_fingerprint: String,
    /// Epochs on the chain in use.
    pub epochs: Vec<EpochView>,
}

/// Who is affected by a change of an SM2 key, and how.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
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
    /// Its gateway.
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
    /// Its gateway.
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
    /// All its topics.
    pub topics: Vec<String>,
}

/// The result of a transaction of the profile (register, grant, revoke, rotate).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransactionView {
    /// Its hash; `None` = nothing had to be sent.
    pub transaction: Option<Hash>,
    /// Its block.
    pub block: Option<u64>,
    /// The profile's epoch after it.
    pub epoch: u64,
    /// The deed, in words.
    pub text: String,
}
