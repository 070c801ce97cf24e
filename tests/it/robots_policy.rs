//! Robots as code: what a robot captures is set from its owner's site, taken up at its next contact, kept over a crash,
//! and seen as drift until then.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use crate::robots::{Robot, Site, when};
use serde_json::Value;
use support::{Authros, count, heavy, list, text, wait_until};

const INPUT: i32 = 3;
const WATCHED: &str = "/robot1/odom";
const UNWATCHED: &str = "/robot1/camera/compressed";

fn row(owner: &Authros, name: &str) -> Value {
    let robots = owner.json(&["robot", "list"]);
    let found = list(&robots, "robots").into_iter().find(|row| text(row, "name") == name);
    found.unwrap_or_else(|| panic!("no robot {name}: {robots}"))
}

fn version(figures: &Value) -> u64 {
    figures["policy"]["version"].as_u64().unwrap_or_default()
}

/// The publisher numbers its messages; the first four bytes of each say which it is.
fn takes_every_second(alice: &Authros, site: &Site, records: &[Value]) {
    let number = |record: &Value| {
        let id = text(record, "id");
        let path = site.home.root().join(format!("{id}.bin"));
        alice.run(&["records", "open", &id, "--out", path.to_str().expect("UTF-8")]).expect_code(0);
        let body = std::fs::read(path).expect("written");
        (count(record, "seq"), u32::from_le_bytes(body[..4].try_into().expect("a header")))
    };
    let mut numbers: Vec<(u64, u32)> = records.iter().map(number).collect();
    numbers.sort_unstable();
    let steps: Vec<(u64, u32)> = numbers.windows(2).map(|two| (two[1].0 - two[0].0, two[1].1 - two[0].1)).collect();
    assert!(
        steps.iter().all(|step| *step == (1, 2)),
        "its own numbers follow each other, the publisher's skip one: {numbers:?}"
    );
}

#[test]
fn a_robot_works_by_the_policy_of_its_owner_and_its_drift_is_seen() {
    let _alone = heavy();
    let site = Site::new();
    let alice = site.owner("alice");
    let robot = Robot::enrol(&site, &alice, "scout", &[WATCHED, UNWATCHED]);
    let before = row(&alice, "scout");
    assert_eq!((text(&before, "standing"), &before["drift"]), ("none".to_owned(), &Value::Bool(false)), "{before}");

    let file = site.home.root().join("scout.toml");
    let place = file.to_str().expect("UTF-8");
    let set = |policy: &str| std::fs::write(&file, policy).expect("written");
    set("cache.url = \"redis://elsewhere\"\n");
    let told = alice.fails(INPUT, &["robot", "policy", "scout", "--set", place]);
    assert!(told.contains("cache.url"), "{told}");
    assert_eq!(row(&alice, "scout")["wanted"], 0, "what is not valid is not sent");

    // Set while the robot is away: drift until its next contact.
    set(&format!(
        "ring.keep = \"\"\nring.topics = \"\"\n[[watch]]\ntopic = \"{UNWATCHED}\"\n\
         [[topic]]\nmatch = \"{UNWATCHED}\"\nevery = 2\n"
    ));
    alice.json(&["robot", "policy", "scout", "--set", place]);
    let drifting = row(&alice, "scout");
    assert_eq!((count(&drifting, "wanted"), &drifting["drift"]), (1, &Value::Bool(true)), "{drifting}");
    assert_eq!((text(&drifting, "standing"), drifting["drift_since"].is_null()), ("waiting".to_owned(), false));

    let agent = robot.run("5m, 64MiB", "[\"/robot1/camera/**\"]");
    when(&agent, "the policy is taken up", |figures| version(figures) == 1);
    let in_force = wait_until(120, "the owner hears of it", || {
        let row = row(&alice, "scout");
        (text(&row, "standing") == "in force").then_some(row)
    });
    assert_eq!((count(&in_force, "running"), &in_force["drift"]), (1, &Value::Bool(false)), "{in_force}");
    let taken = wait_until(120, "what the policy watches arrives", || {
        let records = alice.records(&["records", "list", "--oldest", "--topic", UNWATCHED]);
        (records.len() >= 6).then_some(records)
    });
    takes_every_second(&alice, &site, &taken);
    let odometry = alice.records(&["records", "list", "--oldest", "--topic", WATCHED]).len();
    let shown = alice.json(&["robot", "show", "scout"]);
    let overruled = shown["overruled"].to_string();
    assert!(overruled.contains("ring") && overruled.contains("300s"), "its own ring does not count: {shown}");
    assert!(text(&shown, "policy").contains("every = 2"), "{shown}");
    let topics = list(&shown, "topics");
    assert!(topics.iter().any(|topic| text(topic, "topic") == UNWATCHED && count(topic, "records") >= 3), "{shown}");
    let camera = topics.iter().find(|topic| text(topic, "topic") == UNWATCHED).expect("there");
    assert!(text(camera, "strip").contains('█') && text(camera, "first") <= text(camera, "last"), "{shown}");
    assert!(text(&shown["covered"], "since") <= text(camera, "first"), "{shown}");
    let told = alice.run(&["robot", "show", "scout"]).expect_code(0).stdout;
    assert!(told.contains(" per sign: █ recorded"), "{told}");
    // A report may come between the two questions.
    wait_until(60, "the list to count the losses of all topics", || {
        let shown = alice.json(&["robot", "show", "scout"]);
        let lost: u64 = list(&shown, "topics").iter().map(|topic| count(topic, "lost")).sum();
        (count(&row(&alice, "scout"), "lost") == lost && count(&shown, "lost") == lost).then_some(())
    });

    // Without a chance to write anything, and with its own settings as before.
    agent.stop("KILL", 10);
    let agent = robot.run("5m, 64MiB", "[\"/robot1/camera/**\"]");
    when(&agent, "it is there again", |figures| count(figures, "captured") > 0 && version(figures) == 1);

    // A rule of its own again.
    alice.json(&["robot", "policy", "scout", "--clear"]);
    when(&agent, "cleared", |figures| version(figures) == 2);
    wait_until(120, "what its own settings watch arrives again", || {
        let records = alice.records(&["records", "list", "--oldest", "--topic", WATCHED]);
        (records.len() > odometry).then_some(())
    });
    when(&agent, "and its own ring fills", |figures| {
        figures["ring"]["messages"].as_u64().is_some_and(|messages| messages > 0)
    });
    agent.stop("TERM", 30).expect_code(0);
    let lines = alice.json(&["audit", "list", "--limit", "1000"]).to_string();
    assert!(lines.contains("robot policy"), "who set it and when is in the audit log");
}
