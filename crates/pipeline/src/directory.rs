//! Who is registered and who may read what, rebuilt only from the contract's events, in chain order. The current state
//! is in memory; each event is stored too ([`kept`]), so that a restart scans only new blocks.

mod administration;
pub mod kept;

pub use administration::{Administration, Proposal, Recovery, Succession};
pub use kept::Told;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock};

use serde::{Deserialize, Serialize};

use crate::chain::{Event, EventAt};
use crate::crypto::{Provider, check_identity, signer_id};
use crate::model::{Address, Domain, GrantTerms, Hash, Identity, PublicKey, SignerId, Timestamp, Token};
use crate::{PipelineError, Result, model::steady_clock::steady_now};

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdentityAt {
    /// Block of the registration or key rotation.
    pub block: u64,
    pub signing: PublicKey,
    pub envelope: PublicKey,
    pub proven: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lending {
    /// SM3 of the device's public key.
    pub device: SignerId,
    /// First block.
    pub from: u64,
    /// Block, if recalled.
    pub recalled: Option<u64>,
    /// Until this moment; `None` = no end.
    pub until: Option<Timestamp>,
}

/// A period in which the administrator had suspended an account's changes, and with them its right to sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Suspension {
    /// First block.
    pub from: u64,
    /// Block in which it was lifted.
    pub until: Option<u64>,
    /// Its successor, if the account was lost.
    pub successor: Option<Address>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Account {
    pub identities: Vec<IdentityAt>,
    pub epoch: u64,
    /// Its token; for earlier ones see [`kept::token`].
    pub token: Option<Token>,
    /// Loans of devices that may sign, oldest first.
    pub devices: Vec<Lending>,
    pub suspensions: Vec<Suspension>,
    /// Who may stop a succession of it, as named by its owner; `None` = never anyone.
    pub recovery: Option<Recovery>,
}

impl Account {
    /// The suspension in force after a block's events (`None` = after all known events).
    pub fn suspended_at(&self, block: Option<u64>) -> Option<Suspension> {
        let holds = |interval: &&Suspension| match block {
            Some(block) => interval.from <= block && interval.until.is_none_or(|until| block < until),
            None => interval.until.is_none(),
        };
        self.suspensions.iter().find(holds).copied()
    }

    /// The block in which a device was revoked; a later loan is valid again.
    pub fn recalled(&self, device: SignerId) -> Option<u64> {
        self.devices.iter().rfind(|loan| loan.device == device)?.recalled
    }

    fn suspend(&mut self, block: u64, successor: Option<Address>) {
        match self.suspensions.last_mut().filter(|interval| interval.until.is_none()) {
            Some(interval) => interval.successor = successor.or(interval.successor),
            None => self.suspensions.push(Suspension { from: block, until: None, successor }),
        }
    }

    fn begin_epoch(&mut self, epoch: u64, token: Token) {
        if epoch > self.epoch {
            (self.epoch, self.token) = (epoch, Some(token));
        }
    }

    fn restore(&mut self, block: u64) {
        let open = self.suspensions.iter_mut().filter(|interval| interval.until.is_none());
        open.for_each(|interval| interval.until = Some(block));
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct State {
    accounts: BTreeMap<Address, Account>,
    /// Indices of its owner's loans that were not recalled.
    open_loans: BTreeMap<(Address, SignerId), Vec<usize>>,
    grants: BTreeMap<(Address, Address), Granted>,
    /// Same pairs, the other way round.
    received: BTreeSet<(Address, Address)>,
    administration: Administration,
    /// Block and index of the last event applied.
    applied: Option<(u64, u64)>,
}

pub struct Directory {
    domain: Domain,
    provider: &'static dyn Provider,
    state: RwLock<State>,
    /// The time of the newest block seen, seconds.
    head_time: AtomicU64,
}

impl Directory {
    pub fn new(domain: Domain, provider: &'static dyn Provider) -> Self {
        Self { domain, provider, state: RwLock::default(), head_time: AtomicU64::new(0) }
    }

    pub fn saw_head_of(&self, seconds: u64) {
        self.head_time.store(seconds, Ordering::Release);
    }

    /// The time by which rights begin and end: the contract judges by its blocks' time, so it is never before the
    /// newest block's, whatever this machine's clock says; between two blocks that clock counts, without its jumps.
    pub fn now(&self) -> Timestamp {
        steady_now().max(Timestamp::from_seconds(self.head_time.load(Ordering::Acquire)))
    }

    pub fn blank(&self) -> Self {
        Self::new(self.domain, self.provider)
    }

    /// Events up to this position were applied, some of which no longer count.
    fn applied_up_to(&self, last: Option<(u64, u64)>) {
        self.state.write().unwrap_or_else(PoisonError::into_inner).applied = last;
    }

    /// Takes over the whole state of a directory that was rebuilt without replaced or missed blocks.
    pub fn become_like(&self, other: &Self) {
        let state = other.state.read().unwrap_or_else(PoisonError::into_inner).clone();
        *self.state.write().unwrap_or_else(PoisonError::into_inner) = state;
    }

    /// The block of the last event that changed anything; 0 before the first.
    pub fn newest(&self) -> u64 {
        self.state.read().unwrap_or_else(PoisonError::into_inner).applied.map_or(0, |(block, _)| block)
    }

    /// Returns whether the event was new and changes rights.
    pub fn apply(&self, at: &EventAt) -> bool {
        self.judge(at).is_some_and(|told| self.take(&told))
    }

    /// An event's effect on rights; `None` for anchors, which are up to the watcher.
    pub fn judge(&self, at: &EventAt) -> Option<Told> {
        let proven = match &at.event {
            Event::DataUploaded { .. } | Event::Anchored { .. } => return None,
            Event::Registered { owner, identity, .. } | Event::KeysRotated { owner, identity, .. } => {
                check_identity(self.provider, &self.domain, owner, identity).is_ok()
            }
            _ => false,
        };
        let (block, place, transaction) = (at.block, at.log_index, at.transaction);
        Some(Told { block, place, transaction, event: at.event.clone(), proven })
    }

    pub fn take(&self, told: &Told) -> bool {
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        let place = (told.block, told.place);
        if state.applied.is_some_and(|applied| place <= applied) {
            return false;
        }
        state.change(told);
        state.applied = Some(place);
        true
    }

    pub fn account(&self, owner: Address) -> Option<Account> {
        self.state.read().unwrap_or_else(PoisonError::into_inner).accounts.get(&owner).cloned()
    }

    pub(super) fn with_account<T>(&self, owner: Address, look: impl FnOnce(Option<&Account>) -> T) -> T {
        look(self.state.read().unwrap_or_else(PoisonError::into_inner).accounts.get(&owner))
    }

    /// 0 if not registered.
    pub fn epoch(&self, owner: Address) -> u64 {
        self.with_account(owner, |account| account.map_or(0, |account| account.epoch))
    }

    pub fn identity(&self, owner: Address) -> Result<IdentityAt> {
        let account = self.account(owner).ok_or(PipelineError::Unregistered(owner))?;
        let identity = account.identities.last().cloned().ok_or(PipelineError::Unregistered(owner))?;
        if identity.proven { Ok(identity) } else { Err(PipelineError::BadIdentity(owner)) }
    }

    /// The proven identities of an account that were registered at any moment of a block, newest first: whatever it
    /// signed in that block, it signed with one of them.
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

    /// The block since which an account has its present envelope key; 0 if it has none.
    pub fn envelope_key_since(&self, account: Address) -> u64 {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let known = state.accounts.get(&account).map(|account| account.identities.as_slice()).unwrap_or_default();
        let Some(now) = known.last() else { return 0 };
        let same = known.iter().rev().take_while(|identity| identity.envelope == now.envelope);
        same.last().map_or(0, |identity| identity.block)
    }

    pub fn administration(&self) -> Administration {
        self.state.read().unwrap_or_else(PoisonError::into_inner).administration.clone()
    }

    /// `None` if the administrator named none. If a successor was lost as well, its own successor.
    pub fn successor(&self, account: Address) -> Option<Address> {
        self.state.read().unwrap_or_else(PoisonError::into_inner).administration.successor(account)
    }

    /// The account that has registered the signing key with this id, now or earlier: a gateway keeps its identity when
    /// its keeper's key changes.
    pub fn registered_as(&self, signer: SignerId) -> Option<Address> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let has = |account: &Account| {
            let is_it = |identity: &IdentityAt| identity.proven && signer_id(&identity.signing) == signer;
            account.identities.iter().any(is_it)
        };
        state.accounts.iter().find(|(_, account)| has(account)).map(|(address, _)| *address)
    }

    /// Not revoked; it may have expired.
    pub fn grant_between(&self, owner: Address, grantee: Address) -> Option<Granted> {
        self.state.read().unwrap_or_else(PoisonError::into_inner).grants.get(&(owner, grantee)).cloned()
    }

    /// Not revoked, oldest first.
    pub fn grants_to(&self, grantee: Address) -> Vec<Granted> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        let owners = state.received.range((grantee, LOWEST)..=(grantee, HIGHEST)).map(|(_, owner)| *owner);
        oldest_first(owners.filter_map(|owner| state.grants.get(&(owner, grantee)).cloned()))
    }

    /// Not revoked, oldest first.
    pub fn grants_of(&self, owner: Address) -> Vec<Granted> {
        let state = self.state.read().unwrap_or_else(PoisonError::into_inner);
        oldest_first(state.grants.range((owner, LOWEST)..=(owner, HIGHEST)).map(|(_, grant)| grant.clone()))
    }
}

const LOWEST: Address = Address([0; 20]);
const HIGHEST: Address = Address([0xff; 20]);

fn oldest_first(grants: impl Iterator<Item = Granted>) -> Vec<Granted> {
    let mut found: Vec<Granted> = grants.collect();
    found.sort_by_key(Granted::place);
    found
}

impl State {
    fn account(&mut self, owner: Address) -> &mut Account {
        self.accounts.entry(owner).or_default()
    }

    fn change(&mut self, told: &Told) {
        let block = told.block;
        match &told.event {
            Event::Registered { owner, identity, epoch } => {
                self.account(*owner).begin_epoch(*epoch, identity.token);
                self.account(*owner).identities.push(identity_at(told, identity));
            }
            Event::KeysRotated { owner, identity, .. } => {
                self.account(*owner).identities.push(identity_at(told, identity));
            }
            Event::Granted { terms, .. } => self.grant(terms, told),
            Event::Extended { owner, grantee, expiry } => {
                if let Some(grant) = self.grants.get_mut(&(*owner, *grantee)) {
                    grant.extended = Some(Extension { expiry: *expiry, block });
                }
            }
            Event::RecoveryNamed { owner, recovery, from } => {
                let delay = self.administration.delay;
                let known = &mut self.account(*owner).recovery;
                *known = Some(Recovery::named(known.take(), *recovery, *from, delay));
            }
            Event::Wrapped { owner, grantee, epoch, .. } => {
                if let Some(grant) = self.grants.get_mut(&(*owner, *grantee)) {
                    grant.take_envelope(*epoch, block);
                }
            }
            Event::Revoked { owner, grantee, epoch, token } => {
                self.account(*owner).begin_epoch(*epoch, *token);
                self.grants.remove(&(*owner, *grantee));
                self.received.remove(&(*grantee, *owner));
            }
            Event::Rotated { owner, epoch, token } => self.account(*owner).begin_epoch(*epoch, *token),
            Event::Lent { owner, device, until } => self.lend(*owner, *device, *until, block),
            Event::Recalled { owner, device } => self.recall(*owner, *device, block),
            Event::Suspended { account } => self.account(*account).suspend(block, None),
            Event::Restored { account } => self.account(*account).restore(block),
            Event::Succeeded { lost, successor } => self.account(*lost).suspend(block, Some(*successor)),
            _ => {}
        }
        self.administration.apply(told);
    }

    fn grant(&mut self, terms: &GrantTerms, told: &Told) {
        let pair = (terms.owner, terms.grantee);
        // A grant renewed in a later epoch keeps what earlier envelopes opened.
        let mut grant = Granted::of(terms.clone(), told, self.grants.get(&pair));
        grant.take_envelope(terms.epoch, told.block);
        self.grants.insert(pair, grant);
        self.received.insert((terms.grantee, terms.owner));
    }

    fn lend(&mut self, owner: Address, device: SignerId, until: Option<Timestamp>, block: u64) {
        let devices = &mut self.accounts.entry(owner).or_default().devices;
        self.open_loans.entry((owner, device)).or_default().push(devices.len());
        devices.push(Lending { device, from: block, recalled: None, until });
    }

    fn recall(&mut self, owner: Address, device: SignerId, block: u64) {
        let devices = &mut self.accounts.entry(owner).or_default().devices;
        for place in self.open_loans.remove(&(owner, device)).unwrap_or_default() {
            if let Some(lending) = devices.get_mut(place) {
                lending.recalled = Some(block);
            }
        }
    }
}

fn identity_at(told: &Told, identity: &Identity) -> IdentityAt {
    let (signing, envelope) = (identity.signing, identity.envelope);
    IdentityAt { block: told.block, signing, envelope, proven: told.proven }
}

/// This many of a grant's newest epochs are held in memory; all others are read from the ledger.
const EPOCHS_HELD: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extension {
    /// `None` = no end.
    pub expiry: Option<Timestamp>,
    pub block: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Granted {
    /// The terms of the grant, as its envelopes repeat them; for its end see [`Granted::expiry`].
    pub terms: GrantTerms,
    pub extended: Option<Extension>,
    pub block: u64,
    pub transaction: Hash,
    /// The epoch that began with its revocation.
    pub revoked: Option<u64>,
    /// Index of the grant among the block's events.
    place: u64,
    /// The newest epochs that have an envelope, with the block of the newest one.
    wrapped: BTreeMap<u64, u64>,
}

impl Granted {
    /// A grant that it renews already had envelopes.
    fn of(terms: GrantTerms, told: &Told, renewed: Option<&Self>) -> Self {
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

    fn place(&self) -> (u64, u64) {
        (self.block, self.place)
    }

    /// When it ends, including extensions; `None` = never.
    pub fn expiry(&self) -> Option<Timestamp> {
        self.extended.map_or(self.terms.expiry, |extended| extended.expiry)
    }

    pub fn is_active(&self, now: Timestamp) -> bool {
        self.revoked.is_none() && self.expiry().is_none_or(|expiry| expiry > now)
    }

    pub fn state(&self, now: Timestamp) -> GrantState {
        match (self.revoked, self.is_active(now)) {
            (Some(_), _) => GrantState::Revoked,
            (None, true) => GrantState::Active,
            (None, false) => GrantState::Expired,
        }
    }

    pub fn is_wrapped(&self, epoch: u64) -> bool {
        self.wrapped.contains_key(&epoch)
    }

    /// Whether it has an envelope for such an epoch that was made in this block or later.
    pub fn is_wrapped_since(&self, epoch: u64, block: u64) -> bool {
        self.wrapped.get(&epoch).is_some_and(|newest| *newest >= block)
    }

    pub fn newest_wrapped(&self) -> Option<u64> {
        self.wrapped.keys().next_back().copied()
    }

    /// The epochs before `epoch` and since the grant that have no envelope, as far back as memory goes. Each of them began
    /// while it stood: it cannot be extended once it has ended.
    pub fn unwrapped_before(&self, epoch: u64) -> impl Iterator<Item = u64> {
        let oldest = self.wrapped.keys().next().copied().unwrap_or(epoch);
        (oldest.max(self.terms.epoch)..epoch).filter(|epoch| !self.is_wrapped(*epoch))
    }

    #[cfg(test)]
    fn held(&self) -> usize {
        1 + self.wrapped.len()
    }

    fn take_envelope(&mut self, epoch: u64, block: u64) {
        let newest = self.wrapped.entry(epoch).or_insert(block);
        *newest = block.max(*newest);
        if self.wrapped.len() > EPOCHS_HELD {
            self.wrapped.pop_first();
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum GrantState {
    Active,
    Expired,
    Revoked,
}

impl GrantState {
    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[cfg(test)]
mod tests;
