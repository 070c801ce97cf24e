//! Recordings: imported with their own times, shared, exported, played by real rosbag; damaged ones; rules for topics.
#![allow(clippy::print_stdout, reason = "figures that the run shows")]
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::Value;
use support::{
    Authros, Home, Roscore, Two, count, heavy, hex, list, list_bag, long, make_bag, read_bag, robot_recording, skipped,
    system_program, text, two_profiles, wait_until, write_bag,
};

const NO_ROS: &str = "no roscore, rosbag and rostopic in /usr/bin";
const INCOMPLETE: i32 = 8;
const TAMPERED: i32 = 6;

fn path(two: &Two, name: &str) -> PathBuf {
    two.home.root().join(name)
}

fn utf8(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn import(authros: &Authros, path: &Path) -> Value {
    authros.json_within(900, &["bag", "import", utf8(path)])
}

fn export(authros: &Authros, path: &Path, options: &[&str]) -> Value {
    let format = if path.extension().is_some_and(|end| end == "mcap") { "--mcap" } else { "--bag" };
    authros.json_within(900, &[&["bag", "export", format, utf8(path)], options].concat())
}

/// A bag's messages in any order: topic, type, md5sum, definition, time and bytes; the caller if known.
fn sorted(mut entries: Vec<Value>) -> Vec<Value> {
    entries.sort_by_key(ToString::to_string);
    entries
}

#[test]
fn a_recorded_robot_is_imported_shared_exported_and_played_message_by_message() {
    let _alone = heavy();
    let Some(bag) = robot_recording() else { skipped!(NO_ROS) };
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    let two = two_profiles(0);
    let summary = import(&two.alice, &bag);
    let held = read_bag(&bag);
    let topics = ["/imu/data", "/jackal_velocity_controller/odom"];
    let all: usize = topics.iter().map(|topic| list(&held[topic], "bodies").len()).sum();
    let figures = ["imported", "verified", "already", "skipped"].map(|field| count(&summary, field));
    assert_eq!(figures, [all as u64, all as u64, 0, 0], "{summary}");

    two.alice.json(&["grant", "add", &two.bob_address]);
    let exported = path(&two, "exported.bag");
    let written = export(&two.bob, &exported, &["--compression", "lz4"]);
    assert_eq!(count(&written, "messages"), all as u64, "{written}");
    let (was, is) = (sorted(list_bag(&bag)), sorted(list_bag(&exported)));
    assert!(was == is, "types, definitions, times and bytes");

    let heard = roscore.play_to_subscriber(&exported, 20, all, &topics);
    for topic in topics {
        assert!(heard[topic] == held[topic]["bodies"], "{topic}: what is heard is what was recorded");
    }
}

#[test]
fn bags_of_every_compression_come_back_as_they_were() {
    if system_program("rosbag").is_none() {
        skipped!(NO_ROS);
    }
    let two = two_profiles(0);
    for compression in ["none", "bz2", "lz4"] {
        let bag = path(&two, &format!("{compression}.bag"));
        write_bag(&bag, compression, 60);
        let tag = format!("mission={compression}");
        let summary = two.alice.json_within(240, &["bag", "import", utf8(&bag), "--tag", &tag, "--again"]);
        assert_eq!((count(&summary, "imported"), count(&summary, "verified")), (126, 126), "{summary}");
    }
    // One import after the other: the same messages three times.
    let all = path(&two, "all.bag");
    let written = export(&two.alice, &all, &["--compression", "bz2"]);
    assert_eq!(count(&written, "messages"), 3 * 126, "{written}");
    let expected = list_bag(&path(&two, "none.bag"));
    let three = sorted([&expected[..], &expected[..], &expected[..]].concat());
    assert!(sorted(list_bag(&all)) == three, "every field of every message");
    let words = path(&two, "words.bag");
    let written = export(&two.alice, &words, &["--topic", "/w*", "--until", "2023-11-14T22:13:21Z"]);
    assert_eq!((count(&written, "messages"), list(&written, "topics").len()), (15, 1), "{written}");
    support::process::output_of("/usr/bin/rosbag", &["info", utf8(&words)]);
    // An existing file is not overwritten.
    two.alice.fails(3, &["bag", "export", "--bag", utf8(&words)]);

    let opened = two.alice.records(&["records", "list", "--oldest", "--topic", "/words"]);
    let opened = two.alice.json(&["records", "open", &text(&opened[0], "id")]);
    assert_eq!(opened["caller_id"], "/talker", "{opened}");
    let tags = opened["tags"].to_string();
    assert!(tags.contains("source") && tags.contains("mission") && tags.contains("recording"), "{tags}");
    assert!(text(&opened, "captured_at").starts_with("2023-11-14T22:13:20"), "{opened}");
}

#[test]
fn damaged_bags_are_read_as_far_as_they_are_readable_and_nothing_twice() {
    if system_program("rosbag").is_none() {
        skipped!(NO_ROS);
    }
    let two = two_profiles(0);
    let good = path(&two, "good.bag");
    write_bag(&good, "lz4", 300);
    let bytes = fs::read(&good).expect("a bag");
    let known = list_bag(&good);
    let damaged = |name: &str, change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = bytes.clone();
        change(&mut bytes);
        let path = path(&two, name);
        fs::write(&path, bytes).expect("written");
        let outcome = two.alice.with(&["--json"]).spawn(&["bag", "import", utf8(&path)]).wait(240);
        let code = outcome.code;
        (code, outcome.document())
    };
    let (code, summary) = damaged("flipped.bag", &|bytes| {
        // In the data of a chunk: between the chunks are indexes, which nobody needs.
        let chunks: Vec<usize> =
            (0..bytes.len() - 15).filter(|at| bytes[*at..].starts_with(b"compression=lz4")).collect();
        bytes[chunks[chunks.len() / 2] + 200] ^= 4;
    });
    assert_eq!((code, list(&summary, "damages").len()), (Some(INCOMPLETE), 1), "{summary}");
    assert!((100..630).contains(&count(&summary, "verified")), "{summary}");
    let (code, summary) = damaged("cut.bag", &|bytes| bytes.truncate(bytes.len() * 2 / 3));
    assert_eq!(code, Some(INCOMPLETE), "{summary}");
    assert!((100..630).contains(&count(&summary, "verified")), "{summary}");
    // Everything that came out of the damaged ones is in the good one.
    let part = path(&two, "part.mcap");
    export(&two.alice, &part, &["--compression", "zstd"]);
    let back = path(&two, "back.bag");
    let other = two.home.profile("carol");
    other.enrol();
    import(&other, &part);
    export(&other, &back, &[]);
    assert!(list_bag(&back).iter().all(|message| known.contains(message)), "nothing but what was recorded");

    let (code, summary) = damaged("unindexed.bag", &|bytes| {
        let index = bytes.windows(10).position(|at| at == b"index_pos=").expect("a header") + 10;
        bytes[index..index + 8].fill(0);
    });
    assert_eq!((code, count(&summary, "verified")), (Some(0), 630), "{summary}");
    // The very same file again.
    let again = import(&two.alice, &path(&two, "unindexed.bag"));
    assert_eq!((count(&again, "imported"), count(&again, "already")), (0, 630), "{again}");
    let no_bag = two.home.file("no.bag", "#ROSBAG V1.2\n", 0o600);
    assert!(two.alice.fails(3, &["bag", "import", &no_bag]).contains("version"));
}

#[test]
fn an_import_that_is_cut_goes_on_where_it_was() {
    let _alone = heavy();
    if system_program("rosbag").is_none() {
        skipped!(NO_ROS);
    }
    let two = two_profiles(0);
    let bag = path(&two, "long.bag");
    write_bag(&bag, "none", 2000);
    let cut = two.alice.with(&["--json"]).spawn(&["bag", "import", utf8(&bag)]);
    let sealed = || two.alice.records(&["records", "list", "--oldest", "--topic", "/odom"]).len();
    wait_until(60, "the first messages are sealed", || (sealed() > 0).then_some(()));
    let exported = path(&two, "exported.bag");
    two.site.stop("KILL", 60);
    cut.wait(60);
    let _site = two.home.authros().with(&["--robots", "0"]).serve(&two.home);
    let summary = import(&two.alice, &bag);
    let (imported, already) = (count(&summary, "imported"), count(&summary, "already"));
    assert_eq!(imported + already, 4200, "{summary}");
    wait_until(120, "all is verified", || {
        let verified = two.alice.records(&["records", "list", "--oldest", "--state", "verified"]).len();
        (verified == 4200).then_some(())
    });
    export(&two.alice, &exported, &[]);
    assert!(sorted(list_bag(&exported)) == sorted(list_bag(&bag)), "each message once");
    println!("cut after {already} of 4200 messages");
}

/// Imports a bag in a separate process and kills that after this long; returns how much is sealed then.
fn cut_import(authros: &Authros, bag: &Path, after: Duration) -> usize {
    let import = authros.spawn(&["bag", "import", utf8(bag)]);
    std::thread::sleep(after);
    import.signal("KILL");
    drop(import.wait(60));
    authros.records(&["records", "list", "--oldest"]).len()
}

#[test]
fn two_recordings_are_never_taken_for_each_other_however_often_one_is_cut() {
    let _alone = heavy();
    if system_program("rosbag").is_none() {
        skipped!(NO_ROS);
    }
    let (messages, cuts) = if long() { (20_000, 20) } else { (1_000, 2) };
    // A fixed seed: points spread over the whole import.
    let mut chance = 0x2545_f491_4f6c_dd1d_u64;
    for _ in 0..cuts {
        let home = Home::new();
        let authros = home.authros().with(&["--robots", "0"]);
        let bags = ["1", "2"].map(|seed| {
            let bag = home.root().join(format!("run-{seed}.bag"));
            make_bag(&["simulated", utf8(&bag), &messages.to_string(), seed]);
            bag
        });
        let begun = Instant::now();
        assert_eq!(count(&import(&authros, &bags[0]), "imported"), messages);
        let (before, whole) = (authros.records(&["records", "list", "--oldest"]).len(), begun.elapsed());
        chance = chance.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let after = cut_import(&authros, &bags[1], whole.mul_f64(f64::from((chance >> 33) as u32) / 2_147_483_648.0));
        let summary = import(&authros, &bags[1]);
        let (imported, already) = (count(&summary, "imported"), count(&summary, "already"));
        println!("cut at {} of {messages}: {already} were sealed, {imported} came then", after - before);
        assert_eq!(imported + already, messages, "{summary}");
        assert_eq!(count(&import(&authros, &bags[1]), "already"), messages, "a third time nothing is sealed");
        // What was sealed before the kill is anchored by whichever site runs next.
        let site = authros.serve(&home);
        wait_until(900, "all is verified", || (authros.json(&["status"])["life"]["pending"] == 0).then_some(()));
        site.stop("INT", 60);
        let exported = home.root().join("all.bag");
        export(&authros, &exported, &[]);
        let recorded = bags.iter().flat_map(|bag| list_bag(bag)).collect();
        assert!(sorted(list_bag(&exported)) == sorted(recorded), "each message of both once");
    }
}

#[test]
fn topics_by_names_that_ros_does_not_know_are_imported_and_come_back_under_them() {
    if system_program("rosbag").is_none() {
        skipped!(NO_ROS);
    }
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    let bag = home.root().join("named.bag");
    make_bag(&["named", utf8(&bag)]);
    let summary = authros.with(&["--json"]).run(&["bag", "import", utf8(&bag)]).expect_code(INCOMPLETE).document();
    let topics: Vec<String> = list(&summary, "topics").iter().map(|topic| text(topic, "topic")).collect();
    assert_eq!(topics, ["/ORB_SLAM", "/ORB_SLAM_2", "/_1num", "/foo", "/foo/bar", "/ok"], "{summary}");
    assert_eq!((count(&summary, "imported"), count(&summary, "skipped")), (18, 3), "{summary}");
    let left_out = list(&summary, "left_out");
    assert!(left_out.len() == 1 && count(&left_out[0], "messages") == 3, "{summary}");
    assert_eq!(text(&left_out[0], "why"), "its topic name is longer than 255 bytes");
    let exported = home.root().join("back.bag");
    export(&authros, &exported, &[]);
    let mut recorded = sorted(list_bag(&bag));
    recorded.retain(|entry| entry[0].as_str().is_some_and(|topic| topic.len() < 300));
    assert!(sorted(list_bag(&exported)) == recorded, "under the names that were recorded");
}

#[test]
fn an_import_needs_no_running_site() {
    let home = Home::new();
    let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("labs/fuzz/corpus/mcap/foreign_none");
    let summary = import(&home.authros(), &recording);
    assert_eq!((count(&summary, "imported"), count(&summary, "verified")), (12, 12), "{summary}");
    let exported = home.root().join("out.mcap");
    assert_eq!(count(&export(&home.authros(), &exported, &["--compression", "lz4"]), "messages"), 12);
}

#[test]
fn what_was_tampered_with_or_is_not_shared_is_never_exported() {
    let two = two_profiles(0);
    let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("labs/fuzz/corpus/mcap/foreign_lz4");
    let summary = import(&two.alice, &recording);
    assert_eq!((count(&summary, "imported"), count(&summary, "verified")), (12, 12), "{summary}");
    two.bob.fails(5, &["bag", "export", "--mcap", utf8(&path(&two, "b.mcap")), "--owner", &two.alice_address]);
    let nothing = two.bob.with(&["--json"]).run(&["bag", "export", "--mcap", utf8(&path(&two, "b.mcap"))]);
    assert_eq!(count(&nothing.expect_code(INCOMPLETE).document(), "messages"), 0);

    two.alice.json(&["grant", "add", &two.bob_address, "--topic", "/count"]);
    let first = text(&two.alice.records(&["records", "list", "--oldest"])[0], "digest");
    spoil(&two.home, &first);
    let spoiled = path(&two, "spoiled.mcap");
    let outcome = two.bob.with(&["--json"]).run(&["bag", "export", "--mcap", utf8(&spoiled)]);
    let document = outcome.expect_code(TAMPERED).document();
    assert_eq!((count(&document, "messages"), count(&document["refused"], "tampered")), (11, 1), "{document}");
    assert_eq!(list(&document, "suspicious").len(), 1);
    // Everyone reads what was written as it was recorded.
    let carol = two.home.profile("carol");
    carol.enrol();
    let back = import(&carol, &spoiled);
    assert_eq!(count(&back, "verified"), 11, "{back}");

    // ROS 2: raw CDR, kept unchanged, only in MCAP.
    let cdr = Path::new(env!("CARGO_MANIFEST_DIR")).join("labs/fuzz/corpus/mcap/foreign_zstd");
    let dave = two.home.profile("dave");
    dave.enrol();
    assert_eq!(count(&import(&dave, &cdr), "verified"), 12);
    let outcome = dave.with(&["--json"]).run(&["bag", "export", "--bag", utf8(&path(&two, "cdr.bag"))]);
    assert_eq!(count(&outcome.expect_code(INCOMPLETE).document()["refused"], "unsuitable"), 12);
    let mcap = path(&two, "cdr.mcap");
    assert_eq!(count(&export(&dave, &mcap, &[]), "messages"), 12);
    let bytes = fs::read(&mcap).expect("written");
    assert!(
        support::holds(&bytes, b"ros2msg") && support::holds(&bytes, b"std_msgs/msg/UInt32"),
        "{}",
        hex(&bytes[..64])
    );
}

/// Changes one byte of a record's ciphertext in the store.
fn spoil(home: &Home, digest: &str) {
    let store = home.path().join("ledger.db");
    let script = "import sqlite3, sys\n\
                  store = sqlite3.connect(sys.argv[1], timeout=30)\n\
                  key = bytes.fromhex(sys.argv[2])\n\
                  (n, blob) = store.execute('SELECT record, ciphertext.bytes FROM ciphertext JOIN records ON n = record WHERE digest = ?', (key,)).fetchone()\n\
                  blob = blob[:-1] + bytes([blob[-1] ^ 1])\n\
                  store.execute('UPDATE ciphertext SET bytes = ? WHERE record = ?', (blob, n))\n\
                  store.commit()\n";
    support::process::output_of("/usr/bin/python3", &["-c", script, utf8(&store), digest]);
}

#[test]
fn rules_thin_out_topics_and_say_so() {
    let home = Home::new();
    fs::create_dir_all(home.path()).expect("a home");
    let rules = "[[topic]]\nmatch = \"/robot*/odom\"\ntype = \"nav_msgs/Odometry\"\nevery = 4\n\
                 tags = { mission = \"harbour\" }\nretention = \"30d\"\n\n[[topic]]\nmatch = \"/nobody/**\"\nrate = 1\n";
    let config = home.path().join("config.toml");
    fs::write(&config, rules).expect("written");
    let _site = home.authros().with(&["--robots", "1"]).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    alice.capture(&["/robot1/odom"], 10);
    let row = |document: &Value| {
        let topics = list(document, "topics");
        topics.into_iter().find(|row| row["topic"] == "/robot1/odom").expect("the topic")
    };
    let topics = alice.json(&["topics", "list"]);
    let (left_out, lost) = (count(&row(&topics), "left_out"), count(&row(&topics), "lost_in_recorder"));
    assert!((27..=200).contains(&left_out) && lost == 0, "three of four, and not lost: {left_out}");
    let sealed = alice.records(&["records", "list", "--oldest"]);
    let seqs: Vec<f64> = sealed
        .iter()
        .map(|record| alice.json(&["records", "open", &text(record, "id")]))
        .map(|opened| {
            assert!(opened["tags"].to_string().contains("harbour"), "{opened}");
            support::at(&opened["message"], "header.seq")
        })
        .collect();
    assert!(seqs.windows(2).all(|pair| (pair[1] - pair[0] - 4.0).abs() < 1e-9), "every fourth: {seqs:?}");
    let policy = alice.json(&["topics", "rules"]);
    assert_eq!(row(&policy)["rule"]["line"], 1, "{policy}");
    assert_eq!(list(&policy, "idle").len(), 1, "{policy}");

    let other = Home::new();
    fs::create_dir_all(other.path()).expect("a home");
    fs::write(other.path().join("config.toml"), "robots = 1\n[[topic]]\nmatch = \"/a\"\nrate = 0\n").expect("written");
    let told = other.authros().fails(3, &["config", "check"]);
    assert!(told.contains("config.toml line 4"), "{told}");
}
