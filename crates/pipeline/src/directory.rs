//! Who is registered and who may read what, rebuilt from the contract's events alone.
//!
//! Events are applied in chain order; one that is not behind the last one applied is passed over. The state can be
//! written down and read back, so that a restart scans only new blocks. What follows from it is `authority`'s to say.

mod administration;
mod granted;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock};

use serde::{Deserialize, Serialize};

use crate::chain::{Event, EventAt};
use crate::crypto::{Provider, check_identity, signer_id};
use crate::model::steady_clock::steady_now;
use crate::model::{Address, Domain, GrantTerms, Identity, PublicKey, SignerId, Timestamp, Token};

use super::PipelineError;
pub use administration::{Administration, Proposal, Recovery, Succession};
pub use granted::{Envelope, Extension, Granted};

/// How the state is written down; another one is read anew from the chain.
const WRITTEN: u8 = 5;

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

/// A time in which the administrator had stopped an account's changes, and with them its right to sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Suspension {
    /// From this block on.
    pub from: u64,
    /// Until this block, in which it was restored.
    pub until: Option<u64>,
    /// Who continues its work, where the account was lost.
    pub successor: Option<Address>,
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
    /// Loans of devices that may sign, oldest first.
    pub devices: Vec<Lending>,
    /// Times of being suspended, oldest first.
    #[serde(default)]
    pub suspensions: Vec<Suspension>,
    /// Who may stop a succession of it, as its owner named them; `None` = never anybody.
    #[serde(default)]
    pub recovery: Option<Recovery>,
}

impl Account {
    /// The suspension that was in force after a block's events (`None` = after all that are known).
    pub fn suspended_at(&self, block: Option<u64>) -> Option<Suspension> {
        let holds = |interval: &&Suspension| match block {
            Some(block) => interval.from <= block && interval.until.is_none_or(|until| block < until),
            None => interval.until.is_none(),
        };
        self.suspensions.iter().find(holds).copied()
    }

    fn suspend(&mut self, block: u64, successor: Option<Address>) {
        match self.suspensions.last_mut().filter(|interval| interval.until.is_none()) {
            Some(interval) => interval.successor = successor.or(interval.successor),
            None => self.suspensions.push(Suspension { from: block, until: None, successor }),
        }
    }

    fn restore(&mut self, block: u64) {
        let open = self.suspensions.iter_mut().filter(|interval| interval.until.is_none());
        open.for_each(|interval| interval.until = Some(block));
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct State {
    accounts: BTreeMap<Address, Account>,
    grants: Vec<Granted>,
    administration: Administration,
    /// Block and place of the last event that was applied.
    applied: Option<(u64, u64)>,
}

/// Registrations and grants of one contract.
pub struct Directory {
    domain: Domain,
    provider: &'static dyn Provider,
    state: RwLock<State>,
    /// The time of the newest block seen, seconds.
    head_time: AtomicU64,
}

impl Directory {
    /// An empty directory.
    pub fn new(domain: Domain, provider: &'static dyn Provider) -> Self {
        Self { domain, provider, state: RwLock::default(), head_time: AtomicU64::new(0) }
    }

    /// Notes the time of the newest block, seconds.
    pub fn saw_head_of(&self, seconds: u64) {
        self.head_time.store(seconds, Ordering::Release);
    }

    /// The moment by which rights begin and end: the contract judges by its blocks' time, so it is never before the
    /// newest one's, whatever this machine's clock says; between two blocks that clock counts, jumps left out.
    pub fn now(&self) -> Timestamp {
        steady_now().max(Timestamp::from_seconds(self.head_time.load(Ordering::Acquire)))
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
        self.state.read().unwrap_or_else(PoisonError::into_inner).applied.map_or(0, |(block, _)| block)
    }

    /// Applies one event; returns whether it was a new one that changes rights.
    pub fn apply(&self, at: &EventAt) -> bool {
        // Anchors are the watcher's.
        if matches!(at.event, Event::DataUploaded { .. } | Event::Anchored { .. }) {
            return false;
        }
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        let place = (at.block, at.log_index);
        if state.applied.is_some_and(|applied| place <= applied) {
            return false;
        }
        self.change(&mut state, at);
        state.applied = Some(place);
        true
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
            Event::Extended { owner, grantee, expiry } => {
                let matching = |grant: &&mut Granted| {
                    grant.terms.owner == *owner && grant.terms.grantee == *grantee && grant.revoked.is_none()
                };
                if let Some(grant) = state.grants.iter_mut().rev().find(matching) {
                    grant.extended = Some(Extension { expiry: *expiry, block: at.block });
                }
            }
            Event::RecoveryNamed { owner, recovery, from } => {
                let delay = state.administration.delay.unwrap_or(0);
                let known = &mut state.accounts.entry(*owner).or_default().recovery;
                *known = Some(Recovery::named(known.take(), *recovery, *from, delay));
            }
            Event::Wrapped { owner, grantee, epoch, envelope } => {
                let found = state
                    .grants
                    .iter_mut()
                    .rev()
                    .find(|grant| grant.terms.owner == *owner && grant.terms.grantee == *grantee);
                if let Some(grant) = found {
                    grant.take_envelope(*epoch, envelope, at.block);
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
                state.accounts.entry(*owner).or_default().devices.push(lending);
            }
            Event::Recalled { owner, device } => {
                let devices = &mut state.accounts.entry(*owner).or_default().devices;
                devices
                    .iter_mut()
                    .filter(|lending| lending.device == *device && lending.recalled.is_none())
                    .for_each(|lending| lending.recalled = Some(at.block));
            }
            Event::Suspended { account } => state.accounts.entry(*account).or_default().suspend(at.block, None),
            Event::Restored { account } => state.accounts.entry(*account).or_default().restore(at.block),
            Event::Succeeded { lost, successor } => {
                state.accounts.entry(*lost).or_default().suspend(at.block, Some(*successor));
            }
            _ => {}
        }
        state.administration.apply(at);
    }

    fn identify(&self, account: &mut Account, owner: Address, identity: &Identity, block: u64) {
        let proven = check_identity(self.provider, &self.domain, &owner, identity).is_ok();
        let entry = IdentityAt { block, signing: identity.signing, envelope: identity.envelope, proven };
        account.identities.push(entry);
    }

    /// What is known of an account.
    pub fn account(&self, owner: Address) -> Option<Account> {
        self.state.read().unwrap_or_else(PoisonError::into_inner).accounts.get(&owner).cloned()
    }

    /// Looks at an account without copying it.
    pub(super) fn with_account<T>(&self, owner: Address, look: impl FnOnce(Option<&Account>) -> T) -> T {
        look(self.state.read().unwrap_or_else(PoisonError::into_inner).accounts.get(&owner))
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

    /// The proven identities of an account that were registered at any moment of a block, the newest first: what it
    /// signed in that block it signed with one of them.
    pub fn identities_at(&self, owner: Address, block: u64) -> Vec<IdentityAt> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let known = state.accounts.get(&owner).map(|account| account.identities.as_slice()).unwrap_or_default();
        let ends = known.iter().skip(1).map(|next| Some(next.block)).chain([None]);
        let lasting = known
            .iter()
            .zip(ends)
            .filter(|(identity, end)| identity.proven && identity.block <= block && end.is_none_or(|end| block <= end));
        let mut found: Vec<IdentityAt> = lasting.map(|(identity, _)| identity.clone()).collect();
        found.reverse();
        found
    }

    /// The block since which an account has the envelope key that it has now; 0 where it has none.
    pub fn envelope_key_since(&self, account: Address) -> u64 {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let known = state.accounts.get(&account).map(|account| account.identities.as_slice()).unwrap_or_default();
        let Some(now) = known.last() else { return 0 };
        let same = known.iter().rev().take_while(|identity| identity.envelope == now.envelope);
        same.last().map_or(0, |identity| identity.block)
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

    /// The account that has registered the signing key with this id, now or before: a gateway keeps its identity when
    /// its keeper's key changes.
    pub fn registered_as(&self, signer: SignerId) -> Option<Address> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let has = |account: &Account| {
            let is_it = |identity: &IdentityAt| identity.proven && signer_id(&identity.signing) == signer;
            account.identities.iter().any(is_it)
        };
        state.accounts.iter().find(|(_, account)| has(account)).map(|(address, _)| *address)
    }

    /// Whether the account ever registered this token.
    pub fn has_token(&self, owner: Address, token: Token) -> bool {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        state.accounts.get(&owner).is_some_and(|account| account.tokens.values().any(|known| *known == token))
    }

    /// The grant of an owner to a grantee that was not revoked; it may have run out.
    pub fn grant_between(&self, owner: Address, grantee: Address) -> Option<Granted> {
        let between = |grant: &Granted| grant.terms.owner == owner && grant.terms.grantee == grantee;
        self.grants(|grant| grant.revoked.is_none() && between(grant)).pop()
    }

    /// The grants to an account that were not revoked, oldest first.
    pub fn grants_to(&self, grantee: Address) -> Vec<Granted> {
        self.grants(|grant| grant.revoked.is_none() && grant.terms.grantee == grantee)
    }

    /// The grants of an account that were not revoked, oldest first.
    pub fn grants_of(&self, owner: Address) -> Vec<Granted> {
        self.grants(|grant| grant.revoked.is_none() && grant.terms.owner == owner)
    }

    /// Grants that match, revoked ones too, oldest first.
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
    let (terms, block, transaction) = (terms.clone(), at.block, at.transaction);
    let mut grant = Granted { terms, envelopes, block, transaction, revoked: None, extended: None };
    grant.take_envelope(grant.terms.epoch, envelope, block);
    state.grants.push(grant);
}
