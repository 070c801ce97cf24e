//! Who publishes in ROS 2: nodes that start, stop, die, come back and are named late are no forgers; strangers are.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support;

use serde_json::Value;
use support::ros2::{Network, network, python_with};
use support::{Authros, Home, Running, heavy, list, long, poll, skipped, text, wait_until};

const NO_NODES: &str = "no rclpy in target/peers (jazzy, kilted, cyclonedds)";

/// The Python of each distribution, and Cyclone's.
struct Pythons {
    jazzy: PathBuf,
    kilted: PathBuf,
    cyclone: PathBuf,
}

fn pythons() -> Option<Pythons> {
    Some(Pythons { jazzy: python_with("jazzy")?, kilted: python_with("kilted")?, cyclone: python_with("cyclonedds")? })
}

/// A peer, and what it publishes on.
struct Node {
    topic: String,
    running: Running,
}

impl Node {
    fn start(network: &Network, python: &Path, script: &str, arguments: &[&str]) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers").join(script);
        let mut command: Command = network.command(python);
        command.arg("-B").arg(script).args(arguments).env_remove("CYCLONEDDS_URI");
        let mut running = Running::start(command);
        running.wait_for_text("\"ready\"", 120);
        Self { topic: arguments[1].to_owned(), running }
    }

    /// A real node.
    fn real(network: &Network, python: &Path, name: &str, topic: &str, messages: u32) -> Self {
        Self::start(network, python, "ros2_identity.py", &[name, topic, "20", &messages.to_string()])
    }

    /// What it sent, once it has ended as a node does.
    fn ends(self) -> (String, u64) {
        let said = self.running.wait(180).expect_code(0);
        let lines = said.stdout.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let sent = lines.filter_map(|line| line["sent"].as_u64()).next_back();
        (self.topic, sent.unwrap_or_else(|| panic!("it did not say what it sent: {said}")))
    }

    fn kill(&mut self) {
        self.running.signal("KILL");
        poll(10, || (!self.running.is_running()).then_some(()));
    }
}

/// A site with a profile that watches topics of a domain.
struct Scene {
    network: Network,
    alice: Authros,
    _site: Running,
    _home: Home,
}

impl Scene {
    fn open(network: Network) -> Self {
        let home = Home::new();
        let site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
        let alice = home.profile("alice");
        alice.enrol();
        Self { network, alice, _site: site, _home: home }
    }

    fn watch(&self, topics: impl IntoIterator<Item = String>) {
        topics.into_iter().for_each(|topic| drop(self.alice.json(&["topics", "watch", &topic])));
    }

    fn count(&self, topic: &str, state: &str) -> usize {
        let records = self.alice.records(&["records", "list", "--oldest", "--topic", topic]);
        records.iter().filter(|record| record["state"] == state).count()
    }

    fn verifies(&self, topic: &str, least: usize) {
        let enough = || (self.count(topic, "verified") >= least).then_some(());
        let state = || (self.count(topic, "verified"), self.count(topic, "quarantined"));
        assert!(poll(120, enough).is_some(), "{topic}: {:?} of {least}, {:?}", state(), self.alarms());
    }

    fn alarms(&self) -> Vec<Value> {
        list(&self.alice.json(&["topics", "pins"]), "alarms")
    }

    fn pins(&self, topic: &str) -> Vec<String> {
        let pins = list(&self.alice.json(&["topics", "pins", "--topic", topic]), "pins");
        pins.iter().map(|pin| text(pin, "caller_id")).collect()
    }

    /// One real node after another stops as a node does: all that it sent is verified.
    fn expect_whole(&self, nodes: Vec<Node>) {
        for (topic, sent) in nodes.into_iter().map(Node::ends) {
            self.verifies(&topic, usize::try_from(sent).expect("few"));
            assert_eq!(self.count(&topic, "quarantined"), 0, "{topic}");
        }
    }
}

#[test]
fn nodes_that_start_stop_die_and_are_named_late_are_no_forgers_and_strangers_are() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let Some(python) = pythons() else { skipped!(NO_NODES) };
    let scene = Scene::open(network);
    let of = |number: usize| if number.is_multiple_of(2) { &python.jazzy } else { &python.kilted };
    let (clean, killed) = if long() { (20, 20) } else { (2, 2) };
    let names = |word: &str, count: usize| (0..count).map(|at| format!("/{word}{at}")).collect::<Vec<_>>();
    scene.watch(names("clean", clean).into_iter().chain(names("killed", killed)).chain(names("late", 1)));
    let begun = std::time::Instant::now();
    let busy: Vec<Running> = (0..if long() { 4 } else { 0 })
        .map(|_| {
            let mut command = Command::new("sh");
            command.args(["-c", "while :; do :; done"]);
            Running::start(command)
        })
        .collect();

    // A name that comes after five seconds.
    let late = Node::start(&scene.network, &python.cyclone, "ros2_late_name.py", &["slow", "/late0", "160", "5"]);
    // Ten at a time are enough for a machine.
    let start = |at: usize, topic: &String| Node::real(&scene.network, of(at), &topic[1..], topic, 60);
    for some in names("clean", clean).chunks(5) {
        scene.expect_whole(some.iter().enumerate().map(|(at, topic)| start(at, topic)).collect());
    }
    scene.expect_whole(vec![late]);
    assert_eq!(scene.pins("/late0"), ["/slow"]);

    // Killed, and back under the same name.
    let mut robots = Vec::new();
    for (at, topic) in names("killed", killed).iter().enumerate() {
        let again = |messages| Node::real(&scene.network, of(at), &format!("robot{at}"), topic, messages);
        let mut robot = again(0);
        scene.verifies(topic, 20);
        robot.kill();
        if at + 1 < killed {
            let (_, sent) = again(60).ends();
            scene.verifies(topic, 20 + usize::try_from(sent).expect("few"));
        } else {
            robots.push(again(0));
            let before = scene.count(topic, "verified");
            scene.verifies(topic, before + 60);
        }
        assert_eq!((scene.count(topic, "quarantined"), scene.pins(topic)), (0, vec![format!("/robot{at}")]));
    }
    assert!(scene.alarms().is_empty(), "{:?}", scene.alarms());
    drop(busy);

    // Strangers on the topic of a robot that is there: with another name, and with its own.
    assert!(begun.elapsed().as_secs() > 10, "the order in which publishers come is known");
    let topic = format!("/killed{}", killed - 1);
    let alarm = |name: &str, reason: &str| {
        let is_it = |alarm: &Value| text(alarm, "publisher").starts_with(name) && alarm["reason"] == reason;
        poll(60, || scene.alarms().iter().any(is_it).then_some(()))
            .unwrap_or_else(|| panic!("no alarm about {name}: {:?}", scene.alarms()));
    };
    let mut held = 0;
    for (name, reason) in [("stranger".to_owned(), "new"), (format!("robot{}", killed - 1), "replaced")] {
        let (_, sent) = Node::real(&scene.network, &python.kilted, &name, &topic, 30).ends();
        alarm(&format!("/{name}@"), reason);
        held += usize::try_from(sent).expect("few");
        wait_until(60, "every word of the stranger is held", || {
            (scene.count(&topic, "quarantined") >= held).then_some(())
        });
    }
    let before = scene.count(&topic, "verified");
    scene.verifies(&topic, before + 20);
    assert_eq!(scene.count(&topic, "quarantined"), held, "nothing of the robot is held");
    assert!(robots.iter_mut().all(|robot| robot.running.is_running()));
}
