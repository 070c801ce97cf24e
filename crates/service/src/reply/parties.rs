//! What is told of other accounts: grants, devices, the address book, fingerprints, the administrator's decisions.

use serde::{Deserialize, Serialize};

use crate::chain::Revision;
use crate::model::{Address, ContactName, Hash, SignerId, Timestamp};
pub use crate::pipeline::directory::GrantState;

/// One account of the address book.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactRow {
    /// Its name here.
    pub name: ContactName,
    /// Its address.
    pub address: Address,
    /// The fingerprint of its SM2 key as it was noted.
    pub fingerprint: Option<String>,
    /// Whether that was given by a person, and not just found on the chain.
    pub given: bool,
    /// The fingerprint of the key that it has registered now.
    pub registered: Option<String>,
    /// `same`, `differs`, `not registered` or `not noted`.
    pub state: String,
}

/// Two fingerprints side by side.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompareView {
    /// Whose.
    pub account: Address,
    /// Its name in the address book.
    pub name: Option<String>,
    /// That of its SM2 key.
    pub fingerprint: String,
    /// The one that was given, in the same form.
    pub given: String,
    /// Whether they are the same.
    pub equal: bool,
}

/// A lost account and who continues its work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SuccessionView {
    /// The lost one.
    pub lost: Address,
    /// Its name in the address book.
    pub lost_name: Option<String>,
    /// Who continues.
    pub successor: Address,
    /// Its name in the address book.
    pub successor_name: Option<String>,
    /// Since which block.
    pub block: u64,
}

/// A succession that waits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProposalView {
    /// The account said to be lost.
    pub lost: Address,
    /// Its name in the address book.
    pub lost_name: Option<String>,
    /// Who is to continue.
    pub successor: Address,
    /// Its name in the address book.
    pub successor_name: Option<String>,
    /// Who may stop it, besides the administrator.
    pub recovery: Option<Address>,
    /// It can be completed from then on.
    pub due: Timestamp,
    /// Since which block it waits.
    pub block: u64,
}

/// Who may stop a succession of the profile's account.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecoveryView {
    /// Who may now.
    pub account: Option<Address>,
    /// Who was named last, where that is still to take effect.
    pub next: Option<Address>,
    /// When it does.
    pub from: Option<Timestamp>,
}

/// What the administrator of the contract decided.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdministrationView {
    /// Who administers.
    pub administrator: Option<Address>,
    /// Who is to, once it accepts.
    pub nominee: Option<Address>,
    /// Whether anyone may register.
    pub open: bool,
    /// Whether all changes are stopped now but those that take rights away.
    pub paused: bool,
    /// When a pause ends by itself; `None` = there is none, or it has no end.
    #[serde(default)]
    pub paused_until: Option<Timestamp>,
    /// The contract's revision.
    #[serde(default)]
    pub revision: Option<Revision>,
    /// How long a succession waits, seconds; `None` = not at all.
    #[serde(default)]
    pub delay: Option<u64>,
    /// Successions that wait.
    #[serde(default)]
    pub proposals: Vec<ProposalView>,
    /// Who may stop a succession of the profile's account.
    #[serde(default)]
    pub recovery: RecoveryView,
    /// Accounts whose changes are stopped.
    pub suspended: Vec<Address>,
    /// Lost accounts with their successors.
    pub successions: Vec<SuccessionView>,
}

/// Which way a grant goes, as one of its sides sees it.
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
    /// Who shares.
    pub owner: Address,
    /// Who reads.
    pub grantee: Address,
    /// From this epoch on (or the only epochs it opens, once revoked).
    pub epoch: u64,
    /// When it ends.
    pub expires: Option<Timestamp>,
    /// Topic names where known, else ids; empty = all topics.
    pub topics: Vec<String>,
    /// How it stands.
    pub state: GrantState,
    /// Block of the grant.
    pub block: u64,
    /// Its transaction.
    pub transaction: Hash,
    /// The other side's name in the address book.
    #[serde(default)]
    pub name: Option<String>,
    /// The fingerprint of the SM2 key that the other side has registered.
    #[serde(default)]
    pub fingerprint: Option<String>,
}

/// One device that was lent.
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
