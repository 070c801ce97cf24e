//! What is shown of a message of ROS 2 is what rclpy reads, bit by bit: every field in an opened record, in a JSON file, and
//! in an exported recording. The nodes are real; `tests/peers/ros2_shown.py` makes the values and compares.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::Value;
use support::ros2::{Network, python_with, reader_program};
use support::{Authros, Home, Running, count, is_verified, long, poll, skipped, text};

const PEER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_shown.py");

/// Messages of each type.
const EACH: u64 = 3;

fn peer(network: &Network, python: &Path, arguments: &[&str]) -> Running {
    let mut command = network.command(python);
    command.args(["-B", PEER]).args(arguments).env("ROS_DOMAIN_ID", "0");
    Running::start(command)
}

/// The records of what was sent, of those that are listed.
fn of_sent(records: Vec<Value>) -> Vec<Value> {
    records.into_iter().filter(|record| text(record, "topic").starts_with("/shown/")).collect()
}

/// Opens every record in both forms beside what was sent; returns how many there are.
fn open_all(alice: &Authros, folder: &Path) -> usize {
    let records = of_sent(alice.records(&["records", "list", "--oldest"]));
    let mut topics: BTreeMap<String, Vec<(u64, String)>> = BTreeMap::new();
    for record in &records {
        topics.entry(text(record, "topic")).or_default().push((count(record, "seq"), text(record, "id")));
    }
    for (topic, mut ids) in topics {
        let name = topic.trim_start_matches("/shown/").replace('/', ".");
        ids.sort();
        for (place, (_, id)) in ids.iter().enumerate() {
            let view = alice.json(&["records", "open", id]);
            fs::write(folder.join(format!("{name}.{place}.view.json")), view.to_string()).expect("written");
            let file = folder.join(format!("{name}.{place}.json"));
            alice.json(&["records", "open", id, "--out", file.to_str().expect("UTF-8")]);
        }
    }
    records.len()
}

fn expect_shown_as_sent(distribution: &str, seed: &str) {
    let Some(python) = python_with(distribution).filter(|_| reader_program().is_some()) else {
        skipped!("no rclpy in target/peers; tests/run installs it");
    };
    let Some(network) = Network::new() else { skipped!("this machine gives no network namespace") };
    let home = Home::new();
    let folder = home.root().join("sent");
    fs::create_dir(&folder).expect("created");
    let which: &[&str] = if long() { &["types", "all"] } else { &["types"] };
    let listed = peer(&network, &python, which).wait(60).expect_code(0).stdout;
    let types: Vec<&str> = listed.lines().collect();
    assert!(types.len() >= 30, "{types:?}");

    let _site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    let path = folder.to_str().expect("UTF-8");
    let each = EACH.to_string();
    let mut talker = peer(&network, &python, &[&["publish", path, seed, &each], &types[..]].concat());
    talker.wait_for_text("ready", 120);
    let watched = types.iter().map(|name| format!("/shown/{name}"));
    watched.for_each(|topic| drop(alice.json(&["topics", "watch", &topic])));
    let expected = types.len() * usize::try_from(EACH).expect("few");
    let all = || {
        let records = of_sent(alice.records_so_far(&["records", "list", "--oldest"])?);
        (records.len() >= expected && records.iter().all(is_verified)).then_some(())
    };
    let so_far = || of_sent(alice.records(&["records", "list", "--oldest"])).len();
    poll(180, all).unwrap_or_else(|| panic!("{} of {expected} records are verified", so_far()));

    // The definitions of types that are not built in come from the node; the messages before them are shown by them too.
    let own = |id: &str| alice.json(&["records", "open", id])["message"].is_object();
    let mut without: Vec<Value> = of_sent(alice.records(&["records", "list", "--oldest"]));
    let mut all_have = || {
        without.retain(|record| !own(&text(record, "id")));
        without.is_empty().then_some(())
    };
    let done = poll(60, &mut all_have);
    assert!(
        done.is_some(),
        "without fields: {:?}",
        without.iter().map(|record| text(record, "topic")).collect::<Vec<_>>()
    );
    assert_eq!(open_all(&alice, &folder), expected);
    let recording = folder.join("export.mcap");
    let recording = recording.to_str().expect("UTF-8");
    alice.json_within(240, &["bag", "export", "--mcap", recording, "--compression", "none", "--topic", "/shown/**"]);
    let compared = peer(&network, &python, &["compare", path]).wait(120).expect_code(0).document();
    assert_eq!(compared["differ"], 0, "{compared:#}");
    for way in ["file", "view", "export"] {
        assert!(count(&compared["made"], way) >= expected as u64, "{way}: {compared}");
    }
}

#[test]
fn what_is_shown_of_every_type_is_what_a_node_of_jazzy_reads() {
    expect_shown_as_sent("jazzy", "1");
}

#[test]
fn what_is_shown_of_every_type_is_what_a_node_of_kilted_reads() {
    expect_shown_as_sent("kilted", "2");
}
