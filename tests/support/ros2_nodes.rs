//! Real nodes of ROS 2 (rclpy with Fast DDS, its default), of the distributions that `tests/run` installs.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use super::poll;
use super::process::Running;
use super::ros2::{Network, python_with};

/// The distributions.
pub const DISTRIBUTIONS: [&str; 2] = ["jazzy", "kilted"];

const NODE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_node.py");

/// The interpreter of one distribution, with rclpy.
#[derive(Debug, Clone)]
pub struct Python(PathBuf);

/// A distribution's interpreter; `None` where `tests/run` has not installed it.
pub fn real_nodes(distribution: &str) -> Option<Python> {
    python_with(distribution).map(Python)
}

/// All distributions, or why the test is skipped.
pub fn all_real_nodes() -> Result<Vec<(&'static str, Python)>, &'static str> {
    let found = DISTRIBUTIONS.iter().map(|name| Some((*name, real_nodes(name)?)));
    found.collect::<Option<_>>().ok_or("no rclpy in target/peers (jazzy, kilted)")
}

impl Python {
    /// A script of this repository's, inside a network, in a domain.
    pub fn command(&self, network: &Network, domain: &str, script: &Path) -> Command {
        let mut command = network.command(&self.0);
        command.arg("-B").arg(script).env("ROS_DOMAIN_ID", domain);
        command
    }

    /// Starts `tests/peers/ros2_node.py`, which explains the arguments, and waits until it is in the domain.
    pub fn node(&self, network: &Network, domain: &str, arguments: &[&str]) -> Node {
        let mut command = self.command(network, domain, Path::new(NODE));
        command.args(arguments);
        let mut running = Running::start(command);
        running.wait_for_text("\"ready\"", 60);
        Node(running)
    }
}

/// A running node.
#[derive(Debug)]
pub struct Node(Running);

impl Node {
    /// What it said last under a key.
    pub fn last(&self, key: &str) -> Option<Value> {
        let text = self.0.stdout();
        text.lines().rev().filter_map(|line| serde_json::from_str::<Value>(line).ok()).find_map(|mut said| {
            let found = said.get_mut(key)?;
            Some(found.take())
        })
    }

    /// Messages that it has sent, or heard. Fails the test if it has died of something.
    pub fn number(&self, key: &str) -> u64 {
        assert_eq!(self.last("error"), None, "the node died: {}", self.0.stderr());
        self.last(key).and_then(|number| number.as_u64()).unwrap_or(0)
    }

    /// The ids of those on the other side of its topic (`subscribers`, `publishers`).
    pub fn others(&self, side: &str) -> Vec<String> {
        let said = self.last(side);
        let ids = said.iter().filter_map(Value::as_array).flatten();
        ids.map(|id| id.as_str().expect("an id").to_owned()).collect()
    }

    /// Waits until those on the other side are as they should be; fails the test with who is there instead.
    pub fn meets(&self, side: &str, seconds: u64, what: &str, fits: impl Fn(&[String]) -> bool) -> Vec<String> {
        let found = poll(seconds, || Some(self.others(side)).filter(|others| fits(others)));
        found.unwrap_or_else(|| panic!("{what} within {seconds} s: {side} {:?}", self.others(side)))
    }

    /// Ends it in order, if it is a patient one; what it sent, all of which is acknowledged.
    pub fn ends_having_sent(self) -> u64 {
        let said = self.0.stop("TERM", 60).expect_code(0).stdout;
        let lines = said.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        lines.filter_map(|line| line["sent"].as_u64()).next_back().expect("it says what it sent")
    }

    /// Ends it in order.
    pub fn end(self) {
        self.0.stop("TERM", 20).expect_code(0);
    }
}
