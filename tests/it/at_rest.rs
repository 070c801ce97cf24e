//! A home at rest: commands that only read leave every file unchanged, to the byte and to its time; those that open the
//! keyring to do so leave a line in the audit log.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::SystemTime;

use crate::support;

use support::authros::files_below;
use support::{Home, wait_until};

type Files = BTreeMap<PathBuf, (Vec<u8>, SystemTime)>;

/// Every file with its content; except the index that SQLite keeps of a log while it is open, and an empty log.
fn files(home: &Home) -> Files {
    let read = |path: PathBuf| {
        let changed = std::fs::metadata(&path).and_then(|about| about.modified()).expect("a time");
        (path.clone(), (std::fs::read(&path).expect("read"), changed))
    };
    let is_kept = |path: &PathBuf| path.is_file() && !path.to_string_lossy().ends_with("-shm");
    let all = files_below(&home.path()).into_iter().filter(is_kept).map(read);
    all.filter(|(path, (bytes, _))| !(bytes.is_empty() && path.to_string_lossy().ends_with("-wal"))).collect()
}

/// What has changed, in words.
fn changes(before: &Files, after: &Files) -> Vec<String> {
    let all: std::collections::BTreeSet<&PathBuf> = before.keys().chain(after.keys()).collect();
    let word = |path: &PathBuf| match (before.get(path), after.get(path)) {
        (Some(one), Some(other)) if one == other => None,
        (Some((one, _)), Some((other, _))) if one == other => Some("its time"),
        (Some(_), Some(_)) => Some("its bytes"),
        (None, _) => Some("is new"),
        (_, None) => Some("is gone"),
    };
    all.into_iter().filter_map(|path| Some(format!("{}: {}", path.display(), word(path)?))).collect()
}

#[test]
fn who_only_looks_writes_nothing() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&["/robot1/odom"], 3);
    let id = support::text(&authros.records(&["records", "list", "--oldest"])[0], "id");
    authros.run(&["audit"]).expect_code(0);
    let looking: [&[&str]; 6] = [
        &["status"],
        &["records", "list", "--oldest"],
        &["records", "show", &id],
        &["topics", "list"],
        &["chain", "status"],
        &["audit"],
    ];
    // What the short runs left open is settled by a longer one: any run may fetch proofs of the chain while it lasts.
    let site = authros.serve(&home);
    wait_until(60, "all proofs are kept", || Some(()).filter(|()| unproven(&home) == 0));
    site.stop("TERM", 20).expect_code(0);
    for arguments in looking {
        authros.run(arguments).expect_code(0);
    }
    let mut written = Vec::new();
    for arguments in looking {
        let before = files(&home);
        authros.run(arguments).expect_code(0);
        written.extend(changes(&before, &files(&home)).into_iter().map(|change| format!("{arguments:?}: {change}")));
    }
    assert!(written.is_empty(), "{}", written.join("\n"));

    // Opening the keyring to read is noted in the audit log, and nothing else is.
    for opening in [&["grant", "list"], &["received", "list"]] {
        let before = rows(&home);
        authros.run(opening).expect_code(0);
        let after = rows(&home);
        let grown: Vec<&String> = after.keys().filter(|table| after.get(*table) != before.get(*table)).collect();
        assert_eq!(grown, ["audit"], "{opening:?}");
    }
}

fn ledger(home: &Home) -> rusqlite::Connection {
    rusqlite::Connection::open(home.path().join("ledger.db")).expect("the ledger")
}

/// How many batches' proofs are still to be fetched.
fn unproven(home: &Home) -> u64 {
    let batches = "SELECT count(*) FROM batches WHERE proof IS NULL";
    ledger(home).query_row(batches, [], |row| row.get(0)).map(i64::cast_unsigned).expect("counted")
}

/// How many rows each table of the ledger has.
fn rows(home: &Home) -> BTreeMap<String, u64> {
    let ledger = ledger(home);
    let mut names = ledger.prepare("SELECT name FROM sqlite_master WHERE type = 'table'").expect("asked");
    let names = names.query_map([], |row| row.get::<_, String>(0)).expect("asked");
    let count = |name: &str| {
        let rows: i64 =
            ledger.query_row(&format!("SELECT count(*) FROM {name}"), [], |row| row.get(0)).expect("counted");
        rows.cast_unsigned()
    };
    names.map(|name| name.expect("a name")).map(|name| (name.clone(), count(&name))).collect()
}
