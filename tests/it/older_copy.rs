//! Parts of a home that are older than others, or gone: the embedded chain and the ledger of an old backup under a newer
//! keyring, and a keyring whose ledger is lost. Nothing is sealed for nobody, given to a reader who was revoked, or bound
//! to a second contract.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::{Authros, Home, is_verified, list, text, two_profiles, wait_until};

const REFUSED: i32 = 5;
const TAMPERED: i32 = 6;
/// A secret key in the form that `keys load --sm2` reads.
const SIGNING_KEY: &str = "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8";

fn copy_keyring(from: &Path, to: &Path, profile: &str) {
    let at = |home: &Path| home.join("profiles").join(profile).join("keyring");
    fs::copy(at(from), at(to)).expect("the keyring is copied");
}

fn health(authros: &Authros, part: &str) -> String {
    let parts = list(&authros.json(&["status"]), "health");
    let found = parts.iter().find(|one| one["part"] == part);
    found.map(|one| text(one, "text")).unwrap_or_default()
}

fn epochs(authros: &Authros) -> Vec<u64> {
    list(&authros.json(&["keys", "list"]), "epochs").iter().filter_map(|epoch| epoch["epoch"].as_u64()).collect()
}

#[test]
fn a_newer_keyring_brings_an_older_chain_to_its_keys_and_gives_nothing_to_a_revoked_reader() {
    let two = two_profiles(1);
    two.alice.capture(&["/robot1/odom"], 2);
    two.alice.json(&["grant", "add", &two.bob_address]);
    let secret = two.home.file("secret", "a passphrase of its own\n", 0o600);
    let backup = two.home.root().join("old.backup").to_str().expect("UTF-8").to_owned();
    two.alice.json(&["backup", "create", &backup, "--passphrase-file", &secret]);

    two.alice.json(&["grant", "end", &two.bob_address]);
    let key = two.home.file("sm2", SIGNING_KEY, 0o600);
    two.alice.run(&["keys", "load", "--sm2", &key]).expect_code(0);
    two.alice.json(&["keys", "rotate"]);
    let newest = two.alice.json(&["keys", "list"]);
    two.site.stop("TERM", 30).expect_code(0);

    let home = Home::new();
    let alice = home.profile("alice").with(&["--robots", "1"]);
    alice.json(&["backup", "restore", &backup, "--passphrase-file", &secret]);
    copy_keyring(&two.home.path(), &home.path(), "alice");
    copy_keyring(&two.home.path(), &home.path(), "bob");
    for name in ["alice", "bob"] {
        let file = format!("profiles/{name}/passphrase");
        fs::copy(two.home.path().join(&file), home.path().join(&file)).expect("the passphrase is copied");
    }
    let site = alice.serve(&home);
    let bob = home.profile("bob").with(&["--robots", "1"]);

    // What is captured counts: the keyring's key is the registered one again.
    let captured = alice.capture(&["/robot1/odom"], 2);
    assert_eq!(captured["verified"], 2, "{captured}");
    let shown = alice.json(&["identity", "show"]);
    assert_eq!((&shown["registered"], &shown["signing_key"]), (&Value::from(true), &newest["signing_key"]), "{shown}");
    alice.json(&["identity", "register"]);

    // The revocation is lost with the chain. It is said, and until the owner has decided nobody is given a key.
    let told = health(&alice, "keys");
    assert!(told.contains("the chain has epoch 1 of 'alice' and had epoch 3 before"), "{told}");
    assert!(told.contains("authros grant list") && told.contains("authros keys rotate"), "{told}");
    let refused = alice.fails(REFUSED, &["grant", "add", &two.bob_address]);
    assert!(refused.contains("had epoch 3 before"), "{refused}");
    let readable = |reader: &Authros| {
        let records = reader.records(&["received", "list", "--oldest"]);
        records.iter().filter(|record| reader.run(&["records", "open", &text(record, "id")]).code == Some(0)).count()
    };
    assert_eq!(readable(&bob), 2, "what was sealed before the revocation, and no more");

    alice.json(&["grant", "end", &two.bob_address]);
    assert_eq!(epochs(&alice), [1, 2, 3, 4], "no epoch is begun twice");
    assert_eq!(health(&alice, "keys"), "");
    alice.capture(&["/robot1/odom"], 2);
    assert_eq!(readable(&bob), 0, "a reader who was revoked is refused");
    let own = alice.records(&["records", "list", "--oldest"]);
    assert!(own.len() == 6 && own.iter().all(is_verified), "{own:?}");
    for record in &own {
        assert_eq!(alice.json(&["records", "open", &text(record, "id")])["verdict"], "verified", "{record}");
    }
    alice.run(&["audit", "--deep"]).expect_code(0);
    site.stop("TERM", 30).expect_code(0);
}

#[test]
fn keys_that_had_a_contract_on_this_chain_get_no_second_one() {
    let home = Home::new();
    let alice = home.profile("alice").with(&["--robots", "1"]);
    alice.enrol();
    alice.capture(&["/robot1/odom"], 2);
    let before = alice.json(&["chain", "status"]);
    let contract = text(&before, "contract");
    for name in ["ledger.db", "ledger.db-wal", "ledger.db-shm"] {
        // The last two are there only after a crash.
        drop(fs::remove_file(home.path().join(name)));
    }

    let doctor = alice.run(&["doctor"]);
    assert!(doctor.code != Some(0) && doctor.stdout.contains("ledger.db is gone"), "{doctor}");
    for command in [&["identity", "register"][..], &["capture", "--topic", "/robot1/odom", "--count", "1"]] {
        let message = alice.fails(REFUSED, command);
        assert!(message.contains(&contract) && message.contains("--contract"), "{command:?}: {message}");
        assert!(message.contains("nothing was deployed"), "{message}");
    }

    // A new store began in its place, and says so until it has a contract.
    for command in ["doctor", "status"] {
        let said = alice.run(&[command]);
        assert!(said.code != Some(0), "{command}: {said}");
        assert!(said.stdout.contains("ledger.db was gone at 20"), "{command}: {said}");
    }

    let named = alice.with(&["--contract", &contract]);
    let shown = named.json(&["identity", "register"]);
    assert_eq!((&shown["registered"], &shown["epoch"]), (&Value::from(true), &Value::from(1)), "{shown}");
    // From here on the new ledger knows it.
    assert_eq!(text(&alice.json(&["chain", "status"]), "contract"), contract);
    assert!(health(&alice, "store").starts_with("rows and ciphertext"), "it has one");
    alice.capture(&["/robot1/odom"], 2);
    // The records of the lost ledger are lost, and the audit says so.
    let audit = alice.run(&["audit"]).expect_code(TAMPERED);
    assert!(audit.stdout.contains("MISSING: batch") && audit.stdout.contains("does not have it"), "{audit}");
}

#[test]
fn a_keyring_that_is_gone_or_another_accounts_is_named_and_nothing_takes_its_place() {
    let home = Home::new();
    let alice = home.profile("alice").with(&["--robots", "1"]);
    let address = alice.enrol();
    home.profile("bob").with(&["--robots", "1"]).enrol();
    alice.capture(&["/robot1/odom"], 2);
    let (folder, kept) = (home.path().join("profiles/alice"), home.root().join("kept"));
    let refused = |words: &str| {
        for command in
            [&["identity", "create"][..], &["capture", "--topic", "/robot1/odom", "--count", "1"], &["serve"]]
        {
            let message = alice.fails(REFUSED, command);
            assert!(message.contains(words) && message.contains(&address), "{command:?}: {message}");
        }
        let doctor = alice.run(&["doctor"]);
        assert!(doctor.code != Some(0) && doctor.stdout.contains(words), "{doctor}");
        let status = alice.run(&["status"]);
        assert!(status.code != Some(0), "{status}");
    };
    let words = folder.join("passphrase");
    let before = fs::read(&words).expect("a passphrase");
    fs::rename(folder.join("keyring"), home.root().join("keyring")).expect("moved away");
    refused("is gone");
    assert_eq!(fs::read(&words).expect("it may open the keyring once that is back"), before);
    fs::rename(home.root().join("keyring"), folder.join("keyring")).expect("put back");
    fs::rename(&folder, &kept).expect("moved away");
    refused("is gone");
    assert!(!folder.join("passphrase").exists(), "no passphrase of keys that were not made");
    fs::create_dir_all(&folder).expect("made");
    fs::set_permissions(&folder, fs::metadata(&kept).expect("there").permissions()).expect("as it was");
    for name in ["keyring", "passphrase"] {
        fs::copy(home.path().join("profiles/bob").join(name), folder.join(name)).expect("copied");
    }
    refused("is the keyring of account");
    fs::remove_dir_all(&folder).expect("removed");
    fs::rename(&kept, &folder).expect("put back");
    alice.run(&["doctor"]).expect_code(0);
    for record in alice.records(&["records", "list", "--oldest"]) {
        assert_eq!(alice.json(&["records", "open", &text(&record, "id")])["verdict"], "verified", "{record}");
    }
}

#[test]
fn what_a_restored_home_anchored_and_lost_is_missing() {
    let home = Home::new();
    let alice = home.profile("alice").with(&["--robots", "1"]);
    alice.enrol();
    alice.capture(&["/robot1/odom"], 2);
    let secret = home.file("secret", "a passphrase of its own\n", 0o600);
    let backup = home.root().join("a.backup").to_str().expect("UTF-8").to_owned();
    alice.json(&["backup", "create", &backup, "--passphrase-file", &secret]);
    let place = Home::new();
    let restored = place.profile("alice").with(&["--robots", "1"]);
    restored.json(&["backup", "restore", &backup, "--passphrase-file", &secret]);
    let ledger = place.path().join("ledger.db");
    let before = fs::read(&ledger).expect("a store");
    // Blocks of the second in which it was restored may be of the home before.
    std::thread::sleep(std::time::Duration::from_secs(7));
    restored.capture(&["/robot1/odom"], 2);
    restored.run(&["audit"]).expect_code(0);
    for name in ["ledger.db-wal", "ledger.db-shm"] {
        drop(fs::remove_file(place.path().join(name)));
    }
    fs::write(&ledger, before).expect("an older one");
    let audit = restored.run(&["audit"]).expect_code(TAMPERED);
    assert!(audit.stdout.contains("MISSING: batch") && audit.stdout.contains("does not have it"), "{audit}");
}

#[test]
fn what_the_former_key_signed_is_anchored_before_a_newer_key_is_registered_again() {
    let two = two_profiles(1);
    let alice = &two.alice;
    alice.capture(&["/robot1/odom"], 2);
    // While nothing can be anchored, records wait; the backup has them like that.
    let boss = two.home.profile("default");
    boss.json(&["chain", "admin", "pause", "--for", "1h"]);
    alice.json(&["topics", "watch", "/robot1/odom"]);
    wait_until(60, "some records wait", || (alice.records(&["records", "list", "--oldest"]).len() >= 8).then_some(()));
    alice.json(&["topics", "unwatch", "/robot1/odom"]);
    let secret = two.home.file("secret", "a passphrase of its own\n", 0o600);
    let backup = two.home.root().join("waiting.backup").to_str().expect("UTF-8").to_owned();
    alice.json(&["backup", "create", &backup, "--passphrase-file", &secret]);
    boss.json(&["chain", "admin", "resume"]);
    let key = two.home.file("sm2", SIGNING_KEY, 0o600);
    alice.run(&["keys", "load", "--sm2", &key]).expect_code(0);
    let newest = alice.json(&["keys", "list"]);
    two.site.stop("TERM", 30).expect_code(0);

    let home = Home::new();
    let restored = home.profile("alice").with(&["--robots", "1"]);
    restored.json(&["backup", "restore", &backup, "--passphrase-file", &secret]);
    for name in ["alice", "default"] {
        copy_keyring(&two.home.path(), &home.path(), name);
        let file = format!("profiles/{name}/passphrase");
        fs::copy(two.home.path().join(&file), home.path().join(&file)).expect("the passphrase is copied");
    }
    let site = restored.serve(&home);
    let waiting = restored.records(&["records", "list", "--oldest"]);
    assert!(waiting.iter().filter(|record| !is_verified(record)).count() >= 6, "{waiting:?}");
    home.profile("default").json(&["chain", "admin", "resume"]);
    wait_until(120, "all of them are verified", || {
        restored.records(&["records", "list", "--oldest"]).iter().all(is_verified).then_some(())
    });
    wait_until(120, "the newer key is registered", || {
        let shown = restored.json(&["identity", "show"]);
        (shown["registered"] == true && shown["signing_key"] == newest["signing_key"]).then_some(())
    });
    restored.capture(&["/robot1/odom"], 2);
    restored.run(&["audit", "--deep"]).expect_code(0);
    site.stop("TERM", 30).expect_code(0);
}
