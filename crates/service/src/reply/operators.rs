//! Answers about operators.

use serde::{Deserialize, Serialize};

use crate::model::{Address, Digest, OperatorName, OperatorRights, SignerId, Timestamp};

/// Whether an operator may act now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OperatorState {
    /// It may.
    Stands,
    /// Its time has not begun.
    NotYet,
    /// Its time is over.
    Expired,
    /// The profile's signing key did not sign it: it was changed, or the list was.
    NotSigned,
}

impl OperatorState {
    /// In words.
    pub fn word(self) -> &'static str {
        match self {
            Self::Stands => "stands",
            Self::NotYet => "not yet",
            Self::Expired => "expired",
            Self::NotSigned => "not signed by the profile's key",
        }
    }
}

/// An operator of a profile.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OperatorView {
    /// Its name.
    pub name: OperatorName,
    /// SM3 of its public key.
    pub key: SignerId,
    /// What it may do.
    pub rights: OperatorRights,
    /// From when on.
    pub from: Timestamp,
    /// Before when.
    pub until: Option<Timestamp>,
    /// Whether it may act now.
    pub state: OperatorState,
}

/// What an operator signs, with its name and the profile's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct OperatorChallenge {
    /// 32 random bytes of this connection.
    pub challenge: Digest,
    /// The account of the profile.
    pub account: Address,
}
