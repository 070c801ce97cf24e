//! A round on several cores: the same outcome as on one thread, and one bad message among many.

use std::collections::BTreeMap;
use std::path::Path;

use zeroize::Zeroizing;

use super::super::fixture::{Notes, message};
use super::super::tests::body_of;
use super::*;
use crate::crypto::{CryptoError, IndexKey, Provider, ProviderName, SealingKey, SmKeyPair, SmSecret, provider};
use crate::model::{Address, Domain, PublicKey, RecordKind, RecordState, Signature, Token};
use crate::pipeline::Author;
use crate::pipeline::epoch::EpochKeys;
use crate::store::{Ciphertext, Ledger, RecordQuery};

/// A text on which [`Trap`] panics.
const BAD: &[u8] = b"the bad one";

/// The default provider, except for one text.
struct Trap(&'static dyn Provider);

impl Provider for Trap {
    fn name(&self) -> &'static str {
        "trap"
    }
    fn sm3(&self, parts: &[&[u8]]) -> [u8; 32] {
        self.0.sm3(parts)
    }
    fn gcm_seal_in_place(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        text: &mut [u8],
    ) -> Result<[u8; 16], CryptoError> {
        assert_ne!(text, BAD, "the test's own panic");
        self.0.gcm_seal_in_place(key, nonce, aad, text)
    }
    fn gcm_open(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        sealed: &[u8],
    ) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        self.0.gcm_open(key, nonce, aad, sealed)
    }
    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature, CryptoError> {
        self.0.sign(secret, message)
    }
    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
        self.0.verify(public, message, signature)
    }
    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>, CryptoError> {
        self.0.encrypt(public, plain)
    }
    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        self.0.decrypt(secret, der)
    }
    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey, CryptoError> {
        self.0.public_key(secret)
    }
    fn check_public_key(&self, public: &PublicKey) -> Result<(), CryptoError> {
        self.0.check_public_key(public)
    }
}

/// A sealer with its store, and one author.
struct Line {
    sealer: Sealer,
    losses: Arc<Losses>,
    notes: Arc<Notes>,
    author: Arc<Author>,
    keys: Arc<EpochKeys>,
}

impl Line {
    fn new(home: &Path) -> Self {
        let ours = provider(ProviderName::default());
        let notes = Arc::new(Notes::default());
        let ledger = Ledger::open(&home.join("ledger.db")).expect("ledger");
        let plant = Plant {
            ciphertext: Ciphertext::of(&ledger),
            ledger,
            provider: Box::leak(Box::new(Trap(ours))),
            observer: Arc::clone(&notes) as Arc<dyn super::super::Observer>,
        };
        let signing = SmKeyPair::generate(ours).expect("pair");
        let (key, index) = (SealingKey::Epoch(crate::crypto::EpochKey::new([1; 32])), IndexKey::new([2; 32]));
        let keys = Arc::new(EpochKeys::new(Domain([3; 32]), (1, Token([4; 32])), signing, key, index));
        let author = Arc::new(Author::new(Address([5; 20])));
        author.seal_under(Arc::clone(&keys));
        let losses = Arc::new(Losses::default());
        losses.know(&author);
        let sealer = Sealer::new(plant, Arc::default(), Arc::clone(&losses));
        Self { sealer, losses, notes, author, keys }
    }

    fn item(&self, topic: &str, number: usize, body: Vec<u8>) -> CapturedMessage {
        let message = message(topic, Timestamp(number as u64 + 1), body);
        let (author, message) = (Arc::clone(&self.author), Arc::new(message));
        CapturedMessage {
            author,
            message,
            kind: RecordKind::Data,
            simulated: false,
            sessions: Vec::new(),
            doubt: None,
            rule: None,
            ring: false,
        }
    }

    /// All records of a topic by number, opened.
    fn stored(&self, topic: &str) -> Vec<(u64, RecordKind, Vec<u8>)> {
        let plant = &self.sealer.plant;
        let query = RecordQuery { topic: Some(topic.to_owned()), limit: 10_000, ..RecordQuery::default() };
        let mut records: Vec<_> = plant
            .ledger
            .records
            .list(&query)
            .expect("a page")
            .rows
            .iter()
            .map(|row| {
                let blob = plant.ciphertext.get(row.digest).expect("read").expect("stored");
                (row.seq, row.kind, body_of(plant.provider, &self.keys, row, &blob))
            })
            .collect();
        records.sort_by_key(|(seq, ..)| *seq);
        records
    }
}

/// Bodies of many lengths, some of them compressible.
fn body(number: usize) -> Vec<u8> {
    let mut state = u32::try_from(number).expect("small") | 1;
    let mut noise = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        state.to_le_bytes()[3]
    };
    let length = [0, 40, 300, 5_000, 90_000][number % 5];
    let mut body: Vec<u8> =
        if number.is_multiple_of(2) { vec![7; length] } else { (0..length).map(|_| noise()).collect() };
    body.extend(number.to_be_bytes());
    body
}

const TOPICS: [&str; 3] = ["/a", "/b", "/c"];
const ALL: usize = 300;

#[test]
fn rounds_on_several_cores_store_what_one_thread_would_in_the_same_order() {
    let homes = [(); 2].map(|()| tempfile::tempdir().expect("folder"));
    let (mut line, mut slow) = (Line::new(homes[0].path()), Line::new(homes[1].path()));
    let rings = Rings::new(usize::MAX);
    for number in 0..ALL {
        let topic: Arc<str> = TOPICS[number % 3].into();
        assert!(rings.push(&topic, line.item(&topic, number, body(number))).is_ok());
        // A round of one never has a helper.
        let alone = slow.item(&topic, number, body(number));
        let names = slow.sealer.round(std::slice::from_ref(&alone)).expect("sealed");
        slow.sealer.note_definitions(names);
    }
    rings.close();
    line.sealer.run(&rings, &|| ());
    for (at, topic) in TOPICS.iter().enumerate() {
        let stored = line.stored(topic);
        let expected: Vec<_> = std::iter::once((1, RecordKind::Definition, b"string data".to_vec()))
            .chain((0..ALL / 3).map(|number| (number as u64 + 2, RecordKind::Data, body(number * 3 + at))))
            .collect();
        assert!(stored == expected, "{topic}: {} records", stored.len());
        assert!(stored == slow.stored(topic), "{topic} by one thread");
    }
    assert!(line.notes.all().is_empty(), "{:?}", line.notes.all());
}

#[test]
fn a_panic_over_one_message_of_a_round_loses_that_one_alone() {
    let home = tempfile::tempdir().expect("folder");
    let mut line = Line::new(home.path());
    let rings = Rings::new(usize::MAX);
    let bodies: BTreeMap<usize, Vec<u8>> =
        (0..60).map(|number| (number, if number == 31 { BAD.to_vec() } else { body(number) })).collect();
    for (number, body) in &bodies {
        let topic: Arc<str> = TOPICS[number % 3].into();
        assert!(rings.push(&topic, line.item(&topic, *number, body.clone())).is_ok());
    }
    rings.close();
    line.sealer.run(&rings, &|| ());
    for (at, topic) in TOPICS.iter().enumerate() {
        let stored = line.stored(topic);
        let seqs: Vec<u64> = stored.iter().map(|(seq, ..)| *seq).collect();
        assert_eq!(seqs, (1..=stored.len() as u64).collect::<Vec<_>>(), "{topic}: no number is left out");
        let data: Vec<_> = stored.iter().filter(|(_, kind, _)| *kind == RecordKind::Data).map(|one| &one.2).collect();
        let expected: Vec<_> =
            bodies.iter().filter(|(number, body)| **number % 3 == at && body.as_slice() != BAD).collect();
        assert!(data == expected.into_iter().map(|(_, body)| body).collect::<Vec<_>>(), "{topic}");
        assert_eq!(stored.iter().filter(|(_, kind, _)| *kind == RecordKind::Gap).count(), usize::from(at == 1));
    }
    let counts = line.losses.counts(&line.sealer.plant, line.author.address).expect("counts");
    assert_eq!((counts.data_in(RecordState::Stored), counts.lost_in_recorder), (59, 1));
    assert!(counts.topics.iter().all(crate::store::TopicCounts::is_conserved));
    assert_eq!(line.notes.with("sealing failed"), 1);
}

#[test]
fn a_round_gathers_only_where_more_come_and_find_room() {
    let (took, rings) = (Duration::from_millis(4), 64 << 20);
    assert_eq!(gathering((20, 30_000), took, rings), took);
    assert_eq!(gathering((20, 30_000), Duration::from_secs(3), rings), LONGEST_GATHERING);
    let at_once = [(1, 1_500), (7, 10_000), (ROUND, 400_000), (40, ROUND_BYTES)];
    for taken in at_once {
        assert_eq!(gathering(taken, took, rings), Duration::ZERO, "{taken:?}");
    }
    assert_eq!(gathering((20, 30_000), took, 119_999), Duration::ZERO, "as many again might not fit");
}

#[test]
fn a_definition_is_stored_once() {
    let home = tempfile::tempdir().expect("folder");
    let mut line = Line::new(home.path());
    let item = line.item("/a", 1, b"x".to_vec());
    let definitions = line.sealer.round(std::slice::from_ref(&item)).expect("sealed");
    assert_eq!(definitions.len(), 1);
    line.sealer.note_definitions(definitions);
    assert!(line.sealer.round(&[item]).expect("sealed").is_empty(), "once");
}

#[test]
fn a_definition_alone_is_one_record_once_and_never_a_loss() {
    let home = tempfile::tempdir().expect("folder");
    let mut line = Line::new(home.path());
    let alone = CapturedMessage { kind: RecordKind::Definition, ..line.item("/a", 1, Vec::new()) };
    for expected in [1, 0] {
        let definitions = line.sealer.round(std::slice::from_ref(&alone)).expect("sealed");
        assert_eq!(definitions.len(), expected);
        line.sealer.note_definitions(definitions);
    }
    assert_eq!(line.stored("/a"), [(1, RecordKind::Definition, b"string data".to_vec())]);
    let counts = || line.losses.counts(&line.sealer.plant, line.author.address).expect("counted");
    let before = counts();
    line.sealer.lose(&alone, LossReason::End);
    let mut waiting = InMemory::default();
    waiting.add(&alone);
    assert!(waiting.is_empty() && counts() == before);
}
