//! A script of operations on the store and the audit log, and the model that says what must be there after each.

use std::collections::BTreeMap;
use std::path::Path;

use authros::chain::merkle::Tree;
use authros::model::{Address, Digest, Hash, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId};
use authros::store::{
    Anchors, AuditEntry, AuditLog, Ciphertext, Ledger, NewBatch, NewRecord, NewTransaction, RecordQuery, RootSighting,
    StoreError,
};

const OWNER: Address = Address([1; 20]);

/// What one operation does; each is one commit of the ledger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// Stores this many records, rows and bytes in one commit.
    Capture(usize),
    /// Closes a batch over everything stored.
    Close,
    /// Stores the transaction of the oldest waiting batch.
    Submit,
    /// Sees the oldest submitted batch in a block.
    Mine,
    /// Confirms all blocks.
    Confirm,
    /// Re-reads what is confirmed, and marks it as verified.
    Verify,
    /// Writes an audit line.
    Tell,
}

/// Operation number `index` of the script.
pub fn operation(index: usize) -> Operation {
    match index % 10 {
        5 => Operation::Close,
        6 => Operation::Submit,
        7 => Operation::Mine,
        8 if index.is_multiple_of(20) || index % 20 == 8 => Operation::Confirm,
        8 => Operation::Verify,
        9 => Operation::Tell,
        _ => Operation::Capture(1 + index % 3),
    }
}

/// What must be in the store after this many operations.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Model {
    /// State, batch and block of each record, in the order of acknowledgement.
    records: Vec<(RecordState, Option<usize>)>,
    batches: usize,
    submitted: usize,
    mined: usize,
    pub lines: u64,
}

impl Model {
    /// After this many operations.
    pub fn after(operations: usize) -> Self {
        let mut model = Self::default();
        (0..operations).for_each(|index| model.apply(operation(index)));
        model
    }

    /// One more operation.
    pub fn apply(&mut self, operation: Operation) {
        match operation {
            Operation::Capture(count) => self.records.extend((0..count).map(|_| (RecordState::Stored, None))),
            Operation::Close => {
                let batch = self.batches;
                let stored = self.records.iter_mut().filter(|(state, _)| *state == RecordState::Stored);
                stored.for_each(|record| *record = (RecordState::Batched, Some(batch)));
                self.batches += 1;
            }
            Operation::Submit if self.submitted < self.batches => {
                self.move_batch(self.submitted, RecordState::Submitted);
                self.submitted += 1;
            }
            Operation::Mine if self.mined < self.submitted => {
                self.move_batch(self.mined, RecordState::Mined);
                self.mined += 1;
            }
            Operation::Confirm => self.move_all(RecordState::Mined, RecordState::Confirmed),
            Operation::Verify => self.move_all(RecordState::Confirmed, RecordState::Verified),
            Operation::Tell => self.lines += 1,
            Operation::Submit | Operation::Mine => {}
        }
    }

    fn move_batch(&mut self, batch: usize, to: RecordState) {
        self.records.iter_mut().filter(|(_, of)| *of == Some(batch)).for_each(|record| record.0 = to);
    }

    fn move_all(&mut self, from: RecordState, to: RecordState) {
        self.records.iter_mut().filter(|(state, _)| *state == from).for_each(|record| record.0 = to);
    }

    /// Only the states, as the ledger reports them.
    pub fn states(&self) -> Vec<RecordState> {
        self.records.iter().map(|(state, _)| *state).collect()
    }
}

/// The bytes of record `number`; of a length that fills some pages and not others.
fn blob(number: usize) -> Vec<u8> {
    let length = 200 + (number * 37) % 1_300;
    (0..length).map(|place| u8::try_from((number + place * 7) % 251).expect("small")).collect()
}

fn digest(number: usize) -> Digest {
    let mut bytes = [0x5a; 32];
    bytes[..8].copy_from_slice(&(number as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes());
    bytes[8..16].copy_from_slice(&(number as u64).to_be_bytes());
    Digest(bytes)
}

fn record(number: usize) -> NewRecord {
    NewRecord {
        digest: digest(number),
        owner: OWNER,
        topic_id: TopicId([1; 16]),
        seq: number as u64 + 1,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: "/robot1/odom".to_owned(),
        type_name: "nav_msgs/Odometry".to_owned(),
        bytes: blob(number).len() as u64,
        captured_at: Timestamp(1_000 + number as u64),
        simulated: false,
        state: RecordState::Stored,
        blob: Some(blob(number)),
    }
}

/// Store and audit log of one directory.
pub struct Store {
    pub ledger: Ledger,
    ciphertext: Ciphertext,
    audit: AuditLog,
}

impl Store {
    /// Opens it.
    pub fn open(directory: &Path) -> Result<Self, StoreError> {
        let ledger = Ledger::open(&directory.join("ledger.db"))?;
        Ok(Self { audit: ledger.audit.clone(), ciphertext: Ciphertext::of(&ledger), ledger })
    }

    /// Does the model's next operation.
    pub fn perform(&self, model: &Model, operation: Operation) -> Result<(), StoreError> {
        let number = |batch: usize| u8::try_from(batch % 200).expect("small");
        match operation {
            Operation::Capture(count) => {
                let numbers = model.records.len()..model.records.len() + count;
                self.ledger.records.append(numbers.map(record).collect())
            }
            Operation::Close => {
                let leaves = self.ledger.batches.stored_leaves(OWNER, 16_384)?;
                let tree = Tree::new(leaves.iter().map(|leaf| leaf.hash()).collect()).expect("some are stored");
                let paths = leaves.iter().enumerate().map(|(index, leaf)| (leaf.digest, tree.path(index)));
                self.ledger.batches.close(NewBatch { owner: OWNER, root: tree.root(), leaves: paths.collect() })
            }
            Operation::Submit if model.submitted < model.batches => {
                let batch = self.ledger.batches.waiting(OWNER, 1)?[0];
                let nonce = model.submitted as u64;
                let hash = Hash([number(model.submitted); 32]);
                let (purpose, anchors) = ("anchor".to_owned(), Anchors::Batch(batch.root));
                self.ledger.lanes.submit(NewTransaction {
                    hash,
                    account: OWNER,
                    nonce,
                    raw: vec![3; 300],
                    purpose,
                    anchors,
                })
            }
            Operation::Mine if model.mined < model.submitted => {
                let root = self.ledger.batches.open_roots(OWNER)?[model.mined];
                let first = model.records.iter().filter(|(_, batch)| *batch == Some(model.mined)).count() as u64;
                let transaction = Hash([number(model.mined); 32]);
                let (block, block_hash) = (model.mined as u64 + 1, Hash([9; 32]));
                let seen = RootSighting { account: OWNER, root, count: first, transaction, block, block_hash };
                self.ledger.batches.anchored(&[seen]).map(drop)
            }
            Operation::Confirm => self.ledger.batches.confirm(u64::from(u32::MAX)).map(drop),
            Operation::Verify => {
                let digests: Vec<Digest> = self
                    .ledger
                    .records
                    .in_state(None, RecordState::Confirmed, 10_000)?
                    .iter()
                    .map(|row| row.digest)
                    .collect();
                for digest in &digests {
                    assert!(self.ciphertext.get(*digest)?.is_some(), "{digest} is in the store");
                }
                self.ledger.records.advance(&digests, RecordState::Confirmed, RecordState::Verified).map(drop)
            }
            Operation::Tell => self.audit.append(AuditEntry {
                at: Timestamp(model.lines),
                profile: "default".to_owned(),
                action: "open".to_owned(),
                subject: format!("line {}", model.lines),
                outcome: "done".to_owned(),
            }),
            Operation::Submit | Operation::Mine => Ok(()),
        }
    }

    /// Everything in the ledger that the model knows, as the ledger reports it.
    pub fn found(&self) -> (Vec<RecordState>, u64) {
        let mut states = Vec::new();
        let mut after = None;
        loop {
            let page = self
                .ledger
                .records
                .list(&RecordQuery { limit: 10_000, after, ..RecordQuery::default() })
                .expect("lists");
            for row in page.rows {
                let number = states.len();
                assert_eq!((row.digest, row.seq), (digest(number), number as u64 + 1), "in order and without a hole");
                assert_eq!(
                    self.ciphertext.get(row.digest).expect("reads").as_deref(),
                    Some(&*blob(number)),
                    "record {number}"
                );
                states.push(row.state);
            }
            after = page.next;
            if after.is_none() {
                break;
            }
        }
        let counts = self.ledger.counts.by_state(None).expect("counts");
        let mut by_state = BTreeMap::new();
        states.iter().for_each(|state| *by_state.entry(*state).or_insert(0u64) += 1);
        for (state, count) in &by_state {
            assert_eq!(counts.data_in(*state), *count, "the counters say what the rows say: {}", state.word());
        }
        (states, self.audit.verify().expect("the audit log is chained"))
    }
}
