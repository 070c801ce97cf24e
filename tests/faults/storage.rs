//! A disk that fails, dies, hangs or tears at the k-th write or sync of a script of a thousand operations: whatever
//! ledger and vault acknowledged is there afterwards, nothing is half, and the work goes on.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::support::{long, skipped, system_program};
use authros::chain::merkle::Tree;
use authros::model::{Address, Digest, Hash, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId};
use authros::store::{
    Anchors, AuditEntry, AuditLog, Ledger, NewBatch, NewRecord, NewTransaction, RecordQuery, RootSighting, StoreError,
    Vault, open_vault,
};
use tempfile::TempDir;

const OWNER: Address = Address([1; 20]);
/// Operations of a script, but in the long form with every k, where each of them costs a run.
const OPERATIONS: usize = 1_000;
/// Tries of an operation on a disk that refused it.
const TRIES: usize = 5;

/// What one operation does; each is one commit of the ledger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Operation {
    /// Seals so many records: into the vault, then acknowledged by the ledger.
    Capture(usize),
    /// Closes a batch over all that is stored.
    Close,
    /// Keeps the transaction of the oldest batch that waits.
    Submit,
    /// Sees the oldest submitted batch in a block.
    Mine,
    /// Confirms all blocks.
    Confirm,
    /// Re-reads what is confirmed, and says that it is verified.
    Verify,
    /// Writes an audit line.
    Tell,
}

fn operation(index: usize) -> Operation {
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

/// What must be in the store after so many operations.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Model {
    /// State, batch and block of each record, in the order of acknowledgement.
    records: Vec<(RecordState, Option<usize>)>,
    batches: usize,
    submitted: usize,
    mined: usize,
    lines: u64,
}

impl Model {
    fn after(operations: usize) -> Self {
        let mut model = Self::default();
        (0..operations).for_each(|index| model.apply(operation(index)));
        model
    }

    fn apply(&mut self, operation: Operation) {
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

    /// The states alone, as the ledger can be asked for them.
    fn states(&self) -> Vec<RecordState> {
        self.records.iter().map(|(state, _)| *state).collect()
    }
}

/// The bytes of record `number`; of a length that fills some pages and not others.
fn blob(number: usize) -> Vec<u8> {
    let length = 200 + (number * 37) % 6_000;
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
        local_copy: None,
    }
}

/// Ledger, vault and audit log of one directory.
struct Store {
    ledger: Ledger,
    vault: Arc<dyn Vault>,
    audit: AuditLog,
}

impl Store {
    fn open(directory: &Path) -> Result<Self, StoreError> {
        let ledger = Ledger::open(&directory.join("ledger.db"))?;
        let vault = open_vault(None, directory)?;
        Ok(Self { audit: AuditLog::new(ledger.clone()), ledger, vault })
    }

    /// Does what the model does next.
    fn perform(&self, model: &Model, operation: Operation) -> Result<(), StoreError> {
        let number = |batch: usize| u8::try_from(batch % 200).expect("small");
        match operation {
            Operation::Capture(count) => {
                let numbers = model.records.len()..model.records.len() + count;
                let blobs: Vec<_> = numbers.clone().map(|number| (digest(number), blob(number))).collect();
                let entries: Vec<_> = blobs.iter().map(|(digest, bytes)| (*digest, bytes.as_slice())).collect();
                self.vault.put(&entries)?;
                self.ledger.append(numbers.map(record).collect())
            }
            Operation::Close => {
                let leaves = self.ledger.stored_leaves(OWNER, 16_384)?;
                let tree = Tree::new(leaves.iter().map(|leaf| leaf.hash()).collect()).expect("some are stored");
                let paths = leaves.iter().enumerate().map(|(index, leaf)| (leaf.digest, tree.path(index)));
                self.ledger.close_batch(NewBatch { owner: OWNER, root: tree.root(), leaves: paths.collect() })
            }
            Operation::Submit if model.submitted < model.batches => {
                let batch = self.ledger.waiting_batches(OWNER, 1)?[0];
                let nonce = model.submitted as u64;
                let hash = Hash([number(model.submitted); 32]);
                let (purpose, anchors) = ("anchor".to_owned(), Anchors::Batch(batch.root));
                self.ledger.submit(NewTransaction { hash, account: OWNER, nonce, raw: vec![3; 300], purpose, anchors })
            }
            Operation::Mine if model.mined < model.submitted => {
                let root = self.ledger.open_roots(OWNER)?[model.mined];
                let first = model.records.iter().filter(|(_, batch)| *batch == Some(model.mined)).count() as u64;
                let transaction = Hash([number(model.mined); 32]);
                let (block, block_hash) = (model.mined as u64 + 1, Hash([9; 32]));
                let seen = RootSighting { account: OWNER, root, count: first, transaction, block, block_hash };
                self.ledger.anchored(&[seen]).map(drop)
            }
            Operation::Confirm => self.ledger.confirm(u64::from(u32::MAX)).map(drop),
            Operation::Verify => {
                let digests: Vec<Digest> =
                    self.ledger.in_state(None, RecordState::Confirmed, 10_000)?.iter().map(|row| row.digest).collect();
                for digest in &digests {
                    assert!(self.vault.get(*digest)?.is_some(), "{digest} is in the vault");
                }
                self.ledger.advance(&digests, RecordState::Confirmed, RecordState::Verified).map(drop)
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

    /// Everything of the ledger that the model knows, as the ledger tells it.
    fn found(&self) -> (Vec<RecordState>, u64) {
        let mut states = Vec::new();
        let mut after = None;
        loop {
            let page =
                self.ledger.list(&RecordQuery { limit: 10_000, after, ..RecordQuery::default() }).expect("lists");
            for row in page.rows {
                let number = states.len();
                assert_eq!((row.digest, row.seq), (digest(number), number as u64 + 1), "in order and without a hole");
                assert_eq!(
                    self.vault.get(row.digest).expect("reads").as_deref(),
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
        let counts = self.ledger.counts(None).expect("counts");
        let mut by_state = BTreeMap::new();
        states.iter().for_each(|state| *by_state.entry(*state).or_insert(0u64) += 1);
        for (state, count) in &by_state {
            assert_eq!(counts.data_in(*state), *count, "the counters say what the rows say: {}", state.word());
        }
        (states, self.audit.verify().expect("the audit log is chained"))
    }
}

/// A directory on a file system whose fsync costs nothing, where there is one: the points are the same.
fn directory() -> TempDir {
    let mut builder = tempfile::Builder::new();
    builder.prefix("authros-storage");
    builder.tempdir_in("/dev/shm").or_else(|_| builder.tempdir()).expect("a temporary directory")
}

/// Runs as a process of its own, started by `Driver::start`: does the script and says what is done.
#[test]
fn driver() {
    let Some(directory) = std::env::var_os("STORAGE_SCRIPT").map(PathBuf::from) else { return };
    let operations: usize = std::env::var("STORAGE_OPERATIONS").expect("given").parse().expect("a number");
    let mut out = std::io::stdout();
    let mut tell = |word: &str| {
        out.write_all(format!("\n{word}\n").as_bytes()).and_then(|()| out.flush()).expect("told");
    };
    let Some(store) = (0..TRIES).find_map(|_| Store::open(&directory).ok()) else { return tell("gave up") };
    let mut model = Model::default();
    for index in 0..operations {
        let next = operation(index);
        if !(0..TRIES).any(|_| store.perform(&model, next).is_ok()) {
            return tell("gave up");
        }
        model.apply(next);
        tell(&format!("done {}", index + 1));
    }
    assert_eq!(store.found(), (model.states(), model.lines), "as seen by the process that did it");
    tell("finished");
}

/// How the disk fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Whole,
    Fail,
    Dead,
    Freeze,
    Torn,
}

impl Mode {
    fn word(self) -> &'static str {
        match self {
            Self::Whole => "none",
            Self::Fail => "fail",
            Self::Dead => "dead",
            Self::Freeze => "freeze",
            Self::Torn => "torn",
        }
    }
}

/// The library that is preloaded, compiled once.
pub struct Shim {
    directory: TempDir,
}

impl Shim {
    /// Compiles it; nothing where there is no compiler.
    pub fn compile() -> Option<Self> {
        let compiler = system_program("cc")?;
        let directory = tempfile::tempdir().expect("a temporary directory");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/storage_shim.c");
        let mut command = Command::new(compiler);
        command.args(["-shared", "-fPIC", "-O2", "-o"]).arg(directory.path().join("shim.so")).arg(source).arg("-ldl");
        let built = command.status().expect("the compiler runs");
        assert!(built.success(), "the shim compiles");
        Some(Self { directory })
    }

    /// Where it lies.
    pub fn path(&self) -> String {
        self.directory.path().join("shim.so").to_str().expect("UTF-8").to_owned()
    }

    fn command(&self, place: &Path, operations: usize, mode: Mode, at: usize) -> Command {
        let mut command = Command::new(std::env::current_exe().expect("this test"));
        command.args(["--exact", "storage::driver", "--nocapture", "--test-threads", "1"]);
        command.env("STORAGE_SCRIPT", place).env("STORAGE_OPERATIONS", operations.to_string());
        command.env("LD_PRELOAD", self.directory.path().join("shim.so")).env("SHIM_DIR", place);
        command.env("SHIM_MODE", mode.word()).env("SHIM_AT", at.to_string()).env("SHIM_TELL", "1");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// How many writes and syncs the whole script makes.
    fn count(&self, operations: usize) -> usize {
        let place = directory();
        let file = self.directory.path().join("count");
        let output = self.command(place.path(), operations, Mode::Whole, 0).env("SHIM_COUNT", &file).output();
        let output = output.expect("the driver runs");
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success() && said.contains("\nfinished\n"), "{said}{output:?}");
        check(place.path(), operations, operations, "the script without a fault");
        fs::read_to_string(file).expect("counted").trim().parse().expect("a number")
    }

    /// One run with a fault at number `at`; returns how many operations were acknowledged.
    fn run(&self, operations: usize, mode: Mode, at: usize) -> usize {
        let place = directory();
        let what = format!("{} at write or sync {at}", mode.word());
        let child = self.command(place.path(), operations, mode, at).spawn().expect("the driver starts");
        let (done, word) = hear(child, &what);
        match mode {
            // One refused write is made good by trying again, and by opening again.
            Mode::Fail | Mode::Whole => assert_eq!((done, &*word), (operations, "finished"), "{what}"),
            Mode::Dead => assert_eq!(word, "gave up", "{what}"),
            Mode::Freeze | Mode::Torn => assert_eq!(word, "frozen", "{what}"),
        }
        check(place.path(), operations, done, &what);
        done
    }
}

/// Reads what a driver says to its end, or to the hang of its disk, upon which it is killed.
fn hear(mut child: Child, what: &str) -> (usize, String) {
    let (mut done, mut word) = (0, String::new());
    let out = child.stdout.take().expect("piped");
    let begun = Instant::now();
    for line in BufReader::new(out).lines() {
        let line = line.unwrap_or_default();
        match line.split_once(' ') {
            Some(("done", number)) => done = number.parse().expect("a number"),
            _ if line == "frozen" => {
                word = line;
                // Its other threads go on: none of them may acknowledge what lies behind the hang.
                std::thread::sleep(Duration::from_millis(3));
                child.kill().expect("killed");
            }
            _ if line == "finished" || line == "gave up" => word = line,
            _ => {}
        }
        assert!(begun.elapsed() < Duration::from_secs(120), "{what}: the driver does not end");
    }
    let output = child.wait_with_output().expect("it ends");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(word == "frozen" || output.status.success(), "{what}: {told}");
    (done, word)
}

/// The store opens, holds exactly what was acknowledged, or that and the whole of the one operation under way, and
/// works on.
fn check(place: &Path, operations: usize, done: usize, what: &str) {
    let store = Store::open(place).unwrap_or_else(|error| panic!("{what}: cannot be opened: {error}"));
    let found = store.found();
    let mut model = Model::after(done);
    let mut next = done;
    if found != (model.states(), model.lines) {
        assert!(done < operations, "{what}: more than the script");
        model.apply(operation(done));
        next += 1;
        assert_eq!(found, (model.states(), model.lines), "{what}: after {done} acknowledged operations");
    }
    for index in next..next + 20 {
        let next = operation(index);
        store.perform(&model, next).unwrap_or_else(|error| panic!("{what}: then {next:?}: {error}"));
        model.apply(next);
    }
    assert_eq!(store.found(), (model.states(), model.lines), "{what}: and further");
    store.ledger.close().expect("closes");
}

/// Where the fault falls: everywhere in the long form, else at the first writes, which make the files, and then at
/// a stride.
fn points(total: usize, few: usize) -> Vec<usize> {
    if long() {
        return (1..=total).collect();
    }
    let step = (total / few).max(1);
    let opening = (1..=24).step_by(5);
    opening.chain((25..=total).step_by(step)).collect()
}

fn every_point(mode: Mode, few: usize) {
    let Some(shim) = Shim::compile() else { skipped!("no C compiler") };
    let total = shim.count(OPERATIONS);
    let points = points(total, few);
    let (next, least) = (AtomicUsize::new(0), Mutex::new(usize::MAX));
    let workers = if long() { 2 } else { 1 };
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(&at) = points.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let done = shim.run(OPERATIONS, mode, at);
                    let mut least = least.lock().unwrap_or_else(PoisonError::into_inner);
                    *least = (*least).min(done);
                }
            });
        }
    });
    println!("{}: {} of {total} writes and syncs of {OPERATIONS} operations, 0 violations", mode.word(), points.len());
}

#[test]
fn a_write_or_sync_that_fails_once_loses_nothing() {
    every_point(Mode::Fail, 24);
}

#[test]
fn a_disk_that_dies_at_a_write_or_sync_keeps_what_was_acknowledged() {
    every_point(Mode::Dead, 12);
}

#[test]
fn a_disk_that_hangs_at_a_write_or_sync_keeps_what_was_acknowledged() {
    every_point(Mode::Freeze, 24);
}

#[test]
fn a_write_that_is_torn_is_never_taken_for_whole() {
    every_point(Mode::Torn, 12);
}
