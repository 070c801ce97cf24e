//! The program under test in folders of its own, and what it shares with the flows of the product.
#![allow(dead_code, reason = "the files of the product's flows hold more than these flows use")]

#[path = "../../../../tests/support/anvil.rs"]
pub mod anvil;
#[path = "../../../../tests/support/process.rs"]
pub mod process;

use std::fs::File;
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

pub use anvil::Anvil;
pub use process::{Outcome, Running};

/// Allowance for a busy machine, seconds.
const LIMIT: u64 = 400;

/// The program with a folder to work in, and another for its temporary files.
pub struct Bench {
    folder: TempDir,
    scratch: TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let folder = || tempfile::Builder::new().prefix("bench").tempdir().expect("a temporary directory");
        Self { folder: folder(), scratch: folder() }
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn scratch(&self) -> &Path {
        self.scratch.path()
    }

    pub fn spawn(&self, arguments: &[&str]) -> Running {
        let mut command = Command::new(env!("CARGO_BIN_EXE_authros-bench"));
        let path = std::env::var_os("PATH").unwrap_or_default();
        command.args(arguments).current_dir(self.folder()).env_clear().env("PATH", path);
        Running::start({
            command.env("HOME", self.folder()).env("TMPDIR", self.scratch()).env("RUST_BACKTRACE", "1");
            command
        })
    }

    /// Runs it to its end; nothing temporary may be left.
    pub fn run(&self, arguments: &[&str]) -> Outcome {
        let outcome = self.spawn(arguments).wait(LIMIT);
        self.expect_nothing_left();
        outcome
    }

    /// The document of a bench that ran.
    pub fn report(&self, name: &str) -> Value {
        let text = self.result(name, "json");
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{name}.json: {error}: {text}"))
    }

    /// One of its files in the default folder.
    pub fn result(&self, name: &str, kind: &str) -> String {
        let path = self.folder().join("authros-bench").join(format!("{name}.{kind}"));
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    /// A file that only its owner may read, unless `mode` says otherwise.
    pub fn file(&self, name: &str, text: &str, mode: u32) -> String {
        let path = self.folder().join(name);
        std::fs::write(&path, text).expect("written");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).expect("its mode is set");
        path.to_str().expect("UTF-8").to_owned()
    }

    pub fn expect_nothing_left(&self) {
        let left: Vec<_> = std::fs::read_dir(self.scratch()).expect("readable").flatten().collect();
        assert!(left.is_empty(), "left behind: {left:?}");
    }
}

/// The same lock as of the product's flows.
pub fn heavy() -> File {
    let file = File::create(Path::new(env!("CARGO_TARGET_TMPDIR")).join("heavy.lock")).expect("a file to lock");
    file.lock().expect("locked");
    file
}

/// Written past the test harness's capture, in one write.
pub fn tell_skipped(place: &str, reason: &str) {
    drop(std::io::stderr().write_all(format!("\nSKIPPED {place}: {reason}\n").as_bytes()));
}

/// A program that `tests/run` installed from the npm registry, if it is there.
pub fn npm_program(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/peers");
    let peers = std::env::var_os("AUTHROS_PEERS").map_or_else(beside, PathBuf::from);
    let program = peers.join("node_modules/.bin").join(name);
    program.is_file().then_some(program)
}

pub fn poll<T>(seconds: u64, mut answer: impl FnMut() -> Option<T>) -> Option<T> {
    let end = Instant::now() + Duration::from_secs(seconds);
    while Instant::now() < end {
        if let Some(found) = answer() {
            return Some(found);
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    None
}

pub fn wait_until<T>(seconds: u64, what: &str, answer: impl FnMut() -> Option<T>) -> T {
    poll(seconds, answer).unwrap_or_else(|| panic!("{what}: not within {seconds} s"))
}

pub fn unhex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.trim_start_matches("0x").bytes().collect();
    let pair = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).expect("ASCII"), 16).expect("hex");
    digits.chunks(2).map(pair).collect()
}

pub fn number(value: &Value, field: &str) -> f64 {
    value[field].as_f64().unwrap_or_else(|| panic!("no number '{field}' in {value}"))
}

pub fn count(value: &Value, field: &str) -> u64 {
    value[field].as_u64().unwrap_or_else(|| panic!("no count '{field}' in {value}"))
}

pub fn text(value: &Value, field: &str) -> String {
    value[field].as_str().unwrap_or_else(|| panic!("no text '{field}' in {value}")).to_owned()
}

pub fn list(value: &Value, field: &str) -> Vec<Value> {
    value[field].as_array().unwrap_or_else(|| panic!("no list '{field}' in {value}")).clone()
}
