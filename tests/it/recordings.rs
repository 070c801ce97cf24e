//! Recordings in all their parts: what lies beside the messages, files without messages or without an index, numbers as
//! they were sent.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use authros::model::Timestamp;
use authros::ros::bag::BagWriter;
use authros::ros::mcap::{McapReader, McapWriter};
use authros::ros::recording::{BESIDE, Beside, Channel, ChunkCompression, Encoding, RecordingReader as _};
use serde_json::{Value, json};
use support::ros2::{beside_by_others, others_can_read};
use support::{Authros, Home, count, list, skipped, text, two_profiles};

const INCOMPLETE: i32 = 8;
/// Written by the format's Python library: twelve messages, an attachment, a metadata record.
const FOREIGN: &str = "labs/fuzz/corpus/mcap/foreign_none";

fn foreign() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(FOREIGN)
}

fn utf8(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// Type, and MCAP's own bytes, of all that a file holds beside its messages.
fn beside(path: &Path) -> Vec<(String, Vec<u8>)> {
    let mut reader = McapReader::open(BufReader::new(File::open(path).expect("a file"))).expect("MCAP");
    let mut found = Vec::new();
    while let Some(message) = reader.next_message().expect("readable") {
        if &*message.channel.topic == BESIDE {
            found.push((message.channel.type_name.to_string(), message.body));
        }
    }
    assert!(reader.findings().is_whole(), "{:?}", reader.findings());
    found.sort();
    found
}

fn attachments(authros: &Authros, of: &str) -> Vec<Value> {
    authros.records(&[of, "list", "--oldest", "--kind", "attachment"])
}

/// An attachment in MCAP's own bytes.
fn attachment(name: &str, data: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    [1_700_000_000_000_000_007_u64, 1_600_000_000_000_000_001].iter().for_each(|time| out.extend(time.to_le_bytes()));
    for text in [name, "application/x-yaml"] {
        out.extend(u32::try_from(text.len()).expect("short").to_le_bytes());
        out.extend(text.as_bytes());
    }
    out.extend((data.len() as u64).to_le_bytes());
    out.extend(data);
    // Nobody computed a checksum.
    out.extend([0; 4]);
    out
}

/// Metadata in MCAP's own bytes; a name may occur twice, in any order.
fn metadata(name: &str, entries: &[(&str, &str)]) -> Vec<u8> {
    let put = |out: &mut Vec<u8>, text: &str| {
        out.extend(u32::try_from(text.len()).expect("short").to_le_bytes());
        out.extend(text.as_bytes());
    };
    let (mut out, mut map) = (Vec::new(), Vec::new());
    put(&mut out, name);
    entries.iter().flat_map(|(key, value)| [key, value]).for_each(|text| put(&mut map, text));
    out.extend(u32::try_from(map.len()).expect("short").to_le_bytes());
    out.extend(map);
    out
}

fn channel(topic: &str, type_name: &str, md5sum: &str, definition: &str) -> Arc<Channel> {
    Arc::new(Channel {
        topic: topic.into(),
        type_name: type_name.into(),
        md5sum: md5sum.into(),
        definition: definition.into(),
        caller_id: "/teller".into(),
        latching: false,
        encoding: Encoding::Ros1,
        about: BTreeMap::new(),
    })
}

fn words() -> Arc<Channel> {
    channel("/words", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n")
}

#[test]
fn what_an_mcap_file_holds_beside_its_messages_comes_out_as_it_went_in() {
    let two = two_profiles(0);
    let root = two.home.root().to_owned();
    let summary = two.alice.json_within(240, &["bag", "import", utf8(&foreign())]);
    let figures = ["imported", "verified", "attachments", "skipped"].map(|field| count(&summary, field));
    assert_eq!(figures, [12, 12, 2, 0], "{summary}");
    let topics = list(&summary, "topics");
    let row = topics.iter().find(|topic| topic["topic"] == BESIDE).expect("a row of their own");
    assert_eq!((count(row, "imported"), count(row, "verified")), (2, 2), "{summary}");
    let again = two.alice.json_within(240, &["bag", "import", utf8(&foreign())]);
    assert_eq!((count(&again, "imported"), count(&again, "already"), count(&again, "attachments")), (0, 12, 2));
    let own = attachments(&two.alice, "records");
    assert_eq!(own.len(), 2, "sealed once: {own:?}");
    assert!(own.iter().all(|record| record["kind"] == "attachment" && record["topic"] == BESIDE), "{own:?}");

    // A grant of one topic covers no attachment, a grant of all topics does.
    let carol = two.home.profile("carol");
    let carol_address = carol.enrol();
    two.alice.json(&["grant", "add", &carol_address, "--topic", "/count"]);
    two.alice.json(&["grant", "add", &two.bob_address]);
    assert!(attachments(&carol, "received").is_empty());
    assert_eq!(attachments(&two.bob, "received").len(), 2);
    let exported = root.join("back.mcap");
    let view = two.bob.json_within(240, &["bag", "export", "--mcap", utf8(&exported)]);
    assert_eq!((count(&view, "messages"), count(&view, "attachments")), (12, 2), "{view}");
    assert_eq!(beside(&exported), beside(&foreign()), "byte for byte");
    // A bag has no room for them, and says so.
    let bag = root.join("back.bag");
    let outcome = two.alice.with(&["--json"]).run(&["bag", "export", "--bag", utf8(&bag)]);
    let view = outcome.expect_code(INCOMPLETE).document();
    assert_eq!((count(&view, "messages"), count(&view["refused"], "attachments")), (12, 2), "{view}");
    two.alice.json_within(240, &["bag", "export", "--bag", utf8(&root.join("topics.bag")), "--topic", "/**"]);

    // Erasing the recording erases them.
    let tags = list(&two.alice.json(&["records", "open", &text(&own[0], "id")]), "tags");
    let tag = tags.iter().find(|tag| tag[0] == "recording").and_then(|tag| tag[1].as_str()).expect("a tag").to_owned();
    let erased = two
        .alice
        .json_within(240, &["records", "erase", "--recording", &tag, "--reason", "the customer asked for it", "--yes"]);
    assert_eq!((count(&erased, "named"), &erased["deleted"]), (14, &json!(true)), "{erased}");
    for record in &own {
        assert_ne!(two.alice.run(&["records", "open", &text(record, "id")]).code, Some(0), "{record}");
    }
}

#[test]
fn an_attachment_is_shown_as_what_it_is_and_written_as_the_file_that_was_attached() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    let (file, data) = (home.root().join("run.mcap"), b"%YAML:1.0\nfocal: 0.0029\n\x00\xff");
    let mut writer = McapWriter::begin(Cursor::new(Vec::new()), ChunkCompression::Lz4).expect("begun");
    let facts = metadata("rig", &[("z", "last"), ("a", "first"), ("z", "again")]);
    let put = |writer: &mut McapWriter<_>, kind: Beside, body: &[u8]| {
        writer.write(&Arc::new(kind.channel()), Timestamp(0), body).expect("written");
    };
    put(&mut writer, Beside::Metadata, &facts);
    writer.write(&words(), Timestamp(1_700_000_000_000_000_000), b"\x02\0\0\0hi").expect("written");
    put(&mut writer, Beside::Attachment, &attachment("left \u{1b}[31m.yaml", data));
    put(&mut writer, Beside::Attachment, &attachment("empty", b""));
    fs::write(&file, writer.finish().expect("finished").into_inner()).expect("written");

    let summary = authros.json_within(240, &["bag", "import", utf8(&file)]);
    assert_eq!((count(&summary, "imported"), count(&summary, "attachments")), (1, 3), "{summary}");
    let records = attachments(&authros, "records");
    let opened: Vec<Value> =
        records.iter().map(|record| authros.json(&["records", "open", &text(record, "id")])).collect();
    let of = |name: &str| {
        let found = opened.iter().find(|view| text(&view["message"], "name").starts_with(name));
        found.unwrap_or_else(|| panic!("{name} in {opened:?}"))
    };
    let (left, rig) = (of("left"), of("rig"));
    assert_eq!((count(&left["message"], "bytes"), &left["type"]), (26, &json!("authros/Attachment")), "{left}");
    assert_eq!(left["message"]["media_type"], "application/x-yaml", "{left}");
    assert_eq!(count(&left["message"], "created_at"), 1_600_000_000_000_000_001, "beyond 2^53, and exact");
    assert!(!text(&left["message"], "name").contains('\u{1b}'), "{left}");
    assert!(text(left, "captured_at").starts_with("2023-11-14T22:13:20"), "its log time: {left}");
    assert_eq!(rig["message"]["entries"], json!([["z", "last"], ["a", "first"], ["z", "again"]]), "in its order");
    assert!(text(rig, "captured_at").starts_with("2023-11-14T22:13:20"), "that of the recording: {rig}");

    let out = home.root().join("left.yaml");
    authros.run(&["records", "open", &text(left, "id"), "--out", utf8(&out)]).expect_code(0);
    assert_eq!(fs::read(&out).expect("written"), data, "the file that was attached");
    let out = home.root().join("rig.json");
    authros.run(&["records", "open", &text(rig, "id"), "--out", utf8(&out)]).expect_code(0);
    let written: Value = serde_json::from_slice(&fs::read(&out).expect("written")).expect("JSON");
    assert_eq!(written, rig["message"]);

    let exported = home.root().join("back.mcap");
    authros.json_within(240, &["bag", "export", "--mcap", utf8(&exported)]);
    assert_eq!(beside(&exported), beside(&file));
    assert!(beside(&exported).iter().any(|(_, body)| *body == facts));
    if !others_can_read() {
        skipped!("no mcap in target/peers; tests/run installs it");
    }
    let (was, is) = (beside_by_others(&file), beside_by_others(&exported));
    assert_eq!((was.len(), &was), (3, &is), "what the format's own library finds by the summary");
}

#[test]
fn a_sound_recording_without_messages_is_no_failure() {
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let authros = home.authros();
    authros.enrol();
    let memory = || Cursor::new(Vec::new());
    let bag = BagWriter::begin(memory(), ChunkCompression::None).expect("begun").finish().expect("finished");
    let mcap = McapWriter::begin(memory(), ChunkCompression::None).expect("begun").finish().expect("finished");
    for (name, bytes) in [("empty.bag", bag.into_inner()), ("empty.mcap", mcap.into_inner())] {
        let file = home.root().join(name);
        fs::write(&file, bytes).expect("written");
        let outcome = authros.run(&["bag", "import", utf8(&file)]).expect_code(0);
        assert!(outcome.stderr.contains("contains no messages"), "{name}: {}", outcome.stderr);
    }
    // Other than a choice that fits nothing.
    let outcome = authros.run(&["bag", "import", utf8(&foreign()), "--topic", "/nothing"]).expect_code(INCOMPLETE);
    assert!(outcome.stderr.contains("no messages of these topics"), "{}", outcome.stderr);
}

#[test]
fn a_bag_without_an_index_says_that_its_recorder_was_killed() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    let mut writer = BagWriter::begin(Cursor::new(Vec::new()), ChunkCompression::None).expect("begun");
    writer.write(&words(), Timestamp(1_700_000_000_000_000_000), b"\x02\0\0\0hi").expect("written");
    let mut bytes = writer.finish().expect("finished").into_inner();
    let place = bytes.windows(10).position(|at| at == b"index_pos=").expect("a header") + 10;
    let index = u64::from_le_bytes(bytes[place..place + 8].try_into().expect("8 bytes"));
    bytes.truncate(usize::try_from(index).expect("usize"));
    bytes[place..place + 8].fill(0);
    let file = home.root().join("killed.bag");
    fs::write(&file, bytes).expect("written");
    let summary = authros.json_within(240, &["bag", "import", utf8(&file)]);
    assert_eq!((count(&summary, "imported"), &summary["unfinished"]), (1, &json!(true)), "{summary}");
    let outcome = authros.run(&["bag", "import", utf8(&file), "--again"]).expect_code(0);
    assert!(outcome.stderr.contains("its recorder was killed"), "{}", outcome.stderr);
}

#[test]
fn numbers_of_a_message_survive_the_answer_of_a_site() {
    const FLOATS: u64 = 400;
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let authros = home.authros();
    authros.enrol();
    // A fixed seed; about one double in ten is another one when it is read carelessly.
    let mut chance = 0x9e37_79b9_7f4a_7c15_u64;
    let mut wide = Vec::new();
    while wide.len() < usize::try_from(FLOATS).expect("usize") {
        chance ^= chance << 13;
        chance ^= chance >> 7;
        chance ^= chance << 17;
        let number = f64::from_bits(chance);
        let odd = (chance >> 11).to_string().parse::<f64>().expect("a number") / 9_007_199.254_740_992;
        wide.extend([number, odd].into_iter().filter(|number| number.is_finite()));
    }
    #[allow(clippy::cast_possible_truncation, reason = "that is what a float32 holds")]
    let narrow: Vec<f32> = wide.iter().map(|number| (number % 1e30) as f32).collect();
    let mut body = Vec::new();
    body.extend(u32::try_from(wide.len()).expect("few").to_le_bytes());
    wide.iter().for_each(|number| body.extend(number.to_le_bytes()));
    body.extend(u32::try_from(narrow.len()).expect("few").to_le_bytes());
    narrow.iter().for_each(|number| body.extend(number.to_le_bytes()));
    body.extend(u64::MAX.to_le_bytes());
    body.extend(i64::MIN.to_le_bytes());
    let definition = "float64[] wide\nfloat32[] narrow\nuint64 most\nint64 least\n";
    let numbers = channel("/numbers", "rig_msgs/Numbers", "*", definition);
    let mut writer = BagWriter::begin(Cursor::new(Vec::new()), ChunkCompression::None).expect("begun");
    writer.write(&numbers, Timestamp(1_700_000_000_000_000_000), &body).expect("written");
    let file = home.root().join("numbers.bag");
    fs::write(&file, writer.finish().expect("finished").into_inner()).expect("written");
    authros.json_within(240, &["bag", "import", utf8(&file)]);

    let id = text(&authros.records(&["records", "list", "--oldest"])[0], "id");
    let out = home.root().join("numbers.json");
    authros.run(&["records", "open", &id, "--out", utf8(&out)]).expect_code(0);
    let written: Value = serde_json::from_slice(&fs::read(&out).expect("written")).expect("JSON");
    for (from, message) in [("--json", &authros.json(&["records", "open", &id])["message"]), ("--out", &written)] {
        let bits = |field: &str| -> Vec<u64> {
            list(message, field).iter().map(|number| number.as_f64().expect("a number").to_bits()).collect()
        };
        let sent: Vec<u64> = wide.iter().map(|number| number.to_bits()).collect();
        assert!(bits("wide") == sent, "{from}: float64");
        let sent: Vec<u64> = narrow.iter().map(|number| f64::from(*number).to_bits()).collect();
        assert!(bits("narrow") == sent, "{from}: float32");
        assert_eq!((&message["most"], &message["least"]), (&json!(u64::MAX), &json!(i64::MIN)), "{from}");
    }
}
