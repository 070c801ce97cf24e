//! The other DDS of the field, eProsima Fast DDS (the distribution's 2.9, between those of Humble and Jazzy), as a publisher
//! with ROS 2's names: every message arrives, byte for byte.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use support::ros2::{Talker, network};
use support::{Authros, Home, count, heavy, long, skipped, system_program, text};

/// The peer, compiled if its source is newer; `None` without compiler or library.
fn peer() -> Option<PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/ros2_fastdds.cpp");
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ros2_fastdds");
    let compiler = system_program("g++")?;
    if !Path::new("/usr/include/fastdds").is_dir() {
        return None;
    }
    let changed = |path: &Path| fs::metadata(path).and_then(|about| about.modified()).ok();
    if changed(&program) < changed(&source) {
        let mut command = Command::new(compiler);
        command.args(["-std=c++17", "-O1", "-o"]).args([&program, &source]).args(["-lfastrtps", "-lfastcdr"]);
        assert!(command.status().expect("the compiler runs").success(), "the peer compiles");
    }
    Some(program)
}

fn figures(summary: &Value) -> [u64; 3] {
    ["captured", "verified", "lost"].map(|figure| count(summary, figure))
}

/// The bodies of all records of a topic in the order of their numbers.
fn bodies(alice: &Authros, home: &Home, topic: &str) -> Vec<u8> {
    let mut records = alice.records(&["uploads", "list", "--topic", topic]);
    records.sort_by_key(|record| count(record, "seq"));
    let path = home.root().join("body.bin");
    let mut all = Vec::new();
    for record in &records {
        alice.json(&["shared", "open", &text(record, "id"), "--out", path.to_str().expect("UTF-8")]);
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
    let Some(peer) = peer() else { skipped!("no g++ with libfastrtps-dev") };
    let home = Home::new();
    let _site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    let (fast, pictures) = if long() { (5000, 100) } else { (2000, 10) };
    let copy = |name: &str| home.root().join(name).to_str().expect("UTF-8").to_owned();
    for (topic, kind, number, hertz, size, flag) in [
        ("/fast", "string", fast, "1000", "100", ""),
        ("/loose", "string", fast, "1000", "100", "best_effort"),
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
