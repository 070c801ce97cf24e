//! Shared records played to real nodes of ROS 2 (rclpy with Fast DDS, of Jazzy and Kilted): what they get is what is counted, large
//! pictures and the first message included, and they see who publishes. All in a network namespace of the test's own.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::Value;
use support::ros2::{Listener, Network, Talker, network, python_with};
use support::{Authros, Home, Running, count, heavy, is_verified, long, poll, skipped, wait_until};

const INCOMPLETE: i32 = 8;
/// Where the reader plays; the robots are in domain 0.
const OUT: &str = "7";
const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_bridge.py");

/// A real node that subscribes.
struct Node(Running);

impl Node {
    fn start(network: &Network, distribution: &str, topics: &[&str]) -> Self {
        let mut command = network.command(&python_with(distribution).expect("asked before"));
        command.args(["-B", SCRIPT, OUT]).args(topics);
        let mut running = Running::start(command);
        running.wait_for_text("\"ready\"", 60);
        Self(running)
    }

    fn said(&self) -> Vec<Value> {
        let said = self.0.stdout();
        said.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    fn heard(&self, topic: &str) -> Vec<Value> {
        self.said().into_iter().filter(|line| line["topic"] == topic).map(|line| line["sha256"].clone()).collect()
    }

    fn hears(&self, topic: &str, count: usize, seconds: u64) -> Vec<Value> {
        let enough = || Some(self.heard(topic)).filter(|heard| heard.len() >= count);
        poll(seconds, enough).unwrap_or_else(|| panic!("{topic}: {} of {count} heard", self.heard(topic).len()))
    }

    /// Waits until the graph tells of a publisher of the topic by a node.
    fn sees(&self, topic: &str, node: &str) {
        let is_seen = |line: &Value| {
            line["publishers"][topic].as_array().is_some_and(|them| them.iter().any(|one| one[0] == node))
        };
        let seen =
            || self.said().iter().any(|line| is_seen(line) && line["nodes"].to_string().contains(node)).then_some(());
        poll(20, seen).unwrap_or_else(|| panic!("{node} on {topic}: {:?}", self.said().last()));
    }
}

/// A site with records of these topics (name, kind, number, rate, bytes, flag), shared with another profile.
struct Plant {
    _home: Home,
    _site: Running,
    bob: Authros,
    originals: Vec<Listener>,
}

type Kind<'a> = (&'a str, &'a str, &'a str, &'a str, &'a str, &'a str);

fn plant(network: &Network, kinds: &[Kind<'_>]) -> Plant {
    let home = Home::new();
    let site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    let originals =
        kinds.iter().map(|&(topic, kind, .., flag)| Listener::start(network, "0", &[topic, kind, flag])).collect();
    for &(topic, kind, number, hertz, size, flag) in kinds {
        alice.json(&["topics", "watch", topic]);
        let talker = Talker::start(network, &[topic, kind, number, hertz, size, flag, "readers2"]);
        let number: usize = number.parse().expect("a number");
        wait_until(120, "all is verified", || {
            let records = alice.records(&["records", "list", "--oldest", "--topic", topic]);
            (records.len() == number && records.iter().all(is_verified)).then_some(())
        });
        drop(talker);
    }
    alice.json(&["grant", "add", &bob_address]);
    Plant { _home: home, _site: site, bob, originals }
}

fn ready() -> Result<Network, &'static str> {
    if ["jazzy", "kilted"].iter().any(|distribution| python_with(distribution).is_none()) {
        return Err("no nodes of ROS 2 in target/peers");
    }
    network()
}

fn figures(played: &Value) -> [u64; 4] {
    ["published", "refused", "dropped", "unconfirmed"].map(|figure| count(played, figure))
}

#[test]
fn real_nodes_get_what_is_counted_from_the_first_message_on_and_see_who_publishes() {
    let _alone = heavy();
    let network = match ready() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let pictures = if long() { "100" } else { "15" };
    let kinds = [
        ("/words", "string", "300", "300", "36", ""),
        ("/loose", "string", "100", "100", "120", "best_effort"),
        ("/camera", "image", pictures, "10", "1000000", ""),
    ];
    let plant = plant(&network, &kinds);
    let wanted = ["/words:string:reliable", "/loose:string:best_effort", "/camera:image:reliable"];
    let nodes = ["jazzy", "kilted"].map(|distribution| Node::start(&network, distribution, &wanted));
    let player = plant.bob.spawn(&["--json", "received", "play", "--as-captured", "--ros2", OUT]);
    for node in &nodes {
        poll(60, || (!node.heard("/words").is_empty()).then_some(())).expect("heard");
        node.sees("/words", "/authros_bridge");
    }
    let played = player.wait(180).expect_code(0).document();
    let pictures: u64 = pictures.parse().expect("a number");
    assert_eq!(figures(&played), [400 + pictures, 0, 0, 100], "{played}");
    for node in &nodes {
        for (original, (topic, _, number, ..)) in
            plant.originals.iter().zip(kinds).filter(|(_, kind)| kind.0 != "/loose")
        {
            let number = number.parse().expect("a number");
            let expected = original.hears(number, 20);
            assert!(node.hears(topic, number, 20) == expected, "{topic}: the same bytes, in the same order");
        }
    }
}

#[test]
fn pictures_of_eight_megabytes_reach_a_real_node_and_cyclone_dds() {
    let _alone = heavy();
    let network = match ready() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let pictures = if long() { "60" } else { "6" };
    let plant = plant(&network, &[("/camera", "image", pictures, "5", "8000000", "")]);
    let number: usize = pictures.parse().expect("a number");
    let node = Node::start(&network, "kilted", &["/camera:image:reliable"]);
    let cyclone = Listener::start(&network, OUT, &["/camera", "image"]);
    let played =
        plant.bob.run(&["--json", "received", "play", "--as-captured", "--ros2", OUT]).expect_code(0).document();
    assert_eq!(figures(&played), [number as u64, 0, 0, 0], "{played}");
    let expected = plant.originals[0].hears(number, 20);
    assert!(node.hears("/camera", number, 20) == expected && cyclone.hears(number, 20) == expected);
}

#[test]
fn what_a_node_that_was_killed_did_not_acknowledge_is_not_counted_as_published() {
    let _alone = heavy();
    let network = match ready() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let plant = plant(&network, &[("/words", "string", "300", "100", "36", "")]);
    let node = Node::start(&network, "jazzy", &["/words:string:reliable"]);
    let player = plant.bob.spawn(&["--json", "received", "play", "--as-captured", "--ros2", OUT]);
    node.hears("/words", 50, 60);
    node.0.signal("KILL");
    let played = player.wait(60).expect_code(INCOMPLETE).document();
    let [published, refused, dropped, unconfirmed] = figures(&played);
    assert_eq!((published + dropped, refused, unconfirmed), (300, 0, 0), "{played}");
    assert!(published >= 50 && dropped > 50, "{played}");
}
