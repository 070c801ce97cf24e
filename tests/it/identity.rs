//! Identities: created once, registered once, kept in files that only their owner can read.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use support::{Home, authros::files_below, text};

fn mode(path: &Path) -> u32 {
    fs::metadata(path).expect("it exists").permissions().mode() & 0o777
}

#[test]
fn an_identity_is_made_shown_and_registered() {
    let home = Home::new();
    let alice = home.profile("alice").with(&["--robots", "0"]);
    home.profile("carol").with(&["--robots", "0"]).json(&["identity", "create"]);
    let none = alice.json(&["identity", "show"]);
    assert_eq!((&none["profile"], &none["exists"], &none["address"]), (&"alice".into(), &false.into(), &().into()));

    let made = alice.json(&["identity", "create"]);
    assert_eq!(made["exists"], true);
    let address = text(&made, "address");
    assert!(address.starts_with("0x") && address.len() == 42, "{made}");
    assert_eq!(text(&made, "signing_key").len(), 128, "x and y in hex");
    assert_ne!(made["signing_key"], made["envelope_key"], "signing and reading are different keys");

    let registered = alice.json(&["identity", "register"]);
    assert_eq!((&registered["registered"], &registered["epoch"]), (&true.into(), &1.into()), "{registered}");
    let shown = alice.json(&["identity", "show"]);
    for field in ["address", "signing_key", "envelope_key", "registered", "epoch"] {
        assert_eq!(shown[field], registered[field], "{field}");
    }
    assert_eq!(
        alice.json(&["identity", "register"])["address"].as_str(),
        Some(&*address),
        "registering again changes nothing"
    );
}

#[test]
fn a_second_identity_for_the_same_profile_is_refused_and_the_first_stays() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    let first = authros.json(&["identity", "create"]);
    let outcome = authros.run(&["identity", "create"]);
    assert!(matches!(outcome.code, Some(3 | 5)), "{outcome}");
    assert_eq!(authros.json(&["identity", "show"])["address"], first["address"]);
}

#[test]
fn profiles_of_one_home_are_different_accounts() {
    let home = Home::new();
    let alice = home.profile("alice").with(&["--robots", "0"]).enrol();
    let bob = home.profile("bob").with(&["--robots", "0"]).enrol();
    assert_ne!(alice, bob);
    let listed = home.profile("bob").run(&["identity", "list"]).expect_code(0);
    let has = |begin: &str, address: &str| {
        listed.stdout.lines().any(|line| line.starts_with(begin) && line.contains(address))
    };
    assert!(has("  alice ", &alice) && has("* bob ", &bob), "{listed}");
}

#[test]
fn what_is_secret_at_rest_is_readable_by_its_owner_alone() {
    let home = Home::new();
    let outcome = home.authros().with(&["--robots", "0"]).run(&["identity", "create"]).expect_code(0);
    assert!(outcome.stderr.contains("passphrase"), "says where the passphrase is: {outcome}");
    let directory = home.path().join("profiles/default");
    assert_eq!(mode(&directory.join("keyring")), 0o600);
    assert_eq!(mode(&directory.join("passphrase")), 0o600);
    assert_eq!(mode(&home.path()), 0o700);
    let passphrase = fs::read_to_string(directory.join("passphrase")).expect("text");
    assert!(passphrase.trim().len() >= 20, "long enough to be random");
    for path in files_below(&home.path()).iter().filter(|path| !path.ends_with("passphrase")) {
        let bytes = fs::read(path).unwrap_or_default();
        assert!(!support::holds(&bytes, passphrase.trim().as_bytes()), "the passphrase is also in {}", path.display());
    }
}

#[test]
fn a_passphrase_of_ones_own_is_needed_again_and_written_nowhere() {
    let home = Home::new();
    let right = home.file("right", "correct horse battery\n", 0o600);
    let wrong = home.file("wrong", "correct horse bakery\n", 0o600);
    let carol = home.profile("carol").with(&["--robots", "0"]);
    carol.json(&["identity", "create", "--passphrase-file", &right]);
    assert!(!home.path().join("profiles/carol/passphrase").exists(), "no copy of it");

    let before = fs::read(home.path().join("profiles/carol/keyring")).expect("a keyring");
    let refused = carol.run(&["keys", "rotate", "--passphrase-file", &wrong]);
    assert!(matches!(refused.code, Some(3 | 5)), "{refused}");
    let missing = carol.run(&["keys", "rotate"]);
    assert!(matches!(missing.code, Some(2 | 3 | 5)), "never asks without a terminal: {missing}");
    assert_eq!(fs::read(home.path().join("profiles/carol/keyring")).expect("a keyring"), before, "and changes nothing");
    assert_eq!(carol.json(&["identity", "register", "--passphrase-file", &right])["registered"], true);
}
