//! The directory in the ledger: each event as stored, the directory rebuilt from the current ones, and what only the
//! others show: revoked grants, envelopes, tokens of past epochs.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Directory, Extension, Granted};
use crate::chain::{Event, EventAt};
use crate::model::{Address, Hash, Identity, Token};
use crate::store::{KeptEnvelope, KeptRight, RightEvent, RightKind, Rights, StoreError};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Told {
    pub block: u64,
    /// Its index among the block's events.
    pub place: u64,
    pub transaction: Hash,
    pub event: Event,
    /// Whether the identity in it has a valid proof.
    pub proven: bool,
}

/// The encoding of an event; the envelope is stored separately.
#[derive(Serialize, Deserialize)]
struct Written {
    transaction: Hash,
    proven: bool,
    event: Event,
}

impl Told {
    pub fn to_row(&self) -> RightEvent {
        let mut event = self.event.clone();
        let envelope = match &mut event {
            Event::Granted { envelope, .. } | Event::Wrapped { envelope, .. } | Event::KeysRotated { envelope, .. } => {
                Some(std::mem::take(envelope))
            }
            _ => None,
        };
        let (kind, grantee, epoch, token) = match &event {
            Event::Granted { terms, .. } => (RightKind::Grant, Some(terms.grantee), Some(terms.epoch), None),
            Event::Wrapped { owner, grantee, epoch, .. } if owner == grantee => {
                (RightKind::Own, None, Some(*epoch), None)
            }
            Event::Wrapped { grantee, epoch, .. } => (RightKind::Envelope, Some(*grantee), Some(*epoch), None),
            Event::Extended { grantee, .. } => (RightKind::Extension, Some(*grantee), None, None),
            Event::Revoked { grantee, epoch, token, .. } => {
                (RightKind::Epoch, Some(*grantee), Some(*epoch), Some(*token))
            }
            Event::Rotated { epoch, token, .. } => (RightKind::Epoch, None, Some(*epoch), Some(*token)),
            Event::Registered { identity, epoch, .. } => (RightKind::Other, None, Some(*epoch), Some(identity.token)),
            _ => (RightKind::Other, None, None, None),
        };
        let (block, place, owner) = (self.block, self.place, event.account());
        let written = Written { transaction: self.transaction, proven: self.proven, event };
        let event = serde_json::to_string(&written).unwrap_or_default();
        RightEvent { block, place, kind, owner, grantee, epoch, token, event, envelope }
    }

    /// Whether this is what was stored of an event on the chain.
    pub(crate) fn is_of(&self, at: &EventAt) -> bool {
        let mut event = at.event.clone();
        if let Event::Granted { envelope, .. } | Event::Wrapped { envelope, .. } | Event::KeysRotated { envelope, .. } =
            &mut event
        {
            envelope.clear();
        }
        self.transaction == at.transaction && self.event == event
    }

    /// From a row; without its envelope.
    pub(crate) fn from_row(rights: &Rights, row: &KeptRight) -> Result<Self, StoreError> {
        let Written { transaction, proven, event } = serde_json::from_str(&row.event).map_err(|_| {
            let detail = format!("the event {} of block {} cannot be read", row.place, row.block);
            StoreError::Corrupt { file: rights.path().to_owned(), detail }
        })?;
        Ok(Self { block: row.block, place: row.place, transaction, event, proven })
    }
}

/// Fills an empty directory; `false` if nothing is stored. After an error the directory is empty.
pub fn read_back(rights: &Rights, directory: &Directory) -> Result<bool, StoreError> {
    let standing = rights.standing_rights()?;
    let told: Vec<Told> = standing.events.iter().map(|row| Told::from_row(rights, row)).collect::<Result<_, _>>()?;
    if standing.last.is_none() {
        return Ok(false);
    }
    for told in &told {
        directory.take(told);
    }
    directory.applied_up_to(standing.last);
    Ok(true)
}

/// Stores events applied to the directory; those already stored are skipped.
pub fn keep(rights: &Rights, told: &[Told]) -> Result<(), StoreError> {
    rights.keep_rights(told.iter().map(Told::to_row).collect())
}

/// The identity of an account with this version of its keys, as registered; `None` if the chain's events have none.
pub fn identity(rights: &Rights, account: Address, version: u64) -> Result<Option<Identity>, StoreError> {
    for row in rights.other_rights(account)? {
        match Told::from_row(rights, &row)?.event {
            Event::Registered { identity, .. } if version == 1 => return Ok(Some(identity)),
            Event::KeysRotated { keys, identity, .. } if keys == version => return Ok(Some(identity)),
            _ => {}
        }
    }
    Ok(None)
}

/// The grants that an account gave or received, including revoked ones, oldest first.
pub fn history(rights: &Rights, directory: &Directory, account: Address) -> Result<Vec<Granted>, StoreError> {
    let mut revoked: BTreeMap<(Address, Address, u64), Granted> = BTreeMap::new();
    for row in rights.revoked_grants(account)? {
        let Some(epoch) = row.revoked else { continue };
        let told = Told::from_row(rights, &row)?;
        match &told.event {
            // What it renewed was the same grant.
            Event::Granted { terms, .. } => {
                let mut grant = Granted::of(terms.clone(), &told, None);
                grant.revoked = Some(epoch);
                revoked.insert((terms.owner, terms.grantee, epoch), grant);
            }
            Event::Extended { owner, grantee, expiry } => {
                if let Some(grant) = revoked.get_mut(&(*owner, *grantee, epoch)) {
                    grant.extended = Some(Extension { expiry: *expiry, block: told.block });
                }
            }
            _ => {}
        }
    }
    let mut all: Vec<Granted> = revoked.into_values().collect();
    all.extend(directory.grants_of(account));
    all.extend(directory.grants_to(account));
    all.sort_by_key(Granted::place);
    Ok(all)
}

/// The envelopes of a grant, the newest epoch first. For each epoch, those that may open are returned: the newest, made
/// for the grantee's latest keys, and the first, which may carry keys of earlier epochs too.
pub fn envelopes(rights: &Rights, grant: &Granted) -> Result<Vec<KeptEnvelope>, StoreError> {
    let terms = &grant.terms;
    let all = rights.envelopes_between(terms.owner, terms.grantee, grant.revoked)?;
    let mut epochs: BTreeMap<u64, Vec<KeptEnvelope>> = BTreeMap::new();
    for envelope in all {
        let known = epochs.entry(envelope.epoch).or_default();
        if !known.iter().any(|other| other.bytes == envelope.bytes) {
            known.truncate(1);
            known.push(envelope);
        }
    }
    Ok(epochs.into_values().rev().flat_map(|known| known.into_iter().rev()).collect())
}

/// In the chain's order, each with the envelope that hands it over to the keys before it.
pub fn handed_over(rights: &Rights, account: Address) -> Result<Vec<(Identity, Vec<u8>)>, StoreError> {
    let mut found = Vec::new();
    for row in rights.other_rights(account)? {
        let told = Told::from_row(rights, &row)?;
        let Event::KeysRotated { identity, .. } = &told.event else { continue };
        if let Some(envelope) = rights.envelope_at(told.block, told.place)? {
            found.push((*identity, envelope));
        }
    }
    Ok(found)
}

pub fn token(rights: &Rights, directory: &Directory, owner: Address, epoch: u64) -> Result<Option<Token>, StoreError> {
    let now = directory.with_account(owner, |account| {
        account.filter(|account| account.epoch == epoch).and_then(|account| account.token)
    });
    now.map_or_else(|| rights.epoch_token(owner, epoch), |token| Ok(Some(token)))
}

pub fn has_token(rights: &Rights, directory: &Directory, owner: Address, token: Token) -> Result<bool, StoreError> {
    let now = directory.with_account(owner, |account| account.is_some_and(|account| account.token == Some(token)));
    Ok(now || rights.ever_had_token(owner, token)?)
}
