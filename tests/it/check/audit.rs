//! `authros audit`: clean stores, each kind of damage, the scrubber.

use rusqlite::Connection;
use serde_json::Value;

use super::{TAMPERED, damaged, database};
use crate::support::{Authros, Home, count, heavy, list, long, poll, text, wait_until};

/// The result of an audit; it must find something.
fn finds(authros: &Authros, deep: bool) -> Value {
    let arguments: &[&str] = if deep { &["audit", "--deep"] } else { &["audit"] };
    let found = authros.with(&["--json"]).run(arguments).expect_code(TAMPERED).document();
    assert_eq!(found["ok"], false, "{found}");
    found
}

fn clean(authros: &Authros, deep: bool) -> Value {
    let arguments: &[&str] = if deep { &["audit", "--deep"] } else { &["audit"] };
    let found = authros.json_within(600, arguments);
    let nothing = ["missing", "tampered", "gaps", "unchecked"].map(|field| count(&found, field));
    assert_eq!((&found["ok"], nothing), (&true.into(), [0; 4]), "{found}");
    found
}

/// Whether a finding of this kind names the subject, or contains these words.
fn tells(found: &Value, kind: &str, words: &str) -> bool {
    list(found, "findings").iter().any(|finding| {
        finding["kind"] == kind && (text(finding, "subject").contains(words) || text(finding, "text").contains(words))
    })
}

fn id(connection: &Connection, row: i64) -> String {
    let found = connection.query_row("SELECT lower(hex(digest)) FROM records WHERE n = ?1", [row], |row| row.get(0));
    let digest: String = found.expect("a record");
    digest[..16].to_owned()
}

/// One byte in the middle of the bytes stored of row `n`; returns the id of its record.
fn flip(connection: &Connection, n: i64) -> String {
    let found = connection.query_row(
        "SELECT digest, ciphertext.bytes FROM ciphertext JOIN records ON n = record WHERE n = ?1",
        [n],
        |row| Ok((row.get::<_, [u8; 32]>(0)?, row.get::<_, Vec<u8>>(1)?)),
    );
    let (digest, mut bytes) = found.expect("a blob");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    connection
        .execute("UPDATE ciphertext SET bytes = ?2 WHERE record = ?1", rusqlite::params![n, bytes])
        .expect("altered");
    crate::support::hex(&digest)[..16].to_owned()
}

/// A home with a few thousand records, all verified, and no process in it.
fn filled() -> (Home, Authros) {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "16"]);
    let topics: Vec<String> = (1..=16).map(|robot| format!("/robot{robot}/odom")).collect();
    authros.enrol();
    authros.capture(&topics.iter().map(String::as_str).collect::<Vec<_>>(), 64);
    (home, authros)
}

#[test]
fn an_audit_finds_every_kind_of_damage_and_nothing_on_a_clean_store() {
    let _alone = heavy();
    let (home, authros) = filled();
    let found = clean(&authros, true);
    assert!(count(&found, "records") >= 1024 && count(&found, "bytes") > 500_000, "{found}");
    assert!(count(&found, "batches") >= 2 && count(&found, "audit_lines") >= 2, "{found}");
    assert!(found["records_per_second"].as_f64() > Some(0.0), "{found}");
    let later = authros.json(&["audit", "--since", "2100-01-01T00:00:00Z"]);
    assert_eq!(count(&later, "records"), 0, "{later}");

    in_the_bytes(&home, &authros);
    in_rows(&home, &authros);
    in_batches(&home, &authros);

    let edit = "UPDATE audit SET subject = 'nothing' WHERE line = 2";
    let found =
        damaged(&home, "ledger.db", |ledger| ledger.execute_batch(edit).expect("edited"), || finds(&authros, false));
    assert!(tells(&found, "tampered", "line 2 of the audit log"), "{found}");
    let cut = "DELETE FROM audit WHERE line = 2";
    let found =
        damaged(&home, "ledger.db", |ledger| ledger.execute_batch(cut).expect("cut"), || finds(&authros, false));
    assert!(tells(&found, "tampered", "audit log"), "{found}");
    clean(&authros, true);
}

/// One payload byte, one payload.
fn in_the_bytes(home: &Home, authros: &Authros) {
    let mut altered = String::new();
    let found = damaged(home, "ledger.db", |store| altered = flip(store, 500), || finds(authros, true));
    assert_eq!((count(&found, "tampered"), count(&found, "missing")), (1, 0), "{found}");
    assert!(tells(&found, "tampered", &altered), "{altered}: {found}");

    let mut lost = String::new();
    let delete = |store: &Connection| {
        let row = store.query_row("SELECT lower(hex(digest)) FROM records WHERE n = 700", [], |row| row.get(0));
        lost = row.expect("a record");
        store.execute("DELETE FROM ciphertext WHERE record = 700", []).expect("deleted");
    };
    let found = damaged(home, "ledger.db", delete, || finds(authros, true));
    assert_eq!((count(&found, "tampered"), count(&found, "missing")), (0, 1), "{found}");
    assert!(tells(&found, "missing", &lost[..16]), "{lost}: {found}");
}

/// The leaf pages of a table, by their numbers: below its root, or below the pages that the root names.
fn leaves_of(store: &Connection, table: &str) -> Vec<usize> {
    const LEAF_OF_A_TABLE: u8 = 0x0d;
    store.execute_batch("PRAGMA wal_checkpoint(TRUNCATE)").expect("in the file");
    let root = "SELECT rootpage FROM sqlite_schema WHERE name = ?1";
    let root: i64 = store.query_row(root, [table], |row| row.get(0)).expect("a table");
    let root = usize::try_from(root).expect("a page");
    let file = std::fs::read(store.path().expect("a path")).expect("read");
    let size = usize::from(u16::from_be_bytes([file[16], file[17]]));
    let (mut inner, mut leaves) = (vec![root], Vec::new());
    while let Some(number) = inner.pop() {
        let page = &file[(number - 1) * size..number * size];
        if page[0] == LEAF_OF_A_TABLE {
            leaves.push(number);
            continue;
        }
        let word = |at: usize| u32::from_be_bytes([page[at], page[at + 1], page[at + 2], page[at + 3]]) as usize;
        let cells = usize::from(u16::from_be_bytes([page[3], page[4]]));
        inner.extend(
            (0..cells).map(|cell| word(usize::from(u16::from_be_bytes([page[12 + 2 * cell], page[13 + 2 * cell]])))),
        );
        inner.push(word(8));
    }
    leaves.sort_unstable();
    leaves
}

/// One page of ciphertext copied over another one of it: records are in the tree and nowhere else.
fn swap_pages(path: &std::path::Path, pages: &[usize]) {
    let mut file = std::fs::read(path).expect("read");
    let size = usize::from(u16::from_be_bytes([file[16], file[17]]));
    let (from, to) = (pages[pages.len() / 2] - 1, pages[pages.len() / 2 + 1] - 1);
    file.copy_within(from * size..(from + 1) * size, to * size);
    std::fs::write(path, file).expect("written");
}

#[test]
fn a_store_with_a_swapped_page_ends_each_audit_with_the_code_of_tampering() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "4"]);
    authros.enrol();
    authros.capture(&["/robot1/odom", "/robot2/odom", "/robot3/odom", "/robot4/odom"], 20);
    let store = database(&home, "ledger.db");
    let pages = leaves_of(&store, "ciphertext");
    drop(store);
    let path = home.path().join("ledger.db");
    let kept = std::fs::read(&path).expect("read");
    swap_pages(&path, &pages);
    for audit in [&["audit"][..], &["audit", "--deep"]] {
        let outcome = authros.run(audit);
        assert_eq!(outcome.code, Some(TAMPERED), "{audit:?}: {outcome}");
    }
    std::fs::write(&path, kept).expect("put back");
    for end in ["-wal", "-shm"] {
        drop(std::fs::remove_file(format!("{}{end}", path.display())));
    }
    clean(&authros, true);
}

/// Every field of a row that anything outside it can contradict.
fn in_rows(home: &Home, authros: &Authros) {
    let edits: [(&str, bool); 10] = [
        ("seq = seq + 1000000", true),
        ("digest = zeroblob(32)", true),
        ("tx = zeroblob(32)", true),
        (
            "(tx, block, block_hash) = (SELECT tx, block + 1, block_hash FROM leaves JOIN batches ON key = batch
             WHERE record = n)",
            true,
        ),
        ("state = 1", true),
        ("epoch = epoch + 1", false),
        ("signature = zeroblob(64)", false),
        ("bytes = 1", false),
        ("captured_at = captured_at + 1", false),
        ("stream = (SELECT min(key) FROM streams)", true),
    ];
    for deep in [false, true] {
        let mut named = Vec::new();
        let damage = |ledger: &Connection| {
            for (row, (edit, quick)) in (100..).zip(edits) {
                if deep || quick {
                    let before = id(ledger, row);
                    ledger.execute(&format!("UPDATE records SET {edit} WHERE n = ?1"), [row]).expect(edit);
                    named.push((edit, if edit.starts_with("digest") { "0".repeat(16) } else { before }));
                }
            }
        };
        let found = damaged(home, "ledger.db", damage, || finds(authros, deep));
        for (edit, id) in named {
            assert!(tells(&found, "tampered", &id), "{edit}: {id} is not in {found}");
        }
    }
    let cut = "DELETE FROM records WHERE n = 300";
    let found = damaged(home, "ledger.db", |ledger| ledger.execute_batch(cut).expect("cut"), || finds(authros, false));
    assert_eq!(count(&found, "gaps"), 1, "{found}");
    assert!(tells(&found, "missing", "of its") && tells(&found, "gap", "/odom"), "{found}");
}

/// A batch without its row, and one of which only the chain's word is left.
fn in_batches(home: &Home, authros: &Authros) {
    let removed = "DELETE FROM batches WHERE key = (SELECT max(key) FROM batches)";
    let found =
        damaged(home, "ledger.db", |ledger| ledger.execute_batch(removed).expect("removed"), || finds(authros, false));
    assert!(tells(&found, "tampered", "its batch is missing from the ledger"), "{found}");

    let mut root = String::new();
    let whole = |ledger: &Connection| {
        let newest = "SELECT lower(hex(root)) FROM batches ORDER BY key DESC LIMIT 1";
        root = ledger.query_row(newest, [], |row| row.get(0)).expect("a batch");
        let removed =
            "DELETE FROM records WHERE n IN (SELECT record FROM leaves WHERE batch = (SELECT max(key) FROM batches));
                       DELETE FROM leaves WHERE batch = (SELECT max(key) FROM batches);
                       DELETE FROM batches WHERE key = (SELECT max(key) FROM batches);";
        ledger.execute_batch(removed).expect("removed");
    };
    let found = damaged(home, "ledger.db", whole, || finds(authros, false));
    assert!(tells(&found, "missing", &root), "{root}: {found}");
}

#[test]
fn the_scrubber_finds_damage_by_itself_and_says_so() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_AUDIT_SCRUB", "1000000");
    authros.enrol();
    authros.capture(&["/robot1/odom"], 20);
    let site = authros.serve(&home);
    let altered = flip(&database(&home, "ledger.db"), 5);
    let tampered = || {
        let records = authros.records(&["records", "list", "--oldest", "--state", "tampered"]);
        (!records.is_empty()).then_some(records)
    };
    let records = wait_until(60, "the scrubber found it", tampered);
    assert_eq!((records.len(), text(&records[0], "id")), (1, altered));
    let told = site.stop("INT", 30).expect_code(0);
    assert!(told.stderr.contains("altered") || told.stdout.contains("altered"), "{told}");
}

#[test]
fn a_hundred_thousand_records_are_audited_beside_the_bound_of_sm3() {
    if !long() {
        return;
    }
    let _alone = heavy();
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "32"]);
    authros.enrol();
    let topics: Vec<String> = (1..=32).map(|robot| format!("/robot{robot}/odom")).collect();
    let site = authros.serve(&home);
    for topic in &topics {
        authros.run(&["topics", "watch", topic]).expect_code(0);
    }
    let total = || {
        let ledger = rusqlite::Connection::open(home.path().join("ledger.db")).ok()?;
        let records: i64 = ledger.query_row("SELECT sum(records) FROM counters", [], |row| row.get(0)).ok()?;
        (records >= 100_000).then_some(())
    };
    poll(1800, total).expect("all records within half an hour");
    for topic in &topics {
        authros.run(&["topics", "unwatch", topic]).expect_code(0);
    }
    let open = || {
        let ledger = rusqlite::Connection::open(home.path().join("ledger.db")).ok()?;
        let sql = "SELECT coalesce(sum(records), 0) FROM counters WHERE state <> 6";
        let open: i64 = ledger.query_row(sql, [], |row| row.get(0)).ok()?;
        (open == 0).then_some(())
    };
    poll(1800, open).expect("all verified within half an hour");
    site.stop("INT", 60).expect_code(0);
    for deep in [false, true] {
        let found = clean(&authros, deep);
        assert!(count(&found, "records") >= 100_000, "{found}");
        println!("audit, deep {deep}: {found}");
    }
}
