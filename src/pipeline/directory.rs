//! Who is registered and who may read what, rebuilt from the contract's events alone.
//!
//! Events are applied in chain order; applying one twice changes nothing. The state can be
//! written down and read back, so that a restart scans only new blocks.

mod administration;

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

use serde::{Deserialize, Serialize};

use crate::chain::{Event, EventAt};
use crate::crypto::{Provider, check_identity, signer_id};
use crate::model::bytes::{hex, unhex};
use crate::model::{Address, Domain, GrantTerms, Hash, Identity, PublicKey, SignerId, Timestamp, Token};

use super::PipelineError;
pub use administration::{Administration, Succession};

/// How the state is written down; another one is read anew from the chain.
const WRITTEN: u8 = 2;

/// One identity of an account, valid from a block on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdentityAt {
    /// Block of the registration or key rotation.
    pub block: u64,
    /// P_C.
    pub signing: PublicKey,
    /// P_E.
    pub envelope: PublicKey,
    /// Whether the proof verifies.
    pub proven: bool,
}

/// A device's time of being lent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lending {
    /// SM3 of the device's public key.
    pub device: SignerId,
    /// From this block on.
    pub from: u64,
    /// Until this block, once recalled.
    pub recalled: Option<u64>,
    /// Until this moment; `None` = no end.
    pub until: Option<Timestamp>,
}

/// What the chain knows of one account.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Account {
    /// Identities, oldest first.
    pub identities: Vec<IdentityAt>,
    /// Current epoch.
    pub epoch: u64,
    /// Tokens by epoch.
    pub tokens: BTreeMap<u64, Token>,
    /// Devices that may sign.
    pub devices: Vec<Lending>,
    /// Whether the administrator stopped its changes.
    #[serde(default)]
    pub suspended: bool,
}

/// A grant with its envelopes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Granted {
    /// The terms at the grant.
    pub terms: GrantTerms,
    /// Envelopes by epoch, hex.
    pub envelopes: BTreeMap<u64, String>,
    /// Block of the grant.
    pub block: u64,
    /// Transaction of the grant.
    pub transaction: Hash,
    /// The epoch that began with its revocation.
    pub revoked: Option<u64>,
}

impl Granted {
    /// Whether it is neither revoked nor expired at `now`.
    pub fn is_active(&self, now: Timestamp) -> bool {
        self.revoked.is_none() && self.terms.expiry.is_none_or(|expiry| expiry > now)
    }

    /// `active`, `revoked` or `expired` at `now`.
    pub fn word(&self, now: Timestamp) -> &'static str {
        match (self.revoked, self.is_active(now)) {
            (Some(_), _) => "revoked",
            (None, true) => "active",
            (None, false) => "expired",
        }
    }

    /// The envelope of an epoch.
    pub fn envelope(&self, epoch: u64) -> Option<Vec<u8>> {
        self.envelopes.get(&epoch).and_then(|text| unhex(text))
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct State {
    accounts: BTreeMap<Address, Account>,
    grants: Vec<Granted>,
    administration: Administration,
    /// The block of the last event that changed anything.
    #[serde(default)]
    newest: u64,
}

/// Registrations and grants of one contract.
pub struct Directory {
    domain: Domain,
    provider: &'static dyn Provider,
    state: RwLock<State>,
}

impl Directory {
    /// An empty directory.
    pub fn new(domain: Domain, provider: &'static dyn Provider) -> Self {
        Self { domain, provider, state: RwLock::default() }
    }

    /// What [`Self::write_down`] wrote; unreadable text gives an empty directory and `false`.
    pub fn read_back(&self, text: &str) -> bool {
        let parsed: Option<(u8, Domain, State)> = serde_json::from_str(text).ok();
        let known = parsed.filter(|(written, domain, _)| (*written, *domain) == (WRITTEN, self.domain));
        let Some((_, _, state)) = known else { return false };
        *self.state.write().unwrap_or_else(PoisonError::into_inner) = state;
        true
    }

    /// The whole state as JSON.
    pub fn write_down(&self) -> String {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        serde_json::to_string(&(WRITTEN, self.domain, &*state)).unwrap_or_default()
    }

    /// An empty directory of the same network.
    pub fn blank(&self) -> Self {
        Self::new(self.domain, self.provider)
    }

    /// Takes over the whole state of another one at once, after replaced blocks were read anew into it.
    pub fn become_like(&self, other: &Self) {
        let state = other.state.read().unwrap_or_else(PoisonError::into_inner).clone();
        *self.state.write().unwrap_or_else(PoisonError::into_inner) = state;
    }

    /// The block of the last event that changed anything; 0 before the first.
    pub fn newest(&self) -> u64 {
        self.state.read().unwrap_or_else(PoisonError::into_inner).newest
    }

    /// Applies one event; returns whether anything changed.
    pub fn apply(&self, at: &EventAt) -> bool {
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        // Anchors are the watcher's; comparing whole states for each would be wasteful.
        if matches!(at.event, Event::DataUploaded { .. } | Event::Anchored { .. }) {
            return false;
        }
        let old = state.clone();
        self.change(&mut state, at);
        let changed = *state != old;
        if changed {
            state.newest = state.newest.max(at.block);
        }
        changed
    }

    fn change(&self, state: &mut State, at: &EventAt) {
        match &at.event {
            Event::Registered { owner, identity, epoch } => {
                let account = state.accounts.entry(*owner).or_default();
                account.epoch = account.epoch.max(*epoch);
                account.tokens.entry(*epoch).or_insert(identity.token);
                self.identify(account, *owner, identity, at.block);
            }
            Event::KeysRotated { owner, identity, .. } => {
                self.identify(state.accounts.entry(*owner).or_default(), *owner, identity, at.block);
            }
            Event::Granted { terms, envelope } => grant(state, terms, envelope, at),
            Event::Wrapped { owner, grantee, epoch, envelope } => {
                let found = state
                    .grants
                    .iter_mut()
                    .rev()
                    .find(|grant| grant.terms.owner == *owner && grant.terms.grantee == *grantee);
                if let Some(grant) = found {
                    grant.envelopes.entry(*epoch).or_insert_with(|| hex(envelope));
                }
            }
            Event::Revoked { owner, grantee, epoch, token } => {
                begin_epoch(state, *owner, *epoch, *token);
                let matching = |grant: &&mut Granted| {
                    // Not one given later: a chunk of events may be read twice.
                    let earlier = grant.terms.epoch < *epoch;
                    earlier && grant.terms.owner == *owner && grant.terms.grantee == *grantee && grant.revoked.is_none()
                };
                state.grants.iter_mut().filter(matching).for_each(|grant| grant.revoked = Some(*epoch));
            }
            Event::Rotated { owner, epoch, token } => begin_epoch(state, *owner, *epoch, *token),
            Event::Lent { owner, device, until } => {
                let lending = Lending { device: *device, from: at.block, recalled: None, until: *until };
                let devices = &mut state.accounts.entry(*owner).or_default().devices;
                if !devices.contains(&lending) {
                    devices.push(lending);
                }
            }
            Event::Recalled { owner, device } => {
                let devices = &mut state.accounts.entry(*owner).or_default().devices;
                devices
                    .iter_mut()
                    .filter(|lending| lending.device == *device && lending.recalled.is_none())
                    .for_each(|lending| lending.recalled = Some(at.block));
            }
            Event::Suspended { account } => state.accounts.entry(*account).or_default().suspended = true,
            Event::Restored { account } => state.accounts.entry(*account).or_default().suspended = false,
            Event::Succeeded { lost, .. } => state.accounts.entry(*lost).or_default().suspended = true,
            _ => {}
        }
        state.administration.apply(at);
    }

    fn identify(&self, account: &mut Account, owner: Address, identity: &Identity, block: u64) {
        let proven = check_identity(self.provider, &self.domain, &owner, identity).is_ok();
        let entry = IdentityAt { block, signing: identity.signing, envelope: identity.envelope, proven };
        if !account.identities.contains(&entry) {
            account.identities.push(entry);
        }
    }

    /// What is known of an account.
    pub fn account(&self, owner: Address) -> Option<Account> {
        self.state.read().unwrap_or_else(PoisonError::into_inner).accounts.get(&owner).cloned()
    }

    /// The account's current epoch; 0 = not registered.
    pub fn epoch(&self, owner: Address) -> u64 {
        self.state
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .accounts
            .get(&owner)
            .map_or(0, |account| account.epoch)
    }

    /// The account's current identity.
    ///
    /// # Errors
    /// `Unregistered` where there is none, `BadIdentity` where its proof does not verify.
    pub fn identity(&self, owner: Address) -> Result<IdentityAt, PipelineError> {
        let account = self.account(owner).ok_or(PipelineError::Unregistered(owner))?;
        let identity = account.identities.last().cloned().ok_or(PipelineError::Unregistered(owner))?;
        if identity.proven { Ok(identity) } else { Err(PipelineError::BadIdentity(owner)) }
    }

    /// The key by which `signer` could sign for `owner` at `block` (`None` = now): the owner's
    /// own at that block. A lent device's key is not on the chain: see `signers`.
    pub fn signing_key(&self, owner: Address, signer: SignerId, block: Option<u64>) -> Option<PublicKey> {
        let account = self.account(owner)?;
        let mut known =
            account.identities.iter().rev().filter(|identity| block.is_none_or(|block| identity.block <= block));
        known
            .next()
            .filter(|identity| identity.proven && signer_id(&identity.signing) == signer)
            .map(|identity| identity.signing)
    }

    /// What the administrator decided.
    pub fn administration(&self) -> Administration {
        self.state.read().unwrap_or_else(PoisonError::into_inner).administration.clone()
    }

    /// The account that continues the work of `account`, which is lost; `None` where the administrator named none. A
    /// successor that was lost as well is followed to its own.
    pub fn successor(&self, account: Address) -> Option<Address> {
        self.state.read().unwrap_or_else(PoisonError::into_inner).administration.successor(account)
    }

    /// Whether `owner` had lent this device at `block` and `moment` (`None` = now).
    pub fn is_lent(&self, owner: Address, device: SignerId, block: Option<u64>, moment: Timestamp) -> bool {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let devices = state.accounts.get(&owner).map(|account| account.devices.as_slice()).unwrap_or_default();
        devices.iter().any(|lending| {
            let begun = block.is_none_or(|block| lending.from <= block);
            let recalled = lending.recalled.is_some_and(|recalled| block.is_none_or(|block| recalled <= block));
            lending.device == device && begun && !recalled && lending.until.is_none_or(|until| moment < until)
        })
    }

    /// The account whose signing key has this id now.
    pub fn registered_as(&self, signer: SignerId) -> Option<Address> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let has = |account: &Account| {
            let now = account.identities.last();
            now.is_some_and(|identity| identity.proven && signer_id(&identity.signing) == signer)
        };
        state.accounts.iter().find(|(_, account)| has(account)).map(|(address, _)| *address)
    }

    /// Whether the account ever registered this token.
    pub fn has_token(&self, owner: Address, token: Token) -> bool {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        state.accounts.get(&owner).is_some_and(|account| account.tokens.values().any(|known| *known == token))
    }

    /// Grants that match, oldest first.
    pub fn grants(&self, matches: impl Fn(&Granted) -> bool) -> Vec<Granted> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        state.grants.iter().filter(|grant| matches(grant)).cloned().collect()
    }
}

fn begin_epoch(state: &mut State, owner: Address, epoch: u64, token: Token) {
    let account = state.accounts.entry(owner).or_default();
    account.epoch = account.epoch.max(epoch);
    account.tokens.entry(epoch).or_insert(token);
}

fn grant(state: &mut State, terms: &GrantTerms, envelope: &[u8], at: &EventAt) {
    let known = state.grants.iter().any(|grant| grant.transaction == at.transaction && grant.terms == *terms);
    if known {
        return;
    }
    let mut envelopes = BTreeMap::new();
    // A grant renewed in a later epoch keeps what earlier envelopes opened.
    for grant in state.grants.iter().filter(|grant| {
        grant.revoked.is_none() && grant.terms.owner == terms.owner && grant.terms.grantee == terms.grantee
    }) {
        envelopes.extend(grant.envelopes.clone());
    }
    state.grants.retain(|grant| {
        grant.revoked.is_some() || grant.terms.owner != terms.owner || grant.terms.grantee != terms.grantee
    });
    envelopes.insert(terms.epoch, hex(envelope));
    let (terms, block, transaction) = (terms.clone(), at.block, at.transaction);
    state.grants.push(Granted { terms, envelopes, block, transaction, revoked: None });
}
