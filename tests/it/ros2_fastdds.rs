//! The other DDS of the field, eProsima Fast DDS (the distribution's 2.9, between those of Humble and Jazzy), as a publisher
//! with ROS 2's names: every message arrives, byte for byte.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use serde_json::Value;
use support::ros2::{NO_FAST_DDS, Talker, fast_dds, network};
use support::{Authros, Home, count, heavy, long, skipped, text};

fn figures(summary: &Value) -> [u64; 3] {
    ["captured", "verified", "lost"].map(|figure| count(summary, figure))
}

/// The bodies of all records of a topic in the order of their numbers.
fn bodies(alice: &Authros, home: &Home, topic: &str) -> Vec<u8> {
    let mut records = alice.records(&["records", "list", "--oldest", "--topic", topic]);
    records.sort_by_key(|record| count(record, "seq"));
    let path = home.root().join("body.bin");
    let mut all = Vec::new();
    for record in &records {
        alice.json(&["records", "open", &text(record, "id"), "--out", path.to_str().expect("UTF-8")]);
        all.extend(fs::read(&path).expect("written"));
        fs::remove_file(&path).expect("removed");
    }
    all
}

#[test]
fn messages_of_fast_dds_arrive_whole_reliable_or_not_small_or_large() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let Some(peer) = fast_dds("ros2_fastdds") else { skipped!(NO_FAST_DDS) };
    let home = Home::new();
    let _site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    let (fast, pictures) = if long() { (5000, 100) } else { (2000, 10) };
    let copy = |name: &str| home.root().join(name).to_str().expect("UTF-8").to_owned();
    for (topic, kind, number, hertz, size, flag) in [
        ("/fast", "string", fast, "1000", "100", ""),
        ("/loose", "string", fast, "200", "100", "best_effort"),
        ("/camera", "image", pictures, "10", "1000000", ""),
    ] {
        let number_text = number.to_string();
        let capture = alice.with(&["--json"]).spawn(&["capture", "--topic", topic, "--count", &number_text]);
        let file = copy(kind);
        let mut talker = Talker::by(&network, &peer, &[topic, kind, &number_text, hertz, size, &file, flag]);
        assert_eq!(count(&talker.sent(60), "sent"), number);
        let summary = capture.wait(240).expect_code(0).document();
        assert_eq!(figures(&summary), [number, number, 0], "{topic}: {summary}");
    }
    assert!(bodies(&alice, &home, "/camera") == fs::read(copy("image")).expect("its copy"), "the same bytes");
}
