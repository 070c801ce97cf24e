//! A grant, as built from its events. Its envelopes are in the ledger.

use serde::{Deserialize, Serialize};

use std::collections::BTreeMap;

use super::Told;
use crate::model::{GrantTerms, Hash, Timestamp};

/// This many of a grant's newest epochs are held in memory; all others are read from the ledger.
const EPOCHS_HELD: usize = 8;

/// An extension of a grant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extension {
    /// Its end from then on; `None` = no end.
    pub expiry: Option<Timestamp>,
    /// Block of the extension.
    pub block: u64,
}

/// A grant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Granted {
    /// The terms of the grant, as its envelopes repeat them; for its end see [`Granted::expiry`].
    pub terms: GrantTerms,
    /// The last extension.
    pub extended: Option<Extension>,
    /// Block of the grant.
    pub block: u64,
    /// Transaction of the grant.
    pub transaction: Hash,
    /// The epoch that began with its revocation.
    pub revoked: Option<u64>,
    /// Index of the grant among the block's events.
    place: u64,
    /// The newest epochs that have an envelope, with the block of the newest one.
    wrapped: BTreeMap<u64, u64>,
}

impl Granted {
    /// From its event; a grant that it renews already had envelopes.
    pub(super) fn of(terms: GrantTerms, told: &Told, renewed: Option<&Self>) -> Self {
        Self {
            terms,
            extended: None,
            block: told.block,
            transaction: told.transaction,
            revoked: None,
            place: told.place,
            wrapped: renewed.map(|grant| grant.wrapped.clone()).unwrap_or_default(),
        }
    }

    /// The position of its event on the chain.
    pub(super) fn place(&self) -> (u64, u64) {
        (self.block, self.place)
    }

    /// When it ends, including extensions; `None` = never.
    pub fn expiry(&self) -> Option<Timestamp> {
        self.extended.map_or(self.terms.expiry, |extended| extended.expiry)
    }

    /// Whether it is neither revoked nor expired at `now`.
    pub fn is_active(&self, now: Timestamp) -> bool {
        self.revoked.is_none() && self.expiry().is_none_or(|expiry| expiry > now)
    }

    /// Its state at `now`.
    pub fn state(&self, now: Timestamp) -> GrantState {
        match (self.revoked, self.is_active(now)) {
            (Some(_), _) => GrantState::Revoked,
            (None, true) => GrantState::Active,
            (None, false) => GrantState::Expired,
        }
    }

    /// Whether it has an envelope for an epoch, one of the newest with any.
    pub fn is_wrapped(&self, epoch: u64) -> bool {
        self.wrapped.contains_key(&epoch)
    }

    /// Whether it has an envelope for such an epoch that was made in this block or later.
    pub fn is_wrapped_since(&self, epoch: u64, block: u64) -> bool {
        self.wrapped.get(&epoch).is_some_and(|newest| *newest >= block)
    }

    /// The newest epoch that has an envelope.
    pub fn newest_wrapped(&self) -> Option<u64> {
        self.wrapped.keys().next_back().copied()
    }

    /// The epochs before `epoch` and since the grant that have no envelope, as far back as memory goes. Each of them began
    /// while it stood: it cannot be extended once it has ended.
    pub fn unwrapped_before(&self, epoch: u64) -> impl Iterator<Item = u64> {
        let oldest = self.wrapped.keys().next().copied().unwrap_or(epoch);
        (oldest.max(self.terms.epoch)..epoch).filter(|epoch| !self.is_wrapped(*epoch))
    }

    /// The number of its entries in memory.
    #[cfg(test)]
    pub(super) fn held(&self) -> usize {
        1 + self.wrapped.len()
    }

    pub(super) fn take_envelope(&mut self, epoch: u64, block: u64) {
        let newest = self.wrapped.entry(epoch).or_insert(block);
        *newest = block.max(*newest);
        if self.wrapped.len() > EPOCHS_HELD {
            self.wrapped.pop_first();
        }
    }
}

/// The state of a grant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GrantState {
    /// It opens new records.
    Active,
    /// Its end has come.
    Expired,
    /// Its owner revoked it.
    Revoked,
}

impl GrantState {
    /// One word for screens and JSON.
    pub fn word(self) -> &'static str {
        match self {
            Self::Active => "active",
            Self::Expired => "expired",
            Self::Revoked => "revoked",
        }
    }
}
