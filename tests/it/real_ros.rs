//! With the distribution's own ROS: a recorded robot captured message by message, late publishers, a new master.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::Path;
use std::time::Instant;

use serde_json::Value;
use support::{
    Authros, Home, Roscore, at, count, heavy, hex, is_verified, list, long, poll, read_bag, robot_recording, skipped,
    text, wait_until,
};

const ODOMETRY: &str = "/jackal_velocity_controller/odom";
const INERTIA: &str = "/imu/data";
const NO_ROS: &str = "no roscore, rosbag and rostopic in /usr/bin";

/// Numbers of an odometry message, as `rostopic echo` prints them.
const FIELDS: [&str; 12] = [
    "header.seq",
    "header.stamp.secs",
    "header.stamp.nsecs",
    "pose.pose.position.x",
    "pose.pose.position.y",
    "pose.pose.orientation.z",
    "pose.pose.orientation.w",
    "pose.covariance.0",
    "pose.covariance.35",
    "twist.twist.linear.x",
    "twist.twist.angular.z",
    "twist.covariance.0",
];

/// Like [`at`], with numbers as indices of arrays.
fn field(message: &Value, path: &str) -> f64 {
    let pointer = format!("/{}", path.replace('.', "/"));
    message.pointer(&pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number '{path}' in {message}"))
}

fn equal(left: f64, right: f64) -> bool {
    (left - right).abs() <= 1e-12 * left.abs().max(right.abs())
}

fn by_seq(mut records: Vec<Value>) -> Vec<Value> {
    records.sort_by_key(|record| count(record, "seq"));
    records
}

/// Plays the bag at a rate, captures for a few seconds, and compares the result with the bag itself.
fn expect_the_bag(bag: &Path, roscore: &Roscore, rate: u32, seconds: u32) {
    let home = Home::new();
    let _site = home.authros().with(&["--ros-master", &roscore.uri()]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    let duration = format!("{seconds}s");
    let capture = ["capture", "--topic", ODOMETRY, "--topic", INERTIA, "--for", &duration];
    let capture = alice.with(&["--json"]).spawn(&capture);
    // Nobody publishes yet: capture waits for the topics.
    let player = roscore.play(bag, rate);
    player.wait(u64::from(seconds)).expect_code(0);
    let summary = capture.wait(u64::from(seconds) + 240).expect_code(0).document();
    assert_eq!(
        (count(&summary, "captured"), count(&summary, "verified"), count(&summary, "lost")),
        (6121, 6121, 0),
        "{summary}"
    );

    alice.json(&["grant", "add", &bob_address]);
    let held = read_bag(bag);
    for topic in [ODOMETRY, INERTIA] {
        let own = by_seq(alice.records(&["records", "list", "--oldest", "--topic", topic]));
        let bodies = list(&held[topic], "bodies");
        let lengths = |records: &[Value]| records.iter().map(|record| count(record, "bytes")).collect::<Vec<_>>();
        let expected: Vec<u64> =
            bodies.iter().map(|body| u64::try_from(body.as_str().expect("hex").len() / 2).expect("small")).collect();
        assert_eq!(lengths(&own), expected, "{topic}");
        assert!(own.iter().all(|record| record["type"] == held[topic]["type"] && is_verified(record)));
        let shared = by_seq(bob.records(&["received", "list", "--oldest", "--topic", topic]));
        assert_eq!(lengths(&shared), expected, "{topic}, as the grantee sees it");
        let step = if long() { 60 } else { 600 };
        for index in (0..shared.len()).step_by(step).chain([shared.len() - 1]) {
            expect_message(&home, &bob, &shared[index], &bodies[index], &held[topic]["messages"][index]);
        }
    }
}

/// What the grantee opens is the bag's message: the same bytes, and for odometry the same numbers.
fn expect_message(home: &Home, reader: &Authros, record: &Value, body: &Value, message: &Value) {
    let id = text(record, "id");
    let path = home.root().join("message");
    let opened = reader.json(&["records", "open", &id, "--out", path.to_str().expect("UTF-8")]);
    assert_eq!(opened["verdict"], "verified", "{opened}");
    assert_eq!(hex(&fs::read(&path).expect("written")), body.as_str().expect("hex"), "{record}");
    fs::remove_file(&path).expect("removed");
    if record["topic"] == ODOMETRY {
        for path in FIELDS {
            let (ours, theirs) = (field(&opened["message"], path), field(message, path));
            assert!(equal(ours, theirs), "{path}: {ours}, but rospy reads {theirs}");
        }
    }
}

#[test]
fn a_bag_played_at_twenty_times_its_speed_is_captured_whole() {
    let _alone = heavy();
    let Some(bag) = robot_recording() else { skipped!(NO_ROS) };
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    expect_the_bag(&bag, &roscore, 20, 20);
}

#[test]
fn a_bag_played_at_its_own_speed_is_captured_whole() {
    if !long() {
        return; // Takes over a minute: `tests/run --long`.
    }
    let _alone = heavy();
    let Some(bag) = robot_recording() else { skipped!(NO_ROS) };
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    expect_the_bag(&bag, &roscore, 1, 80);
}

#[test]
fn a_topic_that_nobody_publishes_yet_is_waited_for() {
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    let home = Home::new();
    let authros = home.authros().with(&["--ros-master", &roscore.uri()]);
    let mut capture = authros.with(&["--json"]).spawn(&["capture", "--topic", "/late", "--count", "5"]);
    wait_until(60, "the site is up", || {
        capture.expect_running();
        home.socket()
    });
    let topics = list(&authros.json(&["topics", "list"]), "topics");
    assert!(topics.iter().all(|topic| topic["simulated"] == false), "no simulated robots beside real ones: {topics:?}");
    let _publisher = roscore.publish("/late", "std_msgs/String", "data: better late", 10);
    let summary = capture.wait(60).expect_code(0).document();
    assert_eq!(
        (count(&summary, "captured"), count(&summary, "verified"), count(&summary, "lost")),
        (5, 5, 0),
        "{summary}"
    );
    assert_eq!(summary["topics"][0]["type"], "std_msgs/String");
    let records = authros.records(&["records", "list", "--oldest"]);
    let opened = authros.json(&["records", "open", &text(&records[0], "id")]);
    assert_eq!(opened["message"]["data"], "better late", "{opened}");
    assert_eq!(opened["simulated"], false);
}

#[test]
fn a_topic_of_another_type_than_asked_for_is_not_captured() {
    let _alone = heavy();
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    let home = Home::new();
    let _publisher = roscore.publish("/words", "std_msgs/String", "data: words", 10);
    wait_until(60, "it is published", || (!roscore.publishers("/words").is_empty()).then_some(()));
    let authros = home.authros().with(&["--ros-master", &roscore.uri(), "--json"]);
    let outcome = authros.run(&["capture", "--topic", "/words", "--type", "nav_msgs/Odometry", "--for", "6s"]);
    assert!(matches!(outcome.code, Some(3 | 5 | 8)), "{outcome}");
    assert_eq!(outcome.document()["captured"].as_u64().unwrap_or(0), 0, "{outcome}");
    assert!(count(&outcome.document(), "skipped") > 0, "what was left out is counted: {outcome}");
    assert!(outcome.stderr.contains("different type"), "and told: {outcome}");
}

#[test]
fn a_capture_survives_a_new_master() {
    let Some(mut roscore) = Roscore::start() else { skipped!(NO_ROS) };
    let home = Home::new();
    let authros = home.authros().with(&["--ros-master", &roscore.uri()]);
    let _site = authros.serve(&home);
    authros.enrol();
    let first = roscore.publish("/beat", "std_msgs/UInt32", "data: 1", 10);
    authros.run(&["topics", "watch", "/beat"]).expect_code(0);
    let arrived = |value: f64| {
        let newest = authros.json(&["records", "list", "--limit", "1"]);
        let record = list(&newest, "records").first().cloned()?;
        let opened = authros.run(&["records", "open", &text(&record, "id"), "--json"]);
        let opened = (opened.code == Some(0)).then(|| opened.document())?;
        equal(at(&opened["message"], "data"), value).then_some(())
    };
    assert!(poll(60, || arrived(1.0)).is_some(), "the first publisher is captured");
    drop(first);
    roscore.restart();
    let begun = Instant::now();
    let _second = roscore.publish("/beat", "std_msgs/UInt32", "data: 2", 10);
    assert!(poll(60, || arrived(2.0)).is_some(), "what the new master knows is captured");
    println!("the master is back: its publisher is captured and opened after {:?}", begun.elapsed());
}
