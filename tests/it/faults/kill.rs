//! kill -9 at random moments of a running load and at every named place in a record's life, on the embedded chain and on
//! anvil with Redis as a cache: nothing acknowledged is lost, nothing is anchored twice, every store opens.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::support::anvil::{call, word};
use crate::support::{
    Anvil, Authros, Conservation, Home, Redis, Running, count, faulty, hex, is_verified, long, poll, skipped, text,
    wait_until,
};
use rusqlite::{Connection, OpenFlags};
use serde_json::{Value, json};
use sha3::{Digest as _, Keccak256};

const TOPICS: [&str; 3] = ["/robot1/odom", "/robot2/odom", "/robot2/camera/compressed"];
const NO_PEERS: &str = "no redis-server or no anvil";
/// Every fail point in a record's life, in order.
const POINTS: [&str; 19] = [
    "sealed",
    "appended",
    "commit-begun",
    "committed",
    "batch-due",
    "batch-closed",
    "signed",
    "signed-kept",
    "handed-in",
    "events-read",
    "mined",
    "directory-kept",
    "walked",
    "confirmed",
    "read-back",
    "checked",
    "verified",
    "block-due",
    "block-sealed",
];
/// Places passed only by a chain in this process.
const EMBEDDED: [&str; 2] = ["block-due", "block-sealed"];

/// Nanoseconds since 1970.
pub fn now() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970");
    u64::try_from(since.as_nanos()).expect("before 2554")
}

/// Pseudo-random numbers; the seed is printed, so that a run can be identified.
struct Dice(u64);

impl Dice {
    fn thrown() -> Self {
        println!("seed {}", now());
        Self(now() | 1)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

/// A home under load, whose site is killed repeatedly.
struct Field {
    home: Home,
    authros: Authros,
    peers: Option<(Redis, Anvil)>,
    observer: Conservation,
    restarts: Vec<Duration>,
}

impl Field {
    fn embedded() -> Self {
        Self::open(&[], None)
    }

    fn on_redis_and_anvil() -> Option<Self> {
        let redis = Redis::start(&[])?;
        let anvil = Anvil::start(&[])?;
        let options = ["--cache".to_owned(), redis.url(), "--chain".to_owned(), anvil.http()];
        Some(Self::open(&options.each_ref().map(String::as_str), Some((redis, anvil))))
    }

    fn open(options: &[&str], peers: Option<(Redis, Anvil)>) -> Self {
        let home = Home::new();
        let authros = home.authros().with(&["--robots", "2"]).with(options);
        let site = authros.serve(&home);
        for topic in TOPICS {
            authros.run(&["topics", "watch", topic]).expect_code(0);
        }
        let observer = Conservation::watch(&home.path(), "default");
        observer.wait_for_capture_after(0, 60).expect("the load runs");
        drop(site);
        Self { home, authros, peers, observer, restarts: Vec::new() }
    }

    /// Starts the site again, and waits until it captures; records how long that took.
    fn start_capturing(&mut self, authros: &Authros) -> Running {
        let (begun, since) = (Instant::now(), now());
        let site = authros.spawn(&["serve"]);
        let captured = self.observer.wait_for_capture_after(since, 60);
        self.restarts.push(captured.expect("a started site captures").saturating_duration_since(begun));
        site
    }

    /// One life that ends at a random moment: during startup, or while it works.
    fn live_and_die(&mut self, dice: &mut Dice) {
        let site = if dice.below(4) == 0 {
            self.authros.clone().spawn(&["serve"])
        } else {
            self.start_capturing(&self.authros.clone())
        };
        std::thread::sleep(Duration::from_millis(dice.below(700)));
        site.stop("KILL", 10);
    }

    /// One life that ends at a place in the program, the `passing`th time it is reached.
    fn live_until(&mut self, program: &Path, place: &str, passing: u64) {
        let point = format!("{place}:{passing}");
        let mut site = self.authros.with_program(program).with_variable("AUTHROS_FAIL_POINT", &point).spawn(&["serve"]);
        let mut tries = 0;
        let ended = poll(120, || {
            if !site.is_running() {
                return Some(());
            }
            tries += 1;
            self.provoke(place, tries);
            None
        });
        assert!(ended.is_some(), "{point} was never passed: {}", site.stderr());
        let outcome = site.wait(10);
        assert_eq!(outcome.signal, Some(6), "it ended at {point}: {outcome}");
    }

    /// Some places are reached only if something happens beside the load.
    fn provoke(&self, place: &str, tries: u64) {
        match place {
            "directory-kept" if tries % 15 == 1 && self.home.socket().is_some() => {
                let name = format!("visitor{}", now() % 1_000_000_000);
                drop(self.home.profile(&name).spawn(&["identity", "register"]).wait(60));
            }
            _ => {}
        }
    }

    /// Ends the load, lets everything be verified, and compares it with everything ever acknowledged, with the chain's
    /// events and with the files.
    fn settle(self, what: &str) {
        let Self { home, authros, peers, observer, mut restarts } = self;
        let site = authros.serve(&home);
        for topic in TOPICS {
            authros.run(&["topics", "unwatch", topic]).expect_code(0);
        }
        let states = wait_until(240, "everything is verified", || {
            let life = observer.seen().life?;
            (life.pending == 0 && life.captured > 0).then_some(life)
        });
        let seen = observer.finish();
        let records = wait_until(60, "the last ones are verified", || {
            let records = every_record(&authros);
            records.iter().all(is_verified).then_some(records)
        });
        let kept: BTreeMap<String, &Value> = records.iter().map(|record| (text(record, "digest"), record)).collect();
        let roots = match &peers {
            Some((_, anvil)) => anchored_roots(anvil.port(), &contract(&authros)),
            None => roots_of_the_embedded_chain(&authros),
        };
        for (digest, (topic, seq)) in &seen.noted {
            let record = kept.get(digest).unwrap_or_else(|| panic!("lost: number {seq} of {topic}, {digest}"));
            assert_eq!((text(record, "topic"), count(record, "seq")), (topic.clone(), *seq));
            assert!(is_verified(record), "{record}");
        }
        assert_eq!((states.tampered, states.quarantined), (0, 0), "{states:?}");
        expect_dense(&records);
        site.stop("TERM", 30).expect_code(0);
        expect_sound_files(&home, &roots);
        restarts.sort();
        println!(
            "{what}: {} records noted, {} in all, {} batches, {} looks at the law; restart to capturing: median {:?}, longest {:?}",
            seen.noted.len(),
            records.len(),
            roots.len(),
            seen.looks,
            restarts.get(restarts.len() / 2),
            restarts.last()
        );
        // The target is two seconds on an otherwise idle machine.
        assert!(restarts.iter().all(|took| *took < Duration::from_secs(30)), "{restarts:?}");
    }
}

/// Captured messages, their definitions, and reports of losses.
fn every_record(authros: &Authros) -> Vec<Value> {
    let list = |kind| authros.records(&["records", "list", "--oldest", "--kind", kind]);
    ["data", "definition", "gap"].into_iter().flat_map(list).collect()
}

fn roots_of_the_embedded_chain(authros: &Authros) -> Vec<(String, u64)> {
    let mut served = authros.with(&["--json"]).spawn(&["chain", "serve", "--listen", "127.0.0.1:0"]);
    let said = served.wait_for_text("\"url\"", 30);
    let line = said.lines().find(|line| line.contains("\"url\"")).expect("a line");
    let told: Value = serde_json::from_str(line).expect("JSON");
    let url = text(&told["serving"], "url");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    anchored_roots(port, &contract(authros))
}

fn contract(authros: &Authros) -> String {
    text(&authros.json(&["chain", "status"]), "contract")
}

/// Roots with their counts, from the chain's events.
fn anchored_roots(port: u16, contract: &str) -> Vec<(String, u64)> {
    let event = format!("0x{}", hex(&Keccak256::digest("Anchored(address,bytes32,uint64,bytes32)")));
    let filter = json!([{ "fromBlock": "0x0", "toBlock": "latest", "address": contract, "topics": [event] }]);
    let logs = call(port, "eth_getLogs", &filter);
    let root = |log: &Value| {
        let root = log["topics"][2].as_str().expect("the root").trim_start_matches("0x").to_owned();
        (root, u64::from_be_bytes(word(log, 0)[24..].try_into().expect("8 bytes")))
    };
    logs.as_array().expect("logs").iter().map(root).collect()
}

/// The numbers of each topic have no gaps and no duplicates.
fn expect_dense(records: &[Value]) {
    for topic in TOPICS {
        let of_topic = records.iter().filter(|record| record["topic"] == topic);
        let mut seqs: Vec<u64> = of_topic.map(|record| count(record, "seq")).collect();
        seqs.sort_unstable();
        assert!(seqs.iter().copied().eq(1..=seqs.len() as u64), "{topic} has a hole or a double");
    }
}

/// Every database is intact, and what the ledger says about its batches is on the chain, once each.
fn expect_sound_files(home: &Home, roots: &[(String, u64)]) {
    let files = crate::support::authros::files_below(&home.path());
    let databases: Vec<_> = files.iter().filter(|path| path.extension().is_some_and(|end| end == "db")).collect();
    assert!(!databases.is_empty(), "{files:?}");
    for path in databases {
        let found: String = open(path).query_row("PRAGMA integrity_check", [], |row| row.get(0)).expect("checked");
        assert_eq!(found, "ok", "{}", path.display());
    }
    let ledger = open(files.iter().find(|path| path.ends_with("ledger.db")).expect("a ledger"));
    let mut once = BTreeMap::new();
    roots.iter().for_each(|(root, leaves)| assert_eq!(once.insert(root, *leaves), None, "{root} is anchored twice"));
    let number = |sql: &str| ledger.query_row(sql, [], |row| row.get::<_, i64>(0)).expect("counted");
    let anchored = i64::try_from(once.values().sum::<u64>()).expect("few");
    let leaves = number("SELECT count(*) FROM leaves JOIN batches ON key = batch WHERE block IS NOT NULL");
    assert_eq!(leaves, anchored, "each anchored leaf is one record's, and each record is in one anchored batch");
    for root in once.keys() {
        let known = number(&format!("SELECT count(*) FROM batches WHERE hex(root) = upper('{root}')"));
        assert_eq!(known, 1, "the ledger knows the anchored root {root}");
    }
}

fn open(path: &Path) -> Connection {
    Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE).expect("it opens")
}

fn random_kills(mut field: Field, what: &str) {
    let mut dice = Dice::thrown();
    for _ in 0..if long() { 100 } else { 10 } {
        field.live_and_die(&mut dice);
    }
    field.settle(what);
}

#[test]
fn random_kills_on_the_embedded_chain_lose_and_double_nothing() {
    random_kills(Field::embedded(), "random kills, embedded");
}

#[test]
fn random_kills_on_redis_and_anvil_lose_and_double_nothing() {
    let Some(field) = Field::on_redis_and_anvil() else { skipped!(NO_PEERS) };
    random_kills(field, "random kills, Redis and anvil");
}

/// In the short form each place once, and those shared by both sides on one of them.
fn kills_at(field: Option<Field>, places: &[&str], what: &str) {
    let (Some(program), Some(mut field)) = (faulty(), field) else {
        crate::support::tell_skipped(
            what,
            "no authros-faulty (cargo test builds it with the examples), or no redis-server or anvil",
        );
        return;
    };
    let mut dice = Dice::thrown();
    for _ in 0..if long() { 20 } else { 1 } {
        for place in places {
            // Commits and blocks are frequent, some before the first record; the others occur a few times a second.
            let most = if matches!(*place, "commit-begun" | "committed") { 60 } else { 3 };
            let most = if *place == "directory-kept" { 1 } else { most };
            field.live_until(&program, place, 1 + dice.below(most));
        }
    }
    drop(field.start_capturing(&field.authros.clone()));
    field.settle(what);
}

fn places(own: &[&'static str], half: usize) -> Vec<&'static str> {
    let common: Vec<&str> = POINTS.iter().filter(|place| !EMBEDDED.contains(place)).copied().collect();
    let (first, second) = common.split_at(common.len() / 2);
    let shared = if long() { common.clone() } else { [first, second][half].to_vec() };
    shared.into_iter().chain(own.iter().copied()).collect()
}

#[test]
fn ends_at_every_place_of_a_records_life_on_the_embedded_chain() {
    kills_at(Some(Field::embedded()), &places(&EMBEDDED, 0), "ends at places, embedded");
}

#[test]
fn ends_at_every_place_of_a_records_life_on_redis_and_anvil() {
    kills_at(Field::on_redis_and_anvil(), &places(&[], 1), "ends at places, Redis and anvil");
}
