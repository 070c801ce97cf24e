//! Random operations on the ledger and on a simple model of it; both must agree in every answer and row.

use std::collections::{BTreeMap, HashMap};

use proptest::prelude::*;
use proptest::sample::Index;
use proptest::strategy::ValueTree as _;
use proptest::test_runner::TestRunner;

mod batch;
mod chain;

use super::*;
use RecordState::{Batched, Confirmed, Mined, Stored, Submitted, Tampered, Verified};
use batch::Batch;

const STATES: [RecordState; 7] = [Stored, Batched, Submitted, Mined, Confirmed, Verified, Tampered];

#[derive(Debug, Clone)]
enum Step {
    Append { owner: u8, topics: Vec<u8>, data: bool, whole: bool },
    AppendTwin(Index),
    Advance { picked: Vec<Index>, from: usize, to: usize },
    Submit(Vec<Index>),
    CloseBatch(Vec<Index>),
    SubmitBatch(Index),
    SeeBatch { picked: Index, own: bool, block: u64 },
    SeeBoth { picked: Index, own: bool, block: u64 },
    Close { picked: Index, how: u8, block: u64 },
    Replace { picked: Index, kept: usize },
    See { picked: Vec<Index>, own: bool, block: u64 },
    Confirm(u64),
    TakeBack(u64),
    Drop { topic: u8, count: u64 },
    Discard(Vec<Index>),
    Reopen { clean: bool },
}

fn step() -> impl Strategy<Value = Step> {
    let picked = || prop::collection::vec(any::<Index>(), 1..6);
    let block = || 1u64..12;
    prop_oneof![
        6 => (1u8..3, prop::collection::vec(1u8..4, 1..6), prop::bool::weighted(0.8), any::<bool>())
            .prop_map(|(owner, topics, data, whole)| Step::Append { owner, topics, data, whole }),
        1 => any::<Index>().prop_map(Step::AppendTwin),
        8 => (picked(), 0..STATES.len(), 0..STATES.len())
            .prop_map(|(picked, from, to)| Step::Advance { picked, from, to }),
        5 => picked().prop_map(Step::Submit),
        5 => picked().prop_map(Step::CloseBatch),
        5 => any::<Index>().prop_map(Step::SubmitBatch),
        4 => (any::<Index>(), any::<bool>(), block())
            .prop_map(|(picked, own, block)| Step::SeeBatch { picked, own, block }),
        2 => (any::<Index>(), any::<bool>(), block())
            .prop_map(|(picked, own, block)| Step::SeeBoth { picked, own, block }),
        3 => (any::<Index>(), 0u8..3, block()).prop_map(|(picked, how, block)| Step::Close { picked, how, block }),
        1 => (any::<Index>(), 0usize..4).prop_map(|(picked, kept)| Step::Replace { picked, kept }),
        5 => (picked(), any::<bool>(), block()).prop_map(|(picked, own, block)| Step::See { picked, own, block }),
        3 => block().prop_map(Step::Confirm),
        2 => block().prop_map(Step::TakeBack),
        1 => (1u8..4, 1u64..9).prop_map(|(topic, count)| Step::Drop { topic, count }),
        1 => picked().prop_map(Step::Discard),
        1 => any::<bool>().prop_map(|clean| Step::Reopen { clean }),
    ]
}

#[derive(Debug, Clone)]
struct Known {
    new: NewRecord,
    state: RecordState,
    transaction: Option<Hash>,
    block: Option<u64>,
    batch: Option<usize>,
}

#[derive(Debug, Clone)]
struct Sent {
    new: NewTransaction,
    state: TransactionState,
    block: Option<u64>,
}

#[derive(Default)]
struct Model {
    records: Vec<Known>,
    sent: Vec<Sent>,
    batches: Vec<Batch>,
    dropped: BTreeMap<u8, u64>,
    hashes: u8,
}

impl Model {
    fn pick(&self, picked: &[Index]) -> Vec<usize> {
        let mut picked: Vec<usize> = picked.iter().map(|index| index.index(self.records.len())).collect();
        picked.sort_unstable();
        picked.dedup();
        picked
    }

    fn digests(&self, picked: &[usize]) -> Vec<Digest> {
        picked.iter().map(|index| self.records[*index].new.digest).collect()
    }

    fn append(&mut self, owner: u8, topics: &[u8], data: bool, whole: bool) -> Vec<NewRecord> {
        let mut added = Vec::new();
        for topic in topics {
            let same = |known: &&Known| (known.new.owner.0[0], known.new.topic_id.0[0]) == (owner, *topic);
            let seq = u64::try_from(self.records.iter().filter(same).count()).expect("small") + 1;
            let kind = if data { RecordKind::Data } else { RecordKind::Gap };
            let blob = whole.then(|| vec![*topic; 50]);
            let new = NewRecord { kind, blob, ..record(owner, *topic, seq) };
            self.records.push(Known { new: new.clone(), state: Stored, transaction: None, block: None, batch: None });
            added.push(new);
        }
        added
    }

    fn advance(&mut self, picked: &[usize], from: RecordState, to: RecordState) -> u64 {
        let mut moved = 0;
        for index in picked {
            let known = &mut self.records[*index];
            if known.state == from {
                known.state = to;
                moved += 1;
            }
        }
        moved
    }

    fn new_transaction(&mut self, nonce: Option<u64>, anchors: Anchors) -> NewTransaction {
        self.hashes += 1;
        let new = transaction(self.hashes, &[]);
        NewTransaction { nonce: nonce.unwrap_or(new.nonce), anchors, ..new }
    }

    /// Whether the ledger may accept it; if so, records it.
    fn submit(&mut self, new: &NewTransaction) -> bool {
        // A replaced transaction that was mined all the same is open again after a reorg, beside its replacement.
        if self.sent.iter().any(|sent| sent.state == TransactionState::Open && sent.new.nonce == new.nonce) {
            return false;
        }
        match &new.anchors {
            Anchors::Nothing => {}
            Anchors::Batch(root) => {
                if !self.submit_batch(*root, new.hash) {
                    return false;
                }
            }
            Anchors::Digests(digests) => {
                let ready = |known: &&mut Known| digests.contains(&known.new.digest);
                let mut picked: Vec<_> = self.records.iter_mut().filter(ready).collect();
                if picked.iter().any(|known| known.state != Stored) {
                    return false;
                }
                for known in &mut picked {
                    (known.state, known.transaction) = (Submitted, Some(new.hash));
                }
            }
        }
        self.sent.push(Sent { new: new.clone(), state: TransactionState::Open, block: None });
        true
    }

    fn close(&mut self, index: usize, state: TransactionState, block: Option<u64>) {
        let sent = &mut self.sent[index];
        (sent.state, sent.block) = (state, block);
        let hash = Some(sent.new.hash);
        if state != TransactionState::Mined
            && let Anchors::Batch(root) = sent.new.anchors
        {
            return self.release_batch(root, hash);
        }
        self.place(self.sent[index].new.hash);
        for known in self.records.iter_mut().filter(|k| k.transaction == hash && k.block.is_none()) {
            if state != TransactionState::Mined && matches!(known.state, Submitted | Tampered) {
                known.transaction = None;
                let waiting = if known.batch.is_some() { Batched } else { Stored };
                known.state = if known.state == Submitted { waiting } else { Tampered };
            }
        }
    }

    /// A mined transaction is in the block in which its batch was seen.
    fn place(&mut self, transaction: Hash) {
        for sent in self.sent.iter_mut().filter(|s| s.new.hash == transaction && s.state == TransactionState::Mined) {
            let Anchors::Batch(root) = sent.new.anchors else { continue };
            let batch = self.batches.iter().find(|batch| batch.root == root && batch.transaction == Some(transaction));
            sent.block = batch.and_then(|batch| batch.block).or(sent.block);
        }
    }

    fn see(&mut self, sighting: &Sighting) -> u64 {
        let known = self.records.iter_mut().find(|known| known.new.digest == sighting.digest).expect("known");
        let same = known.block == Some(sighting.block);
        let (state, changed) = match known.state {
            Stored | Batched | Submitted => (Mined, 1),
            Mined if !same => (Mined, 1),
            Tampered if !same => (Tampered, 0),
            _ => return 0,
        };
        let batch = known.batch.map(|number| &self.batches[number]).filter(|batch| batch.block == Some(sighting.block));
        let transaction = batch.map_or(Some(sighting.transaction), |batch| batch.transaction);
        (known.state, known.transaction, known.block) = (state, transaction, Some(sighting.block));
        changed
    }

    fn take_back(&mut self, block: u64, states: &[RecordState]) -> u64 {
        let gone = |at: Option<u64>| at.is_some_and(|at| at >= block);
        for sent in self.sent.iter_mut().filter(|s| s.state == TransactionState::Mined && gone(s.block)) {
            (sent.state, sent.block) = (TransactionState::Open, None);
        }
        let mut open: Vec<NewTransaction> =
            self.sent.iter().filter(|s| s.state == TransactionState::Open).map(|s| s.new.clone()).collect();
        open.sort_by_key(|new| new.nonce);
        let opened = |anchors: &Anchors| open.iter().find(|new| new.anchors == *anchors).map(|new| new.hash);
        for batch in self.batches.iter_mut().filter(|batch| gone(batch.block)) {
            (batch.block, batch.transaction) = (None, opened(&Anchors::Batch(batch.root)));
        }
        let mut moved = 0;
        for known in self.records.iter_mut().filter(|known| gone(known.block)) {
            if known.state == Tampered {
                let batch = known.batch.map(|number| &self.batches[number]);
                known.transaction = batch.and_then(|batch| batch.transaction);
                known.block = batch.and_then(|batch| batch.block);
            } else if states.contains(&known.state) {
                let batch = known.batch.map(|number| &self.batches[number]);
                let upload = || opened(&Anchors::Digests(vec![known.new.digest]));
                let own = |new: &NewTransaction| !matches!(new.anchors, Anchors::Batch(_));
                let ours = known.transaction.filter(|hash| open.iter().any(|new| new.hash == *hash && own(new)));
                (known.state, known.transaction, known.block) = match (ours, batch) {
                    (_, Some(batch)) if batch.block.is_some() => (Mined, batch.transaction, batch.block),
                    (Some(hash), _) => (Submitted, Some(hash), None),
                    (None, Some(batch)) if batch.transaction.is_some() => (Submitted, batch.transaction, None),
                    (None, Some(_)) => (Batched, None, None),
                    (None, None) => upload().map_or((Stored, None, None), |hash| (Submitted, Some(hash), None)),
                };
                moved += 1;
            }
        }
        moved
    }
}

struct Pair {
    model: Model,
    ledger: Option<Ledger>,
    home: tempfile::TempDir,
}

impl Pair {
    fn ledger(&self) -> &Ledger {
        self.ledger.as_ref().expect("open")
    }

    fn take(&mut self, step: Step) {
        if self.model.records.is_empty() && !matches!(step, Step::Append { .. } | Step::Reopen { .. }) {
            return;
        }
        match step {
            Step::Append { owner, topics, data, whole } => {
                let added = self.model.append(owner, &topics, data, whole);
                assert_eq!(self.ledger().records.append(added), Ok(()));
            }
            Step::AppendTwin(picked) => {
                let new = picked.get(&self.model.records).new.clone();
                assert_eq!(self.ledger().records.append(vec![new.clone()]), Ok(()));
                let twin = NewRecord { digest: Digest([3; 32]), ..new };
                assert!(self.ledger().records.append(vec![twin]).is_err());
            }
            Step::Advance { picked, from, to } => {
                let (picked, from, to) = (self.model.pick(&picked), STATES[from], STATES[to]);
                let answer = self.ledger().records.advance(&self.model.digests(&picked), from, to);
                match answer {
                    Ok(moved) => assert_eq!(moved, self.model.advance(&picked, from, to), "{from:?} {to:?}"),
                    Err(_) => assert!(!rows::may(rows::By::Worker, from, to)),
                }
            }
            Step::Discard(picked) => {
                let picked = self.model.pick(&picked);
                assert_eq!(Ciphertext::of(self.ledger()).discard(&self.model.digests(&picked)), Ok(()));
                picked.iter().for_each(|index| self.model.records[*index].new.blob = None);
            }
            // A gateway captures nothing that could be lost.
            Step::Drop { .. } if server::is_here() => {}
            Step::Drop { topic, count } => {
                *self.model.dropped.entry(topic).or_default() += count;
                let name = record(1, topic, 1).topic;
                let lost = Loss { topic: name, ..super::loss(LossReason::Memory, count) };
                assert_eq!(self.ledger().losses.count(vec![lost]), Ok(()));
            }
            Step::Reopen { clean } => self.reopen(clean),
            other => self.take_chain(other),
        }
    }

    fn reopen(&mut self, clean: bool) {
        let ledger = self.ledger.take().expect("open");
        if clean {
            ledger.close().expect("closed");
        } else {
            drop(ledger);
        }
        self.ledger = Some(open_again(&self.home));
    }

    fn compare(&self) {
        let rows = all_rows(self.ledger(), 7);
        assert_eq!(rows.len(), self.model.records.len());
        let by_digest: HashMap<Digest, &RecordRow> = rows.iter().map(|row| (row.digest, row)).collect();
        for known in &self.model.records {
            let row = by_digest[&known.new.digest];
            assert_eq!((row.state, row.transaction, row.block), (known.state, known.transaction, known.block));
            assert_eq!((row.seq, row.kind, &row.topic, row.bytes), expected(&known.new));
            assert_eq!(Ciphertext::of(self.ledger()).get(row.digest), Ok(known.new.blob.clone()));
        }
        let open = self.ledger().lanes.open_transactions(Address([1; 20])).expect("open");
        let model = self.model.sent.iter().filter(|sent| sent.state == TransactionState::Open);
        // A transaction that anchors an empty list anchors nothing.
        let plain = |anchors: &Anchors| match anchors {
            Anchors::Digests(digests) if digests.is_empty() => Anchors::Nothing,
            other => other.clone(),
        };
        let mut model: Vec<_> = model.map(|sent| (sent.new.nonce, sent.new.hash, plain(&sent.new.anchors))).collect();
        model.sort_by_key(|sent| (sent.0, sent.1));
        let mut open: Vec<_> = open.into_iter().map(|row| (row.nonce, row.hash, row.anchors)).collect();
        open.sort_by_key(|row| (row.0, row.1));
        assert_eq!(open, model);
        self.compare_batches();
        self.recount();
        // What `release` relies on: a batch in a block has no record that still waits for its own transaction.
        let sql = "SELECT count(*) FROM records JOIN leaves ON record = n JOIN batches ON key = batch
            WHERE batches.block IS NOT NULL AND records.tx IS NOT NULL AND records.block IS NULL";
        assert_eq!(self.ledger().database.one(sql, [], |row| row.get(0)), Ok(0_i64));
        // What readers and audit rely on: in its batch's block, a record has no transaction of its own.
        let sql = "SELECT count(*) FROM records JOIN leaves ON record = n JOIN batches ON key = batch
            WHERE batches.block = records.block";
        assert_eq!(self.ledger().database.one(sql, [], |row| row.get(0)), Ok(0_i64));
    }

    /// The counters equal a full recount, and the conservation law holds.
    fn recount(&self) {
        let counts = self.ledger().counts.by_state(None).expect("counts");
        let dropped: u64 = self.model.dropped.values().sum();
        for (data, found) in [(true, &counts.data), (false, &counts.others)] {
            let mut model: BTreeMap<RecordState, u64> = BTreeMap::new();
            for known in self.model.records.iter().filter(|k| (k.new.kind == RecordKind::Data) == data) {
                *model.entry(known.state).or_default() += 1;
            }
            if data && dropped > 0 {
                model.insert(RecordState::Dropped, dropped);
            }
            assert_eq!(*found, model);
        }
        let topics = counts.topics.iter();
        let sum = |of: fn(&TopicCounts) -> u64| topics.clone().map(of).sum::<u64>();
        assert_eq!(sum(|topic| topic.captured), counts.captured());
        let data = self.model.records.iter().filter(|known| known.new.kind == RecordKind::Data);
        assert_eq!(sum(|topic| topic.bytes), data.map(|known| known.new.bytes).sum::<u64>());
        for topic in topics {
            let parts =
                topic.verified + topic.pending + topic.right_ended + topic.quarantined + topic.dropped + topic.tampered;
            assert_eq!(topic.captured, parts, "conservation");
        }
        assert_eq!(self.ledger().inspection.contradictions(), Ok(Vec::new()));
    }
}

fn expected(new: &NewRecord) -> (u64, RecordKind, &String, u64) {
    (new.seq, new.kind, &new.topic, new.bytes)
}

fn all_rows(ledger: &Ledger, limit: usize) -> Vec<RecordRow> {
    let mut query = RecordQuery { limit, ..RecordQuery::default() };
    let mut rows = Vec::new();
    loop {
        let page = ledger.records.list(&query).expect("page");
        rows.extend(page.rows);
        query.after = Some(match page.next {
            Some(next) => next,
            None => return rows,
        });
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: if server::is_here() { 20 } else { 200 }, ..ProptestConfig::default() })]

    #[test]
    fn the_ledger_does_what_the_model_does(steps in prop::collection::vec(step(), 1..60)) {
        let (home, ledger) = open();
        let mut pair = Pair { model: Model::default(), ledger: Some(ledger), home };
        for (number, step) in steps.into_iter().enumerate() {
            pair.take(step);
            if number % 7 == 0 {
                pair.compare();
            }
        }
        pair.compare();
    }
}

/// One record of one batch.
fn take_each(steps: Vec<Step>) -> RecordRow {
    let (home, ledger) = open();
    let mut pair = Pair { model: Model::default(), ledger: Some(ledger), home };
    let begin = [Step::Append { owner: 1, topics: vec![1], data: true, whole: true }, Step::CloseBatch(vec![only()])];
    for step in begin.into_iter().chain(steps) {
        pair.take(step);
        pair.compare();
    }
    all_rows(pair.ledger(), 1).remove(0)
}

/// Of a list of one.
fn only() -> Index {
    any::<Index>().new_tree(&mut TestRunner::deterministic()).expect("an index").current()
}

#[test]
fn a_record_whose_own_block_is_undone_rests_on_its_batchs() {
    let seen = |tampered: bool| {
        let mined = STATES.iter().position(|state| *state == Mined).expect("a state");
        let to = if tampered { STATES.len() - 1 } else { mined };
        take_each(vec![
            Step::SubmitBatch(only()),
            Step::SeeBatch { picked: only(), own: true, block: 2 },
            Step::See { picked: vec![only()], own: true, block: 5 },
            Step::Advance { picked: vec![only()], from: mined, to },
            Step::TakeBack(4),
        ])
    };
    for (row, state) in [(seen(false), Mined), (seen(true), Tampered)] {
        assert_eq!((row.state, row.block), (state, Some(2)));
    }
}

#[test]
fn a_record_uploaded_in_its_batchs_block_rests_on_its_batch() {
    let alone = |block| Step::See { picked: vec![only()], own: false, block };
    let batch = || Step::SeeBatch { picked: only(), own: true, block: 5 };
    let after = |steps: Vec<Step>| {
        let row = take_each([vec![Step::SubmitBatch(only())], steps].concat());
        (row.state, row.transaction, row.block)
    };
    let sent = Some(Hash([1; 32]));
    for steps in [vec![alone(5), batch()], vec![batch(), alone(5)], vec![batch(), alone(9), alone(5)]] {
        assert_eq!(after(steps.clone()), (Mined, sent, Some(5)), "{steps:?}");
        assert_eq!(after([steps, vec![Step::TakeBack(5)]].concat()), (Submitted, sent, None), "it waits for its batch");
    }
}

#[test]
fn a_record_seen_with_its_batchs_transaction_waits_again_when_that_fails() {
    let row = take_each(vec![
        Step::SubmitBatch(only()),
        Step::See { picked: vec![only()], own: true, block: 9 },
        Step::TakeBack(5),
        Step::Close { picked: only(), how: 1, block: 8 },
    ]);
    assert_eq!((row.state, row.transaction), (Batched, None));
}

server::on_a_server! {
    the_ledger_does_what_the_model_does, a_record_whose_own_block_is_undone_rests_on_its_batchs,
    a_record_uploaded_in_its_batchs_block_rests_on_its_batch,
    a_record_seen_with_its_batchs_transaction_waits_again_when_that_fails,
}
