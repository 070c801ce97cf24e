//! Sharing between two profiles of one home: grant, check, open, revoke, and who cannot read what.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;
use std::fs;

use serde_json::{Value, json};
use support::{Authros, at, ids, is_verified, list, text, two_profiles};

const REFUSED: i32 = 5;

fn open(authros: &Authros, id: &str) -> Value {
    let opened = authros.json(&["records", "open", id]);
    assert_eq!(opened["verdict"], "verified", "{opened}");
    opened
}

/// The contract's word on a reader's right, where no digest was anchored by itself.
fn answer(owner: &str, reader: &str, authorised: bool, epoch: u64) -> Value {
    let (count, last) = (0, Value::Null);
    json!({ "reader": reader, "owner": owner, "authorised": authorised, "epoch": epoch, "count": count, "last": last })
}

fn sequence(authros: &Authros, record: &Value) -> f64 {
    at(&open(authros, &text(record, "id"))["message"], "header.seq")
}

#[test]
fn a_grantee_checks_and_opens_until_the_revoke_and_nothing_after_it() {
    let two = two_profiles(2);
    two.alice.capture(&["/robot1/odom"], 5);
    assert!(two.bob.records(&["received", "list", "--oldest"]).is_empty(), "nothing without a grant");
    let own = two.alice.records(&["records", "list", "--oldest"]);
    two.bob.is_refused(&["records", "open", &text(&own[0], "id")]);

    let granted = two.alice.json(&["grant", "add", &two.bob_address, "--expires", "30d"]);
    assert!(granted["transaction"].is_string(), "{granted}");
    let shared = two.bob.records(&["received", "list", "--oldest"]);
    assert_eq!(ids(&shared), ids(&own), "all of the current epoch");
    for record in &shared {
        assert_eq!(text(record, "owner"), two.alice_address);
        assert_eq!((&record["topic"], &record["type"]), (&"/robot1/odom".into(), &"nav_msgs/Odometry".into()));
        let id = text(record, "id");
        let checked = two.bob.json(&["records", "check", &id]);
        assert_eq!((&checked["verdict"], &checked["digest"]), (&"verified".into(), &record["digest"]), "{checked}");
        assert_eq!(checked["contract"], answer(&two.alice_address, &two.bob_address, true, 1), "{checked}");
        let opened = open(&two.bob, &id);
        assert!(at(&opened["message"], "pose.pose.position.x").is_finite(), "{opened}");
        assert_eq!(opened["message"], open(&two.alice, &id)["message"], "the owner reads the same");
    }

    let revoked = two.alice.json(&["grant", "end", &two.bob_address]);
    assert_eq!(revoked["epoch"], 2, "a revoke begins a new epoch: {revoked}");
    two.alice.capture(&["/robot1/odom"], 3);
    let all = two.alice.records(&["records", "list", "--oldest"]);
    let later: Vec<&Value> = all.iter().filter(|record| record["epoch"] == 2).collect();
    assert_eq!((all.len(), later.len()), (8, 3), "sealed under the new key");
    for record in later {
        two.bob.is_refused(&["records", "open", &text(record, "id")]);
        open(&two.alice, &text(record, "id"));
    }
    assert!(
        ids(&two.bob.records(&["received", "list", "--oldest"])).is_subset(&ids(&own)),
        "later records are not even listed"
    );
}

#[test]
fn grants_are_listed_by_both_sides_with_their_state() {
    let two = two_profiles(2);
    two.alice.json(&["grant", "add", &two.bob_address, "--topic", "/robot1/odom", "--expires", "1h"]);
    let rows = |authros: &Authros| list(&authros.json(&["grant", "list"]), "grants");
    let (given, received) = (rows(&two.alice), rows(&two.bob));
    assert_eq!((given.len(), received.len()), (1, 1));
    assert_eq!((&given[0]["direction"], &received[0]["direction"]), (&"given".into(), &"received".into()));
    for row in [&given[0], &received[0]] {
        assert_eq!((text(row, "owner"), text(row, "grantee")), (two.alice_address.clone(), two.bob_address.clone()));
        assert_eq!((&row["state"], list(row, "topics").len()), (&"active".into(), 1), "{row}");
        assert!(row["expires"].is_string() && row["transaction"].is_string() && row["block"].is_u64(), "{row}");
    }
    assert_eq!(list(&given[0], "topics"), ["/robot1/odom"]);

    two.alice.json(&["grant", "end", &two.bob_address]);
    assert_eq!((&rows(&two.alice)[0]["state"], &rows(&two.bob)[0]["state"]), (&"revoked".into(), &"revoked".into()));
    two.alice.fails(REFUSED, &["grant", "end", &two.bob_address]);
}

#[test]
fn a_grant_of_one_topic_opens_that_topic_alone() {
    let two = two_profiles(2);
    two.alice.json(&["grant", "add", &two.bob_address, "--topic", "/robot1/odom"]);
    two.alice.capture(&["/robot1/odom", "/robot2/odom"], 3);
    let own = two.alice.records(&["records", "list", "--oldest"]);
    let (first, second): (Vec<_>, Vec<_>) = own.into_iter().partition(|record| record["topic"] == "/robot1/odom");
    assert_eq!((first.len(), second.len()), (3, 3));
    assert_eq!(ids(&two.bob.records(&["received", "list", "--oldest"])), ids(&first));
    assert_eq!(ids(&two.bob.records(&["received", "list", "--oldest", "--topic", "/robot1/odom"])), ids(&first));
    open(&two.bob, &text(&first[0], "id"));
    two.bob.is_refused(&["records", "open", &text(&second[0], "id")]);
}

#[test]
fn the_current_epoch_is_granted_unless_all_are_asked_for() {
    let two = two_profiles(2);
    two.alice.capture(&["/robot1/odom"], 2);
    let early = ids(&two.alice.records(&["records", "list", "--oldest"]));
    two.alice.json(&["keys", "rotate"]);
    two.alice.capture(&["/robot1/odom"], 2);
    let all = ids(&two.alice.records(&["records", "list", "--oldest"]));

    two.alice.json(&["grant", "add", &two.bob_address]);
    let late: BTreeSet<String> = all.difference(&early).cloned().collect();
    assert_eq!(ids(&two.bob.records(&["received", "list", "--oldest"])), late);

    let carol = two.home.profile("carol");
    let carol_address = carol.enrol();
    two.alice.json(&["grant", "add", &carol_address, "--from", "start"]);
    assert_eq!(ids(&carol.records(&["received", "list", "--oldest"])), all);
    for id in &all {
        open(&carol, id);
        // One envelope carries the keys of all epochs: of the earlier one the contract knows nothing.
        let epoch = if early.contains(id) { 1 } else { 2 };
        let checked = carol.json(&["records", "check", id]);
        assert_eq!(checked["contract"], answer(&two.alice_address, &carol_address, epoch == 2, epoch), "{checked}");
    }
    // Who reads the older records is told on both sides, by what each knows.
    let opened = |authros: &Authros, other: &str| {
        let rows = list(&authros.json(&["grant", "list"]), "grants");
        let row = rows.into_iter().find(|row| row["grantee"] == other).expect("the grant");
        (row["from"].as_u64(), row["opens"]["records"].as_u64())
    };
    assert_eq!(opened(&two.alice, &two.bob_address), (Some(2), Some(2)));
    assert_eq!(opened(&two.alice, &carol_address), (Some(1), Some(4)));
    assert_eq!(opened(&two.bob, &two.bob_address), (Some(2), Some(2)));
    assert_eq!(opened(&carol, &carol_address), (Some(1), Some(4)));
    let list = two.alice.run(&["grant", "list"]).expect_code(0);
    assert!(list.stdout.contains(", 2 records") && list.stdout.contains(", 4 records"), "{}", list.stdout);
}

#[test]
fn who_is_left_reads_on_when_another_is_revoked() {
    let two = two_profiles(2);
    let carol = two.home.profile("carol");
    let carol_address = carol.enrol();
    for grantee in [&two.bob_address, &carol_address] {
        two.alice.json(&["grant", "add", grantee]);
    }
    two.alice.json(&["grant", "end", &two.bob_address]);
    two.alice.capture(&["/robot1/odom"], 2);
    let later = ids(&two.alice.records(&["records", "list", "--oldest"]));
    let seen = support::poll(30, || {
        Some(ids(&carol.records(&["received", "list", "--oldest"]))).filter(|seen| *seen == later)
    });
    assert!(seen.is_some(), "the survivor was re-wrapped for the new epoch");
    for id in &later {
        open(&carol, id);
        two.bob.is_refused(&["records", "open", id]);
    }
}

#[test]
fn a_picture_is_restored_byte_by_byte() {
    let two = two_profiles(2);
    two.alice.json(&["grant", "add", &two.bob_address]);
    two.alice.capture(&["/robot1/camera/compressed"], 1);
    let id = text(&two.bob.records(&["received", "list", "--oldest"])[0], "id");
    let picture = |authros: &Authros, name: &str| {
        let path = two.home.root().join(name);
        authros.run(&["records", "open", &id, "--out", path.to_str().expect("UTF-8")]).expect_code(0);
        let mode = fs::metadata(&path).expect("written").permissions();
        assert_eq!(std::os::unix::fs::PermissionsExt::mode(&mode) & 0o777, 0o600, "nobody else reads what was sealed");
        fs::read(path).expect("written")
    };
    let (hers, his) = (picture(&two.alice, "hers.jpg"), picture(&two.bob, "his.jpg"));
    assert_eq!(hers, his);
    assert!(his.starts_with(&[0xff, 0xd8]) && his.ends_with(&[0xff, 0xd9]), "a whole JPEG");
    assert!(his.len() > 20_000, "{} bytes", his.len());
}

#[test]
fn two_profiles_watch_one_topic_at_once_and_both_hold_every_message() {
    let two = two_profiles(2);
    let capture = ["capture", "--topic", "/robot1/odom", "--for", "5s"];
    let running = [&two.alice, &two.bob].map(|authros| authros.with(&["--json"]).spawn(&capture));
    for summary in running.map(|running| running.wait(120).expect_code(0).document()) {
        assert!(summary["captured"].as_u64() >= Some(5) && summary["captured"] == summary["verified"], "{summary}");
        assert_eq!(summary["lost"], 0, "{summary}");
    }
    let [hers, his] = [&two.alice, &two.bob].map(|authros| {
        let records = authros.records(&["records", "list", "--oldest"]);
        let seqs: Vec<u64> = records.iter().filter_map(|record| record["seq"].as_u64()).collect();
        // The definition of the messages is the first record of the topic.
        assert_eq!(seqs, (2..=u64::try_from(records.len() + 1).expect("few")).collect::<Vec<_>>());
        records
    });
    for (authros, records) in [(&two.alice, &hers), (&two.bob, &his)] {
        let (first, last) = (sequence(authros, &records[0]), sequence(authros, &records[records.len() - 1]));
        let held = f64::from(u32::try_from(records.len()).expect("few"));
        assert!((last - first + 1.0 - held).abs() < 0.5, "every message from {first} to {last}, but {held}");
    }
    assert!(ids(&hers).is_disjoint(&ids(&his)), "each under her own keys");
    two.bob.is_refused(&["records", "open", &text(&hers[0], "id")]);
    two.alice.is_refused(&["records", "open", &text(&his[0], "id")]);
}

#[test]
fn a_watched_topic_is_captured_until_it_is_unwatched() {
    let two = two_profiles(2);
    let watched = |authros: &Authros| {
        let topics = list(&authros.json(&["topics", "list"]), "topics");
        topics.into_iter().any(|topic| topic["topic"] == "/robot1/odom" && topic["watched"] == true)
    };
    two.alice.run(&["topics", "watch", "/robot1/odom"]).expect_code(0);
    assert!(watched(&two.alice) && !watched(&two.bob), "a watch belongs to one profile");
    support::wait_until(30, "a watched topic is uploaded", || {
        (two.alice.records(&["records", "list", "--oldest", "--state", "verified"]).len() >= 5).then_some(())
    });
    two.alice.run(&["topics", "unwatch", "/robot1/odom"]).expect_code(0);
    assert!(!watched(&two.alice));
    let settled = support::wait_until(60, "what was captured is verified", || {
        let records = two.alice.records(&["records", "list", "--oldest"]);
        records.iter().all(is_verified).then_some(records.len())
    });
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert_eq!(two.alice.records(&["records", "list", "--oldest"]).len(), settled, "nothing more comes");
}

#[test]
fn a_followed_list_tells_each_change_of_state_on_a_line_of_its_own() {
    let two = two_profiles(2);
    let follower = two.alice.with(&["--json"]).spawn(&["records", "list", "--follow"]);
    two.alice.capture(&["/robot1/odom"], 3);
    let verified = || follower.stdout().lines().filter(|line| line.contains("\"state\":\"verified\"")).count();
    support::wait_until(30, "all three are told verified", || (verified() >= 3).then_some(()));
    let outcome = follower.stop("INT", 20).expect_code(0);
    let mut last = std::collections::BTreeMap::new();
    for line in outcome.stdout.lines() {
        let record: serde_json::Value = serde_json::from_str(line).expect("one document a line");
        let before = last.insert(support::text(&record, "id"), support::text(&record, "state"));
        assert_ne!(before, last.get(&support::text(&record, "id")).cloned(), "told only when it changed: {line}");
    }
    assert_eq!(last.values().filter(|state| *state == "verified").count(), 3);
}

#[test]
fn each_grant_in_the_history_keeps_its_own_topics_and_terms() {
    let two = two_profiles(1);
    let (odom, camera, other) = ("/robot1/odom", "/robot1/camera/compressed", "/robot1/scan");
    let grant = |topics: &[&str], expires: &str| {
        let mut command = vec!["grant", "add", &two.bob_address, "--expires", expires];
        command.extend(topics.iter().flat_map(|topic| ["--topic", topic]));
        two.alice.json(&command);
    };
    grant(&[odom], "300d");
    two.alice.json(&["grant", "end", &two.bob_address]);
    grant(&[camera, odom], "200d");
    two.alice.json(&["grant", "end", &two.bob_address]);
    grant(&[other], "100d");
    let history = || {
        let rows = list(&two.alice.json(&["grant", "list"]), "grants");
        let told = |row: &Value| {
            let topics: BTreeSet<String> =
                list(row, "topics").iter().filter_map(Value::as_str).map(str::to_owned).collect();
            (row["epoch"].as_u64(), text(row, "state"), topics)
        };
        let ends: Vec<String> = rows.iter().map(|row| text(row, "expires")).collect();
        assert!(ends.iter().is_sorted_by(|one, next| one > next), "each its own end: {ends:?}");
        rows.iter().map(told).collect::<Vec<_>>()
    };
    let names = |topics: &[&str]| topics.iter().map(|&topic| topic.to_owned()).collect::<BTreeSet<_>>();
    let expected = vec![
        (Some(1), "revoked".to_owned(), names(&[odom])),
        (Some(2), "revoked".to_owned(), names(&[camera, odom])),
        (Some(3), "active".to_owned(), names(&[other])),
    ];
    assert_eq!(history(), expected);

    // Where the notes are gone: captured topics get their names from their pseudonyms; unknown pseudonyms stay unknown, and
    // are not guessed.
    two.alice.capture(&[odom], 1);
    two.site.stop("INT", 30).expect_code(0);
    let ledger = rusqlite::Connection::open(two.home.path().join("ledger.db")).expect("opens");
    ledger.execute("DELETE FROM notes WHERE kind = 'granted topic'", []).expect("gone");
    drop(ledger);
    let left = history();
    assert_eq!(left[0].2, names(&[odom]));
    for (grant, named) in [(1, 1), (2, 0)] {
        let unknown = left[grant].2.iter().filter(|topic| topic.starts_with("id:")).count();
        assert_eq!((unknown, left[grant].2.len()), (1, 1 + named), "{left:?}");
    }
    assert!(left[1].2.contains(odom), "{left:?}");
}

#[test]
fn a_grant_says_from_which_moment_it_opens_records_and_that_is_so() {
    let two = two_profiles(1);
    two.alice.capture(&["/robot1/odom"], 3);
    let grant = ["grant", "add", &two.bob_address, "--topic", "/robot1/odom"];
    let said = text(&two.alice.json(&grant), "text");
    assert!(said.contains("since 20") && said.contains(" UTC, 3 records"), "{said}");
    assert_eq!(two.bob.records(&["received", "list", "--oldest"]).len(), 3, "from before the grant");
    two.alice.json(&["grant", "end", &two.bob_address]);
    let said = text(&two.alice.json(&grant), "text");
    assert!(said.ends_with(", no record yet"), "{said}");
}
