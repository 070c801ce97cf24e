//! The store's file damaged in more than sixty ways, each opened by the program: no panic, an exit code with a kind, no
//! record shown as more than it is, and nothing lost or altered without a word.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use rusqlite::Connection;
use serde_json::Value;

use super::field::ODOM;
use crate::support::authros::files_below;
use crate::support::{Authros, Home, Outcome, is_verified, list, text, wait_until};

/// A damage that is none by itself.
const EARLIER: &str = "the file of an earlier moment";
const OTHER: &str = "/robot2/odom";
/// Its publisher is not the pinned one.
const HELD: &str = "/robot3/odom";
const STRANGER: &str = "/other@elsewhere:nav_msgs/Odometry:cd5e73d190d741a2f92e81eda573aca7";
/// Decides which pages and bits.
const SEED: u64 = 0x5eed_0042;
const LEAST: usize = 60;

/// What the chain, the records' headers or the counts contradict: a change must be told. The rest is this home's own word.
const FACTS: [(&str, &str); 12] = [
    ("records", "n, digest, topic, stream, seq, epoch, signature, captured_at, tx, block, block_hash, deleted_at"),
    ("ciphertext", "*"),
    ("leaves", "*"),
    ("branches", "*"),
    ("batches", "key, root, count, account, tx, block, block_hash"),
    ("streams", "key, topic, kind"),
    ("recorders", "*"),
    ("topics", "key, owner, recorder, topic_id"),
    // A count of none says nothing.
    ("(SELECT * FROM counters NOT INDEXED WHERE records <> 0 OR bytes <> 0)", "*"),
    ("intake", "*"),
    ("epoch_records", "*"),
    ("audit", "*"),
];

/// `V`: a verified message, `P`: one that waits, `Q`: one in quarantine, `E`: an erased one.
const EDITS: [&str; 34] = [
    "UPDATE records SET state = 6 WHERE n = Q",
    "UPDATE records SET state = 5 WHERE n = Q",
    "UPDATE records SET state = 77 WHERE n = V",
    "UPDATE records SET deleted_at = NULL WHERE n = E",
    "UPDATE records SET deleted_at = 5 WHERE n = V",
    "UPDATE records SET seq = seq + 1000 WHERE n = V",
    "UPDATE records SET digest = zeroblob(32) WHERE n = V",
    "UPDATE records SET signature = 'x' WHERE n = V",
    "UPDATE records SET captured_at = -1 WHERE n = V",
    "UPDATE records SET (tx, block, block_hash) = (zeroblob(32), 1, zeroblob(32)) WHERE n = P",
    "UPDATE records SET stream = 999 WHERE n = V",
    "UPDATE batches SET root = zeroblob(32) WHERE key = 1",
    "UPDATE batches SET block = block + 1",
    "UPDATE batches SET count = count + 1",
    "UPDATE leaves SET leaf = leaf + 100",
    "UPDATE topics SET owner = zeroblob(20)",
    "UPDATE recorders SET signer = zeroblob(32)",
    "UPDATE counters SET records = 0 WHERE state = 7",
    "UPDATE intake SET records = records - 1",
    "UPDATE about SET recorder = zeroblob(3)",
    "UPDATE ciphertext SET bytes = substr(bytes, 1, length(bytes) - 9)",
    "DELETE FROM records WHERE n = V",
    "DELETE FROM records WHERE n = P",
    "DELETE FROM records WHERE n = Q",
    "DELETE FROM records WHERE n = E",
    "DELETE FROM ciphertext WHERE record = Q",
    "DELETE FROM leaves",
    "DELETE FROM batches",
    "DELETE FROM topics",
    "DELETE FROM counters",
    "DELETE FROM intake",
    "DELETE FROM retained",
    "DROP TABLE leaves",
    "DROP INDEX records_by_state",
];

const PLACES: [(&str, &str); 4] = [
    ("= V", "= (SELECT min(n) FROM records JOIN leaves ON record = n WHERE state = 6 AND deleted_at IS NULL)"),
    ("= P", "= (SELECT max(n) FROM records WHERE state = 4)"),
    ("= Q", "= (SELECT min(record) FROM held)"),
    ("= E", "= (SELECT min(record) FROM retained)"),
];

enum Damage {
    /// Other bytes in the file.
    Bytes(Vec<u8>),
    /// A log beside it.
    Log(Vec<u8>),
    Edit(&'static str),
}

/// A home whose only process has ended, as it is put back before each damage.
struct Ground {
    home: Home,
    authros: Authros,
    kept: PathBuf,
    /// The store while it had fewer records, and a log that was written over it.
    early: (Vec<u8>, Vec<u8>),
}

impl Ground {
    /// Verified, erased, quarantined and waiting messages.
    fn new() -> Self {
        let home = Home::new();
        let authros = home.authros().with(&["--robots", "3"]);
        let site = authros.serve(&home);
        authros.enrol();
        authros.json(&["topics", "pin", HELD, "--publisher", STRANGER]);
        authros.capture(&[ODOM, OTHER], 16);
        site.stop("INT", 30).expect_code(0);
        let file = home.path().join("ledger.db");
        let early = fs::read(&file).expect("a store");
        let site = authros.serve(&home);
        in_state(&authros, HELD, "quarantined", 3);
        let erased = text(&authros.records(&["records", "list", "--oldest", "--topic", ODOM])[1], "id");
        authros.json(&["records", "erase", "--record", &erased, "--reason", "a test", "--yes"]);
        wait_until(60, "one is erased", || {
            let records = authros.records(&["records", "list", "--oldest", "--topic", ODOM]);
            records.iter().any(|record| record["state"] == "deleted").then_some(())
        });
        let early = (early, fs::read(log_of(&file)).expect("a log"));
        site.stop("INT", 30).expect_code(0);
        // Nothing that is captured from here on is deep enough.
        let authros = authros.with_variable("AUTHROS_CONFIRMATIONS", "1000");
        let site = authros.serve(&home);
        in_state(&authros, ODOM, "mined", 3);
        site.stop("INT", 30).expect_code(0);
        Connection::open(&file)
            .and_then(|file| file.execute_batch("PRAGMA wal_checkpoint(TRUNCATE)"))
            .expect("one file");
        let kept = home.root().join("kept");
        copy(&home.path(), &kept);
        Self { home, authros, kept, early }
    }

    fn file(&self) -> PathBuf {
        self.home.path().join("ledger.db")
    }

    /// Into the same files: a home in other ones would be a copy, which is checked and numbered anew.
    fn put_back(&self) {
        for path in files_below(&self.home.path()) {
            let kept = self.kept.join(path.strip_prefix(self.home.path()).expect("below the home"));
            if !kept.exists() {
                fs::remove_file(path).expect("removed");
            }
        }
        copy(&self.kept, &self.home.path());
    }

    fn damage(&self, damage: &Damage) {
        self.put_back();
        match damage {
            Damage::Bytes(bytes) => fs::write(self.file(), bytes).expect("written"),
            Damage::Log(bytes) => fs::write(log_of(&self.file()), bytes).expect("written"),
            Damage::Edit(edit) => {
                let sql = PLACES.iter().fold((*edit).to_owned(), |sql, (name, place)| sql.replace(name, place));
                let changed = Connection::open(self.file()).and_then(|store| store.execute(&sql, []));
                assert!(changed.is_ok_and(|rows| rows > 0 || edit.starts_with("DROP")), "{edit}");
            }
        }
    }

    /// An exit code with a kind, other than that of a fault of the program.
    fn ask(&self, name: &str, arguments: &[&str]) -> Outcome {
        let outcome = self.authros.with(&["--json"]).run(arguments);
        assert!(!outcome.stderr.contains("panicked"), "{name}: {outcome}");
        assert!(outcome.code.is_some_and(|code| code == 0 || (2..=8).contains(&code)), "{name}: {outcome}");
        let document = outcome.document();
        let has_kind = document["error"]["kind"].is_string() || document["ok"] == false;
        assert!(outcome.code == Some(0) || has_kind, "{name}: {outcome}");
        outcome
    }
}

/// Captures a topic until this many of its records are in a state.
fn in_state(authros: &Authros, topic: &str, state: &str, least: usize) {
    authros.json(&["topics", "watch", topic]);
    wait_until(60, state, || {
        let records = authros.records(&["records", "list", "--oldest", "--topic", topic]);
        (records.iter().filter(|record| record["state"] == state).count() >= least).then_some(())
    });
    authros.json(&["topics", "unwatch", topic]);
}

fn log_of(file: &Path) -> PathBuf {
    PathBuf::from(format!("{}-wal", file.display()))
}

/// A home without its socket and the space that it sets aside.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    fs::set_permissions(to, fs::metadata(from).expect("a folder").permissions()).expect("its mode");
    for entry in fs::read_dir(from).expect("a folder").map(|entry| entry.expect("an entry")) {
        let (path, kind) = (to.join(entry.file_name()), entry.file_type().expect("a type"));
        let is_reserve = entry.file_name().to_string_lossy().starts_with("reserve");
        if kind.is_dir() {
            copy(&entry.path(), &path);
        } else if kind.is_file() && !is_reserve {
            fs::copy(entry.path(), path).expect("copied");
        }
    }
}

/// The next of a fixed series of numbers below `most`.
fn draw(state: &mut u64, most: usize) -> usize {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    usize::try_from(*state % most as u64).expect("small")
}

/// A file's bytes by pages.
struct Pages {
    bytes: Vec<u8>,
    size: usize,
    /// The tables and indices that have rows, each with its root page.
    trees: Vec<(String, usize)>,
}

impl Pages {
    fn of(file: &Path) -> Self {
        let bytes = fs::read(file).expect("read");
        let size = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
        let store = Connection::open(file).expect("opens");
        let sql = "SELECT name, rootpage FROM sqlite_schema WHERE rootpage > 0 ORDER BY rootpage";
        let mut statement = store.prepare(sql).expect("a schema");
        let trees = statement.query_map([], |row| Ok((row.get(0)?, row.get::<_, i64>(1)?))).expect("trees");
        let trees = trees.map(|tree| tree.map(|(name, root)| (name, usize::try_from(root).expect("a page"))));
        let trees: Vec<(String, usize)> = trees.collect::<Result<_, _>>().expect("trees");
        let mut pages = Self { bytes, size, trees: Vec::new() };
        pages.trees = trees.into_iter().filter(|(_, root)| pages.word(pages.start(*root) + 3) > 0).collect();
        pages
    }

    fn start(&self, page: usize) -> usize {
        (page - 1) * self.size
    }

    fn word(&self, at: usize) -> usize {
        usize::from(u16::from_be_bytes([self.bytes[at], self.bytes[at + 1]]))
    }

    /// A tree's last leaf: of each page above it, the right-most one below.
    fn last_leaf(&self, mut page: usize) -> usize {
        while matches!(self.bytes[self.start(page)], 2 | 5) {
            let at = self.start(page) + 8;
            page = self.word(at) << 16 | self.word(at + 2);
        }
        page
    }

    fn root(&self, name: &str) -> usize {
        self.trees.iter().find(|(tree, _)| tree == name).expect("a tree with rows").1
    }

    fn flipped(&self, bit: usize) -> Damage {
        let mut bytes = self.bytes.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        Damage::Bytes(bytes)
    }

    fn zeroed(&self, page: usize) -> Damage {
        let mut bytes = self.bytes.clone();
        bytes[self.start(page)..self.start(page) + self.size].fill(0);
        Damage::Bytes(bytes)
    }

    fn swapped(&self, one: usize, other: usize) -> Damage {
        let mut bytes = self.bytes.clone();
        let (one, other) = (self.start(one.min(other)), self.start(one.max(other)));
        let (low, high) = bytes.split_at_mut(other);
        low[one..one + self.size].swap_with_slice(&mut high[..self.size]);
        Damage::Bytes(bytes)
    }
}

fn damages(ground: &Ground) -> Vec<(String, Damage)> {
    let (pages, mut state) = (Pages::of(&ground.file()), SEED);
    let mut all = Vec::new();
    for (name, root) in &pages.trees {
        let leaf = pages.last_leaf(*root);
        // Among its cells, which end at the end of the page.
        let cells = pages.word(pages.start(leaf) + 5);
        let bit = (pages.start(leaf) + cells) * 8 + draw(&mut state, (pages.size - cells) * 8);
        all.push((format!("bit {bit} flipped, among the cells of {name}"), pages.flipped(bit)));
    }
    for name in ["records", "ciphertext", "leaves", "records_by_state"] {
        let bit = pages.start(pages.root(name)) * 8 + draw(&mut state, 8 * 8);
        all.push((format!("bit {bit} flipped, at the head of {name}"), pages.flipped(bit)));
    }
    let length = pages.bytes.len();
    for cut in [0, 100, pages.size, length / 3, length / 2 / pages.size * pages.size, length - pages.size] {
        all.push((format!("cut to {cut} bytes"), Damage::Bytes(pages.bytes[..cut].to_vec())));
    }
    for name in ["records", "ciphertext", "counters", "sqlite_autoindex_records_1", "audit", "about"] {
        all.push((format!("a page of {name} zeroed"), pages.zeroed(pages.last_leaf(pages.root(name)))));
    }
    all.push(("the first page zeroed".to_owned(), pages.zeroed(1)));
    for (one, other) in [("records", "leaves"), ("ciphertext", "records"), ("counters", "intake")] {
        let swapped = pages.swapped(pages.last_leaf(pages.root(one)), pages.last_leaf(pages.root(other)));
        all.push((format!("a page of {one} swapped with one of {other}"), swapped));
    }
    let (early, log) = &ground.early;
    all.push(("a log of before".to_owned(), Damage::Log(log.clone())));
    all.push(("a log of another home".to_owned(), Damage::Log(foreign_log())));
    let garbage = (0..60_000_u32).map(|at| at.to_le_bytes()[0] ^ 0x5a).collect();
    all.push(("a log of garbage".to_owned(), Damage::Log(garbage)));
    all.push((EARLIER.to_owned(), Damage::Bytes(early.clone())));
    all.extend(EDITS.map(|edit| (edit.to_owned(), Damage::Edit(edit))));
    all
}

fn foreign_log() -> Vec<u8> {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    let site = authros.serve(&home);
    authros.enrol();
    authros.capture(&[ODOM], 2);
    let log = fs::read(log_of(&home.path().join("ledger.db"))).expect("a log");
    site.stop("INT", 30).expect_code(0);
    log
}

/// Every fact of a store, read past its indices; nothing if that cannot be done.
fn facts(file: &Path) -> Option<Vec<String>> {
    let store = Connection::open(file).ok()?;
    let mut found = Vec::new();
    for (table, columns) in FACTS {
        let index = if table.starts_with('(') { "" } else { "NOT INDEXED" };
        let mut statement = store.prepare(&format!("SELECT {columns} FROM {table} {index} ORDER BY 1, 2")).ok()?;
        let count = statement.column_count();
        let mut rows = statement.query([]).ok()?;
        while let Some(row) = rows.next().ok()? {
            let value = |column| row.get_ref(column).map(|value| format!("{value:?}"));
            let values: Result<Vec<String>, _> = (0..count).map(value).collect();
            found.push(format!("{table} {}", values.ok()?.join(" ")));
        }
    }
    Some(found)
}

/// Records by their digests.
fn by_digest(document: &Value) -> BTreeMap<String, Value> {
    list(document, "records").into_iter().map(|record| (text(&record, "digest"), record)).collect()
}

/// A record is shown as verified only if it was, with the values that it had; what is sealed is not called checked here.
fn expect_no_better(name: &str, truth: &BTreeMap<String, Value>, shown: &BTreeMap<String, Value>) {
    for (digest, record) in shown.iter().filter(|(_, record)| is_verified(record)) {
        let before = truth.get(digest).unwrap_or_else(|| panic!("{name}: never was here: {record}"));
        // The whole file of an earlier moment has the bytes that were erased later, and nothing in it is false.
        let is_whole = name == EARLIER && before["state"] == "deleted";
        assert!(is_whole || is_verified(before), "{name}: was {before}, is shown as {record}");
        for field in ["id", "seq", "kind", "captured_at", "epoch", "block"] {
            assert_eq!(record[field], before[field], "{name}: {field} of {record}");
        }
    }
}

#[test]
fn no_damage_of_the_file_shows_a_record_as_better_than_it_is_or_hides_one_without_a_word() {
    let ground = Ground::new();
    let damages = damages(&ground);
    assert!(damages.len() >= LEAST, "{}", damages.len());
    let whole = facts(&ground.file());
    assert!(whole.is_some(), "what is compared can be read");
    ground.put_back();
    let list_all = ["records", "list", "--oldest", "--limit", "1000"];
    let truth = by_digest(&ground.ask("whole", &list_all).document());
    let states: Vec<String> = truth.values().map(|record| text(record, "state")).collect();
    for state in ["verified, names unchecked", "mined", "quarantined", "deleted"] {
        assert!(states.iter().any(|found| found == state), "{state}: {states:?}");
    }
    assert_eq!(ground.ask("whole", &["audit", "--deep"]).code, Some(0));
    let id = text(truth.values().find(|record| is_verified(record)).expect("verified"), "id");
    for (number, (name, damage)) in damages.iter().enumerate() {
        ground.damage(damage);
        let listed = ground.ask(name, &list_all);
        if listed.code == Some(0) {
            expect_no_better(name, &truth, &by_digest(&listed.document()));
        }
        let audited = ground.ask(name, &["audit", "--deep"]);
        if number % 4 == 0 {
            let shown = ground.ask(name, &["records", "show", &id]);
            if shown.code == Some(0) {
                let document = shown.document();
                expect_no_better(name, &truth, &BTreeMap::from([(text(&document, "digest"), document)]));
            }
        }
        // As it was damaged, not as the program left it.
        ground.damage(damage);
        let is_changed = facts(&ground.file()) != whole;
        let is_told = listed.code != Some(0) || audited.code != Some(0);
        println!("{name}: list {:?}, audit {:?}, facts changed: {is_changed}", listed.code, audited.code);
        if is_changed && !is_told {
            expect_word(&ground, name, &audited);
        }
    }
}

/// An older store is sound, and the audit notes what the chain has beyond it; one that was emptied is missed by the doctor.
fn expect_word(ground: &Ground, name: &str, audited: &Outcome) {
    let says = |note: &Value| note.as_str().is_some_and(|note| note.contains("batches or records of these accounts"));
    if list(&audited.document(), "notes").iter().any(says) {
        return;
    }
    let doctor = ground.ask(name, &["doctor"]);
    assert_ne!(doctor.code, Some(0), "{name}: {audited} {doctor}");
}
