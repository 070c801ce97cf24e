//! What the tests share: the program under test, real peers, and a pseudo-terminal.
//!
//! Everything started here is stopped when its handle is dropped, and every wait has an end. A test whose peer is
//! absent calls `skipped!`, which reports it in a way `tests/run` counts.
#![allow(dead_code, unused_imports, unused_macros, reason = "each test file uses its part of this module")]

pub mod accounts;
pub mod anvil;
pub mod authros;
pub mod cable;
pub mod client_stream;
pub mod clock;
pub mod conservation;
pub mod console;
pub mod erased;
pub mod figures;
pub mod gate;
pub mod hostile;
pub mod keyless;
pub mod machine;
pub mod member;
pub mod memory;
pub mod nginx;
pub mod operator;
pub mod postgres;
pub mod process;
pub mod proxy;
pub mod redis;
pub mod ros;
pub mod ros2;
pub mod ros2_nodes;
pub mod source;
pub mod stub_desk;
pub mod two;
pub mod wire;

use std::collections::BTreeSet;
use std::fs::File;
use std::io::Write;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

pub use accounts::Accounts;
pub use anvil::Anvil;
pub use authros::{Authros, Home, faulty};
pub use cable::Cable;
pub use conservation::Conservation;
pub use console::{Console, Terminal};
pub use nginx::Nginx;
pub use operator::{Operator, PASSPHRASE, SIZES, locked_profile};
pub use postgres::Postgres;
pub use process::{Outcome, Running};
pub use proxy::{Proxy, Spoil};
pub use redis::Redis;
pub use ros::{Roscore, list_bag, make_bag, odd_bags, read_bag, robot_recording, write_bag};
use serde_json::Value;
pub use two::{Two, two_profiles};
pub use wire::Wire;

/// Ends the test early and counts it as skipped: `skipped!("no redis-server")`.
macro_rules! skipped {
    ($reason:expr) => {{
        fn here() {}
        $crate::support::tell_skipped(std::any::type_name_of_val(&here), &$reason);
        return;
    }};
}
pub(crate) use skipped;

/// Writes past the test harness's capture, so that a skip shows in every run.
pub fn tell_skipped(place: &str, reason: &str) {
    let name = place.trim_end_matches("::here");
    let line = format!("\nSKIPPED {name}: {reason}\n");
    // In one write, so that no other test's output comes in between.
    drop(std::io::stderr().write_all(line.as_bytes()));
}

/// Held by tests that have many processes, so that they do not exceed each other's time limits: three at a time, because
/// each waits for more than two thirds of its time. Files, because tests are processes of their own (tests/in_turn.py, which looks for this
/// call in a test's own body).
pub fn heavy() -> File {
    let place = |name| File::create(Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)).expect("a file to lock");
    for other in ["heavy.second.lock", "heavy.third.lock"].map(place) {
        if other.try_lock().is_ok() {
            return other;
        }
    }
    let first = place("heavy.lock");
    first.lock().expect("locked");
    first
}

/// Whether the long variants are requested (`tests/run --long`).
pub fn long() -> bool {
    std::env::var_os("AUTHROS_LONG").is_some()
}

/// How long a flow goes on: `short` in every run; `usual` in the long one, or as many seconds as `AUTHROS_LONG_SECONDS` says if
/// that is less.
pub fn length(short: Duration, usual: Duration) -> Duration {
    if !long() {
        return short;
    }
    let asked = std::env::var("AUTHROS_LONG_SECONDS").ok().map(|text| text.parse().expect("whole seconds"));
    asked.map_or(usual, Duration::from_secs).min(usual)
}

/// A file of the shared data beside the checkout, if it is there.
pub fn shared_data(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    path.is_file().then_some(path)
}

/// A program that `tests/run` installed from the npm registry, if it is there.
pub fn npm_program(name: &str) -> Option<PathBuf> {
    let peers = std::env::var_os("AUTHROS_PEERS")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("target/peers"), PathBuf::from);
    let program = peers.join("node_modules/.bin").join(name);
    program.is_file().then_some(program)
}

/// A program of the distribution, if it is there.
pub fn system_program(name: &str) -> Option<PathBuf> {
    ["/usr/bin", "/usr/sbin", "/bin", "/usr/local/bin"]
        .iter()
        .map(|directory| Path::new(directory).join(name))
        .find(|path| path.is_file())
}

/// Ports that the system hands to nobody by itself: one of those could be taken, even by an outgoing connection, before the
/// program under test listens on it.
const PORTS: std::ops::Range<u64> = 18_000..32_000;

/// A loopback port nobody listens on.
pub fn free_port() -> u16 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let length = PORTS.end - PORTS.start;
    // Every test is a process of its own, and several run at once: each begins somewhere else.
    let begin = u64::from(std::process::id()).wrapping_mul(7919);
    let free = (0..length).find_map(|_| {
        let step = NEXT.fetch_add(1, Ordering::Relaxed);
        let port = u16::try_from(PORTS.start + begin.wrapping_add(step) % length).ok()?;
        TcpListener::bind(("127.0.0.1", port)).is_ok().then_some(port)
    });
    free.expect("a free port")
}

/// Polls until there is an answer, for at most `seconds`: at first often, then less so, because most answers come from a
/// process of their own.
pub fn poll<T>(seconds: u64, mut answer: impl FnMut() -> Option<T>) -> Option<T> {
    let begin = Instant::now();
    loop {
        match answer() {
            None if begin.elapsed() < Duration::from_secs(seconds) => {
                let pause = (begin.elapsed() / 20).clamp(Duration::from_millis(20), Duration::from_millis(150));
                std::thread::sleep(pause);
            }
            found => return found,
        }
    }
}

/// [`poll`] that fails the test if no answer comes.
pub fn wait_until<T>(seconds: u64, what: &str, answer: impl FnMut() -> Option<T>) -> T {
    poll(seconds, answer).unwrap_or_else(|| panic!("{what}: not within {seconds} s"))
}

/// Whether a listed record is verified, with or without its keys here.
pub fn is_verified(record: &Value) -> bool {
    ["verified", "verified, names unchecked"].iter().any(|state| record["state"] == *state)
}

/// A number in a JSON document.
pub fn count(value: &Value, field: &str) -> u64 {
    value[field].as_u64().unwrap_or_else(|| panic!("no count '{field}' in {value}"))
}

/// A text in a JSON document.
pub fn text(value: &Value, field: &str) -> String {
    value[field].as_str().unwrap_or_else(|| panic!("no text '{field}' in {value}")).to_owned()
}

/// The ids of records.
pub fn ids(records: &[Value]) -> BTreeSet<String> {
    records.iter().map(|record| text(record, "id")).collect()
}

/// A list in a JSON document.
pub fn list(value: &Value, field: &str) -> Vec<Value> {
    value[field].as_array().unwrap_or_else(|| panic!("no list '{field}' in {value}")).clone()
}

/// A number deep in a message: `at(&message, "pose.pose.position.x")`.
pub fn at(message: &Value, path: &str) -> f64 {
    path.split('.')
        .try_fold(message, |value, part| value.get(part))
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("no number '{path}' in {message}"))
}

/// Lower-case hex.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The bytes of a hex text, with or without `0x`.
pub fn unhex(text: &str) -> Vec<u8> {
    let digits = text.trim_start_matches("0x").as_bytes();
    assert!(digits.len().is_multiple_of(2), "odd hex {text}");
    let pair = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).expect("ASCII"), 16).expect("hex digits");
    digits.chunks(2).map(pair).collect()
}

/// Whether `needle` occurs anywhere in `hay`.
pub fn holds(hay: &[u8], needle: &[u8]) -> bool {
    hay.windows(needle.len()).any(|window| window == needle)
}
