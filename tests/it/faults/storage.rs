//! A disk that fails, dies, hangs or tears at the k-th write or sync of a script of a thousand operations: whatever
//! the store acknowledged is there afterwards, nothing is half done, and the work continues.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::script::{Model, Store, operation};
use crate::support::{long, skipped, system_program};

/// Operations of the script.
const OPERATIONS: usize = 1_000;
/// The script runs in pieces of this many operations, each started from a copy of what the previous one left.
const PIECE: usize = 20;
/// Attempts at an operation on a disk that refused it.
const TRIES: usize = 5;

/// A directory on a file system whose fsync is free, if there is one: the points are the same.
fn directory() -> TempDir {
    let mut builder = tempfile::Builder::new();
    builder.prefix("authros-storage");
    builder.tempdir_in("/dev/shm").or_else(|_| builder.tempdir()).expect("a temporary directory")
}

/// Runs as a separate process, started by `Driver::start`: runs the script and reports what is done.
#[test]
fn driver() {
    let Some(directory) = std::env::var_os("STORAGE_SCRIPT").map(PathBuf::from) else { return };
    let number = |name: &str| -> usize { std::env::var(name).expect("given").parse().expect("a number") };
    let (from, until) = (number("STORAGE_FROM"), number("STORAGE_UNTIL"));
    let mut out = std::io::stdout();
    let mut tell = |word: &str| {
        out.write_all(format!("\n{word}\n").as_bytes()).and_then(|()| out.flush()).expect("told");
    };
    let Some(store) = (0..TRIES).find_map(|_| Store::open(&directory).ok()) else { return tell("gave up") };
    let mut model = Model::after(from);
    for index in from..until {
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

/// The preloaded library, compiled once.
pub struct Shim {
    directory: TempDir,
}

impl Shim {
    /// Compiles it; nothing if there is no compiler.
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

    /// Its path.
    pub fn path(&self) -> String {
        self.directory.path().join("shim.so").to_str().expect("UTF-8").to_owned()
    }

    fn command(&self, place: &Path, piece: Range<usize>, mode: Mode, at: usize) -> Command {
        let mut command = Command::new(std::env::current_exe().expect("this test"));
        command.args(["--exact", "faults::storage::driver", "--nocapture", "--test-threads", "1"]);
        command.env("STORAGE_SCRIPT", place).env("STORAGE_FROM", piece.start.to_string());
        command.env("STORAGE_UNTIL", piece.end.to_string());
        command.env("LD_PRELOAD", self.directory.path().join("shim.so")).env("SHIM_DIR", place);
        command.env("SHIM_MODE", mode.word()).env("SHIM_AT", at.to_string()).env("SHIM_TELL", "1");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Runs a piece without a fault; returns how many writes and syncs that makes, including opening the store.
    fn count(&self, place: &Path, piece: Range<usize>) -> usize {
        let file = self.directory.path().join("count");
        let output = self.command(place, piece.clone(), Mode::Whole, 0).env("SHIM_COUNT", &file).output();
        let output = output.expect("the driver runs");
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success() && said.contains("\nfinished\n"), "{piece:?}: {said}{output:?}");
        fs::read_to_string(file).expect("counted").trim().parse().expect("a number")
    }

    /// One run of a piece, from a copy of its starting state, with a fault at number `at`.
    fn run(&self, before: &Path, piece: Range<usize>, mode: Mode, at: usize) {
        let place = directory();
        copy(before, place.path());
        let what = format!("{} at write or sync {at} of operations {piece:?}", mode.word());
        let child = self.command(place.path(), piece.clone(), mode, at).spawn().expect("the driver starts");
        let (done, word) = hear(child, piece.start, &what);
        match mode {
            // One refused write is recovered by retrying, and by opening again.
            Mode::Fail | Mode::Whole => assert_eq!((done, &*word), (piece.end, "finished"), "{what}"),
            // At a write while closing, everything is already acknowledged.
            Mode::Dead if done == piece.end => assert_eq!(word, "finished", "{what}"),
            Mode::Dead => assert_eq!(word, "gave up", "{what}"),
            Mode::Freeze | Mode::Torn => assert_eq!(word, "frozen", "{what}"),
        }
        check(place.path(), piece.end, done, &what);
    }
}

/// What the script leaves after each piece, and how many writes and syncs each makes.
struct Course {
    stores: Vec<TempDir>,
    counts: Vec<usize>,
}

impl Course {
    fn of(shim: &Shim) -> Self {
        let mut course = Self { stores: vec![directory()], counts: Vec::new() };
        for piece in pieces() {
            let place = directory();
            copy(course.stores[course.counts.len()].path(), place.path());
            course.counts.push(shim.count(place.path(), piece));
            course.stores.push(place);
        }
        let last = course.stores.pop().expect("one for each piece");
        check(last.path(), OPERATIONS, OPERATIONS, "the script without a fault");
        course
    }

    /// The piece that contains a number of the whole script, and the number within it.
    fn piece(&self, mut at: usize) -> (usize, usize) {
        for (piece, count) in self.counts.iter().enumerate() {
            if at <= *count {
                return (piece, at);
            }
            at -= count;
        }
        panic!("behind the script");
    }
}

fn pieces() -> impl Iterator<Item = Range<usize>> {
    (0..OPERATIONS).step_by(PIECE).map(|from| from..from + PIECE)
}

/// Copies every file and directory below one folder into another.
fn copy(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).expect("readable").map(|entry| entry.expect("readable")) {
        let target = to.join(entry.file_name());
        if entry.file_type().expect("known").is_dir() {
            fs::create_dir(&target).expect("made");
            fs::set_permissions(&target, entry.metadata().expect("known").permissions()).expect("set");
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), &target).expect("copied");
        }
    }
}

/// Reads a driver's output to its end, or until its disk hangs, after which it is killed.
fn hear(mut child: Child, from: usize, what: &str) -> (usize, String) {
    let (mut done, mut word) = (from, String::new());
    let out = child.stdout.take().expect("piped");
    let begun = Instant::now();
    for line in BufReader::new(out).lines() {
        let line = line.unwrap_or_default();
        match line.split_once(' ') {
            Some(("done", number)) => done = number.parse().expect("a number"),
            _ if line == "frozen" => {
                word = line;
                // Its other threads continue: none of them may acknowledge anything after the hang.
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

/// The store opens, holds exactly what was acknowledged, or that plus the whole of the one operation in progress, and
/// keeps working.
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

/// Where the fault occurs: in the long form at every write and sync, or at every tenth; otherwise at the first ones,
/// which create the files, and then at intervals.
fn points(total: usize, few: usize, every: usize) -> Vec<usize> {
    if long() {
        return (1..=total).step_by(every).collect();
    }
    let step = (total / few).max(1);
    let opening = (1..=24).step_by(8);
    opening.chain((25..=total).step_by(step)).collect()
}

fn every_point(mode: Mode, few: usize, every: usize) {
    let Some(shim) = Shim::compile() else { skipped!("no C compiler") };
    let course = Course::of(&shim);
    let total = course.counts.iter().sum();
    let points = points(total, few, every);
    let next = AtomicUsize::new(0);
    let workers = if long() { 2 } else { 1 };
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(&at) = points.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let (piece, at) = course.piece(at);
                    let range = piece * PIECE..(piece + 1) * PIECE;
                    shim.run(course.stores[piece].path(), range, mode, at);
                }
            });
        }
    });
    println!("{}: {} of {total} writes and syncs of {OPERATIONS} operations, 0 violations", mode.word(), points.len());
}

#[test]
fn a_write_or_sync_that_fails_once_loses_nothing() {
    every_point(Mode::Fail, 10, 1);
}

#[test]
fn a_disk_that_dies_at_a_write_or_sync_keeps_what_was_acknowledged() {
    every_point(Mode::Dead, 5, 10);
}

#[test]
fn a_disk_that_hangs_at_a_write_or_sync_keeps_what_was_acknowledged() {
    every_point(Mode::Freeze, 10, 1);
}

#[test]
fn a_write_that_is_torn_is_never_taken_for_whole() {
    every_point(Mode::Torn, 5, 10);
}
