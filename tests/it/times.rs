//! Times, filters and topics as people type them: a list by local times, words that are no filter, a watch by pattern
//! that a later robot falls under.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use authros::model::Timestamp;
use serde_json::Value;
use support::{Authros, Console, Home, list, text, wait_until};

const INPUT: i32 = 3;
const USAGE: i32 = 2;
const ODOM: &str = "/robot1/odom";
const OTHER: &str = "/robot2/odom";
/// Eight hours before UTC, as POSIX writes it, in nanoseconds.
const EIGHT_HOURS: u64 = 8 * 3_600 * 1_000_000_000;

fn captured_at(record: &Value) -> Timestamp {
    serde_json::from_value(record["captured_at"].clone()).expect("a time")
}

/// `2026-11-27 05:50:41.141` eight hours before UTC, the millisecond cut.
fn local(moment: Timestamp) -> String {
    Timestamp(moment.0 + EIGHT_HOURS).in_milliseconds().replace('T', " ").trim_end_matches('Z').to_owned()
}

fn cut(moment: Timestamp) -> u64 {
    moment.0 / 1_000_000
}

#[test]
fn a_list_by_local_times_has_what_was_captured_then() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]).with_variable("TZ", "CST-8");
    authros.enrol();
    authros.capture(&[ODOM, OTHER], 5);
    let all = authros.records(&["records", "list", "--oldest"]);
    assert_eq!(all.len(), 10);
    let ids = |records: &[Value]| records.iter().map(|record| text(record, "id")).collect::<Vec<_>>();
    let newest_first = authros.records(&["records", "list"]);
    assert_eq!(ids(&newest_first), ids(&all).into_iter().rev().collect::<Vec<_>>());
    let (since, until) = (captured_at(&all[3]), captured_at(&all[7]));
    let within = |record: &&Value| (cut(since)..cut(until)).contains(&cut(captured_at(record)));
    let expected: Vec<String> = all.iter().filter(within).map(|record| text(record, "id")).collect();
    assert!(!expected.is_empty());
    let span = ["--since", &local(since), "--until", &local(until)];
    let listed = authros.records(&[&["records", "list", "--oldest"], &span[..]].concat());
    assert_eq!(listed.iter().map(|record| text(record, "id")).collect::<Vec<_>>(), expected);

    let told = authros.run(&[&["records", "list", "--oldest"], &span[..]].concat()).expect_code(0).stderr;
    let utc = since.in_milliseconds().replace('T', " ").trim_end_matches('Z').to_owned();
    let (utc, here) = (utc.trim_end_matches(".000"), local(since));
    let meaning = format!("since {} local = {utc} UTC", here.trim_end_matches(".000"));
    assert!(told.contains(&meaning), "{told:?} does not say {meaning:?}");
    let absolute = authros.run(&["records", "list", "--oldest", "--since", &since.to_string()]).expect_code(0).stderr;
    assert!(!absolute.contains("local ="), "nothing is to be explained: {absolute:?}");

    assert_eq!(authros.records(&["records", "list", "--oldest", "--since", "-1h", "--until", "now"]).len(), 10);
    assert_eq!(authros.records(&["records", "list", "--oldest", "--since", "tomorrow 18:00"]).len(), 0);
    let wrong = authros.fails(INPUT, &["records", "list", "--oldest", "--since", "soon"]);
    assert!(wrong.contains("yesterday 18:00"), "{wrong}");
    let past =
        authros.fails(INPUT, &["grant", "add", "0x00000000000000000000000000000000000000b0", "--expires", "yesterday"]);
    assert!(past.contains("enter a later time"), "{past}");
}

#[test]
fn lists_take_patterns_and_robots_and_name_the_nearest_word() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]);
    authros.enrol();
    let captured = authros.json(&["capture", "--count", "2", "--topic", "/robot*/odom"]);
    assert_eq!((&captured["captured"], &captured["lost"]), (&4.into(), &0.into()), "{captured}");
    let of = |words: &[&str]| authros.records(&[&["records", "list", "--oldest"], words].concat()).len();
    let counts = [&["--topic", "/robot*/odom"][..], &["--topic", "/robot2/**"], &["--robot", "robot1"]].map(of);
    assert_eq!(counts, [4, 2, 2]);
    let unknown = authros.fails(INPUT, &["records", "list", "--oldest", "--robot", "robot9"]);
    assert!(unknown.contains("robot9"), "{unknown}");
    let near = authros.fails(INPUT, &["records", "list", "--oldest", "--state", "verifed"]);
    assert!(near.contains("did you mean 'verified'?"), "{near}");
    assert!(authros.fails(INPUT, &["records", "list", "--oldest", "--topic", "odom"]).contains("must start with /"));
    assert!(authros.fails(INPUT, &["capture", "--topic", "/robot9/*", "--count", "1"]).contains("no topic matches"));

    let mut console = Console::open(&authros);
    console.press("3");
    console.wait_for("newest first", 60);
    console.press("/odom unti:40s\r");
    console.wait_for("did you mean 'until:'?", 60);
    console.press("/\u{15}robot:robot2 since:1h\r");
    console.wait_for("since 20", 60);
    wait_until(60, "the two of that robot", || {
        let shown = console.shown();
        (shown.matches(OTHER).count() == 2 && !shown.contains(ODOM)).then_some(())
    });
    console.signal("TERM");
    console.wait(60);
}

fn watched(authros: &Authros) -> Vec<(String, String)> {
    let rows = list(&authros.json(&["topics", "list"]), "topics").into_iter().filter(|row| row["watched"] == true);
    rows.map(|row| (text(&row, "topic"), row["watched_by"].as_str().unwrap_or_default().to_owned())).collect()
}

#[test]
fn a_watch_by_pattern_covers_a_robot_that_comes_later() {
    let home = Home::new();
    let authros = home.authros();
    let of = |topic: &str| authros.records(&["records", "list", "--oldest", "--topic", topic]).len();
    let one = authros.with(&["--robots", "1"]).serve(&home);
    authros.enrol();
    authros.json(&["topics", "watch", "/robot*/odom"]);
    wait_until(120, "the first robot is captured", || (of(ODOM) > 0).then_some(()));
    assert_eq!(watched(&authros), [(ODOM.to_owned(), "/robot*/odom".to_owned())]);
    one.stop("TERM", 60);

    let _two = authros.with(&["--robots", "2"]).serve(&home);
    wait_until(120, "the second robot is captured without a word", || (of(OTHER) > 0).then_some(()));
    assert_eq!(of("/robot*/camera/**"), 0, "and nothing else of it");
    let people = authros.run(&["topics", "list"]).expect_code(0).stdout;
    assert!(people.contains("watched by /robot*/odom"), "{people}");

    authros.json(&["topics", "unwatch", "--robot", "robot2"]);
    assert_eq!(watched(&authros), [(ODOM.to_owned(), "/robot*/odom".to_owned())], "an exception");
    authros.json(&["topics", "unwatch", "/robot*/odom"]);
    assert!(watched(&authros).is_empty());
    let nothing = authros.fails(INPUT, &["topics", "unwatch", "/robot*/odom"]);
    assert!(nothing.contains("nothing that is watched matches"), "{nothing}");
    authros.fails(USAGE, &["topics", "watch"]);
}
