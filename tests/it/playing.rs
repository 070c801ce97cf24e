//! Shared records in the reader's own ROS: what a real recorder receives there, when it ends, and what is never played.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::path::Path;

use authros::store::{Ciphertext, Ledger};
use serde_json::Value;
use support::{
    Anvil, Authros, Console, Home, Roscore, Running, Terminal, count, heavy, is_verified, list, list_bag, long,
    make_bag, skipped, text, two_profiles, wait_until,
};

const NO_ROS: &str = "no roscore, rosbag and rostopic in /usr/bin";
const NO_NODE: &str = "no anvil; tests/run installs it into target/peers";
const TOPICS: [&str; 3] = ["/odom", "/words", LATCHED];
const LATCHED: &str = "/calibration";
const ODOM: &str = "/robot1/odom";
const INCOMPLETE: i32 = 8;
const REFUSED: i32 = 5;

/// The content of a bag per topic: type, md5sum, definition and bytes, in order.
fn messages(bag: &Path, topic: &str) -> Vec<Value> {
    let all = list_bag(bag).into_iter().filter(|entry| entry[0] == topic);
    all.map(|entry| Value::from(vec![entry[1].clone(), entry[2].clone(), entry[4].clone(), entry[6].clone()])).collect()
}

fn expect_same(recorded: &Path, original: &Path, times: usize) {
    for topic in TOPICS {
        let expected = vec![messages(original, topic); times].concat();
        let heard = messages(recorded, topic);
        assert_eq!(heard.len(), expected.len(), "{topic}");
        assert!(heard == expected, "{topic}: the same bytes, md5sum, type and definition in the same order");
    }
}

/// A site on one graph with two profiles, of which the first watches the topics.
struct Plant {
    home: Home,
    _site: Running,
    alice: Authros,
    bob: Authros,
    bob_address: String,
}

fn plant(robot: &Roscore, topics: &[&str]) -> Plant {
    let home = Home::new();
    let site = home.authros().with(&["--ros-master", &robot.uri()]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    for topic in topics {
        alice.json(&["topics", "watch", topic]);
    }
    Plant { home, _site: site, alice, bob, bob_address }
}

/// Plays the bag at the robot until all of it is verified for the `times`-th time.
fn drive(robot: &Roscore, plant: &Plant, bag: &Path, times: usize) {
    // Another name would be another publisher than the pinned one, and be quarantined.
    robot.play_as("robot", bag, 2).wait(120).expect_code(0);
    let expected = list_bag(bag).len() * times;
    wait_until(120, "all is verified", || {
        let records = plant.alice.records(&["records", "list", "--oldest"]);
        (records.len() == expected && records.iter().all(is_verified)).then_some(())
    });
}

fn is_played(graph: &Roscore, topic: &str) -> Option<()> {
    graph.publishers(topic).contains("/authros_play_").then_some(())
}

#[test]
fn a_real_recorder_in_the_reader_s_graph_hears_what_the_robot_said() {
    let _alone = heavy();
    let (Some(robot), Some(reader)) = (Roscore::start(), Roscore::start()) else { skipped!(NO_ROS) };
    let plant = plant(&robot, &TOPICS);
    let path = |name: &str| plant.home.root().join(name);
    let bag = path("drive.bag");
    make_bag(&["latched", bag.to_str().expect("UTF-8")]);
    drive(&robot, &plant, &bag, 1);

    let refused = plant.bob.fails(REFUSED, &["received", "play", "--to", &reader.uri()]);
    assert!(refused.contains("shares"), "without a grant there is nothing to play: {refused}");
    plant.alice.json(&["grant", "add", &plant.bob_address]);
    let refused = plant.bob.fails(REFUSED, &["received", "play"]);
    assert!(refused.contains("--prefix"), "a loop is refused: {refused}");

    let ways: [(&str, &[&str]); 3] = [("at-once", &[]), ("paced", &["--as-captured"]), ("fast", &["--rate", "10"])];
    for (name, how) in ways {
        let recorded = &path(&format!("{name}.bag"));
        let recorder = reader.record(recorded, &TOPICS);
        let uri = reader.uri();
        let arguments = [&["--json", "received", "play", "--to", &uri], how].concat();
        let played = plant.bob.spawn(&arguments).wait(120).expect_code(0).document();
        let figures = ["published", "refused", "missing", "dropped"].map(|figure| count(&played, figure));
        assert_eq!(figures, [list_bag(&bag).len() as u64, 0, 0, 0], "{played}");
        assert_eq!(played["ended_by"], "whole");
        Roscore::stop_recording(recorder);
        expect_same(recorded, &bag, 1);
    }
}

#[test]
fn pictures_of_a_megabyte_arrive_at_ten_a_second() {
    let _alone = heavy();
    let (Some(robot), Some(reader)) = (Roscore::start(), Roscore::start()) else { skipped!(NO_ROS) };
    let plant = plant(&robot, &["/camera"]);
    let path = |name: &str| plant.home.root().join(name);
    let (bag, recorded) = (path("camera.bag"), path("played.bag"));
    let number = if long() { "100" } else { "15" };
    make_bag(&["pictures", bag.to_str().expect("UTF-8"), number]);
    drive(&robot, &plant, &bag, 1);
    plant.alice.json(&["grant", "add", &plant.bob_address]);
    let recorder = reader.record(&recorded, &["/camera"]);
    let arguments = ["--json", "received", "play", "--to", &reader.uri(), "--as-captured"].map(str::to_owned);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let played = plant.bob.spawn(&arguments).wait(120).expect_code(0).document();
    assert_eq!(count(&played, "published").to_string(), number, "{played}");
    Roscore::stop_recording(recorder);
    let (heard, said) = (messages(&recorded, "/camera"), messages(&bag, "/camera"));
    assert_eq!(heard.len().to_string(), number);
    assert!(heard == said, "the same bytes in the same order");
}

#[test]
fn what_is_played_live_ends_with_the_grant_and_late_subscribers_get_what_was_latched() {
    let _alone = heavy();
    let (Some(robot), Some(reader)) = (Roscore::start(), Roscore::start()) else { skipped!(NO_ROS) };
    let plant = plant(&robot, &TOPICS);
    let path = |name: &str| plant.home.root().join(name);
    let bag = path("drive.bag");
    make_bag(&["latched", bag.to_str().expect("UTF-8")]);
    drive(&robot, &plant, &bag, 1);
    plant.alice.json(&["grant", "add", &plant.bob_address]);

    let live = path("live.bag");
    let recorder = reader.record(&live, &["/odom", "/words"]);
    let mut player = plant.bob.spawn(&["--json", "received", "play", "--follow", "--to", &reader.uri()]);
    wait_until(60, "the latched topic is there", || {
        player.expect_running();
        is_played(&reader, LATCHED)
    });
    let calibration: Vec<Value> = messages(&bag, LATCHED).into_iter().map(|message| message[3].clone()).collect();
    let latched = list(&reader.hear(1, &[LATCHED]), LATCHED);
    assert!(!latched.is_empty() && latched.iter().all(|message| calibration.contains(message)), "{latched:?}");

    let ear = reader.listen(messages(&bag, "/odom").len() + messages(&bag, "/words").len(), &["/odom", "/words"]);
    drive(&robot, &plant, &bag, 2);
    ear.wait(120).expect_code(0);
    assert_eq!(list(&reader.hear(1, &[LATCHED]), LATCHED).last(), calibration.last(), "the last one is latched");
    let revoked = plant.alice.json(&["grant", "end", &plant.bob_address]);
    assert!(revoked["transaction"].is_string(), "{revoked}");
    let played = player.wait(60).expect_code(REFUSED).document();
    assert_eq!((&played["ended_by"], count(&played, "refused")), (&"revoked".into(), 0), "{played}");
    assert_eq!(reader.publishers(LATCHED), "", "nobody publishes it any more");
    // What comes after the revoke is never received.
    drive(&robot, &plant, &bag, 3);
    Roscore::stop_recording(recorder);
    for topic in ["/odom", "/words"] {
        assert!(messages(&live, topic) == messages(&bag, topic), "{topic}: what was verified live, and nothing after");
    }
}

#[test]
fn a_simulated_robot_is_played_live_until_the_revoke() {
    let two = two_profiles(1);
    two.alice.json(&["topics", "watch", ODOM]);
    two.alice.json(&["grant", "add", &two.bob_address]);
    let mut player =
        two.bob.spawn(&["--json", "received", "play", "--follow", "--prefix", "/shared/alice", "--topic", ODOM]);
    let played = format!("/shared/alice{ODOM}");
    wait_until(60, "it is published", || {
        player.expect_running();
        let topics = list(&two.bob.json(&["topics", "list"]), "topics");
        topics.iter().any(|topic| topic["topic"] == played.as_str()).then_some(())
    });
    two.alice.json(&["grant", "end", &two.bob_address]);
    let ended = player.wait(60).expect_code(REFUSED).document();
    assert_eq!(ended["ended_by"], "revoked", "{ended}");
    assert!(count(&ended, "published") > 0, "{ended}");
    let is_silent = |topic: &Value| topic["publishers"].as_array().is_some_and(Vec::is_empty);
    wait_until(30, "nobody publishes it any more", || {
        let topics = list(&two.bob.json(&["topics", "list"]), "topics");
        topics.iter().all(|topic| topic["topic"] != played.as_str() || is_silent(topic)).then_some(())
    });
}

#[test]
fn nothing_played_live_is_left_out_when_another_reader_s_grant_ends() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "1", "--chain", &node.http()]).serve(&home);
    let [alice, bob, carol, dave] = ["alice", "bob", "carol", "dave"].map(|name| home.profile(name));
    let [_, to_bob, to_carol, to_dave] = [&alice, &bob, &carol, &dave].map(|profile| {
        let address = text(&profile.json(&["identity", "create"]), "address");
        node.fund(&address);
        profile.json(&["identity", "register"]);
        address
    });
    alice.json(&["topics", "watch", ODOM]);
    for reader in [&to_bob, &to_carol, &to_dave] {
        alice.json(&["grant", "add", reader]);
    }
    let prefix = "/shared/alice";
    let mut player = bob.spawn(&["--json", "received", "play", "--follow", "--prefix", prefix, "--topic", ODOM]);
    let played = format!("{prefix}{ODOM}");
    wait_until(60, "it is published", || {
        player.expect_running();
        let topics = list(&bob.json(&["topics", "list"]), "topics");
        topics.iter().any(|topic| topic["topic"] == played.as_str()).then_some(())
    });
    // With each an epoch begins, under which records are sealed and verified before its key is with those who may read on.
    node.set_interval(1);
    for reader in [&to_carol, &to_dave] {
        alice.json(&["grant", "end", reader]);
        let verified = || alice.records(&["records", "list", "--oldest", "--state", "verified"]).len();
        let before = verified();
        wait_until(60, "more is verified", || Some(()).filter(|()| verified() >= before + 5));
    }
    player.expect_running();
    alice.json(&["grant", "end", &to_bob]);
    let ended = player.wait(60).expect_code(REFUSED).document();
    let figures = ["refused", "missing", "dropped"].map(|figure| count(&ended, figure));
    assert_eq!((&ended["ended_by"], figures), (&"revoked".into(), [0, 0, 0]), "{ended}");
}

#[test]
fn a_key_of_the_console_plays_the_topic_of_a_shared_record_and_ends_that() {
    let two = two_profiles(1);
    two.alice.capture(&[ODOM], 3);
    two.alice.json(&["grant", "add", &two.bob_address]);
    two.alice.json(&["topics", "watch", ODOM]);
    let played = || {
        let topics = list(&two.bob.json(&["topics", "list"]), "topics");
        let row = topics.into_iter().find(|topic| text(topic, "topic").starts_with("/shared/"));
        row.map(|row| (text(&row, "topic"), row["publishers"].as_array().is_some_and(|nodes| !nodes.is_empty())))
    };
    assert_eq!(played(), None);
    let mut console = Console::open_in(&Terminal::of(80, 24), &two.bob, &[]);
    console.press("4");
    console.wait_for(ODOM, 60);
    console.press("p");
    let name = wait_until(60, "it is published", || played().filter(|(_, is_published)| *is_published)).0;
    assert!(name.ends_with(ODOM), "{name}");
    console.press("p");
    console.wait_for("playback ended (asked)", 60);
    wait_until(60, "nobody publishes it any more", || {
        played().is_none_or(|(_, is_published)| !is_published).then_some(())
    });
}

#[test]
fn what_was_tampered_with_or_is_gone_is_counted_and_never_played() {
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "1"]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    alice.json(&["grant", "add", &bob_address]);
    alice.capture(&[ODOM], 6);
    let records = alice.records(&["records", "list", "--oldest"]);
    let digest = |index: usize| text(&records[index], "digest").parse().expect("a digest");
    let store = Ciphertext::of(&Ledger::open(&home.path().join("ledger.db")).expect("opens"));
    assert_eq!(store.replace(digest(1), b"something else"), Ok(true));
    store.discard(&[digest(4)]).expect("deleted");
    let play = ["--json", "received", "play", "--prefix", "/shared/alice"];
    let played = bob.run(&play).expect_code(INCOMPLETE).document();
    let figures = ["published", "refused", "missing"].map(|figure| count(&played, figure));
    assert_eq!((figures, &played["ended_by"]), ([4, 1, 1], &"whole".into()), "{played}");
    assert!(played["seconds"].is_f64(), "{played}");
}

#[test]
fn the_embedded_master_is_named_so_that_nodes_can_join_it() {
    let two = two_profiles(1);
    let status = two.alice.json(&["status"]);
    let told = status.to_string();
    let uri = told.split("http://127.0.0.1:").nth(1).and_then(|rest| rest.split('/').next()).expect("a port");
    assert!(two.site.stdout().contains(&format!("http://127.0.0.1:{uri}/")), "serve says the same: {told}");
}

#[test]
fn wishes_that_cannot_be_are_refused_with_words() {
    let two = two_profiles(1);
    two.alice.json(&["grant", "add", &two.bob_address]);
    let says = |arguments: &[&str], words: &str| {
        let outcome = two.bob.run(&[&["received", "play"], arguments].concat());
        assert!(outcome.code != Some(0) && outcome.stderr.contains(words), "{words}: {outcome}");
    };
    says(&[], "--prefix");
    says(&["--prefix", "/shared/a", "--remap", "/robot1/odom:=/robot1/odom"], "/shared/a");
    says(&["--rate", "-1"], "rate");
    says(&["--clock", "--prefix", "/shared/a"], "--as-captured");
    says(&["--remap", "odom"], ":=");
    says(&["--to", "http://127.0.0.1:1", "--prefix", "/shared/a"], "http://127.0.0.1:1");
    says(&["--owner", &two.bob_address, "--prefix", "/shared/a"], "grant");
}
