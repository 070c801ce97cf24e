//! ROS 2 recordings: a foreign one is imported, its messages are viewed, and it is exported unchanged.
//! `tests/peers/ros2_messages.py` generated it with mcap-ros2-support and rosbags.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use authros::ros::mcap::McapReader;
use authros::ros::recording::{RecordedMessage, RecordingReader as _};
use serde_json::{Value, json};
use support::ros2::{others_can_read, read_by_others};
use support::{Authros, Home, count, list, skipped, text};

fn recording() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/ros2.mcap")
}

fn utf8(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// A record of each topic, opened.
fn opened(authros: &Authros) -> BTreeMap<String, Value> {
    let records = authros.records(&["records", "list", "--oldest"]);
    records
        .iter()
        .map(|record| (text(record, "topic"), authros.json(&["records", "open", &text(record, "id")])))
        .collect()
}

fn field(opened: &Value, path: &str) -> String {
    let fields = list(opened, "fields");
    let found = fields.iter().find(|field| field[0] == path).unwrap_or_else(|| panic!("{path} in {opened}"));
    found[1].as_str().expect("a text").to_owned()
}

/// A line of the readable form.
fn line(opened: &Value, label: &str) -> String {
    let lines = list(&opened["readable"], "lines");
    let found = lines.iter().find(|line| line[0] == label).unwrap_or_else(|| panic!("{label} in {opened}"));
    found[1].as_str().expect("a text").to_owned()
}

#[test]
fn messages_of_ros_2_are_looked_at_like_those_of_ros_1() {
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    let summary = alice.json_within(240, &["bag", "import", utf8(&recording())]);
    assert_eq!((count(&summary, "imported"), count(&summary, "verified")), (7, 7), "{summary}");
    assert_eq!(list(&summary, "damages"), Vec::<Value>::new());
    let opened = opened(&alice);

    assert_eq!(opened["/chatter"]["message"], json!({"data": "hello from ROS 2"}));
    assert_eq!(field(&opened["/odom"], "header.stamp.sec"), "1700000000");
    assert_eq!(line(&opened["/odom"], "Stamp (UTC)"), "2023-11-14T22:13:20.000Z (1700000000.000000005)");
    assert_eq!(line(&opened["/odom"], "Pose, m"), "x 1.5  y -2.25  z 0");
    assert_eq!(line(&opened["/scan"], "Beams"), "200, of these 200 in range");
    assert_eq!(list(&opened["/scan"]["readable"]["plot"], "points").len(), 200);
    assert_eq!(opened["/tf_static"]["readable"]["tables"][0]["rows"][0][1], "laser");
    assert_eq!(opened["/latched"]["message"], json!({"data": "kept /latched"}));
    assert!(opened.values().all(|view| view["topic"] == "/idl" || view["note"].is_null()), "{opened:?}");

    // The picture and the matrix are unchanged: bytes 0, 1, 2 ... of 251.
    let id = text(&opened["/camera"], "id");
    let numbers: Vec<u8> = (0..288_u32).map(|number| u8::try_from(number % 251).expect("a byte")).collect();
    let matrix = home.root().join("camera.npy");
    alice.run(&["records", "open", &id, "--out", utf8(&matrix)]).expect_code(0);
    let npy = fs::read(&matrix).expect("written");
    assert!(npy.ends_with(&numbers) && support::holds(&npy, b"'shape': (8, 12, 3)"), "{} bytes", npy.len());
    let png = home.root().join("camera.png");
    alice.run(&["records", "open", &id, "--out", utf8(&png)]).expect_code(0);
    let mut picture = png::Decoder::new(BufReader::new(File::open(&png).expect("written"))).read_info().expect("a PNG");
    let mut pixels = vec![0; picture.output_buffer_size().expect("small")];
    picture.next_frame(&mut pixels).expect("a picture");
    assert_eq!(pixels, numbers);
    let whole = home.root().join("scan.json");
    alice.run(&["records", "open", &text(&opened["/scan"], "id"), "--out", utf8(&whole)]).expect_code(0);
    let whole: Value = serde_json::from_slice(&fs::read(&whole).expect("written")).expect("JSON");
    assert_eq!((list(&whole, "ranges").len(), &whole["header"]["frame_id"]), (200, &json!("base_link")));

    comes_out_as_it_went_in(&alice, &home);
}

/// Topic, times, number, bytes, and the channel's metadata.
fn read(path: &Path) -> Vec<RecordedMessage> {
    let mut reader = McapReader::open(BufReader::new(File::open(path).expect("a file"))).expect("MCAP");
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message().expect("readable") {
        messages.push(message);
    }
    assert!(reader.findings().is_whole(), "{:?}", reader.findings());
    messages.sort_by_key(|message| message.time);
    messages
}

fn comes_out_as_it_went_in(alice: &Authros, home: &Home) {
    let exported = home.root().join("out.mcap");
    let view = alice.json_within(240, &["bag", "export", "--mcap", utf8(&exported)]);
    assert_eq!(count(&view, "messages"), 7, "{view}");
    let (was, is) = (read(&recording()), read(&exported));
    assert_eq!(was, is);
    let sent: Vec<_> = is.iter().map(|message| message.sent.expect("MCAP says it")).collect();
    assert_eq!(sent.iter().map(|sent| sent.sequence).collect::<Vec<_>>(), [40, 41, 42, 43, 44, 7, 8]);
    assert!(is.iter().zip(&sent).take(5).all(|(message, sent)| message.time.0 - sent.time.0 == 777));
    let latched = &is[5].channel.about;
    assert!(latched["offered_qos_profiles"].contains("transient_local"), "{latched:?}");
    assert!(latched["topic_type_hash"].starts_with("RIHS01_df668c74"), "{latched:?}");
}

#[test]
fn what_is_exported_reads_the_same_to_others_as_what_was_imported() {
    if !others_can_read() {
        skipped!("no mcap in target/peers; tests/run installs it");
    }
    let home = Home::new();
    let summary = home.authros().json_within(240, &["bag", "import", utf8(&recording())]);
    assert_eq!(count(&summary, "verified"), 7, "{summary}");
    let exported = home.root().join("out.mcap");
    home.authros().json_within(240, &["bag", "export", "--mcap", utf8(&exported)]);
    let sorted = |path: &Path| {
        let mut messages = read_by_others(path);
        messages.sort_by_key(|message| (count(message, "logged"), text(message, "topic")));
        messages
    };
    let (was, is) = (sorted(&recording()), sorted(&exported));
    assert_eq!(was, is);
    let chatter = is.iter().find(|message| message["topic"] == "/chatter").expect("it is there");
    assert!(text(chatter, "decoded").contains("data=hello from ROS 2"), "{chatter}");
}

#[test]
fn what_a_recording_describes_in_idl_is_read_by_the_definitions_of_this_machine_or_by_those_built_in() {
    let home = Home::new();
    let summary = home.authros().json_within(240, &["bag", "import", utf8(&recording()), "--topic", "/idl"]);
    assert_eq!(count(&summary, "verified"), 1, "{summary}");
    let id = text(&home.authros().records(&["records", "list", "--oldest"])[0], "id");
    let share = home.root().join("jazzy/share/std_msgs/msg");
    fs::create_dir_all(&share).expect("created");
    let there = home.authros().with_variable("AMENT_PREFIX_PATH", utf8(&home.root().join("jazzy")));
    let opened = |authros: &Authros, source: &str| {
        let view = authros.json(&["records", "open", &id]);
        assert_eq!(view["message"], json!({"data": "kept /idl"}), "{view}");
        let note = text(&view, "note");
        assert!(note.contains(source) && note.contains("its type hash matches the message"), "{view}");
    };
    opened(&home.authros(), "built into this program");
    fs::write(share.join("String.msg"), "# The text.\nstring data\n").expect("written");
    opened(&there, "installed on this machine");
    // Another definition with that name is not accepted for it.
    fs::write(share.join("String.msg"), "string<=5 data\n").expect("written");
    opened(&there, "built into this program");
}
