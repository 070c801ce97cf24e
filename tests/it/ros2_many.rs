//! Much of ROS 2 at once: many topics of mixed QoS, and messages of eight megabytes, from a real DDS peer; all of it arrives, and
//! the memory of the program that reads stays bounded.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use serde_json::Value;
use support::keyless::process_of;
use support::process::own_memory;
use support::ros2::{Network, Talker, network};
use support::{Authros, Home, Running, count, heavy, long, skipped, text};

const READER: &str = "authros-ros2";
/// What the reading program keeps over all topics at most ("What to know" in `docs/ros2.md`), KiB.
const KEPT: u64 = 256 * 1024;
/// What a hundred topics of small messages may add to it, KiB.
const ADDED: u64 = 60 * 1024;

fn begin(network: &Network, home: &Home) -> (Running, Authros) {
    let site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(home);
    let alice = home.profile("alice");
    alice.enrol();
    (site, alice)
}

fn figures(summary: &Value) -> [u64; 3] {
    ["captured", "verified", "lost"].map(|figure| count(summary, figure))
}

fn memory_of_reader(site: &Running) -> u64 {
    own_memory(process_of(site, READER, "--domain").parse().expect("a process"))
}

#[test]
#[allow(clippy::print_stdout, reason = "figures for who runs the long form")]
fn many_topics_of_mixed_quality_arrive_whole_in_little_memory() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let (site, alice) = begin(&network, &home);
    let before = memory_of_reader(&site);
    let (topics, each) = if long() { (100, 80) } else { (30, 20) };
    let number = each.to_string();
    let names: Vec<String> = (1..=topics).map(|number| format!("/many/t{number}")).collect();
    let wanted: Vec<&str> = names.iter().flat_map(|name| ["--topic", name]).collect();
    let capture = alice.with(&["--json"]).spawn(&[&["capture", "--count", &number], &wanted[..]].concat());
    let flag = format!("topics{topics}");
    let mut talker = Talker::start(&network, &["/many/t", "string", &number, "10", "200", &flag]);
    assert_eq!(count(&talker.sent(120), "sent"), topics * each);
    let summary = capture.wait(240).expect_code(0).document();
    assert_eq!(figures(&summary), [topics * each, topics * each, 0], "{summary}");
    let view = alice.json(&["topics", "list"]);
    let qos = |name: &str| {
        support::list(&view, "topics").iter().find(|row| row["topic"] == name).map(|row| row["qos"].clone())
    };
    assert_eq!(qos("/many/t1"), Some("reliable volatile".into()), "{view}");
    assert_eq!(qos("/many/t2"), Some("best_effort volatile".into()), "{view}");
    let memory = memory_of_reader(&site);
    println!("{topics} topics: the program that reads held {before} KiB, then {memory} KiB");
    assert!(memory < before + ADDED, "the program that reads held {before} KiB, then {memory} KiB");
}

#[test]
#[allow(clippy::print_stdout, reason = "figures for who runs the long form")]
fn messages_of_eight_megabytes_arrive_byte_for_byte() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let (site, alice) = begin(&network, &home);
    let number = if long() { 100 } else { 3 };
    let count_text = number.to_string();
    let capture = alice.with(&["--json"]).spawn(&["capture", "--topic", "/camera", "--count", &count_text]);
    let mut camera = Talker::start(&network, &["/camera", "image", &count_text, "5", "8000000"]);
    let sent = camera.sent(240);
    let summary = capture.wait(240).expect_code(0).document();
    assert_eq!(figures(&summary), [number, number, 0], "{summary}");
    // Of a topic four messages are kept at least, however large they are, and each is once more on its way.
    let memory = memory_of_reader(&site);
    println!("{number} messages of 8 MB: the program that reads holds {memory} KiB");
    assert!(memory < KEPT, "the program that reads holds {memory} KiB");
    let mut records = alice.records(&["records", "list", "--oldest", "--topic", "/camera"]);
    records.sort_by_key(|record| count(record, "seq"));
    let (path, all) = (home.root().join("picture.bin"), home.root().join("all.bin"));
    let mut joined = fs::File::create(&all).expect("created");
    for record in &records {
        alice.json(&["records", "open", &text(record, "id"), "--out", path.to_str().expect("UTF-8")]);
        std::io::copy(&mut fs::File::open(&path).expect("written"), &mut joined).expect("copied");
        fs::remove_file(&path).expect("removed");
    }
    let found = support::process::output_of("sha256sum", &[all.to_str().expect("UTF-8")]);
    assert_eq!(found.split(' ').next(), sent["sha256"].as_str(), "header and body of every picture");
}
