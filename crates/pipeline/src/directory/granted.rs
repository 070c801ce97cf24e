//! A grant with its envelopes, as its events made it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::model::bytes::{hex, unhex};
use crate::model::{GrantTerms, Hash, Timestamp};

/// A grant was given a later end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Extension {
    /// Its end since then; `None` = no end.
    pub expiry: Option<Timestamp>,
    /// Block of the extension.
    pub block: u64,
}

/// An envelope as an event brought it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Envelope {
    /// Block of the event: the owner's key of then signed it.
    pub block: u64,
    /// The envelope, hex.
    envelope: String,
}

impl Envelope {
    /// Its bytes.
    pub fn bytes(&self) -> Vec<u8> {
        unhex(&self.envelope).unwrap_or_default()
    }
}

/// A grant with its envelopes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Granted {
    /// The terms at the grant, as its envelopes repeat them; for its end see [`Granted::expiry`].
    pub terms: GrantTerms,
    /// The last extension.
    #[serde(default)]
    pub extended: Option<Extension>,
    /// Envelopes by epoch: the first, and the newest that was made after it for new keys of the grantee. One does not
    /// replace the other: the first may carry keys of earlier epochs too.
    pub envelopes: BTreeMap<u64, Vec<Envelope>>,
    /// Block of the grant.
    pub block: u64,
    /// Transaction of the grant.
    pub transaction: Hash,
    /// The epoch that began with its revocation.
    pub revoked: Option<u64>,
}

impl Granted {
    /// When it ends, extensions included; `None` = no end.
    pub fn expiry(&self) -> Option<Timestamp> {
        self.extended.map_or(self.terms.expiry, |extended| extended.expiry)
    }

    /// Whether it is neither revoked nor expired at `now`.
    pub fn is_active(&self, now: Timestamp) -> bool {
        self.revoked.is_none() && self.expiry().is_none_or(|expiry| expiry > now)
    }

    /// `active`, `revoked` or `expired` at `now`.
    pub fn word(&self, now: Timestamp) -> &'static str {
        match (self.revoked, self.is_active(now)) {
            (Some(_), _) => "revoked",
            (None, true) => "active",
            (None, false) => "expired",
        }
    }

    /// The envelopes of an epoch, the newest first.
    pub fn envelopes_of(&self, epoch: u64) -> impl Iterator<Item = &Envelope> {
        self.envelopes.get(&epoch).into_iter().flatten().rev()
    }

    /// Whether it has an envelope of an epoch that was made in this block or later.
    pub fn is_wrapped_since(&self, epoch: u64, block: u64) -> bool {
        self.envelopes_of(epoch).any(|envelope| envelope.block >= block)
    }

    pub(super) fn take_envelope(&mut self, epoch: u64, bytes: &[u8], block: u64) {
        let envelope = Envelope { block, envelope: hex(bytes) };
        let known = self.envelopes.entry(epoch).or_default();
        if known.iter().any(|other| other.block > block || *other == envelope) {
            return;
        }
        known.truncate(1);
        known.push(envelope);
    }
}
