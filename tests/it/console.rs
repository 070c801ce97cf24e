//! The console in a real pseudo-terminal: what it shows at once, its keys, and the terminal it leaves behind.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;

use support::{Authros, Console, Home, heavy, is_verified, list, poll, text, wait_until};

const TOPIC: &str = "/robot1/odom";
const PASSPHRASE: &str = "a console's passphrase";

fn one_robot(home: &Home) -> Authros {
    home.authros().with(&["--robots", "1"])
}

#[test]
fn the_busiest_topics_are_shown_by_full_name_before_any_key() {
    let home = Home::new();
    let mut console = Console::open(&home.authros());
    let screen = console.wait_for(TOPIC, 60);
    assert!(!screen.to_lowercase().contains("enter your passphrase"), "nothing is asked first:\n{screen}");
    console.press("q");
    assert!(console.wait(20).success(), "{}", console.shown());
    console.expect_restored();
}

#[test]
fn q_restores_the_terminal() {
    let home = Home::new();
    let mut console = Console::open(&home.authros().with(&["--robots", "0"]));
    wait_until(10, "a first screen", || Some(()).filter(|()| console.shown().lines().count() > 10));
    console.press("q");
    assert!(console.wait(20).success(), "{}", console.shown());
    console.expect_restored();
}

#[test]
fn a_topic_watched_with_a_key_is_seen_verified() {
    let home = Home::new();
    let authros = one_robot(&home);
    let passphrase = home.file("passphrase", PASSPHRASE, 0o600);
    authros.with(&["--passphrase-file", &passphrase]).enrol();
    let mut console = Console::open(&authros);
    console.wait_for("Unlock the keyring", 30);
    console.press("\u{1b}");
    console.wait_for(TOPIC, 30);
    console.press("2");
    console.wait_for("nav_msgs/Odometry", 30);
    watch_odometry(&mut console, &authros);
    console.press("3");
    let screen = console.wait_for("verified", 30);
    assert!(screen.contains("/robot1/"), "live uploads with their topics:\n{screen}");
    drop(console);
    let uploads = one_robot(&home).json(&["records", "list", "--oldest"]);
    assert!(!list(&uploads, "records").is_empty(), "what the console captured is kept");
}

/// Finds odometry with a filter and watches it with one key; only now is the passphrase asked for.
fn watch_odometry(console: &mut Console, authros: &Authros) {
    console.press("/");
    console.press("odometry\r");
    wait_until(10, "the filter leaves one topic", || Some(()).filter(|()| !console.shown().contains("/robot1/camera")));
    console.press("w");
    console.wait_for("Passphrase", 60);
    console.press(PASSPHRASE);
    assert!(!console.shown().contains(PASSPHRASE), "never shown");
    console.press("\r");
    let watched = poll(30, || {
        let topics = list(&authros.json(&["topics", "list"]), "topics");
        topics.into_iter().find(|topic| topic["topic"] == TOPIC && topic["watched"] == true)
    });
    assert!(watched.is_some(), "not watched by w:\n{}", console.shown());
}

#[test]
fn the_help_lists_the_keys() {
    let home = Home::new();
    let mut console = Console::open(&one_robot(&home));
    console.wait_for(TOPIC, 60);
    console.press("?");
    console.wait_for("watch", 60);
    console.press("\u{1b}");
    console.press("q");
    console.wait(20);
    console.expect_restored();
}

#[test]
fn a_console_killed_while_it_captures_loses_nothing_acknowledged() {
    let _alone = heavy();
    let home = Home::new();
    let authros = one_robot(&home);
    authros.enrol();
    let digests = |authros: &Authros| -> BTreeSet<String> {
        authros.records(&["records", "list", "--oldest"]).iter().map(|record| text(record, "digest")).collect()
    };
    let console = Console::open(&authros);
    wait_until(30, "the console's site accepts", || home.socket());
    authros.run(&["topics", "watch", TOPIC]).expect_code(0);
    let before = wait_until(60, "records arrive", || Some(digests(&authros)).filter(|digests| digests.len() >= 20));
    console.signal("KILL");
    drop(console);

    let _again = Console::open(&authros);
    wait_until(30, "the console's site accepts", || home.socket());
    authros.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    let after = wait_until(120, "everything is verified", || {
        let records = authros.records(&["records", "list", "--oldest"]);
        let verified = records.iter().filter(|record| is_verified(record)).count();
        (verified == records.len()).then(|| digests(&authros))
    });
    assert_eq!(after.len(), authros.records(&["records", "list", "--oldest"]).len(), "no record twice");
    assert!(before.is_subset(&after), "{} of {} kept", before.intersection(&after).count(), before.len());
}

#[test]
fn a_small_terminal_and_no_colour_are_no_reason_to_fail() {
    let home = Home::new();
    let mut console = Console::open(&one_robot(&home).with_variable("NO_COLOR", "1"));
    console.wait_for(TOPIC, 60);
    console.resize(10, 40);
    wait_until(10, "it says that the terminal is small", || {
        Some(()).filter(|()| console.shown().lines().filter(|line| !line.trim().is_empty()).count() <= 3)
    });
    console.resize(30, 100);
    console.wait_for(TOPIC, 60);
    console.press("q");
    assert!(console.wait(20).success());
    console.expect_restored();
}
