//! Answers about profiles, their keys, and their transactions.

use serde::{Deserialize, Serialize};

use crate::model::{Address, Hash, ProfileName, PublicKey, SignerId, Token};
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
    /// P_C.
    pub signing_key: Option<PublicKey>,
    /// P_C's fingerprint, for people.
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
    /// The first gateway that knows it.
    pub gateway: String,
    /// SM3 of that gateway's identity key.
    pub gateway_key: SignerId,
    /// All its gateways, in order.
    pub gateways: Vec<RobotGatewayView>,
    /// The enrolment file, sealed.
    pub file: SecretBytes,
}

/// A gateway of an enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotGatewayView {
    /// Host:port.
    pub address: String,
    /// SM3 of its identity key.
    pub key: SignerId,
    /// Whether it knows the robot; one that was away is told when it is back.
    pub known: bool,
}

/// The current gateways of an enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceGatewaysView {
    /// N, its name at the gateways.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// All its gateways, in order.
    pub gateways: Vec<RobotGatewayView>,
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
