//! Answers about other accounts: grants, devices, the address book, fingerprints, the administrator's decisions.

use serde::{Deserialize, Serialize};

use crate::model::{Address, ContactName, Hash, SignerId, Timestamp};
pub use crate::pipeline::directory::GrantState;

/// One account of the address book.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactRow {
    /// Its name here.
    pub name: ContactName,
    /// Its address.
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
    /// The account.
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
    /// The lost account.
    pub lost: Address,
    /// Its name in the address book.
    pub lost_name: Option<String>,
    /// The successor.
    pub successor: Address,
    /// Its name in the address book.
    pub successor_name: Option<String>,
    /// Since which block.
    pub block: u64,
}

/// A pending succession.
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
    /// The administrator.
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
    /// Pending successions.
    pub proposals: Vec<ProposalView>,
    /// Who may stop a succession of the profile's account.
    pub recovery: RecoveryView,
    /// Suspended accounts.
    pub suspended: Vec<Address>,
    /// Lost accounts with their successors.
    pub successions: Vec<SuccessionView>,
}

/// The direction of a grant, as seen by one of its sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// By this profile.
    Given,
    /// To this profile.
    Received,
}

impl Direction {
    /// One word for screens and JSON.
    pub fn word(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Received => "received",
        }
    }
}

/// One grant, given or received.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GrantRow {
    /// Given or received.
    pub direction: Direction,
    /// The owner.
    pub owner: Address,
    /// The reader.
    pub grantee: Address,
    /// The first epoch it opens (or the only ones, once revoked).
    pub epoch: u64,
    /// Whether it opens epochs before that one too; `None` = not known here.
    pub earlier: Option<bool>,
    /// When it ends.
    pub expires: Option<Timestamp>,
    /// Topic names if known, otherwise ids; empty = all topics.
    pub topics: Vec<String>,
    /// Its state.
    pub state: GrantState,
    /// Block of the grant.
    pub block: u64,
    /// Its transaction.
    pub transaction: Hash,
    /// The other side's name in the address book.
    pub name: Option<String>,
    /// The fingerprint of the other side's registered SM2 key.
    pub fingerprint: Option<String>,
}

/// One lent device.
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
