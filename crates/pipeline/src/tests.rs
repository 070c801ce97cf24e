//! Anchoring as a whole: ledger, anchorer, sender, watcher and the embedded chain.

mod asking;
mod chain_proofs;
mod definitions;
mod erased;
mod flipped;
mod keeping;
mod misnamed;
mod placed;
mod rights;

use std::path::Path;
use std::sync::Arc;

use super::anchorer::{self, Anchorer};
use super::{Network, Observer, Owner, Plant, Sender, watcher};
use crate::chain::{Call, Chain, ChainOptions, Endpoint, Policy};
use crate::crypto::sm3::sm3;
use crate::crypto::{
    Anchor, Expected, Keyring, Names, Passphrase, ProviderName, UnlockedKeyring, open, prove, provider, signer_id,
};
use crate::model::{
    AnchorMode, Digest, Domain, ProfileName, RecordKind, RecordState, Signature, Timestamp, Token, TopicId,
};
use crate::store::{Ciphertext, Ledger, NewRecord, RecordQuery, RecordRow};

/// The most gas of one batch.
const MOST_GAS: u64 = 70_000;

struct Deaf;

impl Observer for Deaf {
    fn records_changed(&self) {}
    fn verified(&self, _: &[Digest]) {}
    fn tampered(&self, _: &[Digest]) {}
    fn directory_changed(&self) {}
    fn alert(&self, _: bool, text: String) {
        let of_rights = ["records are kept but not anchored", "resumed: the signer", "will be anchored again"];
        assert!(of_rights.iter().any(|words| text.contains(words)), "{text}");
    }
}

struct Line {
    plant: Plant,
    network: Network,
    sender: Sender,
    owner: Owner,
    _home: tempfile::TempDir,
}

impl Line {
    /// A registered owner on a fresh embedded chain.
    async fn new() -> Self {
        let home = tempfile::tempdir().expect("temporary directory");
        let plant = plant(home.path());
        let keyring = Keyring::generate(plant.provider).expect("keys");
        let passphrase = Passphrase::new("correct horse battery".to_owned()).expect("long enough");
        let keyring = UnlockedKeyring::create(keyring, &home.path().join("keys/k"), &passphrase).expect("keyring");
        let owner = Owner::new("owner".parse::<ProfileName>().expect("a name"), keyring);
        let directory = home.path().join("chain");
        let endpoint = Endpoint::Embedded { directory, consensus: None };
        let options = ChainOptions { endpoint, contract: None, pinned: None };
        let chain = Chain::connect(options).await.expect("a chain");
        let pin = chain.deploy(&owner.eoa()).await.expect("deployed");
        let domain = pin.domain();
        let network = Network::new(chain, &pin, plant.provider, 1);
        watcher::restore(&plant, &network).expect("an empty ledger is bound");
        let sender = Sender::new(plant.ledger.clone(), Arc::clone(&plant.observer), Policy::default());
        let (signing, envelope) = (owner.signing(), owner.envelope().public);
        let identity = prove(plant.provider, &domain, &owner.address, &signing, &envelope, Token([1; 32]));
        let call = Call::Register { identity: identity.expect("proven"), envelope: Vec::new() };
        sender.send(&network.chain, &owner.eoa(), call, "register").await.expect("registered");
        let line = Self { plant, network, sender, owner, _home: home };
        line.watch().await;
        line
    }

    async fn watch(&self) -> u64 {
        watcher::watch_round(&self.plant, &self.network).await.expect("scanned").number
    }

    fn append(&self, topic: u8, from: u64, count: u64) {
        let records = (from..from + count).map(|seq| record(&self.owner, topic, seq)).collect();
        self.plant.ledger.records.append(records).expect("acknowledged");
    }

    fn count(&self, state: RecordState) -> u64 {
        self.plant.ledger.counts.by_state(None).expect("counts").data_in(state)
    }

    /// Anchors until everything is confirmed; `feed` adds records between rounds and says whether it has more.
    async fn drain(&self, mode: AnchorMode, all: u64, mut feed: impl FnMut() -> bool) {
        let (mut anchorer, lanes) = (Anchorer::new(mode), [self.owner.eoa()]);
        loop {
            let more = feed();
            let round = anchorer.round(&self.plant, &self.network, &self.sender, self.owner.address, &lanes).await;
            let round = round.expect("a round");
            let head = self.watch().await;
            if !more && self.count(RecordState::Confirmed) == all {
                return;
            }
            if round.submitted == 0 && !more {
                self.network.chain.next_block(head, round.next).await.expect("a block");
            }
            self.sender.tend(&self.network.chain, &self.owner.eoa()).await.expect("closed");
        }
    }

    async fn is_anchored(&self, row: &RecordRow) -> bool {
        crate::chain_proofs::is_anchored(&self.plant, &self.network, row).await.expect("answer")
    }

    fn rows(&self, limit: usize) -> Vec<RecordRow> {
        self.plant.ledger.records.list(&RecordQuery { limit, ..RecordQuery::default() }).expect("a page").rows
    }
}

/// An owner that seals under epoch 1 of some network.
pub(super) fn owner_with_keys(provider: &'static dyn crate::crypto::Provider, home: &Path) -> (Owner, Domain) {
    let (owner, domain) = owner_without_keys(provider, home);
    owner.prepare_epoch(domain, 1).expect("prepared");
    owner.seal_under(domain, 1).expect("seals");
    (owner, domain)
}

/// An owner that has begun no epoch.
pub(super) fn owner_without_keys(provider: &'static dyn crate::crypto::Provider, home: &Path) -> (Owner, Domain) {
    let keyring = Keyring::generate(provider).expect("keys");
    let passphrase = Passphrase::new("correct horse battery".to_owned()).expect("long enough");
    let keyring = UnlockedKeyring::create(keyring, &home.join("keys/k"), &passphrase).expect("keyring");
    (Owner::new("owner".parse::<ProfileName>().expect("a name"), keyring), Domain([5; 32]))
}

/// The body of a record sealed with these keys.
pub(super) fn body_of(
    provider: &'static dyn crate::crypto::Provider,
    keys: &super::epoch::EpochKeys,
    row: &RecordRow,
    blob: &[u8],
) -> Vec<u8> {
    let expected = Expected {
        domain: keys.domain,
        owner: row.owner,
        recorder: Some(row.recorder),
        epoch: Some(row.epoch),
        seq: Some(row.seq),
        topic_id: Some(row.topic_id),
        names: Names::Given(row.topic.clone()),
    };
    let topic = keys.topic(&row.topic).expect("covered");
    let (signer, key) = (keys.signing.public, &topic.key);
    open(provider, blob, &row.signature, &signer, Anchor::Unanchored, key, &expected).expect("opens").body
}

pub(super) fn plant(home: &Path) -> Plant {
    let ledger = Ledger::open(&home.join("ledger.db")).expect("a ledger");
    Plant {
        ciphertext: Ciphertext::of(&ledger),
        ledger,
        provider: provider(ProviderName::default()),
        observer: Arc::new(Deaf),
    }
}

fn record(owner: &Owner, topic: u8, seq: u64) -> NewRecord {
    NewRecord {
        digest: Digest(sm3(&[&[topic], &seq.to_be_bytes()])),
        owner: owner.address,
        topic_id: TopicId([topic; 16]),
        seq,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: signer_id(&owner.signing().public),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: format!("/robot{topic}/odom"),
        type_name: "nav_msgs/Odometry".to_owned(),
        bytes: 100,
        captured_at: Timestamp(u64::from(topic) << 32 | seq),
        simulated: true,
        state: RecordState::Stored,
        blob: None,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_hundred_thousand_records_take_a_handful_of_transactions() {
    let line = Line::new().await;
    let begin = line.watch().await;
    let mut fed = 0;
    let feed = || {
        if fed < 100_000 {
            line.append(u8::try_from(fed / 5_000).expect("twenty topics"), fed + 1, 2_500);
            fed += 2_500;
        }
        fed < 100_000
    };
    line.drain(AnchorMode::Batch, 100_000, feed).await;
    let (transactions, gas) = line.network.chain.work(begin + 1, line.watch().await).await.expect("work");
    assert!((7..=60).contains(&transactions), "{transactions} transactions for 100,000 records");
    assert!(gas <= transactions * MOST_GAS, "{gas} gas in {transactions} transactions");
    let rows = line.rows(10_000);
    for row in rows.iter().step_by(rows.len() / 1_000) {
        assert!(line.is_anchored(row).await, "{}", row.id);
        let other = RecordRow { seq: row.seq + 1, ..row.clone() };
        assert!(!line.is_anchored(&other).await, "another's number");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn both_modes_anchor_what_the_other_left() {
    let line = Line::new().await;
    line.append(1, 1, 40);
    line.drain(AnchorMode::Each, 40, || false).await;
    line.append(1, 41, 40);
    line.drain(AnchorMode::Batch, 80, || false).await;
    // A batch that was closed and not sent is anchored as a batch, even in one-by-one mode.
    line.append(1, 81, 10);
    let leaves = line.plant.ledger.batches.stored_leaves(line.owner.address, 100).expect("leaves");
    let batch = super::anchorer::close_batch(&line.plant, line.owner.address, leaves).expect("closed");
    assert_eq!(batch.map(|batch| batch.count), Some(10));
    line.drain(AnchorMode::Each, 90, || false).await;
    for row in line.rows(100) {
        assert!(line.is_anchored(&row).await, "{}", row.seq);
        let place = line.plant.ledger.records.placed(row.digest).expect("read").and_then(|placed| placed.place);
        assert_eq!(place.is_some(), row.seq > 40);
        let uploaded = line.network.chain.uploaded_at(row.owner, row.digest).await.expect("answer").is_some();
        assert_eq!(uploaded, row.seq <= 40, "one by one or in a batch, never both");
    }
    let never = RecordRow { digest: Digest([1; 32]), ..line.rows(1).remove(0) };
    assert!(!line.is_anchored(&never).await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_extra_account_registers_itself_and_anchors_for_its_owner() {
    let line = Line::new().await;
    let extra = anchorer::extra(&line.owner.eoa(), &line.network.domain, 3).expect("keys");
    for key in &extra {
        let ready = || anchorer::ensure_ready(&line.plant, &line.network, &line.sender, &line.owner, key);
        assert!(!ready().await.expect("registers"), "its registration is not seen yet");
        line.watch().await;
        line.sender.tend(&line.network.chain, key).await.expect("closed");
        assert!(ready().await.expect("is ready"));
        let (owner, own) = (line.owner.public_keys(), line.network.directory.identity(key.address()).expect("proven"));
        assert_eq!((own.signing, own.envelope), owner);
    }
    line.append(1, 1, 300);
    let mut anchorer = Anchorer::new(AnchorMode::Batch);
    while line.count(RecordState::Confirmed) < 300 {
        let round = anchorer.round(&line.plant, &line.network, &line.sender, line.owner.address, &extra).await;
        round.expect("a round");
        line.watch().await;
        for key in &extra {
            line.sender.tend(&line.network.chain, key).await.expect("closed");
        }
    }
    for row in line.rows(300) {
        let place = line
            .plant
            .ledger
            .records
            .placed(row.digest)
            .expect("read")
            .and_then(|placed| placed.place)
            .expect("batched");
        assert!(extra.iter().any(|key| place.account == Some(key.address())));
        assert!(line.is_anchored(&row).await, "{}", row.seq);
    }
}
