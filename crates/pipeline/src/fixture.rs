//! What tests of sender and watcher share: a ledger, a registered account on a chain, and its records.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::sender::Outgoing;
use super::{Network, Observer, Plant, Sender, watcher};
use crate::chain::{Call, Chain, ChainOptions, Endpoint, Event, Pin, Policy};
use crate::crypto::{EoaSecret, ProviderName, SmKeyPair, domain, prove, provider};
use crate::model::{Digest, Hash, RecordKind, RecordState, Signature, SignerId, Timestamp, Token, TopicId};
use crate::ros::{Message, Origin};
use crate::store::{Anchors, Ciphertext, Ledger, NewRecord};

/// Keeps what is reported.
#[derive(Default)]
pub struct Notes(Mutex<Vec<(bool, String)>>);

impl Notes {
    /// Everything reported so far.
    pub fn all(&self) -> Vec<(bool, String)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// How many texts contain these words.
    pub fn with(&self, words: &str) -> usize {
        self.all().iter().filter(|(_, text)| text.contains(words)).count()
    }
}

impl Observer for Notes {
    fn records_changed(&self) {}
    fn verified(&self, _: &[Digest]) {}
    fn tampered(&self, _: &[Digest]) {}
    fn directory_changed(&self) {}
    fn alert(&self, urgent: bool, text: String) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push((urgent, text));
    }
}

/// One process: a ledger with its sender, on a chain.
pub struct Process {
    /// The folder of the ledger, until the test ends.
    _home: TempDir,
    pub plant: Plant,
    pub network: Network,
    pub sender: Sender,
    pub notes: Arc<Notes>,
    pub eoa: EoaSecret,
}

/// The token that test accounts register.
pub const TOKEN: Token = Token([3; 32]);

/// A text message as sent by its only publisher.
pub fn message(topic: &str, captured_at: Timestamp, body: Vec<u8>) -> Message {
    let (type_name, md5sum) = ("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1");
    Message {
        topic: topic.into(),
        type_name: type_name.into(),
        md5sum: md5sum.into(),
        definition: "string data".into(),
        caller_id: "/a".into(),
        origin: Arc::new(Origin {
            number: 1,
            caller_id: "/a".into(),
            host: "robot".into(),
            uri: "http://robot:1/".into(),
            type_name: type_name.into(),
            md5sum: md5sum.into(),
            listed_at: Instant::now(),
            rival: None,
            unnamed: false,
        }),
        latching: false,
        captured_at,
        header_seq: None,
        tags: Vec::new(),
        body,
    }
}

/// The embedded chain in a folder, as soon as nobody else has it open.
pub async fn embedded(directory: &Path, pinned: Option<Pin>) -> Chain {
    let deadline = Instant::now() + Duration::from_secs(20);
    loop {
        let endpoint = Endpoint::Embedded { directory: directory.to_owned(), consensus: None };
        match Chain::connect(ChainOptions { endpoint, contract: None, pinned: pinned.clone() }).await {
            Ok(chain) => return chain,
            Err(error) => assert!(Instant::now() < deadline, "{error}"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// The identity of an account on the chain.
pub fn identity(chain: &Chain, eoa: &EoaSecret) -> Call {
    let pin = chain.pin().expect("pinned");
    let provider = provider(ProviderName::RustCrypto);
    let pairs = [(); 2].map(|()| SmKeyPair::generate(provider).expect("pair"));
    let domain = domain(pin.chain_id, &pin.genesis, &pin.contract);
    let identity = prove(provider, &domain, &eoa.address(), &pairs[0], &pairs[1].public, TOKEN).expect("proves");
    Call::Register { identity, envelope: Vec::new() }
}

/// Signs and sends without any ledger, and waits for the block.
pub async fn by_hand(chain: &Chain, eoa: &EoaSecret, call: &Call) -> Hash {
    let nonce = chain.nonce(eoa.address(), true).await.expect("nonce");
    let signed = chain.sign(eoa, nonce, call).await.expect("signs");
    chain.broadcast(&signed.raw).await.expect("sent");
    let deadline = Instant::now() + Duration::from_secs(30);
    while chain.receipt(signed.hash).await.expect("receipt").is_none() {
        assert!(Instant::now() < deadline, "not mined");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    signed.hash
}

/// A digest not used elsewhere.
pub fn digest(number: u64) -> Digest {
    let mut bytes = [7; 32];
    bytes[..8].copy_from_slice(&number.to_be_bytes());
    Digest(bytes)
}

impl Process {
    /// A new ledger for an account registered on `chain`.
    pub async fn new(chain: Chain, eoa: EoaSecret, policy: Policy) -> Self {
        let home = tempfile::tempdir().expect("folder");
        let notes = Arc::new(Notes::default());
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("ledger");
        let plant = Plant {
            ciphertext: Ciphertext::of(&ledger),
            ledger,
            provider: provider(ProviderName::RustCrypto),
            observer: Arc::clone(&notes) as Arc<dyn Observer>,
        };
        let network = network(chain);
        watcher::restore(&plant, &network).expect("restores");
        watcher::watch_round(&plant, &network).await.expect("scans");
        let sender = Sender::new(plant.ledger.clone(), Arc::clone(&plant.observer), policy);
        Self { _home: home, plant, network, sender, notes, eoa }
    }

    /// A process on a fresh embedded chain with the contract, its account registered.
    pub async fn on_embedded(directory: &Path) -> Self {
        let chain = embedded(directory, None).await;
        let eoa = EoaSecret::generate().expect("key");
        chain.deploy(&eoa).await.expect("deploys");
        by_hand(&chain, &eoa, &identity(&chain, &eoa)).await;
        Self::new(chain, eoa, Policy::default()).await
    }

    /// Acknowledges records with these numbers, stored.
    pub fn store(&self, numbers: std::ops::Range<u64>) {
        let record = |number| NewRecord {
            digest: digest(number),
            owner: self.eoa.address(),
            topic_id: TopicId([1; 16]),
            seq: number + 1,
            foreign: None,
            epoch: 1,
            kind: RecordKind::Data,
            signer: SignerId([2; 32]),
            signature: Signature([1; 64]),
            filters: Vec::new(),
            topic: "/a".to_owned(),
            type_name: "a/B".to_owned(),
            bytes: 1,
            captured_at: Timestamp(number),
            simulated: true,
            state: RecordState::Stored,
            blob: None,
        };
        self.plant.ledger.records.append(numbers.map(record).collect()).expect("acknowledged");
    }

    /// The transaction purpose for anchoring a record.
    pub fn upload(number: u64) -> Outgoing {
        let call = Call::DataUpload { digest: digest(number), token: TOKEN, timestamp: Timestamp(number) };
        Outgoing { call, purpose: "dataUpload".to_owned(), anchors: Anchors::Digests(vec![digest(number)]) }
    }

    /// Submits whatever is stored, at most this many at once.
    pub async fn anchor(&self, most: usize) {
        let rows = self.plant.ledger.records.in_state(None, RecordState::Stored, most).expect("read");
        let outgoing = rows.iter().map(|row| Self::upload(row.seq - 1)).collect();
        self.sender.lane(&self.network.chain, &self.eoa).await.submit(outgoing).await.expect("submits");
    }

    /// One round of the watcher, then the lane is tended.
    pub async fn round(&self) {
        watcher::watch_round(&self.plant, &self.network).await.expect("watches");
        self.sender.tend(&self.network.chain, &self.eoa).await.expect("tends");
    }

    /// How many records are in a state.
    pub fn count(&self, state: RecordState) -> u64 {
        self.plant.ledger.counts.by_state(None).expect("counts").data_in(state)
    }

    /// Rounds until `done`, at most for a minute.
    pub async fn rounds_until(&self, what: &str, mut done: impl FnMut(&Self) -> bool) {
        let deadline = Instant::now() + Duration::from_secs(60);
        loop {
            self.round().await;
            if done(self) {
                return;
            }
            assert!(Instant::now() < deadline, "{what}: {:?}", self.plant.ledger.counts.by_state(None));
            tokio::time::sleep(Duration::from_millis(30)).await;
        }
    }

    /// Like [`Self::rounds_until`], anchoring whatever is stored meanwhile.
    pub async fn work_until(&self, what: &str, mut done: impl FnMut(&Self) -> bool) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while !done(self) {
            self.anchor(16).await;
            self.round().await;
            assert!(Instant::now() < deadline, "{what}: {:?}", self.plant.ledger.counts.by_state(None));
            tokio::time::sleep(Duration::from_millis(30)).await;
        }
    }

    /// How often the chain holds each of these records.
    pub async fn anchored(&self, numbers: std::ops::Range<u64>) -> Vec<usize> {
        let head = self.network.chain.head().await.expect("head").number;
        let events = self.network.chain.events(0, head).await.expect("events");
        let is = |event: &Event, number| matches!(event, Event::DataUploaded { digest: found, .. } if *found == digest(number));
        numbers.map(|number| events.iter().filter(|at| is(&at.event, number)).count()).collect()
    }
}

/// Everything bound to a connected chain.
pub fn network(chain: Chain) -> Network {
    let pin = chain.pin().expect("pinned");
    Network::new(chain, &pin, provider(ProviderName::RustCrypto), 1)
}
