//! A desk that keeps in memory what a chain and a store would keep on disk.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::net::SocketAddr;
use std::sync::{Mutex, MutexGuard};

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::mpsc;

use super::fixtures::{Member, network};
use authros_chain::merkle::{Inclusion, Leaf};
use authros_chain::{AnchorProof, RelayError};
use authros_crypto::{SmKeyPair, signer_id};
use authros_gateway::command::{
    DeviceNotice, Entry, ErasureNotice, ErasureOutcome, Fetched, GrantNotice, Page, Query, Registration, RevokeNotice,
    Selection, Standing,
};
use authros_gateway::desk::{Account, Binding, BoundDevice, Caller, Desk, Received};
use authros_gateway::{Code, NetworkName, Refusal, Stood};
use authros_model::{Address, Digest, Hash, Header, ProfileName, PublicKey, SignerId, Timestamp, Token};

#[derive(Default)]
pub(crate) struct State {
    pub accounts: HashMap<Address, Account>,
    pub tokens: HashSet<(Address, Token)>,
    pub signers: HashMap<(Address, SignerId), PublicKey>,
    /// The chain's part: ids of devices, without their keys.
    pub lent: HashSet<(Address, SignerId)>,
    pub bindings: HashMap<ProfileName, Binding>,
    /// Successors of lost accounts.
    pub successors: HashMap<Address, Address>,
    pub records: BTreeMap<u64, Received>,
    pub readers: HashSet<(Address, Address)>,
    pub subscribers: Vec<(Caller, Selection, mpsc::Sender<Entry>)>,
    pub refusals: Vec<Code>,
    pub registrations: Vec<Registration>,
    pub grants: Vec<GrantNotice>,
    pub revokes: Vec<RevokeNotice>,
    /// Requests passed on to the chain: the caller and the method.
    pub relayed: Vec<(Option<Address>, String)>,
    /// The standing of every record; acknowledged unless set otherwise.
    pub standing: Option<Standing>,
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
}

#[derive(Default)]
pub(crate) struct MemoryDesk(Mutex<State>);

fn entry(record: &Received) -> Entry {
    Entry {
        digest: record.digest,
        owner: record.header.owner,
        recorder: record.header.recorder,
        seq: record.header.seq,
        topic_id: record.header.topic_id,
        epoch: record.header.epoch,
        captured_at: record.header.captured_at,
        length: u64::try_from(record.blob.len()).expect("fits"),
        kind: record.header.kind,
        standing: Standing::Acknowledged,
    }
}

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
        self.state().lent.insert((member.account(), signer_id(&device.public)));
    }

    pub fn recall(&self, member: &Member, device: &SmKeyPair) {
        let device = (member.account(), signer_id(&device.public));
        self.state().lent.remove(&device);
        self.state().signers.remove(&device);
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

    fn keep(&mut self, record: Received) -> Option<Entry> {
        if self.records.values().any(|known| known.digest == record.digest) {
            return None;
        }
        let (number, entry) = (self.records.len() as u64 + 1, entry(&record));
        self.records.insert(number, record);
        self.changes += 1;
        Some(entry)
    }
}

#[async_trait]
impl Desk for MemoryDesk {
    async fn account(&self, account: &Address) -> Result<Account, Refusal> {
        let found = self.state().accounts.get(account).copied();
        found.ok_or_else(|| Refusal::new(Code::NotRegistered, "unknown account"))
    }

    async fn admits(&self, account: &Address) -> Result<(), Refusal> {
        let dismissed = self.state().dismissed.contains(account);
        if dismissed { Err(Refusal::new(Code::NotAuthorised, "not admitted")) } else { Ok(()) }
    }

    async fn is_token(&self, account: &Address, token: &Token) -> Result<bool, Refusal> {
        Ok(self.state().tokens.contains(&(*account, *token)))
    }

    async fn is_lent(&self, owner: &Address, device: &SignerId) -> Result<bool, Refusal> {
        Ok(self.state().lent.contains(&(*owner, *device)))
    }

    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        Ok(self.state().signers.get(&(*owner, *signer)).copied())
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal> {
        Ok(self.state().bindings.get(name).cloned())
    }

    async fn successor(&self, lost: &Address) -> Result<Option<Address>, Refusal> {
        Ok(self.state().successors.get(lost).copied())
    }

    async fn bind(&self, name: &ProfileName, binding: Binding) -> Result<(), Refusal> {
        let mut state = self.state();
        state.bindings.insert(name.clone(), binding);
        state.changes += 1;
        Ok(())
    }

    async fn register(&self, registration: &Registration) -> Result<Hash, Refusal> {
        let mut state = self.state();
        state.registrations.push(registration.clone());
        state.changes += 1;
        Ok(Hash([0x99; 32]))
    }

    async fn store(&self, _: &Caller, records: Vec<Received>) -> Result<Timestamp, Refusal> {
        let new = {
            let mut state = self.state();
            let entries: Vec<Entry> = records.into_iter().filter_map(|record| state.keep(record)).collect();
            let senders = state.subscribers.iter().map(|(_, selection, sender)| (selection.owner, sender.clone()));
            let senders: Vec<_> = senders.collect();
            (entries, senders)
        };
        for entry in new.0 {
            for (_, sender) in new.1.iter().filter(|(owner, _)| *owner == entry.owner) {
                let _ = sender.send(entry).await;
            }
        }
        Ok(Timestamp::now())
    }

    async fn query(&self, caller: &Caller, query: &Query) -> Result<Page, Refusal> {
        let state = self.state();
        state.may_read(&caller.account, &query.selection.owner)?;
        let (owner, limit) = (query.selection.owner, usize::from(query.limit));
        let wanted = state
            .records
            .range(u64::try_from(query.cursor).expect("small") + 1..)
            .filter(|(_, record)| record.header.owner == owner);
        let found: Vec<(u64, Entry)> =
            wanted.take(limit + 1).map(|(number, record)| (*number, entry(record))).collect();
        let next = (found.len() > limit).then(|| u128::from(found[limit - 1].0));
        Ok(Page { entries: found.into_iter().take(limit).map(|(_, entry)| entry).collect(), next })
    }

    /// Each record is alone in its batch.
    async fn check(&self, _: &Caller, digests: &[Digest]) -> Result<Vec<Stood>, Refusal> {
        let state = self.state();
        let stood = |digest: &Digest| {
            let found = state.records.values().find(|record| record.digest == *digest);
            let here = state.standing.unwrap_or(Standing::Acknowledged);
            let standing = if found.is_some() { here } else { Standing::Unknown };
            let proof = found.filter(|_| standing == Standing::Verified && !state.proofless).map(anchor_of);
            Stood { standing, proof: proof.map(|proof| proof.encode()).unwrap_or_default() }
        };
        Ok(digests.iter().map(stood).collect())
    }

    async fn fetch(&self, caller: &Caller, digest: &Digest) -> Result<Fetched, Refusal> {
        let mut state = self.state();
        if state.silent {
            state.asked_in_vain += 1;
            return Err(Refusal::new(Code::Stale, "the chain is silent"));
        }
        let found = state.records.values().find(|record| record.digest == *digest);
        let record = found.ok_or_else(|| Refusal::new(Code::NotFound, "no such record"))?;
        state.may_read(&caller.account, &record.header.owner)?;
        let (signer, signature) = (record.signer, record.signature);
        Ok(Fetched { signer, signature, proof: Vec::new(), blob: record.blob.clone() })
    }

    async fn subscribe(&self, caller: &Caller, selection: &Selection) -> Result<mpsc::Receiver<Entry>, Refusal> {
        let mut state = self.state();
        state.may_read(&caller.account, &selection.owner)?;
        let (sender, receiver) = mpsc::channel(64);
        state.subscribers.push((caller.clone(), selection.clone(), sender));
        Ok(receiver)
    }

    async fn grant(&self, caller: &Caller, notice: &GrantNotice) -> Result<(), Refusal> {
        let mut state = self.state();
        state.readers.insert((caller.account, notice.grantee));
        state.grants.push(*notice);
        state.changes += 1;
        Ok(())
    }

    async fn revoke(&self, caller: &Caller, notice: &RevokeNotice) -> Result<(), Refusal> {
        let mut state = self.state();
        state.readers.remove(&(caller.account, notice.grantee));
        state.revokes.push(*notice);
        state.changes += 1;
        Ok(())
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        Ok(network())
    }

    /// A chain that echoes the request, however long; `eth_gasPrice` fails, `net_version` is silent.
    async fn relay(&self, caller: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        authros_chain::relay::check(method, parameters)?;
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

    async fn device(&self, caller: &Caller, notice: &DeviceNotice) -> Result<(), Refusal> {
        let mut state = self.state();
        let device = (caller.account, signer_id(&notice.key));
        if !state.lent.contains(&device) {
            return Err(Refusal::new(Code::Signature, "not lent"));
        }
        state.signers.insert(device, notice.key);
        if let Some(binding) = state.bindings.get_mut(&caller.name) {
            binding.device = Some(BoundDevice { id: device.1, notices: notice.notices });
        }
        state.changes += 1;
        Ok(())
    }

    async fn erase(&self, _: &Caller, erasures: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>, Refusal> {
        self.state().changes += 1;
        Ok(vec![ErasureOutcome::Taken; erasures.len()])
    }

    fn refused(&self, _: SocketAddr, refusal: &Refusal) {
        self.state().refusals.push(refusal.code);
    }
}
