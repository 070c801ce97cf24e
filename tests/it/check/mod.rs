//! The store as a whole: its audit finds every kind of damage, the doctor says what to do, a stranger checks an
//! exported record, a backup becomes a home again.
#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking, the long form prints its figures"
)]

use crate::support;

mod audit;
mod backup;
mod doctor;
mod killed_backup;
mod verify;

use std::fs;
use std::path::PathBuf;

use serde_json::Value;
use support::{Authros, Home, is_verified, wait_until};

/// The exit codes that are expected here.
const INPUT: i32 = 3;
const UNREACHABLE: i32 = 4;
const REFUSED: i32 = 5;
const TAMPERED: i32 = 6;
const INCOMPLETE: i32 = 8;

/// A database of a home that nobody has open.
fn database(home: &Home, name: &str) -> rusqlite::Connection {
    let connection = rusqlite::Connection::open(home.path().join(name)).expect("opens");
    connection.execute_batch("PRAGMA wal_checkpoint(TRUNCATE)").expect("one file");
    connection
}

/// Damages a database behind the program's back with `damage`, returns what `look` sees, and restores the database.
fn damaged<T>(home: &Home, name: &str, damage: impl FnOnce(&rusqlite::Connection), look: impl FnOnce() -> T) -> T {
    let (path, kept) = (home.path().join(name), home.root().join("kept.db"));
    let connection = database(home, name);
    fs::copy(&path, &kept).expect("copied");
    damage(&connection);
    drop(connection);
    let seen = look();
    for end in ["-wal", "-shm"] {
        drop(fs::remove_file(PathBuf::from(format!("{}{end}", path.display()))));
    }
    fs::copy(&kept, &path).expect("put back");
    seen
}

/// All records of the profile, once all are verified and there are enough.
fn all_verified(authros: &Authros, least: usize) -> Vec<Value> {
    wait_until(120, "everything is verified", || {
        let records = authros.records(&["records", "list", "--oldest"]);
        let verified = records.iter().all(is_verified);
        (verified && records.len() >= least).then_some(records)
    })
}
