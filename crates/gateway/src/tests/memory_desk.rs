//! A desk that keeps in memory what a chain and a store would keep on disk.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::net::SocketAddr;
use std::sync::{Mutex, MutexGuard};

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::watch;

use super::fixtures::{Member, network};
use authros_crypto::AnchorProof;
use authros_crypto::merkle::{Inclusion, Leaf};
use authros_crypto::{SmKeyPair, signer_id};
use authros_gateway::command::{ErasureNotice, ErasureOutcome, Fetched, Found, GrantNotice, Notice, RevokeNotice};
use authros_gateway::desk::{Account, Binding, BoundDevice, Caller, Desk, Received};
use authros_gateway::feed::{FeedEntry, MOST_ENTRIES, Place};
use authros_gateway::{Code, Feed, FeedPage, NetworkName, Refusal};
use authros_model::relay::{self, RelayError};
use authros_model::{
    Address, Digest, Fact, Hash, Header, ProfileName, PublicKey, RecordKind, SignerId, Timestamp, Token,
};

/// When a device was recalled.
const RECALLED: Timestamp = Timestamp(1_700_000_000_000_000_000);

#[derive(Default)]
#[allow(clippy::struct_excessive_bools, reason = "each is one thing that a test may set")]
pub(crate) struct State {
    pub accounts: HashMap<Address, Account>,
    pub tokens: HashSet<(Address, Token)>,
    pub signers: HashMap<(Address, SignerId), PublicKey>,
    /// The chain's part: ids of devices, without their keys.
    pub lent: HashSet<(Address, SignerId)>,
    /// Devices whose loan was recalled.
    pub recalled: HashSet<(Address, SignerId)>,
    pub bindings: HashMap<ProfileName, Binding>,
    /// Names whose transport key at rest does not open.
    pub sealed: HashSet<ProfileName>,
    /// Successors of lost accounts.
    pub successors: HashMap<Address, Address>,
    pub records: BTreeMap<u64, Received>,
    pub readers: HashSet<(Address, Address)>,
    pub refusals: Vec<Code>,
    pub grants: Vec<GrantNotice>,
    pub revokes: Vec<RevokeNotice>,
    /// Requests passed on to the chain: the caller and the method.
    pub relayed: Vec<(Option<Address>, String)>,
    /// It gives standings without proofs.
    pub proofless: bool,
    /// Accounts that the keeper does not admit.
    pub dismissed: HashSet<Address>,
    /// The chain is silent: who may read is not known.
    pub silent: bool,
    /// How often a record was asked for meanwhile.
    pub asked_in_vain: usize,
    /// Every change so far.
    pub changes: usize,
    /// Its bytes are not what was uploaded any more.
    pub spoilt: bool,
    /// Every record is verified, from now on as it is stored.
    pub verifies: bool,
    /// The feed: records by their numbers, and what it says of them.
    pub feed: Vec<(u64, Fact)>,
    /// The feed's id: a restored gateway has another one.
    pub feed_id: [u8; 16],
    /// Rings with every change.
    pub ring: Option<watch::Sender<u64>>,
}

#[derive(Default)]
pub(crate) struct MemoryDesk(Mutex<State>);

fn anchor_of(record: &Received) -> AnchorProof {
    let Header { owner, .. } = record.header;
    let root = Leaf::of(&record.header, record.digest).hash();
    let inclusion = Inclusion { index: 0, count: 1, path: Vec::new(), root };
    let (transaction, block_hash) = (Hash([1; 32]), Hash([2; 32]));
    AnchorProof { account: owner, transaction, block: 3, block_hash, inclusion: Some(inclusion) }
}

impl MemoryDesk {
    pub fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().expect("no test panicked while it held the state")
    }

    /// The chain's view of a member.
    pub fn admit(&self, member: &Member) {
        let mut state = self.state();
        let account = Account { signing: member.signing.public, envelope: member.envelope.public };
        state.accounts.insert(member.account(), account);
        state.tokens.insert((member.account(), member.token));
        let own = (member.account(), signer_id(&member.signing.public));
        state.signers.insert(own, member.signing.public);
    }

    pub fn lend(&self, member: &Member, device: &SmKeyPair) {
        let (mut state, device) = (self.state(), (member.account(), signer_id(&device.public)));
        state.lent.insert(device);
        state.recalled.remove(&device);
    }

    pub fn recall(&self, member: &Member, device: &SmKeyPair) {
        let (mut state, device) = (self.state(), (member.account(), signer_id(&device.public)));
        state.recalled.insert(device);
        state.lent.remove(&device);
        state.signers.remove(&device);
    }

    pub fn record_count(&self) -> usize {
        self.state().records.len()
    }
}

impl State {
    fn may_read(&self, reader: &Address, owner: &Address) -> Result<(), Refusal> {
        if reader == owner || self.readers.contains(&(*owner, *reader)) {
            return Ok(());
        }
        Err(Refusal::new(Code::NotAuthorised, "no grant"))
    }

    fn told(&self, (number, fact): (u64, Fact), record: &Received) -> FeedEntry {
        let proof = if fact == Fact::Verified && !self.proofless { anchor_of(record).encode() } else { Vec::new() };
        let header = &record.header;
        FeedEntry {
            number,
            fact,
            digest: record.digest,
            owner: header.owner,
            recorder: header.recorder,
            seq: header.seq,
            topic_id: header.topic_id,
            epoch: header.epoch,
            captured_at: header.captured_at,
            length: record.blob.len() as u64,
            kind: header.kind,
            proof,
        }
    }

    /// Everything that is here and that comes is verified.
    pub fn verify(&mut self) {
        self.verifies = true;
        let waiting = self.records.keys().filter(|number| !self.feed.contains(&(**number, Fact::Verified)));
        let waiting: Vec<_> = waiting.map(|number| (*number, Fact::Verified)).collect();
        self.feed.extend(waiting);
        self.ring();
    }

    /// What readers are told may have changed.
    pub fn ring(&mut self) {
        self.changes += 1;
        if let Some(ring) = &self.ring {
            ring.send_modify(|count| *count += 1);
        }
    }

    fn keep(&mut self, record: Received) {
        if self.records.values().any(|known| known.digest == record.digest) {
            return;
        }
        let (number, kind) = (self.records.len() as u64 + 1, record.header.kind);
        if self.verifies {
            self.feed.push((number, Fact::Verified));
        } else if kind == RecordKind::Key {
            self.feed.push((number, Fact::Stored));
        }
        self.records.insert(number, record);
        self.ring();
    }
}

#[async_trait]
impl Desk for MemoryDesk {
    async fn account(&self, account: &Address, device: Option<&SignerId>) -> Result<Account, Refusal> {
        if device.is_some_and(|device| !self.state().lent.contains(&(*account, *device))) {
            return Err(Refusal::new(Code::NotAuthorised, "not lent"));
        }
        let found = self.state().accounts.get(account).copied();
        found.ok_or_else(|| Refusal::new(Code::NotRegistered, "unknown account"))
    }

    async fn admits(&self, account: &Address, token: Option<&Token>) -> Result<(), Refusal> {
        if token.is_some_and(|token| !self.state().tokens.contains(&(*account, *token))) {
            return Err(Refusal::new(Code::Token, "an unknown token"));
        }
        let dismissed = self.state().dismissed.contains(account);
        if dismissed { Err(Refusal::new(Code::NotAdmitted, "not admitted")) } else { Ok(()) }
    }

    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        Ok(self.state().signers.get(&(*owner, *signer)).copied())
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal> {
        let state = self.state();
        if state.sealed.contains(name) {
            return Err(Refusal::new(Code::Tag, "it does not open"));
        }
        Ok(state.bindings.get(name).cloned())
    }

    async fn recalled(&self, binding: &Binding) -> Result<Option<Timestamp>, Refusal> {
        let (state, Some(device)) = (self.state(), &binding.device) else { return Ok(None) };
        if state.silent {
            return Err(Refusal::new(Code::Stale, "the chain is silent"));
        }
        Ok(state.recalled.contains(&(binding.account, device.id)).then_some(RECALLED))
    }

    async fn successor(&self, lost: &Address) -> Result<Option<Address>, Refusal> {
        Ok(self.state().successors.get(lost).copied())
    }

    async fn bind(&self, name: &ProfileName, _: Option<Address>, binding: Binding) -> Result<(), Refusal> {
        let mut state = self.state();
        state.bindings.insert(name.clone(), binding);
        state.ring();
        Ok(())
    }

    async fn store(&self, _: &Caller, records: Vec<Received>) -> Result<Timestamp, Refusal> {
        let mut state = self.state();
        records.into_iter().for_each(|record| state.keep(record));
        Ok(Timestamp::now())
    }

    async fn feed(&self, caller: &Caller, asked: &Feed, _: bool) -> Result<FeedPage, Refusal> {
        let mut state = self.state();
        if state.silent {
            state.asked_in_vain += 1;
            return Err(Refusal::new(Code::Stale, "the chain is silent"));
        }
        let mut refused = Vec::new();
        for Place { owner, .. } in &asked.places {
            if let Err(refusal) = state.may_read(&caller.account, owner) {
                refused.push((*owner, refusal.code));
            }
        }
        if refused.len() == asked.places.len() {
            return Err(Refusal::new(refused[0].1, "no grant"));
        }
        let head = state.feed.len() as u64;
        let after = |owner: &Address| {
            let is_told = |place: &&Place| place.owner == *owner && !refused.iter().any(|(no, _)| no == owner);
            let place = asked.places.iter().find(is_told);
            place.map(|place| if asked.id == state.feed_id && place.after <= head { place.after } else { 0 })
        };
        let mut entries: Vec<FeedEntry> = Vec::new();
        for (number, (record, fact)) in (1..).zip(&state.feed) {
            let Some(record) = state.records.get(record) else { continue };
            let header = &record.header;
            if after(&header.owner).is_some_and(|after| number > after)
                && (asked.topics.is_empty() || asked.topics.contains(&header.topic_id))
                && (asked.recorders.is_empty() || asked.recorders.contains(&header.recorder))
                && asked.kind.is_none_or(|kind| kind == header.kind)
            {
                entries.push(state.told((number, *fact), record));
            }
        }
        entries.truncate(MOST_ENTRIES);
        let upto = if entries.len() == MOST_ENTRIES { entries[MOST_ENTRIES - 1].number } else { head };
        let is_anew = asked.id != state.feed_id || asked.places.iter().any(|place| place.after > head);
        Ok(FeedPage { is_anew, ..FeedPage::new(state.feed_id, (head, upto), refused, entries) })
    }

    fn changes(&self) -> watch::Receiver<u64> {
        let mut state = self.state();
        state.ring.get_or_insert_with(|| watch::channel(0).0).subscribe()
    }

    async fn records(&self, caller: &Caller, digests: &[Digest], bytes: bool) -> Result<Vec<Found>, Refusal> {
        let state = self.state();
        if state.silent {
            return Err(Refusal::new(Code::Stale, "the chain is silent"));
        }
        let found = |digest: &Digest| {
            let Some(record) = state.records.values().find(|record| record.digest == *digest) else {
                return Found::Missing(Code::NotFound);
            };
            if let Err(refusal) = state.may_read(&caller.account, &record.header.owner) {
                return Found::Missing(refusal.code);
            }
            if state.spoilt {
                return Found::Missing(Code::Tampered);
            }
            let (signer, signature, blob) = (record.signer, record.signature, record.blob.clone());
            if bytes { Found::Held(Fetched { signer, signature, proof: Vec::new(), blob }) } else { Found::Here }
        };
        Ok(digests.iter().map(found).collect())
    }

    async fn notice(&self, caller: &Caller, notice: &Notice) -> Result<(), Refusal> {
        let mut state = self.state();
        match notice {
            Notice::Grant(notice) => {
                state.readers.insert((caller.account, notice.grantee));
                state.grants.push(*notice);
            }
            Notice::Revoke(notice) => {
                state.readers.remove(&(caller.account, notice.grantee));
                state.revokes.push(*notice);
            }
            Notice::Device(notice) => {
                let device = (caller.account, signer_id(&notice.key));
                if !state.lent.contains(&device) {
                    return Err(Refusal::new(Code::Signature, "not lent"));
                }
                state.signers.insert(device, notice.key);
                if let Some(binding) = state.bindings.get_mut(&caller.name) {
                    binding.device = Some(BoundDevice { id: device.1, notices: notice.notices });
                }
            }
        }
        state.ring();
        Ok(())
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        Ok(network())
    }

    /// A chain that echoes the request, however long; `eth_gasPrice` fails, `net_version` is silent.
    async fn relay(&self, caller: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        relay::check(method, parameters)?;
        self.state().relayed.push((caller.map(|caller| caller.account), method.to_owned()));
        match method {
            "eth_gasPrice" => Err(RelayError::Answered {
                code: 3,
                message: "execution reverted: no grant".into(),
                data: Some(parameters.clone()),
            }),
            "net_version" => Err(RelayError::Silent("connection refused".into())),
            "eth_getCode" => Ok(Value::String("6".repeat(3 << 20))),
            _ => Ok(parameters.clone()),
        }
    }

    async fn erase(&self, _: &Caller, erasures: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>, Refusal> {
        self.state().ring();
        Ok(vec![ErasureOutcome::Taken; erasures.len()])
    }

    fn refused(&self, _: SocketAddr, refusal: &Refusal) {
        self.state().refusals.push(refusal.code);
    }
}
