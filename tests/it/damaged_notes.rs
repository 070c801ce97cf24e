//! A damaged note is named by each command that needs it and by the doctor; it is never an empty list, and nothing takes its place.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use support::{Home, list, text, wait_until};

const TAMPERED: i32 = 6;
const ACCOUNT: &str = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed";

fn ledger(home: &Home) -> rusqlite::Connection {
    rusqlite::Connection::open(home.path().join("ledger.db")).expect("opens")
}

fn damage(home: &Home, kind: &str) {
    let cut = "UPDATE notes SET value = substr(value, 1, length(value) - 2) WHERE kind = ?1";
    assert_eq!(ledger(home).execute(cut, [kind]), Ok(1), "{kind}");
}

fn noted(home: &Home, kind: &str) -> String {
    ledger(home).query_row("SELECT value FROM notes WHERE kind = ?1", [kind], |row| row.get(0)).expect("a note")
}

#[test]
fn a_damaged_note_is_named_and_is_not_taken_for_an_empty_one() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    authros.json(&["contacts", "add", "bob", ACCOUNT]);
    authros.json(&["topics", "watch", "/odom"]);
    damage(&home, "contacts");
    let left = noted(&home, "contacts");
    for command in [&["contacts", "list"][..], &["contacts", "add", "carol", ACCOUNT], &["grant", "end", "bob"]] {
        let message = authros.fails(TAMPERED, command);
        assert!(message.contains("the note about the address book"), "{command:?}: {message}");
        assert!(message.contains("ledger.db") && message.contains("restore the last backup"), "{message}");
    }
    assert_eq!(noted(&home, "contacts"), left, "nothing took its place");
    let doctor = authros.with(&["--json"]).run(&["doctor"]);
    let checks = list(&doctor.document(), "checks");
    let found = checks.iter().find(|check| check["name"] == "notes").expect("a check");
    assert!(doctor.code != Some(0) && text(found, "detail").contains("the address book"), "{doctor}");

    // A watch list that cannot be read captures nothing, and that is said at once.
    damage(&home, "watched");
    let site = authros.spawn(&["serve"]);
    let said = || site.stderr().contains("what 'default' watches is not captured: the note about the watched topics");
    wait_until(60, "the watch list is named", || said().then_some(()));
    site.stop("INT", 30);
}
