//! Keys that change while others rely on them: readers open what they were granted, robots continue automatically.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use crate::support::{Authros, Home, Running, count, free_port, is_verified, list, text, two_profiles, wait_until};
use serde_json::Value;

/// d_C from a file, as 64 hex characters.
fn signing_key(home: &Home, digit: char) -> String {
    home.file(&format!("sm2-{digit}"), digit.to_string().repeat(64), 0o600)
}

fn opens(reader: &Authros, record: &Value) {
    let id = text(record, "id");
    let opened = reader.json(&["records", "open", &id]);
    assert_eq!(opened["verdict"], "verified", "{opened}");
}

#[test]
fn readers_open_old_and_new_records_after_a_new_signing_key() {
    let two = two_profiles(1);
    two.alice.capture(&["/robot1/odom"], 2);
    two.alice.json(&["keys", "rotate"]);
    two.alice.json(&["grant", "add", &two.bob_address, "--from", "start"]);
    two.alice.capture(&["/robot1/odom"], 2);
    let before = two.alice.json(&["keys", "list"]);
    let file = signing_key(&two.home, '1');

    let foreseen = two.alice.json(&["keys", "load", "--sm2", &file, "--dry-run"]);
    assert_eq!(list(&foreseen, "readers"), [Value::from(two.bob_address.as_str())], "{foreseen}");
    assert_eq!(two.alice.json(&["keys", "list"])["signing_key"], before["signing_key"], "nothing was changed");

    let loaded = two.alice.run(&["keys", "load", "--sm2", &file]).expect_code(0);
    assert!(loaded.stderr.contains("1 reader with a grant"), "said beforehand: {loaded}");
    let after = two.alice.json(&["keys", "list"]);
    assert_ne!(after["signing_key"], before["signing_key"]);
    assert_eq!(after["envelope_key"], before["envelope_key"]);
    two.alice.capture(&["/robot1/odom"], 2);
    two.alice.json(&["keys", "rotate"]);
    two.alice.capture(&["/robot1/odom"], 2);

    // Neither side remembers anything beyond its disk and the chain.
    two.site.stop("TERM", 30).expect_code(0);
    let _site = two.home.authros().with(&["--robots", "0"]).serve(&two.home);
    let records = two.bob.records(&["received", "list", "--oldest"]);
    assert_eq!(records.len(), 8, "old and new");
    let owned = two.alice.records(&["records", "list", "--oldest"]);
    assert_eq!(owned.len(), 8);
    records.iter().for_each(|record| opens(&two.bob, record));
    owned.iter().for_each(|record| opens(&two.alice, record));
    let mut epochs: Vec<u64> = records.iter().map(|record| count(record, "epoch")).collect();
    epochs.sort_unstable();
    assert_eq!(epochs, [1, 1, 2, 2, 2, 2, 3, 3]);
    two.alice.json(&["audit", "verify"]);
}

#[test]
fn a_new_envelope_key_is_wrapped_for_and_the_old_one_opens_what_was() {
    let two = two_profiles(1);
    two.alice.capture(&["/robot1/odom"], 2);
    two.alice.json(&["keys", "rotate"]);
    two.alice.json(&["grant", "add", &two.bob_address, "--from", "start"]);
    two.alice.capture(&["/robot1/odom"], 2);
    let before = two.bob.json(&["keys", "list"]);

    let foreseen = two.bob.json(&["keys", "rotate", "--envelope", "--dry-run"]);
    assert_eq!(list(&foreseen, "sharers"), [Value::from(two.alice_address.as_str())], "{foreseen}");
    let rotated = two.bob.json(&["keys", "rotate", "--envelope"]);
    assert_ne!(rotated["envelope_key"], before["envelope_key"]);
    assert_eq!(rotated["signing_key"], before["signing_key"]);
    // The owner wraps the present epoch for the new key automatically.
    wait_until(90, "the present epoch is wrapped anew", || {
        let lines = list(&two.alice.json(&["audit", "list"]), "audit");
        lines.into_iter().find(|line| line["action"] == "wrap" && line["subject"].to_string().contains("epoch 2"))
    });
    two.alice.capture(&["/robot1/odom"], 1);
    two.alice.json(&["keys", "rotate"]);
    two.alice.capture(&["/robot1/odom"], 1);

    two.site.stop("TERM", 30).expect_code(0);
    let _site = two.home.authros().with(&["--robots", "0"]).serve(&two.home);
    let records = two.bob.records(&["received", "list", "--oldest"]);
    assert_eq!(records.len(), 6);
    records.iter().for_each(|record| opens(&two.bob, record));
    assert_eq!(two.bob.json(&["keys", "list"])["envelope_key"], rotated["envelope_key"]);
}

/// The newest document printed by a running agent.
fn figures(agent: &Running) -> Option<Value> {
    agent.stdout().lines().rev().find_map(|line| serde_json::from_str(line).ok())
}

fn serve(home: &Home, port: u16) -> (Running, String) {
    let keeper = home.profile("keeper").with(&["--json"]);
    let mut site = keeper.spawn(&["gateway", "serve", "--listen", &format!("127.0.0.1:{port}")]);
    let said = site.wait_for_text("\"gateway\"", 120);
    let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
    let document: Value = serde_json::from_str(line).expect("JSON");
    (site, text(&document["gateway"], "gateway"))
}

#[test]
fn a_robot_goes_on_through_new_keys_of_its_owner_and_its_gateway() {
    let (home, robot, port) = (Home::new(), Home::new(), free_port());
    let (site, fingerprint) = serve(&home, port);
    let (keeper, alice, bob) = (home.profile("keeper"), home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    alice.json(&["grant", "add", &bob_address]);
    let file = robot.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
    let address = format!("127.0.0.1:{port}");
    let enrol = ["robot", "enrol", "--gateway", &address, "--gateway-key", &fingerprint, "--name", "scout"];
    alice.json(&[&enrol[..], &["--topic", "/robot1/odom", "--out", &file]].concat());
    let run = |more: &[&str]| {
        let arguments = [&["robot", "run", &file, "--robots", "1"], more].concat();
        robot.authros().with(&["--json"]).spawn(&arguments)
    };
    let agent = run(&[]);
    let accepts = |agent: &Running, more: u64, what: &str| {
        let before = figures(agent).map_or(0, |figures| count(&figures, "accepted"));
        wait_until(120, what, || figures(agent).filter(|figures| count(figures, "accepted") >= before + more));
    };
    accepts(&agent, 1, "the gateway takes records");

    let loaded = alice.run(&["keys", "load", "--sm2", &signing_key(&home, '1')]).expect_code(0);
    assert!(loaded.stderr.contains("1 robot (scout)"), "said beforehand: {loaded}");
    accepts(&agent, 10, "records after the owner's new key");
    // What only the new key can tell it.
    alice.json(&["keys", "rotate"]);
    let of_epoch = |epoch: u64| {
        wait_until(120, "records of the new epoch", || {
            let records = alice.records(&["records", "list", "--oldest"]);
            records.into_iter().find(|record| count(record, "epoch") == epoch && is_verified(record))
        })
    };
    opens(&bob, &of_epoch(2));

    // The gateway's keeper changes both of its pairs; the gateway keeps its identity.
    let loaded = keeper.run(&["keys", "load", "--sm2", &signing_key(&home, '2')]).expect_code(0);
    assert!(loaded.stderr.contains("keeps its identity"), "{loaded}");
    keeper.json(&["keys", "rotate", "--envelope"]);
    accepts(&agent, 10, "records after the keeper's new keys");
    site.stop("KILL", 10);
    let (site, same) = serve(&home, port);
    assert_eq!(same, fingerprint, "pinned by every robot");
    alice.json(&["keys", "list"]);
    accepts(&agent, 10, "records after the gateway's restart");
    agent.stop("TERM", 20).expect_code(0);

    alice.run(&["keys", "load", "--sm2", &signing_key(&home, '3')]).expect_code(0);
    alice.json(&["keys", "rotate"]);
    // It was down while its owner changed the key and then the epoch: both are in the list, in order.
    let agent = run(&[]);
    opens(&bob, &of_epoch(3));
    agent.stop("TERM", 20).expect_code(0);
    let outcome = run(&["--count", "2"]).wait(180).expect_code(0);
    let summary: Value = serde_json::from_str(outcome.stdout.lines().last().expect("a document")).expect("JSON");
    assert_eq!((count(&summary, "pending"), count(&summary, "lost")), (0, 0), "{summary}");

    site.stop("TERM", 30);
    let (_site, _) = serve(&home, port);
    let records = wait_until(120, "all records are verified", || {
        let records = alice.records(&["records", "list", "--oldest"]);
        records.iter().all(is_verified).then_some(records)
    });
    let shared = bob.records(&["received", "list", "--oldest"]);
    assert_eq!(shared.len(), records.len());
    let step = (shared.len() / 12).max(1);
    shared.iter().step_by(step).chain(shared.last()).for_each(|record| opens(&bob, record));
}

#[test]
fn a_passphrase_is_changed_in_one_step_and_only_by_who_knows_it() {
    let home = Home::new();
    let passphrase = |name: &str, text: &str| home.file(name, format!("{text}\n"), 0o600);
    let (old, new) = (passphrase("old", "the old passphrase"), passphrase("new", "the new passphrase"));
    let wrong = passphrase("wrong", "another passphrase");
    let bare = home.authros().with(&["--robots", "0"]);
    let with = |file: &str| bare.with(&["--passphrase-file", file]);
    let made = with(&old).json(&["identity", "create"]);
    let keyring = crate::support::authros::files_below(&home.path())
        .into_iter()
        .find(|path| path.file_name().is_some_and(|name| name == "keyring"))
        .expect("a keyring");
    let before = fs::read(&keyring).expect("readable");

    let refused = with(&wrong).fails(5, &["keys", "passphrase", "--new-passphrase-file", &new]);
    assert!(refused.contains("passphrase"), "{refused}");
    let untold = with(&old).fails(2, &["keys", "passphrase"]);
    assert!(untold.contains("--new-passphrase-file"), "{untold}");
    let short = passphrase("short", "1234567");
    with(&old).fails(3, &["keys", "passphrase", "--new-passphrase-file", &short]);
    assert_eq!(fs::read(&keyring).expect("readable"), before, "nothing was changed");

    with(&old).run(&["keys", "passphrase", "--new-passphrase-file", &new]).expect_code(0);
    assert_eq!(fs::metadata(&keyring).expect("there").permissions().mode() & 0o777, 0o600);
    with(&old).fails(5, &["keys", "list"]);
    assert_eq!(with(&new).json(&["keys", "list"])["address"], made["address"]);

    // For a keyring that is open in a site: what the site saves later is under the new passphrase too.
    let site = with(&new).serve(&home);
    with(&wrong).fails(5, &["keys", "passphrase", "--new-passphrase-file", &old]);
    with(&new).run(&["keys", "passphrase", "--new-passphrase-file", &old]).expect_code(0);
    bare.json(&["keys", "rotate"]);
    site.stop("TERM", 30).expect_code(0);
    with(&new).fails(5, &["keys", "list"]);
    assert_eq!(list(&with(&old).json(&["keys", "list"]), "epochs").len(), 2);
}

#[test]
fn the_passphrase_file_beside_a_keyring_goes_with_the_passphrase() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.json(&["identity", "create"]);
    let beside = || {
        let files = crate::support::authros::files_below(&home.path());
        files.into_iter().find(|path| path.file_name().is_some_and(|name| name == "passphrase"))
    };
    assert!(beside().is_some(), "written by headless use");
    let new = home.file("new", "the new passphrase\n", 0o600);
    let changed = authros.run(&["keys", "passphrase", "--new-passphrase-file", &new]).expect_code(0);
    assert!(changed.stderr.contains("was removed"), "{changed}");
    assert_eq!(beside(), None);
    authros.with(&["--passphrase-file", &new]).json(&["keys", "list"]);
}
