//! A program that is older than a home: a file of a later version is named, and no file of the home changes, even if a
//! crash left logs beside the databases.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::authros::files_below;
use crate::support::{Home, wait_until};

const INPUT: i32 = 3;
const INCOMPLETE: i32 = 8;

/// Files and the version that a later program writes into each.
const LATER: [(&str, &str); 2] =
    [("ledger.db", "PRAGMA user_version = 900"), ("chain/chain.db", "UPDATE chain SET version = 900")];

/// Every file with its content; except the index that SQLite keeps of a log, and an empty log.
fn files(home: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let is_kept = |path: &PathBuf| path.is_file() && !path.to_string_lossy().ends_with("-shm");
    let read = |path: PathBuf| (path.clone(), std::fs::read(&path).expect("read"));
    let all = files_below(home).into_iter().filter(is_kept).map(read);
    all.filter(|(path, bytes)| !(bytes.is_empty() && path.to_string_lossy().ends_with("-wal"))).collect()
}

fn copy(from: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-a").arg(from).arg(to).status();
    assert!(copied.is_ok_and(|status| status.success()), "the home is copied");
}

#[test]
fn an_older_program_is_refused_in_words_and_changes_nothing() {
    let (stopped, killed) = (Home::new(), Home::new());
    let authros = stopped.authros().with(&["--robots", "1"]);
    let site = authros.serve(&stopped);
    authros.run(&["topics", "watch", "/robot1/odom"]).expect_code(0);
    wait_until(60, "records are verified", || (authros.json(&["status"])["life"]["verified"] != 0).then_some(()));
    // As after a crash: the newest data of each database is in its log.
    site.stop("KILL", 20);
    copy(&stopped.path(), &killed.path());
    authros.run(&["topics", "unwatch", "/robot1/odom"]).expect_code(0);
    authros.run(&["audit"]).expect_code(0);

    for home in [&stopped, &killed] {
        for (name, later) in LATER {
            let place = Home::new();
            copy(&home.path(), &place.path());
            let path = place.path().join(name);
            // A later program that was killed too: its data stays in the log.
            let database = rusqlite::Connection::open(&path).expect("opens");
            database
                .set_db_config(rusqlite::config::DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)
                .expect("the log stays");
            database.execute_batch(later).expect("a later version");
            drop(database);
            let before = files(&place.path());
            if name == "ledger.db" {
                let told = place.authros().with(&["--robots", "0"]).run(&["doctor"]).expect_code(INCOMPLETE).stdout;
                assert!(told.contains("use a newer authros") && !told.contains("backup"), "{told}");
            }
            for command in [&["status"][..], &["records", "list", "--oldest"], &["audit"], &["serve"]] {
                let message = place.authros().with(&["--robots", "0"]).fails(INPUT, command);
                assert!(message.contains("900") && message.contains("use a newer authros"), "{command:?}: {message}");
                assert!(message.contains(name.rsplit('/').next().expect("a name")), "it is named: {message}");
                let after = files(&place.path());
                let changed: Vec<_> = before.keys().chain(after.keys()).collect();
                let changed: Vec<_> =
                    changed.into_iter().filter(|path| before.get(*path) != after.get(*path)).collect();
                assert!(changed.is_empty(), "{command:?} with a later {name} changed {changed:?}");
            }
        }
    }
}
