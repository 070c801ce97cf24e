//! Several operators at one site: each with a key of its own, named in the audit log, and ended at once.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use serde_json::Value;
use support::authros::files_below;
use support::{Authros, Home, list, text};

const REFUSED: i32 = 5;
const UNREACHABLE: i32 = 4;
const TOPIC: &str = "/robot1/odom";

/// The command line of an operator, who has the words for the key.
fn operator(of: &Authros, home: &Home, name: &str) -> Authros {
    let (file, words) = (home.root().join(format!("{name}.operator")), home.root().join(format!("{name}.words")));
    of.with(&["--operator", file.to_str().expect("UTF-8"), "--passphrase-file", words.to_str().expect("UTF-8")])
}

fn audited(authros: &Authros, filter: &[&str]) -> Vec<Value> {
    list(&authros.json(&[&["audit", "list", "--limit", "1000"], filter].concat()), "audit")
}

#[test]
fn who_did_what_is_in_the_log_by_operator() {
    let home = Home::new();
    let alice = home.profile("alice");
    let before = alice.enrol();
    let site = alice.with(&["--robots", "1"]).serve(&home);
    let reader = home.profile("carol").enrol();
    let words = |name: &str| home.file(&format!("{name}.words"), format!("the words of {name}\n"), 0o600);
    let (of_bob, of_eve) = (words("bob"), words("eve"));
    let added =
        alice.json(&["operators", "add", "bob", "--rights", "look,capture", "--operator-passphrase-file", &of_bob]);
    assert_eq!(list(&added, "operators")[0]["rights"], "look,capture");
    // Eve's key is made by herself, in a home that is not there.
    let made = Home::new();
    let out = home.root().join("eve.operator");
    let own = made.authros().json(&[
        "operators",
        "key",
        "eve",
        "--out",
        out.to_str().expect("UTF-8"),
        "--operator-passphrase-file",
        &of_eve,
    ]);
    let public = text(&own, "key");
    let added = alice.json(&["operators", "add", "eve", "--rights", "grant,look", "--until", "2h", "--key", &public]);
    let rows = list(&added, "operators");
    assert!(rows.len() == 2 && rows.iter().all(|row| row["state"] == "stands"), "{rows:?}");
    let secret = fs::read(home.root().join("bob.operator")).expect("the file");
    assert!(
        files_below(&home.path()).iter().all(|path| !fs::read(path).is_ok_and(|bytes| bytes == secret)),
        "not in the home"
    );

    let (bob, eve) = (operator(&alice, &home, "bob"), operator(&alice, &home, "eve"));
    bob.capture(&[TOPIC], 2);
    bob.run(&["topics", "watch", TOPIC]).expect_code(0);
    alice.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    bob.fails(REFUSED, &["grant", &reader]);
    eve.json(&["grant", &reader]);
    eve.fails(REFUSED, &["topics", "watch", TOPIC]);
    assert_eq!(text(&eve.json(&["identity", "show"]), "address"), before, "she acts for alice");
    alice.json(&["operators", "remove", "eve"]);
    assert!(eve.fails(REFUSED, &["revoke", &reader]).contains("is no operator"));

    let deeds = |name: &str| {
        let lines = audited(&alice, &["--by-operator", name]);
        assert!(lines.iter().all(|line| line["profile"] == "alice" && line["operator"] == name), "{lines:?}");
        let mut deeds: Vec<String> = lines.iter().rev().map(|line| text(line, "action")).collect();
        deeds.retain(|deed| deed != "refused");
        deeds
    };
    let expected = ["capture start", "capture start", "capture stop", "watch", "watch"];
    assert_eq!(deeds("bob"), expected, "begun and done, and told");
    assert_eq!(deeds("eve"), ["grant", "grant"]);
    let of_alice = audited(&alice, &["--by", "alice", "--action", "unwatch"]);
    assert!(
        of_alice.len() == 2 && of_alice.iter().all(|line| line.get("operator").is_none()),
        "the owner's own: {of_alice:?}"
    );
    assert_eq!(audited(&alice, &["--by", "alice/bob", "--action", "watch"]).len(), 2);
    let added = audited(&alice, &["--action", "add operator"]);
    assert!(added.iter().any(|line| text(line, "subject").starts_with("eve: look,grant until")), "{added:?}");

    site.stop("INT", 30).expect_code(0);
    assert!(bob.fails(UNREACHABLE, &["uploads", "list"]).contains("opens none"), "a key of an operator opens no home");
    assert_eq!(alice.json(&["audit", "verify"])["ok"], true);
}

#[test]
fn a_site_can_require_to_know_who_asks() {
    let home = Home::new();
    let alice = home.profile("alice").with_variable("AUTHROS_OPERATORS_REQUIRED", "yes");
    alice.enrol();
    let site = alice.serve(&home);
    let words = home.file("bob.words", "the words of bob\n", 0o600);
    alice.json(&["operators", "add", "bob", "--rights", "look", "--operator-passphrase-file", &words]);
    // The passphrase is moved away from the keyring, as it has to be for this to mean anything.
    let beside = home.path().join("profiles").join("alice").join("passphrase");
    let away = home.file("alice.words", fs::read(&beside).expect("stored"), 0o600);
    fs::remove_file(&beside).expect("moved");
    assert!(alice.fails(REFUSED, &["uploads", "list"]).contains("operators.required"));
    assert!(
        alice.with(&["--passphrase-file", &words]).fails(REFUSED, &["uploads", "list"]).contains("wrong passphrase")
    );
    alice.with(&["--passphrase-file", &away]).json(&["uploads", "list"]);
    operator(&alice, &home, "bob").json(&["uploads", "list"]);
    site.stop("INT", 30).expect_code(0);
}
