//! A type that this program does not know: its definition is asked for from the node that publishes it, compared with the
//! announced hash, and goes with its messages. The peer is Eclipse Cyclone DDS with the names, types and rules of ROS 2.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::Value;
use support::ros2::{
    NO_FAST_DDS, Network, describing, describing_by, fast_dds, network, others_can_read, read_by_others,
};
use support::{Authros, Home, Running, is_verified, list, skipped, text, wait_until};

const TOPIC: &str = "/grip";

/// A site that captures the topic; its first profile.
fn begin(network: &Network, home: &Home) -> (Running, Authros) {
    let site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(home);
    let alice = home.profile("alice");
    alice.enrol();
    alice.json(&["topics", "watch", TOPIC]);
    (site, alice)
}

/// The newest record, opened.
fn newest(alice: &Authros) -> Option<Value> {
    let records = alice.records(&["records", "list", "--oldest", "--topic", TOPIC]);
    let last = records.iter().max_by_key(|record| support::count(record, "seq"))?;
    Some(alice.json(&["records", "open", &text(last, "id")]))
}

#[test]
fn the_publishing_node_is_asked_for_a_definition_that_nobody_else_has() {
    match network() {
        Ok(network) => expect_described(&network, || describing(&network, "honest")),
        Err(reason) => skipped!(reason),
    }
}

#[test]
fn a_node_with_fast_dds_is_asked_in_its_own_way() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let Some(peer) = fast_dds("ros2_fastdds_describing") else { skipped!(NO_FAST_DDS) };
    expect_described(&network, || describing_by(&network, &peer));
}

fn expect_described(network: &Network, start: impl Fn() -> Running) {
    let home = Home::new();
    let (_site, alice) = begin(network, &home);
    let mut hand = start();
    let opened =
        wait_until(60, "a message with its fields", || newest(&alice).filter(|view| view["message"].is_object()));
    let message = &opened["message"];
    let number = message["header"]["stamp"]["sec"].as_u64().expect("a number");
    assert_eq!((&message["header"]["frame_id"], &message["label"]), (&"hand".into(), &format!("grip {number}").into()));
    #[allow(clippy::cast_precision_loss, reason = "a small number")]
    let force = number as f64 + 0.25;
    assert_eq!(message["force"].as_f64(), Some(force), "{message}");
    assert!(opened["note"].is_null(), "nothing speaks against it: {opened}");
    hand.wait_for_text("rig_msgs/msg/Grip", 10);
    let asked = hand.stdout().matches("asked").count();
    assert!((1..=5).contains(&asked), "asked {asked} times");

    // The definition goes with the message: whoever reads a recording of it needs nothing else.
    drop(hand);
    wait_until(60, "all is verified", || {
        alice.records(&["records", "list", "--oldest", "--topic", TOPIC]).iter().all(is_verified).then_some(())
    });
    let recording = home.root().join("out.mcap");
    let export = ["bag", "export", "--mcap", recording.to_str().expect("UTF-8"), "--topic", TOPIC];
    let view = alice.json_within(240, &export);
    assert_eq!(list(&view, "given"), [TOPIC], "whose word its comments, constants and default values are: {view}");
    if !others_can_read() {
        skipped!("no mcap in target/peers; tests/run installs it");
    }
    let read = read_by_others(&recording);
    let last = read.last().expect("a message");
    assert!(text(last, "definition").contains("string<=16 label"), "{last}");
    assert!(text(last, "decoded").contains("label=grip "), "{last}");
}

#[test]
fn a_definition_with_another_hash_is_not_used_and_a_node_without_one_is_no_trouble() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let (mut site, alice) = begin(&network, &home);
    let mut hand = describing(&network, "lying");
    hand.wait_for_text("rig_msgs/msg/Grip", 60);
    let said = site.wait_for_text("it is not used", 20);
    assert!(said.contains("rig_msgs/msg/Grip has the hash RIHS01_"), "{said}");
    drop(hand);
    let mut hand = describing(&network, "refusing");
    hand.wait_for_text("rig_msgs/msg/Grip", 60);
    let opened = wait_until(60, "a message", || newest(&alice));
    assert!(
        opened["message"].is_null() && text(&opened, "note").contains("its definition is in no record"),
        "{opened}"
    );
    assert!(list(&alice.json(&["topics", "list"]), "topics").iter().any(|row| row["topic"] == TOPIC));
}
