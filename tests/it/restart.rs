//! kill -9 in the middle of a capture: nothing acknowledged is missing, nothing is anchored twice.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;
use support::{Authros, Home, is_verified, text, wait_until};

const TOPICS: [&str; 2] = ["/robot1/odom", "/robot2/camera/compressed"];

fn digests(records: &[Value]) -> BTreeMap<String, Value> {
    let map: BTreeMap<String, Value> = records.iter().map(|record| (text(record, "digest"), record.clone())).collect();
    assert_eq!(map.len(), records.len(), "every digest once");
    map
}

/// All records of the profile, once all are verified.
fn settled(authros: &Authros) -> Vec<Value> {
    wait_until(120, "everything is verified", || {
        let records = authros.records(&["records", "list", "--oldest"]);
        records.iter().all(is_verified).then_some(records)
    })
}

/// Records of every kind that the profile made: data, definitions of messages, gaps.
fn of_every_kind(authros: &Authros) -> Vec<Value> {
    ["data", "definition", "gap"]
        .iter()
        .flat_map(|kind| authros.records(&["records", "list", "--oldest", "--kind", kind]))
        .collect()
}

fn expect_dense(authros: &Authros) {
    let records = of_every_kind(authros);
    for topic in TOPICS {
        let of_topic = records.iter().filter(|record| record["topic"] == topic);
        let mut seqs: Vec<u64> = of_topic.filter_map(|record| record["seq"].as_u64()).collect();
        seqs.sort_unstable();
        let length = u64::try_from(seqs.len()).expect("few");
        assert_eq!(seqs, (1..=length).collect::<Vec<_>>(), "{topic} has no hole and no double");
    }
}

#[test]
fn a_site_killed_while_it_captures_loses_and_doubles_nothing() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]);
    let site = authros.serve(&home);
    authros.enrol();
    let nonce = |authros: &Authros| authros.json(&["chain", "status"])["nonce"].as_u64().expect("a nonce");
    let nonce_before = nonce(&authros);
    for topic in TOPICS {
        authros.run(&["topics", "watch", topic]).expect_code(0);
    }
    let enough = |authros: &Authros, least: usize| {
        wait_until(60, "records arrive", || {
            let records = authros.records(&["records", "list", "--oldest"]);
            let verified = records.iter().any(is_verified);
            (records.len() >= least && verified).then_some(records)
        })
    };
    let acknowledged = enough(&authros, 40);
    site.stop("KILL", 10);

    let site = authros.serve(&home);
    let more = enough(&authros, acknowledged.len() + 20);
    drop(site);

    let _site = authros.serve(&home);
    for topic in TOPICS {
        authros.run(&["topics", "unwatch", topic]).expect_code(0);
    }
    let all = settled(&authros);
    let by_digest = digests(&all);
    for record in acknowledged.iter().chain(&more) {
        let kept = by_digest.get(&text(record, "digest")).unwrap_or_else(|| panic!("lost: {record}"));
        assert_eq!((&kept["topic"], &kept["seq"]), (&record["topic"], &record["seq"]));
        let was_anchored = record["transaction"].is_string();
        assert!(!was_anchored || kept["transaction"] == record["transaction"], "anchored again: {kept}");
    }
    expect_dense(&authros);
    assert_eq!(by_digest.len(), all.len(), "no record twice");
    let every = of_every_kind(&authros);
    let batches: BTreeSet<String> = every.iter().map(|record| text(record, "transaction")).collect();
    let sent = u64::try_from(batches.len()).expect("few");
    assert!(sent > 1 && sent < u64::try_from(every.len()).expect("few"), "batches: {batches:?}");
    assert_eq!(nonce(&authros) - nonce_before, sent, "no transaction beside these");
}

#[test]
fn a_capture_whose_site_dies_says_so_and_its_records_are_completed_later() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]);
    let site = authros.serve(&home);
    authros.enrol();
    let capture =
        authros.with(&["--json"]).spawn(&["capture", "--topic", TOPICS[0], "--topic", TOPICS[1], "--for", "60s"]);
    let before = wait_until(60, "records arrive", || {
        Some(authros.records(&["records", "list", "--oldest"])).filter(|records| records.len() >= 30)
    });
    site.stop("KILL", 10);
    let outcome = capture.wait(30).expect_code(4);
    assert!(outcome.document()["error"]["message"].is_string(), "{outcome}");

    let _site = authros.serve(&home);
    let all = settled(&authros);
    let by_digest = digests(&all);
    assert!(before.iter().all(|record| by_digest.contains_key(&text(record, "digest"))), "all acknowledged are there");
    expect_dense(&authros);
    authros.capture(&TOPICS[..1], 3);
    expect_dense(&authros);
}

#[test]
fn identities_grants_and_records_are_there_after_a_restart() {
    let home = Home::new();
    let site = home.authros().with(&["--robots", "1"]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    alice.json(&["grant", "add", &bob_address]);
    alice.capture(&["/robot1/odom"], 3);
    let questions = [
        &["identity", "show"][..],
        &["keys", "list"],
        &["grant", "list"],
        &["records", "list", "--oldest"],
        &["received", "list", "--oldest"],
    ];
    let ask = |authros: &Authros| {
        questions.map(|question| {
            let mut answer = authros.json(question);
            answer.as_object_mut().expect("an object").remove("unlocked");
            answer
        })
    };
    let before = [ask(&alice), ask(&bob)];
    let chain = alice.json(&["chain", "status"]);
    assert_eq!(site.stop("TERM", 30).code, Some(0), "a site ends well when asked to");
    assert!(home.socket().is_none());

    let _site = home.authros().with(&["--robots", "1"]).serve(&home);
    assert_eq!([ask(&alice), ask(&bob)], before);
    let chain_after = alice.json(&["chain", "status"]);
    for field in ["chain_id", "genesis", "contract", "nonce", "balance"] {
        assert_eq!(chain_after[field], chain[field], "{field}");
    }
    let id = text(&bob.records(&["received", "list", "--oldest"])[0], "id");
    assert_eq!(bob.json(&["records", "open", &id])["verdict"], "verified");
}

/// What is watched at a site that was started anew is captured: the keyring that it needs is opened, or it is said that it is not.
#[test]
fn a_watch_at_a_restarted_site_begins_or_says_why_it_does_not() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    let site = authros.serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    alice.json(&["topics", "watch", TOPICS[0]]);
    wait_until(60, "a first record", || (!alice.records(&["records", "list", "--oldest"]).is_empty()).then_some(()));
    site.stop("TERM", 60).expect_code(0);
    let _site = authros.serve(&home);
    let before = alice.records(&["records", "list", "--oldest"]).len();

    let passphrase = home.path().join("profiles/alice/passphrase");
    let kept = passphrase.with_extension("elsewhere");
    std::fs::rename(&passphrase, &kept).expect("taken away");
    let said = alice.run(&["topics", "watch", TOPICS[0]]).expect_code(0);
    assert!(said.stderr.contains("locked") && said.stderr.contains("--passphrase-file"), "{}", said.stderr);
    std::fs::rename(&kept, &passphrase).expect("given back");
    alice.json(&["topics", "watch", TOPICS[0]]);
    wait_until(60, "it is captured again", || {
        (alice.records(&["records", "list", "--oldest"]).len() > before + 20).then_some(())
    });
}
