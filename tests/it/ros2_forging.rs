//! A stranger publishes a robot's topic in ROS 2. DDS authenticates nobody; what shows is his middleware, his node and his type.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use support::ros2::{NO_FAST_DDS, Talker, fast_dds, network};
use support::{Home, count, list, skipped, text, wait_until};

const TOPIC: &str = "/words";

#[test]
fn a_publisher_of_another_make_is_quarantined_and_the_robot_goes_on() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let Some(stranger) = fast_dds("ros2_fastdds") else { skipped!(NO_FAST_DDS) };
    let home = Home::new();
    let mut site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    alice.json(&["topics", "watch", TOPIC]);
    let of = |state: &str| {
        let records = alice.records(&["records", "list", "--oldest", "--topic", TOPIC]);
        records.into_iter().filter(|record| record["state"] == state).collect::<Vec<_>>()
    };
    let _robot = Talker::start(&network, &[TOPIC, "string", "6000", "20", "60", "hash"]);
    wait_until(60, "the robot's words are verified", || (of("verified").len() >= 10).then_some(()));
    let pins = list(&alice.json(&["topics", "pins"]), "pins");
    assert_eq!((pins.len(), text(&pins[0], "caller_id")), (1, "/unnamed_cyclonedds".into()), "{pins:?}");
    // It can be pinned by name, its type's hash included.
    let [caller_id, host, kind, hash] = ["caller_id", "host", "type", "md5sum"].map(|field| text(&pins[0], field));
    let robot = format!("{caller_id}@{host}:{kind}:RIHS01_{hash}");
    assert_eq!(hash.len(), 64, "{pins:?}");
    let view = alice.json(&["topics", "pin", TOPIC, "--publisher", &robot]);
    assert!(list(&view, "pins").iter().all(|pin| text(pin, "md5sum") == hash), "{view}");

    let copy = home.root().join("copy");
    let arguments = [TOPIC, "string", "20", "20", "61", copy.to_str().expect("UTF-8")];
    let mut forger = Talker::by(&network, &stranger, &arguments);
    assert_eq!(count(&forger.sent(60), "sent"), 20);
    let held = wait_until(60, "all of the stranger's words are held", || {
        Some(of("quarantined")).filter(|held| held.len() == 20)
    });
    let said = site.wait_for_text("/unnamed_fastdds", 20);
    assert!(said.contains(TOPIC), "{said}");
    for record in [&held[0], &held[19]] {
        let opened = alice.json(&["records", "open", &text(record, "id")]);
        assert_eq!(opened["message"]["data"].as_str().map(str::len), Some(61), "his, not the robot's: {opened}");
    }
    let before = of("verified").len();
    wait_until(60, "the robot goes on", || (of("verified").len() >= before + 20).then_some(()));
    assert_eq!(of("quarantined").len(), 20, "nothing of the robot is held");
}
