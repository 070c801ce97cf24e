//! The audit log: what gets a line, what is counted, heads on the chain, and a full disk.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use support::{Authros, Home, Running, count, is_verified, list, skipped, text, wait_until};

const TAMPERED: i32 = 6;
const HOME: i32 = 7;
const TOPIC: &str = "/robot1/odom";

fn lines(authros: &Authros, filter: &[&str]) -> Vec<Value> {
    list(&authros.json(&[&["audit", "list", "--limit", "1000"], filter].concat()), "audit")
}

fn has(lines: &[Value], action: &str, subject: &str, outcome: &str) -> bool {
    let field = |line: &Value, name: &str, wanted: &str| text(line, name).contains(wanted);
    let is = |line: &&Value| line["action"] == action && field(line, "subject", subject);
    lines.iter().filter(is).any(|line| field(line, "outcome", outcome))
}

#[test]
fn every_deed_is_a_line_and_refusals_are_counted() {
    let home = Home::new();
    let site = home.authros().with(&["--robots", "1"]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    let (own, reader) = (alice.enrol(), bob.enrol());
    alice.capture(&[TOPIC], 2);
    let id = text(&alice.records(&["records", "list", "--oldest"])[0], "id");
    for _ in 0..3 {
        bob.is_refused(&["records", "open", &id]);
    }
    alice.run(&["grant", "add", &reader]).expect_code(0);
    for _ in 0..4 {
        bob.json(&["received", "list", "--oldest"]);
    }
    bob.run(&["records", "check", &id]).expect_code(0);
    bob.run(&["records", "open", &id]).expect_code(0);
    alice.run(&["topics", "watch", TOPIC]).expect_code(0);
    alice.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    alice.run(&["grant", "end", &reader]).expect_code(0);
    let secret = home.root().join("out.pem");
    alice.run(&["keys", "export", "sm2", "--out", secret.to_str().expect("UTF-8")]).expect_code(0);
    let device = "ab".repeat(32);
    alice.run(&["robot", "authorise", &device]).expect_code(0);
    alice.run(&["robot", "revoke", &device]).expect_code(0);
    let wrong = home.file("wrong", "not the passphrase\n", 0o600);
    site.stop("INT", 30).expect_code(0);
    home.profile("bob").with(&["--passphrase-file", &wrong]).run(&["grant", "list"]);

    let all = lines(&alice, &[]);
    for (action, subject, outcome) in [
        ("create identity", "keys", "done"),
        ("register", own.as_str(), "done"),
        ("deploy", "0x", "done"),
        ("capture start", TOPIC, "begun"),
        ("capture start", TOPIC, "done"),
        ("capture stop", TOPIC, "2 captured"),
        ("refused", "not_granted", "in the minute from"),
        ("grant", &reader, "begun"),
        ("grant", &reader, "done"),
        ("list shared", "records", "done"),
        ("list shared", "records", "3 times again"),
        ("check", &id, "begun"),
        ("check", &id, "done"),
        ("decrypt", &id, "begun"),
        ("decrypt", &id, "done"),
        ("watch", TOPIC, "begun"),
        ("watch", TOPIC, "done"),
        ("unwatch", TOPIC, "begun"),
        ("unwatch", TOPIC, "done"),
        ("revoke", &format!("{reader} epoch 2"), "done"),
        ("export key", "sm2", "begun"),
        ("export key", "sm2", "done"),
        ("authorise device", &device, "begun"),
        ("authorise device", &device, "done"),
        ("revoke device", &device, "begun"),
        ("revoke device", &device, "done"),
        ("unlock", "keyring", "refused"),
    ] {
        assert!(has(&all, action, subject, outcome), "{action} {subject}: {outcome} in {all:#?}");
    }
    for begun in all.iter().filter(|line| line["outcome"] == "begun") {
        let of_it = |line: &&Value| line["action"] == begun["action"] && line["subject"] == begun["subject"];
        let has_ended = |line: &Value| line["outcome"] == "done" || text(line, "outcome").starts_with("failed: ");
        assert!(all.iter().filter(of_it).any(has_ended), "{begun} has not ended: {all:#?}");
    }
    let refused = lines(&alice, &["--action", "refused"]);
    // A line for each minute of the clock, and the three may lie on both sides of a full one.
    let times = |line: &Value| text(line, "outcome").split(' ').find_map(|word| word.parse::<u64>().ok());
    let of_bob = refused.iter().filter(|line| line["profile"] == "bob").filter_map(times).sum::<u64>();
    assert!(of_bob == 3 && refused.len() <= 2, "one line for three refusals: {refused:?}");
    assert!(lines(&alice, &["--by", "bob"]).iter().all(|line| line["profile"] == "bob"));
    assert!(lines(&alice, &["--since", "2099-01-01T00:00:00Z"]).is_empty());
    assert_eq!(alice.json(&["audit", "verify", "--without-heads"])["ok"], true);

    let directory = home.root().join("export");
    let export = ["audit", "export", "--dir", directory.to_str().expect("UTF-8")];
    let exported = || fs::read_to_string(directory.join("audit.jsonl")).expect("written");
    alice.run(&export).expect_code(0);
    assert!(!exported().contains(&reader) && exported().contains(&format!("{}…", &reader[..6])), "redacted");
    assert!(alice.run(&export).expect_code(3).stderr.contains("will not be overwritten"));
    fs::remove_file(directory.join("audit.jsonl")).expect("removed");
    alice.run(&[&export[..], &["--addresses"]].concat()).expect_code(0);
    assert!(exported().contains(&reader) && exported().lines().count() > all.len());
}

fn anchored_heads(authros: &Authros) -> Vec<Value> {
    let records = authros.records(&["records", "list", "--oldest", "--kind", "audit"]);
    records.into_iter().filter(is_verified).collect()
}

/// The body of an owner's own record.
fn body(home: &Home, authros: &Authros, record: &Value) -> Vec<u8> {
    let path = home.root().join("body");
    let out = path.to_str().expect("UTF-8");
    authros.run(&["records", "open", &text(record, "id"), "--out", out]).expect_code(0);
    fs::read(path).expect("written")
}

/// Changes the ledger behind the program's back, returns what the check says, and restores the ledger.
fn forged(home: &Home, authros: &Authros, sql: &str) -> Value {
    let (ledger, kept) = (home.path().join("ledger.db"), home.root().join("kept.db"));
    let connection = rusqlite::Connection::open(&ledger).expect("opens");
    connection.execute_batch("PRAGMA wal_checkpoint(TRUNCATE)").expect("one file");
    fs::copy(&ledger, &kept).expect("copied");
    connection.execute_batch(sql).expect(sql);
    drop(connection);
    let found = authros.with(&["--json"]).run(&["audit", "verify"]).expect_code(TAMPERED).document();
    for end in ["db-wal", "db-shm"] {
        drop(fs::remove_file(ledger.with_extension(end)));
    }
    fs::copy(&kept, &ledger).expect("put back");
    assert_eq!(found["ok"], false, "{found}");
    found
}

#[test]
fn heads_are_anchored_while_the_log_changes_and_find_what_was_cut_off() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "1");
    let site = authros.serve(&home);
    authros.enrol();
    let heads = wait_until(60, "a head is anchored and verified", || {
        Some(anchored_heads(&authros)).filter(|heads| !heads.is_empty())
    });
    // Nothing more is written, so at most one head that was on its way follows; then none.
    let quiet = wait_until(60, "no head without a change", || {
        let before = authros.records(&["records", "list", "--oldest", "--kind", "audit"]).len();
        std::thread::sleep(std::time::Duration::from_secs(3));
        let after = authros.records(&["records", "list", "--oldest", "--kind", "audit"]).len();
        (before == after).then_some(after)
    });
    assert!(quiet >= heads.len());
    site.stop("INT", 30).expect_code(0);

    let site = authros.serve(&home);
    authros.run(&["robot", "authorise", &"ab".repeat(32)]).expect_code(0);
    let heads = wait_until(60, "a restart goes on with the heads", || {
        Some(anchored_heads(&authros)).filter(|heads| heads.len() > quiet)
    });
    let (first, second) = (body(&home, &authros, &heads[quiet - 1]), body(&home, &authros, &heads[quiet]));
    assert!(first.starts_with(b"AuthROS/audit-head/1") && first.len() == 100);
    assert_eq!(first[20..60], second[60..100], "each names the one before");
    let found = authros.json(&["audit", "verify"]);
    assert!(found["ok"] == true && count(&found, "anchored") > 1, "{found}");
    site.stop("INT", 30).expect_code(0);

    let covered = count(&authros.json(&["audit", "verify"]), "covered");
    let edited = forged(&home, &authros, "UPDATE audit SET subject = 'nothing' WHERE line = 2");
    assert_eq!(count(&edited, "broken_line"), 2, "{edited}");
    let removed = forged(&home, &authros, "DELETE FROM audit WHERE line = 3");
    assert_eq!(count(&removed, "broken_line"), 3, "{removed}");
    // The note in the ledger goes with it: the record on the chain still reveals it.
    let cut = format!("DELETE FROM audit WHERE line > {}; DELETE FROM notes WHERE kind = 'audit head'", covered - 3);
    let found = forged(&home, &authros, &cut);
    // Opening the keyring for the check wrote a line in place of those cut off.
    let told = text(&found, "text");
    assert!(told.contains("is missing: a head over") || told.contains("another head was anchored"), "{found}");
    assert!(count(&found, "broken_line") <= covered, "{covered}: {found}");
}

/// A site whose home is a small tmpfs of its own; others reach it through its process.
pub(crate) fn on_small_disk(home: &Home) -> Option<(Running, Authros)> {
    let unshare = support::system_program("unshare")?;
    fs::create_dir(home.path()).expect("a place to mount");
    let mount = "mount -t tmpfs -o size=40m,mode=0700 none \"$0\" 2>/dev/null || exit 99; exec \"$@\"";
    let mut command = Command::new(unshare);
    command.args(["-m", "sh", "-c", mount]).arg(home.path()).arg(env!("CARGO_BIN_EXE_authros"));
    let authros = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_DISK_RESERVE", "0");
    command.args(authros.arguments(&["serve"])).env_clear().envs(authros.variables()).current_dir(home.root());
    let mut site = Running::start(command);
    support::poll(60, || {
        (!site.is_running() || site.stdout().contains("serving") || site.stderr().contains("serving")).then_some(())
    })?;
    if !site.is_running() {
        return None;
    }
    let inside = format!("/proc/{}/root{}", site.id(), home.path().display());
    Some((site, Authros::bare(home.root()).with(&["--home", &inside])))
}

/// Fills the disk to the last byte.
pub(crate) fn fill(path: &Path) {
    let mut file = fs::File::create(path).expect("a file");
    for piece in [1 << 20, 1 << 12, 1] {
        while file.write_all(&vec![7; piece]).is_ok() {}
    }
}

#[test]
fn on_a_full_disk_nothing_is_granted_or_opened_but_a_revoke_goes_through() {
    let home = Home::new();
    let Some((_site, authros)) = on_small_disk(&home) else { skipped!("no tmpfs of its own (unshare -m)") };
    let inside = |name: &str| Path::new(&authros.arguments(&[])[1]).join(name);
    let [alice, bob, carol] = ["alice", "bob", "carol"].map(|name| authros.with(&["--profile", name]));
    let [_, reader, third] = [&alice, &bob, &carol].map(Authros::enrol);
    alice.capture(&[TOPIC], 2);
    let id = text(&alice.records(&["records", "list", "--oldest"])[0], "id");
    alice.run(&["grant", "add", &reader]).expect_code(0);
    bob.run(&["records", "open", &id]).expect_code(0);
    assert_eq!(fs::metadata(inside("reserve")).expect("set aside").len(), 4 << 20);
    alice.run(&["topics", "watch", TOPIC]).expect_code(0);

    fill(&inside("fill"));
    // The ledger first uses up the free space in its own files.
    wait_until(120, "the ledger is full", || (bob.run(&["records", "check", &id]).code == Some(HOME)).then_some(()));
    bob.fails(HOME, &["records", "open", &id]);
    alice.fails(HOME, &["grant", "add", &third]);
    let given = |state: &str| {
        let rows = list(&alice.json(&["grant", "list"]), "grants");
        rows.into_iter().filter(|row| row["state"] == state).map(|row| text(&row, "grantee")).collect::<Vec<_>>()
    };
    assert!(given("active").iter().eq([&reader]), "no line, no grant");

    let revoked = alice.json(&["grant", "end", &reader]);
    assert_eq!(revoked["epoch"], 2, "{revoked}");
    assert!(!inside("reserve").exists(), "out of the reserve");
    assert_eq!((given("active").len(), given("revoked")), (0, vec![reader.clone()]));
    let told = lines(&alice, &["--action", "revoke"]);
    assert!(has(&told, "revoke", &format!("{reader} epoch 2"), "done"), "{told:?}");

    fs::remove_file(inside("fill")).expect("space again");
    alice.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    wait_until(120, "what waited in memory is stored and verified", || {
        let records = alice.records(&["records", "list", "--oldest"]);
        let late = records.iter().any(|record| record["epoch"] == 2);
        (late && records.iter().all(is_verified)).then_some(())
    });
    assert_eq!(alice.json(&["audit", "verify"])["ok"], true);
}

/// An edit of the ledger, and what must be reported about it.
struct Edit {
    column: &'static str,
    sql: &'static str,
    /// The field of a list that it changes; empty if the edit hides the record or changes none.
    field: &'static str,
    /// Whether only someone with a key can see it.
    sealed: bool,
}

const EDITS: [Edit; 23] = [
    edit("captured_at", "UPDATE records SET captured_at = captured_at - 86400000000000 WHERE n = {n}", "captured_at"),
    edit("epoch", "UPDATE records SET epoch = 7 WHERE n = {n}", "epoch"),
    edit("seq", "UPDATE records SET seq = 900 WHERE n = {n}", "seq"),
    Edit { sealed: true, ..edit("bytes", "UPDATE records SET bytes = bytes + 1000 WHERE n = {n}", "bytes") },
    edit("bytes, less than sealed", "UPDATE records SET bytes = 9 WHERE n = {n}", "bytes"),
    Edit { sealed: true, ..edit("simulated", "UPDATE records SET simulated = 0 WHERE n = {n}", "simulated") },
    edit("topic", "UPDATE records SET topic = (SELECT max(key) FROM topics), seq = 90 WHERE n = {n}", ""),
    edit(
        "stream",
        "UPDATE records SET stream = (SELECT max(key) FROM streams WHERE topic != {topic}) WHERE n = {n}",
        "topic",
    ),
    edit(
        "block",
        "UPDATE records SET (tx, block, block_hash) = (SELECT tx, block + 1, block_hash {its_batch}) WHERE n = {n}",
        "block",
    ),
    edit("batches.block", "UPDATE batches SET block = block + 1 WHERE key = (SELECT batch {its_leaf})", "block"),
    edit(
        "batches.block_hash",
        "UPDATE batches SET block_hash = zeroblob(32) WHERE key = (SELECT batch {its_leaf})",
        "",
    ),
    edit("tx", "UPDATE records SET tx = zeroblob(32) WHERE n = {n}", "transaction"),
    edit(
        "block_hash",
        "UPDATE records SET (tx, block, block_hash) = (SELECT tx, block, zeroblob(32) {its_batch}) WHERE n = {n}",
        "",
    ),
    edit("signature", "UPDATE records SET signature = zeroblob(64) WHERE n = {n}", ""),
    edit(
        "recorders.id",
        "UPDATE recorders SET id = zeroblob(length(id)) WHERE key = (SELECT recorder FROM topics WHERE key = {topic})",
        "",
    ),
    edit("deleted_at", "UPDATE records SET deleted_at = 1 WHERE n = {n}", ""),
    edit("streams.kind", "UPDATE streams SET kind = 3 WHERE key = {stream}", "kind"),
    edit(
        "recorders.signer",
        "UPDATE recorders SET signer = zeroblob(32) WHERE key = (SELECT recorder FROM topics WHERE key = {topic})",
        "",
    ),
    Edit {
        sealed: true,
        ..edit("streams.type_name", "UPDATE streams SET type_name = 'a/B' WHERE key = {stream}", "type")
    },
    edit("topics.topic_id", "UPDATE topics SET topic_id = zeroblob(16) WHERE key = {topic}", ""),
    Edit { sealed: true, ..edit("topics.name", "UPDATE topics SET name = '/other' WHERE key = {topic}", "topic") },
    edit("topics.owner", "UPDATE topics SET owner = zeroblob(20) WHERE key = {topic}", "owner"),
    edit(
        "filters",
        "UPDATE filters SET filter = filter + 1000 WHERE record = {n} AND filter = (SELECT min(filter) FROM filters WHERE record = {n})",
        "",
    ),
];

/// Columns that no edit covers, and why not.
const EXEMPT: [(&str, &str); 13] = [
    ("records.n", "the row"),
    ("records.digest", "the record's name: another one names bytes that nobody has"),
    ("records.state", "the ledger's own verdict, which opening and audit find anew"),
    ("records.acknowledged_at", "when this site stored it, which is shown as nobody else's word"),
    ("streams.key", "the row"),
    ("streams.topic", "what `stream` edits, from the other side"),
    ("topics.key", "the row"),
    ("topics.recorder", "what `recorders.id` edits, from the other side"),
    ("topics.name", "an edit by another name"),
    ("topics.keeper", "who anchors, which nobody is shown as evidence"),
    ("recorders.key", "the row"),
    ("filters.filter", "an edit by another name"),
    ("filters.record", "the same pair, from the other side"),
];

/// Every column of the tables that hold records is edited, or exempt: a new one must be considered.
fn expect_every_column(ledger: &rusqlite::Connection) {
    for table in ["records", "streams", "topics", "recorders", "filters"] {
        let mut statement = ledger.prepare(&format!("SELECT name FROM pragma_table_info('{table}')")).expect("a table");
        let columns = statement.query_map([], |row| row.get::<_, String>(0)).expect("columns");
        for column in columns.map(|column| column.expect("a name")) {
            let full = format!("{table}.{column}");
            let edited = EDITS.iter().any(|edit| edit.column == full || (table == "records" && edit.column == column));
            assert!(edited || EXEMPT.iter().any(|(name, _)| *name == full), "nobody has thought of {full}");
        }
    }
}

/// The content of an export to a bag for the topic, without the callers; nothing if the edit leaves nothing to export.
fn exported(authros: &Authros, home: &Home) -> Option<Vec<Value>> {
    support::system_program("rosbag")?;
    let bag = home.root().join("exported.bag");
    drop(fs::remove_file(&bag));
    authros.with(&["--json"]).run(&["bag", "export", "--bag", bag.to_str()?, "--topic", TOPIC]);
    Some(if bag.exists() { support::list_bag(&bag) } else { Vec::new() })
}

const fn edit(column: &'static str, sql: &'static str, field: &'static str) -> Edit {
    Edit { column, sql, field, sealed: false }
}

/// An edit's SQL for one record.
fn statement(edit: &Edit, named: &[(&str, i64)]) -> String {
    let its_leaf = "FROM leaves WHERE record = {n}";
    let its_batch = "FROM leaves JOIN batches ON key = batch WHERE record = {n}";
    let sql = edit.sql.replace("{its_leaf}", its_leaf).replace("{its_batch}", its_batch);
    named.iter().fold(sql, |sql, (name, key)| sql.replace(name, &key.to_string()))
}

/// Whether a document shows the record as verified with another value of the field than the true one.
fn shows_falsely(edit: &Edit, document: &Value, record: &Value) -> bool {
    let verified = is_verified(document) && (document["verdict"].is_null() || document["verdict"] == "verified");
    // Without a key, sealed fields are shown as the ledger's word, and the state says so.
    let told = edit.sealed && document["state"] == "verified, names unchecked" && document["compared"] == "header";
    verified && !told && !edit.field.is_empty() && document[edit.field] != record[edit.field]
}

#[test]
fn no_edited_column_is_shown_as_verified() {
    let home = Home::new();
    let (alice, bob) = (home.profile("alice").with(&["--robots", "1"]), home.profile("bob").with(&["--robots", "1"]));
    alice.enrol();
    let reader = bob.enrol();
    alice.capture(&[TOPIC, "/robot1/camera/compressed"], 1);
    alice.run(&["grant", "add", &reader]).expect_code(0);
    let own = alice.records(&["records", "list", "--oldest"]);
    let shared = bob.records(&["received", "list", "--oldest"]);
    let of = |rows: &[Value]| rows.iter().find(|row| row["topic"] == TOPIC).expect("listed").clone();
    let (record, seen) = (of(&own), of(&shared));
    let id = text(&record, "id");
    assert_eq!((&record["compared"], &seen["compared"]), (&"header".into(), &"head".into()));
    alice.run(&["audit"]).expect_code(0);

    let (ledger, kept) = (home.path().join("ledger.db"), home.root().join("kept.db"));
    let connection = rusqlite::Connection::open(&ledger).expect("opens");
    connection.execute_batch("PRAGMA wal_checkpoint(TRUNCATE)").expect("one file");
    let keys = "SELECT n, stream, topic FROM records WHERE lower(hex(digest)) LIKE ?1";
    let [n, stream, topic]: [i64; 3] = connection
        .query_row(keys, [format!("{id}%")], |row| Ok([row.get(0)?, row.get(1)?, row.get(2)?]))
        .expect("its row");
    expect_every_column(&connection);
    drop((connection, fs::copy(&ledger, &kept).expect("copied")));
    let whole = exported(&bob, &home);
    let find = |rows: Vec<Value>| rows.into_iter().find(|row| row["id"] == id.as_str());
    println!("column | records list | received list | records open | export | audit | audit --deep");
    for edit in &EDITS {
        let column = edit.column;
        let connection = rusqlite::Connection::open(&ledger).expect("opens");
        let sql = statement(edit, &[("{n}", n), ("{stream}", stream), ("{topic}", topic)]);
        connection.execute_batch(&sql).expect(column);
        connection.execute_batch("PRAGMA wal_checkpoint(TRUNCATE)").expect("one file");
        drop(connection);

        let listed = find(alice.records(&["records", "list", "--oldest"]));
        let shared = find(bob.records(&["received", "list", "--oldest"]));
        let opened = bob.with(&["--json"]).run(&["records", "open", &id]);
        let document = opened.document();
        for (face, document, truth) in [
            ("records list", listed.as_ref(), &record),
            ("received list", shared.as_ref(), &seen),
            ("records open", Some(&document), &seen),
        ] {
            let falsely = document.is_some_and(|document| shows_falsely(edit, document, truth));
            assert!(!falsely, "{face} shows an edited {column}: {document:?}");
        }
        let given = exported(&bob, &home).map_or("-".to_owned(), |given| {
            let strange = given.iter().find(|message| whole.as_ref().is_none_or(|whole| !whole.contains(message)));
            assert!(strange.is_none(), "an export gives an edited {column} out: {strange:?}");
            given.len().to_string()
        });
        let (audit, deep) = (alice.run(&["audit"]), alice.run(&["audit", "--deep"]));
        let word = |row: &Option<Value>| row.as_ref().map_or("not there".to_owned(), |row| text(row, "state"));
        let code = |code: Option<i32>| code.map_or("-".to_owned(), |code| code.to_string());
        let (listed, shared) = (word(&listed), word(&shared));
        println!(
            "{column} | {listed} | {shared} | {} | {given} | {} | {}",
            code(opened.code),
            code(audit.code),
            code(deep.code)
        );
        if edit.sealed {
            let told = audit.stdout.contains("were not compared") || edit.field == "bytes";
            assert!(
                listed != "verified" && shared != "verified" && opened.code == Some(TAMPERED) && told,
                "{column}: {opened} {audit}"
            );
        } else {
            // Signatures are not shown anywhere: opening, exporting and re-hashing check them.
            let shallow = if column == "signature" && opened.code == Some(TAMPERED) { 0 } else { TAMPERED };
            assert_eq!((audit.code, deep.code), (Some(shallow), Some(TAMPERED)), "{column}: {audit} {deep}");
        }
        for end in ["db-wal", "db-shm"] {
            drop(fs::remove_file(ledger.with_extension(end)));
        }
        fs::copy(&kept, &ledger).expect("put back");
    }
    let renamed = format!("UPDATE topics SET name = '/other' WHERE key = {topic}");
    rusqlite::Connection::open(&ledger).and_then(|ledger| ledger.execute_batch(&renamed)).expect("renamed");
    let site = alice.serve(&home);
    alice.run(&["audit"]).expect_code(TAMPERED);
    site.stop("INT", 30).expect_code(0);
}
