//! How many messages of a watched topic are kept: said on the command line and on the screen of topics, in force at once,
//! counted by what arrives.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use crate::support;

use authros::model::Timestamp;
use serde_json::Value;
use support::{Authros, Console, Terminal, at, count, heavy, list, text, two_profiles, wait_until};

const TOPIC: &str = "/robot1/odom";
const INPUT: i32 = 3;

/// The first records captured since a moment, up to a number, each with its publisher's number and the time of its capture.
fn arrived(alice: &Authros, since: Timestamp, least: usize) -> Vec<(f64, Timestamp)> {
    let since = since.to_string();
    let records = wait_until(120, "records come", || {
        let records = alice.records(&["records", "list", "--oldest", "--topic", TOPIC, "--since", &since]);
        (records.len() >= least).then_some(records)
    });
    let numbered = |record: &Value| {
        let opened = alice.json(&["records", "open", &text(record, "id")]);
        let captured = serde_json::from_value(record["captured_at"].clone()).expect("a time");
        (at(&opened["message"], "header.seq"), captured)
    };
    let mut arrived: Vec<(f64, Timestamp)> = records.iter().map(numbered).collect();
    arrived.sort_by_key(|(_, captured)| *captured);
    arrived.truncate(least);
    arrived
}

fn steps(arrived: &[(f64, Timestamp)]) -> Vec<f64> {
    arrived.windows(2).map(|pair| pair[1].0 - pair[0].0).collect()
}

fn are(steps: &[f64], expected: f64) -> bool {
    steps.iter().all(|step| (step - expected).abs() < 1e-9)
}

fn row(alice: &Authros) -> Value {
    let rows = list(&alice.json(&["topics", "list"]), "topics");
    rows.into_iter().find(|row| row["topic"] == TOPIC).expect("the topic")
}

/// Says it, and returns the moment from which on it holds.
fn says(alice: &Authros, words: &[&str]) -> Timestamp {
    alice.run(&[&["topics", "watch"], words].concat()).expect_code(0);
    Timestamp::now()
}

#[test]
fn a_rule_holds_from_the_moment_it_is_said_until_another_is() {
    let two = two_profiles(1);
    let alice = &two.alice;
    let begun = says(alice, &[TOPIC, "--every", "4"]);
    assert!(are(&steps(&arrived(alice, begun, 6)), 4.0), "one in four");
    let thinned = row(alice);
    assert_eq!((count(&thinned["sampling"], "every"), count(&thinned, "lost_in_recorder")), (4, 0), "{thinned}");
    assert!(count(&thinned, "left_out") >= 15, "left out, and counted: {thinned}");
    let told = alice.run(&["topics", "list"]).expect_code(0).stdout;
    assert!(told.contains("watched, 1 in 4"), "{told}");

    let all = says(alice, &[TOPIC]);
    assert!(are(&steps(&arrived(alice, all, 8)), 1.0), "every message again");
    assert!(row(alice)["sampling"].is_null());

    let slow = says(alice, &["/robot*/odom", "--rate", "2"]);
    let kept = arrived(alice, slow, 6);
    let span = kept[5].1.0 - kept[0].1.0;
    assert!(span >= 2_250_000_000, "six at two a second take two and a half seconds: {kept:?}");
    let by_pattern = row(alice);
    assert_eq!(
        (text(&by_pattern, "watched_by"), count(&by_pattern["sampling"], "rate")),
        ("/robot*/odom".to_owned(), 2_000),
        "{by_pattern}"
    );
    let policy = alice.run(&["topics", "rules"]).expect_code(0).stdout;
    assert!(policy.contains("at most 2/s"), "{policy}");
    for wrong in [["--rate", "fast"], ["--rate", "0"], ["--every", "0"], ["--every", "2.5"]] {
        alice.fails(INPUT, &[&["topics", "watch", TOPIC], &wrong[..]].concat());
    }
    let audited = alice.json(&["audit", "list", "--limit", "1000"]).to_string();
    assert!(audited.contains("/robot1/odom: 1 in 4"), "{audited}");
}

#[test]
fn the_console_limits_a_topic_and_says_by_which_rule_it_is_watched() {
    let _alone = heavy();
    let two = two_profiles(1);
    let alice = &two.alice;
    says(alice, &["/robot*/odom"]);
    let mut console = Console::open_in(&Terminal::of(120, 30), alice, &[]);
    console.wait_for(TOPIC, 60);
    console.press("2/odom\r");
    console.wait_for("(by /robot*/odom)", 60);
    console.press("l");
    console.wait_for("It is watched by /robot*/odom", 60);
    console.press("\r4\r");
    console.wait_for("the rule of /robot1/odom is set", 60);
    let begun = Timestamp::now();
    console.wait_for("(1 in 4, ", 60);
    console.press("\r");
    console.wait_for("watched 1 in 4, ", 60);
    console.press("q");
    assert!(are(&steps(&arrived(alice, begun, 5)), 4.0), "one in four, at once");
    console.signal("TERM");
    console.wait(60);
}
