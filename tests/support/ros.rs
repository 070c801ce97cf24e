//! Real ROS 1 from the distribution: roscore, rosbag, rostopic, and Python's reading of a bag.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;

use super::process::Running;
use super::{free_port, poll, system_program};

/// A running roscore.
#[derive(Debug)]
pub struct Roscore {
    master: Option<Running>,
    port: u16,
    directory: TempDir,
}

impl Roscore {
    /// Starts one on a free port; `None` if ROS is not installed.
    pub fn start() -> Option<Self> {
        for program in ["roscore", "rosbag", "rostopic"] {
            system_program(program)?;
        }
        let directory = tempfile::Builder::new().prefix("ros").tempdir().expect("a temporary directory");
        let mut roscore = Self { master: None, port: free_port(), directory };
        roscore.begin();
        Some(roscore)
    }

    fn begin(&mut self) {
        let mut command = self.command("roscore");
        command.args(["-p", &self.port.to_string()]);
        let mut master = Running::start(command);
        master.wait_for_text("started core service [/rosout]", 60);
        self.master = Some(master);
    }

    /// Its URI.
    pub fn uri(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Ends it and starts another at the same address, with no memory of the past.
    pub fn restart(&mut self) {
        self.end();
        self.begin();
    }

    fn end(&mut self) {
        let Some(mut master) = self.master.take() else { return };
        // Only an interrupt makes roscore end its own children too.
        master.signal("INT");
        poll(15, || (!master.is_running()).then_some(()));
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(Path::new("/usr/bin").join(program));
        command.env("PATH", "/usr/bin:/bin:/usr/sbin:/sbin").env("HOME", self.directory.path());
        command.env("ROS_LOG_DIR", self.directory.path().join("log")).current_dir(self.directory.path());
        command.env("ROS_MASTER_URI", self.uri()).env("ROS_HOSTNAME", "127.0.0.1").env_remove("ROS_IP");
        command
    }

    /// Plays a bag once every topic has a subscriber, with room for all its messages.
    pub fn play(&self, bag: &Path, rate: u32) -> Running {
        Running::start(self.player(bag, rate))
    }

    /// The same with this node name, so that it is the same robot each time.
    pub fn play_as(&self, name: &str, bag: &Path, rate: u32) -> Running {
        let mut command = self.player(bag, rate);
        command.arg(format!("__name:={name}"));
        Running::start(command)
    }

    fn player(&self, bag: &Path, rate: u32) -> Command {
        let mut command = self.command("rosbag");
        command.args(["play", "--quiet", "--queue=10000", "--wait-for-subscribers", "--delay=1"]);
        command.arg(format!("--rate={rate}")).arg(bag);
        command
    }

    /// Plays a bag, and returns what a real subscriber of its topics received: per topic the messages in hex.
    pub fn play_to_subscriber(&self, bag: &Path, rate: u32, count: usize, topics: &[&str]) -> Value {
        let ear = self.listen(count, topics);
        self.play(bag, rate).wait(240).expect_code(0);
        ear.wait(120).expect_code(0).document()
    }

    /// Records topics with ROS's own recorder into a new bag; ended with an interrupt.
    pub fn record(&self, bag: &Path, topics: &[&str]) -> Running {
        let mut command = self.command("rosbag");
        // Its output would be buffered, because it does not go to a terminal.
        command.env("ROSCONSOLE_STDOUT_LINE_BUFFERED", "1");
        command.args(["record", "--output-name"]).arg(bag).args(topics);
        let mut recorder = Running::start(command);
        for topic in topics {
            recorder.wait_for_text(&format!("Subscribing to {topic}"), 60);
        }
        recorder
    }

    /// Ends a recorder. A publisher is gone as soon as the machine has its bytes, and a recorder reads no further once it has
    /// the signal: it gets a moment to read what is there.
    pub fn stop_recording(recorder: Running) {
        std::thread::sleep(Duration::from_secs(1));
        recorder.stop("INT", 60);
    }

    /// A subscriber that ends when it has received this many messages of the topics, and prints them in hex.
    pub fn listen(&self, count: usize, topics: &[&str]) -> Running {
        let mut command = self.command("python3");
        command.args([BAG_SCRIPT, "hear", &count.to_string()]).args(topics);
        let mut ear = Running::start(command);
        ear.wait_for_text("listening", 60);
        ear
    }

    /// What a subscriber that comes now receives: the first `count` messages of the topics, in hex.
    pub fn hear(&self, count: usize, topics: &[&str]) -> Value {
        self.listen(count, topics).wait(120).expect_code(0).document()
    }

    /// Names of the nodes that publish a topic, separated by spaces.
    pub fn publishers(&self, topic: &str) -> String {
        Running::start(self.forge(&["publishers", topic])).wait(60).expect_code(0).stdout.trim().to_owned()
    }

    /// Publishes one message repeatedly, `hz` times a second.
    pub fn publish(&self, topic: &str, type_name: &str, message: &str, hz: u32) -> Running {
        let mut command = self.command("rostopic");
        command.args(["pub", "-r", &hz.to_string(), topic, type_name, message]);
        Running::start(command)
    }

    /// Publishes a text as a node with exactly this name, `hz` times a second; another one with that name ends it.
    pub fn publish_as(&self, name: &str, topic: &str, text: &str, hz: u32) -> Running {
        let mut node = Running::start(self.forge(&["publish", name, topic, text, &hz.to_string()]));
        node.wait_for_text("publishing", 60);
        node
    }

    /// The URI that the master has for a node.
    pub fn uri_of(&self, name: &str) -> String {
        Running::start(self.forge(&["uri", name])).wait(60).expect_code(0).stdout
    }

    /// Tells the subscribers of a topic that `uri` publishes it, without being the master; returns their answers.
    pub fn announce(&self, topic: &str, uri: &str) -> String {
        Running::start(self.forge(&["announce", topic, uri])).wait(60).expect_code(0).stdout
    }

    /// Registers a publisher of texts at the master, whether or not it is there.
    pub fn register(&self, name: &str, topic: &str, uri: &str) {
        Running::start(self.forge(&["register", name, topic, uri])).wait(60).expect_code(0);
    }

    fn forge(&self, arguments: &[&str]) -> Command {
        let mut command = self.command("python3");
        command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/forge.py")).args(arguments);
        command
    }
}

impl Drop for Roscore {
    fn drop(&mut self) {
        self.end();
    }
}

const BAG_SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/bag.py");

/// Writes a bag of several topics with ROS's own library.
pub fn write_bag(bag: &Path, compression: &str, count: usize) {
    let bag = bag.to_str().expect("UTF-8");
    super::process::output_of("/usr/bin/python3", &[BAG_SCRIPT, "write", bag, compression, &count.to_string()]);
}

/// Runs the script that writes and reads odd bags: `write` or `read`, with its folder and the seconds it may take.
pub fn odd_bags(act: &str, folder: &Path, seconds: u64) -> String {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/odd_bags.py");
    let mut command = std::process::Command::new("/usr/bin/python3");
    command.args(["-B", script, act]).arg(folder);
    super::Running::start(command).wait(seconds).expect_code(0).stdout
}

/// Runs the script that writes bags with ROS's own library: `simulated FILE COUNT SEED`, `named FILE`.
pub fn make_bag(arguments: &[&str]) {
    super::process::output_of("/usr/bin/python3", &[&[BAG_SCRIPT], arguments].concat());
}

/// A minute of a wheeled robot, written by ROS's own library once: 3,060 odometry messages, 3,061 of an inertial unit.
/// `None` if ROS is not installed.
pub fn robot_recording() -> Option<PathBuf> {
    super::system_program("rosbag")?;
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (path, new) = (folder.join("robot.bag"), folder.join(format!("robot-{}.bag", std::process::id())));
    let changed = |file: &Path| std::fs::metadata(file).and_then(|about| about.modified()).ok();
    if changed(&path).is_none() || changed(&path) < changed(Path::new(BAG_SCRIPT)) {
        super::process::output_of("/usr/bin/python3", &[BAG_SCRIPT, "robot", new.to_str().expect("UTF-8")]);
        // Renamed when it is complete: another test may read it.
        std::fs::rename(&new, &path).expect("renamed");
    }
    Some(path)
}

/// All messages of a bag, read by ROS's own library: topic, type, md5sum, caller id, definition, nanoseconds, hex,
/// and of the connection's header `latching`, `topic` and `tcp_nodelay`, each `false` if it is absent.
pub fn list_bag(bag: &Path) -> Vec<Value> {
    let output = super::process::output_of("/usr/bin/python3", &[BAG_SCRIPT, "list", bag.to_str().expect("UTF-8")]);
    serde_json::from_str(&output).expect("a list as JSON")
}

/// The contents of a bag, read by ROS's own library: per topic its type, `bodies` in hex and `messages` as fields.
pub fn read_bag(bag: &Path) -> Value {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/read_bag.py");
    let output = super::process::output_of("/usr/bin/python3", &[script, bag.to_str().expect("UTF-8")]);
    serde_json::from_str(&output).expect("the bag as JSON")
}
