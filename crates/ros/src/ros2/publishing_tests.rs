//! The site's side of publishing in ROS 2, without a network: what reports do, and what a program that is none does.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::{Offer, Offered, Ros2Publisher};
use crate::model::ErrorKind;
use crate::pipe::VERSION;
use crate::pipe::write::Report;
use crate::ros::RosError;
use crate::ros::child::{Restarts, State};

fn taken(messages: u32, dropped: u32) -> Report {
    Report::Taken { messages, dropped, unacknowledged: 4, unconfirmed: 7 }
}

#[test]
fn what_is_confirmed_is_no_longer_waited_for_and_what_was_dropped_is_counted() {
    let mut state = State::default();
    for size in [10, 20, 30] {
        state.hand_out(size);
    }
    state.take(taken(2, 1), 0).expect("taken");
    assert_eq!((state.unconfirmed(), state.missed()), ((1, 30), 1));
    // More than was handed out, and more drops than messages.
    state.take(taken(9, u32::MAX), 0).expect("taken");
    assert_eq!((state.unconfirmed(), state.missed()), ((0, 0), 10));
    assert_eq!((state.unacknowledged, state.best_effort), (4, 7), "the last figures hold");
}

#[test]
fn another_release_or_domain_is_refused_and_reasons_are_cleaned() {
    let mut state = State::default();
    for (version, domain) in [(0, 5), (2, 5), (255, 5), (VERSION, 6)] {
        let error = state.take(Report::Hello { version, domain, confined: true }, 5).expect_err("refused");
        assert!(error.contains("install both programs from the same release") && !state.joined, "{error}");
    }
    state.take(Report::Hello { version: VERSION, domain: 5, confined: true }, 5).expect("taken");
    assert!(state.joined && state.confined);
    state.take(Report::Refused { writer: 1, reason: "a\u{1b}[2Jb".into(), occupied: true }, 5).expect("taken");
    let answer = state.answers.remove(&1).expect("an answer").expect_err("refused");
    assert!(answer.occupied && !answer.reason.contains('\u{1b}'), "{answer:?}");
    assert!(state.take(Report::Failed { reason: "x".repeat(9999) }, 5).expect_err("ends").len() <= 410);
}

/// One that joins domain 3, accepts its first topic, and stays; each run leaves a line in `runs`.
fn speaker() -> (tempfile::TempDir, PathBuf) {
    let say = r#"say() { printf "\\$(printf '%03o' ${#1})\\000\\000\\000\\000\\000\\000\\000%s" "$1"; }"#;
    let hello = format!(r#"{{"report":"hello","version":{VERSION},"domain":3,"confined":true}}"#);
    let lines = format!(
        "{say}\necho run >>\"${{0%/*}}/runs\"\nsay '{hello}'\nsay '{{\"report\":\"ready\",\"writer\":1}}'\nexec sleep 1000"
    );
    let (folder, path) = program(&lines);
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o777)).expect("allowed");
    (folder, path)
}

#[test]
fn a_program_that_dies_is_replaced_at_the_next_message() {
    let (folder, path) = speaker();
    let runs = || fs::read_to_string(folder.path().join("runs")).expect("read").lines().count();
    let mut publisher = Ros2Publisher::start(3, Some(&path)).expect("joins");
    let offer = Offer { reliable: true, latched: false, depth: 1 };
    let topic = Offered { name: "/a".into(), type_name: "std_msgs/msg/String".into(), encoding: 1, offer };
    let writer = publisher.advertise(&topic, 8, (false, false)).expect("answers").expect("accepted");
    assert!(publisher.publish(writer, &[0, 1, 0, 0]) && runs() == 1);
    publisher.run.kill();
    let end = publisher.run.wait(Duration::from_secs(60), |_| None::<()>);
    assert!(end.is_err(), "it has ended: {end:?}");
    let begun = Instant::now();
    while !publisher.publish(writer, &[0, 1, 0, 0]) {
        assert!(begun.elapsed() < Duration::from_secs(60), "nobody publishes any more");
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(runs() > 1, "another one publishes");
    assert_eq!(publisher.end(false).missed, 2, "nobody confirmed the message of either run");
}

#[test]
fn one_that_dies_at_each_start_is_started_ever_later() {
    let mut restarts = Restarts::begin();
    assert!(restarts.left() <= Duration::from_millis(50));
    for _ in 0..20 {
        restarts.again();
    }
    assert!(restarts.left() > Duration::from_secs(4) && restarts.left() <= Duration::from_secs(5));
}

fn program(lines: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    // Under root a script is run by nobody, who has to get to it.
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o755)).expect("allowed");
    let path = folder.path().join("authros-ros2");
    fs::write(&path, format!("#!/bin/sh\n{lines}\n")).expect("written");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("allowed");
    (folder, path)
}

#[test]
fn a_program_that_is_missing_or_none_is_told_of() {
    let missing = Ros2Publisher::start(0, Some("/nowhere/authros-ros2".as_ref())).err().expect("missing");
    assert!(
        matches!(missing, RosError::NoReader(_)) && missing.to_string().contains("install the package"),
        "{missing}"
    );
    for lines in ["exit 1", "echo this is no frame at all, but it is long enough"] {
        let (_folder, path) = program(lines);
        let error = Ros2Publisher::start(3, Some(&path)).err().expect("it does not join");
        assert_eq!(error.kind(), ErrorKind::Unreachable, "{error}");
        assert!(error.to_string().contains("domain 3"), "{error}");
    }
}
