//! From when on a grant opens records: from now on, from an earlier moment, in a row; checked by opening.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;

use authros::model::Timestamp;
use serde_json::Value;
use support::{Authros, Console, Terminal, count, heavy, ids, list, long, text, two_profiles, wait_until};

const TOPIC: &str = "/robot1/odom";
const INPUT: i32 = 3;

fn captured(record: &Value) -> Timestamp {
    serde_json::from_value(record["captured_at"].clone()).expect("a time")
}

/// Opens each, and returns them.
fn opened(reader: &Authros) -> BTreeSet<String> {
    let shared = ids(&reader.records(&["received", "list", "--oldest"]));
    for id in &shared {
        assert_eq!(reader.json(&["records", "open", id])["verdict"], "verified", "{id}");
    }
    shared
}

/// Nothing of this is listed or opened.
fn is_closed(reader: &Authros, records: &[Value]) {
    let shared = ids(&reader.records(&["received", "list", "--oldest"]));
    for record in records {
        let id = text(record, "id");
        assert!(!shared.contains(&id), "{record}");
        reader.is_refused(&["records", "open", &id]);
    }
}

#[test]
fn from_now_on_opens_nothing_that_was_captured_before_while_messages_go_on() {
    let two = two_profiles(1);
    two.alice.run(&["topics", "watch", TOPIC]).expect_code(0);
    wait_until(60, "records come", || (two.alice.records(&["records", "list", "--oldest"]).len() >= 5).then_some(()));
    let dry = two.alice.json(&["grant", "add", &two.bob_address, "--from", "now", "--dry-run"]);
    assert_eq!(
        (&dry["epochs"], &dry["nothing_older"], &dry["transactions"]),
        (&1.into(), &true.into(), &2.into()),
        "{dry}"
    );
    assert!(list(&two.alice.json(&["grant", "list"]), "grants").is_empty(), "nothing was done");

    let asked = Timestamp::now();
    let granted = two.alice.json(&["grant", "add", &two.bob_address, "--topic", TOPIC, "--from", "now"]);
    assert_eq!(granted["epoch"], 2, "{granted}");
    assert!(text(&granted, "text").contains("from now on, nothing older"), "{granted}");
    wait_until(60, "what comes afterwards is read", || {
        (two.bob.records(&["received", "list", "--oldest"]).len() >= 5).then_some(())
    });
    two.alice.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    let all = two.alice.records(&["records", "list", "--oldest"]);
    let (before, after): (Vec<Value>, Vec<Value>) = all.into_iter().partition(|record| captured(record) < asked);
    assert!(before.len() >= 5 && after.len() >= 5, "{} before, {} after", before.len(), after.len());
    is_closed(&two.bob, &before[..2]);
    is_closed(&two.bob, &before[before.len() - 2..]);
    for record in two.bob.records(&["received", "list", "--oldest"]) {
        assert!(captured(&record) >= asked && record["epoch"] == 2, "{record}");
    }
    let newest = text(&two.bob.records(&["received", "list"])[0], "id");
    let verified = || two.bob.json(&["records", "open", &newest])["verdict"] == "verified";
    wait_until(60, "the newest is in a block", || verified().then_some(()));
}

#[test]
fn what_was_foreseen_is_what_opens_from_every_moment() {
    let two = two_profiles(1);
    two.alice.capture(&[TOPIC], 3);
    two.alice.json(&["keys", "rotate"]);
    let moment = Timestamp::now().to_string();
    two.alice.capture(&[TOPIC], 2);
    two.alice.json(&["keys", "rotate"]);
    two.alice.capture(&[TOPIC], 4);
    for (name, from, first, records) in [
        ("carol", "start", 1, 9),
        ("dave", moment.as_str(), 2, 6),
        ("erin", "epoch", 3, 4),
        ("frank", "1h", 1, 9),
        ("gina", "2", 2, 6),
    ] {
        let reader = two.home.profile(name);
        let address = reader.enrol();
        let grant = ["grant", "add", &address, "--from", from];
        let dry = two.alice.json(&[&grant[..], &["--dry-run"]].concat());
        assert_eq!((count(&dry, "epoch"), count(&dry["opens"], "records")), (first, records), "{name}: {dry}");
        assert_eq!((count(&dry, "epochs"), count(&dry, "transactions")), (0, 1), "{name}: {dry}");
        let said = text(&two.alice.json(&grant), "text");
        assert!(said.contains(&format!(", {records} records")), "{said}");
        assert_eq!(opened(&reader).len() as u64, records, "{name}");
        let rows = list(&two.alice.json(&["grant", "list"]), "grants");
        let row = rows.iter().find(|row| row["grantee"] == address.as_str()).expect("its row");
        assert_eq!((count(row, "from"), count(&row["opens"], "records")), (first, records), "{row}");
    }
    for wrong in ["soon", "9", "0", "2100-01-01T00:00:00Z"] {
        two.alice.fails(INPUT, &["grant", "add", &two.bob_address, "--from", wrong]);
    }
    let told = two.alice.run(&["grant", "list"]).expect_code(0).stdout;
    assert!(told.contains(" UTC, 6 records"), "{told}");
}

#[test]
fn everything_of_a_robot_until_friday_is_one_grant() {
    let two = two_profiles(2);
    let camera = "/robot1/camera/compressed";
    two.alice.capture(&[TOPIC, camera, "/robot2/odom"], 2);
    let grant =
        ["grant", "add", &two.bob_address, "--robot", "robot1", "--expires", "friday 18:00 UTC", "--from", "start"];
    let dry = two.alice.json(&[&grant[..], &["--dry-run"]].concat());
    assert_eq!(count(&dry, "transactions"), 1, "{dry}");
    let topics: BTreeSet<String> = names(&list(&dry, "topics"));
    assert!([TOPIC, camera].iter().all(|topic| topics.contains(*topic)), "{dry}");
    assert!(topics.iter().all(|topic| topic.starts_with("/robot1/")), "{dry}");
    two.alice.json(&grant);
    let grants = list(&two.alice.json(&["grant", "list"]), "grants");
    assert_eq!((grants.len(), names(&list(&grants[0], "topics"))), (1, topics));
    let expires = text(&grants[0], "expires");
    assert!(expires.contains("T18:00:00"), "{expires}");
    assert_eq!(opened(&two.bob).len(), 4, "two of each of its topics, and nothing of the other robot");
    let told = two.alice.fails(INPUT, &["grant", "add", &two.bob_address, "--robot", "nobody-here"]);
    assert!(told.contains("no robot of this profile is called 'nobody-here'"), "{told}");
}

fn names(topics: &[Value]) -> BTreeSet<String> {
    topics.iter().map(|topic| topic.as_str().expect("a name").to_owned()).collect()
}

/// Grants to many: each begins an epoch, and nobody who read before misses anything.
#[test]
fn many_grants_from_now_on_in_a_row_take_nothing_from_anybody() {
    let _alone = heavy();
    let two = two_profiles(1);
    two.alice.json(&["grant", "add", &two.bob_address]);
    let readers: Vec<Authros> =
        (1..=if long() { 32 } else { 4 }).map(|number| two.home.profile(&format!("reader{number}"))).collect();
    let addresses: Vec<String> = readers.iter().map(Authros::enrol).collect();
    let mut seen = vec![0];
    for address in &addresses {
        two.alice.capture(&[TOPIC], 1);
        two.alice.json(&["grant", "add", address, "--from", "now"]);
        seen.push(two.alice.records(&["records", "list", "--oldest"]).len());
    }
    two.alice.capture(&[TOPIC], 1);
    let all = two.alice.records(&["records", "list", "--oldest"]);
    let whole = ids(&all);
    wait_until(120, "the first reader has all", || {
        (ids(&two.bob.records(&["received", "list", "--oldest"])) == whole).then_some(())
    });
    assert_eq!(opened(&two.bob), whole, "through every epoch");
    for (reader, before) in readers.iter().zip(&seen[1..]) {
        let later = ids(&all[*before..]);
        wait_until(120, "a later reader has the rest", || {
            (ids(&reader.records(&["received", "list", "--oldest"])) == later).then_some(())
        });
    }
    let last = readers.last().expect("readers");
    assert_eq!(opened(last), ids(&all[seen[seen.len() - 1]..]));
    is_closed(last, &all[..1]);
}

#[test]
fn the_form_at_80_by_24_says_from_when_and_the_reader_opens_nothing_older() {
    let _alone = heavy();
    let two = two_profiles(1);
    two.alice.capture(&[TOPIC], 3);
    let before = two.alice.records(&["records", "list", "--oldest"]);
    let mut console = Console::open_in(&Terminal::of(80, 24), &two.alice, &[]);
    console.wait_for(TOPIC, 60);
    console.press("5");
    console.wait_for("No grants given", 60);
    console.press("g");
    for words in ["now    from now on: a new key, nothing older", "UTC, 3 records of all topics"] {
        console.wait_for(words, 60);
    }
    console.press(&two.bob_address);
    console.press("\rall\r\r\r");
    console.wait_for("Records  from now on, nothing older", 60);
    console.wait_for("a new epoch: 0 other readers get the key, no robot is told", 60);
    console.press("n");
    console.wait_for("Lets another account", 60);
    console.press("epoch\r");
    console.wait_for("UTC, 3 records", 60);
    console.wait_for("Cost     1 transaction", 60);
    console.press("n");
    console.wait_for("Lets another account", 60);
    console.press("\u{15}now\r");
    console.wait_for("a new epoch:", 60);
    console.press("y");
    console.wait_for("1 can read new records now", 60);
    is_closed(&two.bob, &before);
    two.alice.capture(&[TOPIC], 2);
    let after: Vec<Value> =
        two.alice.records(&["records", "list", "--oldest"]).into_iter().skip(before.len()).collect();
    assert_eq!((opened(&two.bob), after.len()), (ids(&after), 2));
    console.signal("TERM");
    console.wait(60);
}
