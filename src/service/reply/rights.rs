//! Rights that an owner gave: grants to read, loans to sign.

use serde::{Deserialize, Serialize};

use crate::model::{Address, Hash, SignerId, Timestamp};

/// One grant, given or received.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GrantRow {
    /// `given` or `received`.
    pub direction: String,
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
    /// `active`, `revoked` or `expired`.
    pub state: String,
    /// Block of the grant.
    pub block: u64,
    /// Its transaction.
    pub transaction: Hash,
}

/// One device that was lent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceRow {
    /// SM3 of its public key.
    pub device: SignerId,
    /// `lent`, `expired` or `recalled`.
    pub state: String,
    /// Block of the loan.
    pub from: u64,
    /// When the loan ends.
    pub until: Option<Timestamp>,
    /// Block of the recall.
    pub recalled: Option<u64>,
}
