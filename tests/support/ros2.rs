//! A network of its own for ROS 2, and a real DDS peer in it: Eclipse Cyclone DDS, as `tests/run` installs it.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use super::process::Running;
use super::{Authros, poll};

const DESCRIBING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_describing.py");
const NOISE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_noise.py");
const OTHER_READER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_mcap.py");
const PUBLISHER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_publisher.py");
const SUBSCRIBER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_subscriber.py");

/// A network namespace with nothing but loopback, so that DDS neither leaks nor meets anybody; ends when dropped.
#[derive(Debug)]
pub struct Network {
    holder: Child,
    entry: Vec<String>,
}

impl Network {
    /// A new one; `None` if this machine does not allow it.
    pub fn new() -> Option<Self> {
        for own_user in [false, true] {
            let mut command = Command::new("unshare");
            if own_user {
                command.args(["--user", "--map-root-user"]);
            }
            let script = "ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo; echo up; exec sleep 3600";
            command.args(["--net", "--kill-child", "sh", "-c", script]).stdout(Stdio::piped()).stderr(Stdio::null());
            let Ok(mut holder) = command.spawn() else { return None };
            let mut line = String::new();
            let said = holder.stdout.take().map(std::io::BufReader::new);
            if said.is_some_and(|mut said| std::io::BufRead::read_line(&mut said, &mut line).is_ok() && line == "up\n")
            {
                let mut entry = vec!["--target".to_owned(), holder.id().to_string(), "--net".to_owned()];
                if own_user {
                    entry.extend(["--user".to_owned(), "--preserve-credentials".to_owned()]);
                }
                entry.push("--".to_owned());
                return Some(Self { holder, entry });
            }
            drop(holder.kill());
            drop(holder.wait());
        }
        None
    }

    /// The program under test, inside.
    pub fn inside(&self, authros: &Authros) -> Authros {
        let program = authros.program().to_str().expect("UTF-8").to_owned();
        let prefix: Vec<&str> = self.entry.iter().map(String::as_str).chain([program.as_str()]).collect();
        authros.with_program(Path::new("/usr/bin/nsenter")).with_prefix(&prefix)
    }

    /// A command, inside.
    pub fn command(&self, program: &Path) -> Command {
        let mut command = Command::new("nsenter");
        // The nodes of all networks have one shared memory, and Fast DDS of one release dies of what another left in it.
        command.args(&self.entry).arg(program).env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4");
        command
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        drop(self.holder.kill());
        drop(self.holder.wait());
    }
}

/// The program that reads ROS 2, if it was built beside the program under test.
pub fn reader_program() -> Option<PathBuf> {
    super::keyless::program("authros-ros2")
}

/// The interpreter with the packages of `tests/peers/NAME.txt`.
pub fn python_with(name: &str) -> Option<PathBuf> {
    let peers = std::env::var_os("AUTHROS_PEERS")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("target/peers"), PathBuf::from);
    let path = peers.join(name).join("bin/python");
    path.is_file().then_some(path)
}

fn python() -> Option<PathBuf> {
    python_with("cyclonedds")
}

/// Whether a recording can be read by others ([`read_by_others`]).
pub fn others_can_read() -> bool {
    python_with("mcap").is_some()
}

/// All that mcap and mcap-ros2-support find in a recording; `tests/peers/ros2_mcap.py` names the fields.
pub fn read_by_others(recording: &Path) -> Vec<Value> {
    let mut command = Command::new(python_with("mcap").expect("asked before"));
    command.args(["-B", OTHER_READER]).arg(recording);
    let read = Running::start(command).wait(60).expect_code(0).document();
    read.as_array().expect("a list").clone()
}

/// The requirements of a ROS 2 test, or why it is skipped.
pub fn network() -> Result<Network, &'static str> {
    reader_program().ok_or("authros-ros2 is not built: cargo build -p authros-ros2")?;
    python().ok_or("no cyclonedds in target/peers")?;
    Network::new().ok_or("this machine gives no network namespace")
}

/// Sends this many datagrams that are not RTPS to the ports of domain 0, and a few that nearly are; then ends.
pub fn noise(network: &Network, count: usize) -> Running {
    let mut command = network.command(&python().expect("asked before"));
    command.arg(NOISE).arg(count.to_string());
    Running::start(command)
}

/// Why a peer of [`fast_dds`] is missing.
pub const NO_FAST_DDS: &str = "no g++ with libfastrtps-dev";

/// A peer in C++ of `tests/peers`, with Fast DDS, compiled if its source is newer; `None` without compiler or library.
pub fn fast_dds(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers");
    let (source, shared) = (folder.join(name).with_extension("cpp"), folder.join("ros2_fastdds.hpp"));
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let compiler = super::system_program("g++")?;
    if !Path::new("/usr/include/fastdds").is_dir() {
        return None;
    }
    let changed = |path: &Path| std::fs::metadata(path).and_then(|about| about.modified()).ok();
    if changed(&program) < changed(&source).max(changed(&shared)) {
        let mut command = Command::new(compiler);
        command.args(["-std=c++17", "-O1", "-o"]).args([&program, &source]).args(["-lfastrtps", "-lfastcdr"]);
        assert!(command.status().expect("the compiler runs").success(), "the peer compiles");
    }
    Some(program)
}

/// A real DDS publisher of a type of its own, which answers for its definition in this way (`tests/peers/ros2_describing.py`).
pub fn describing(network: &Network, how: &str) -> Running {
    let mut command = network.command(&python().expect("asked before"));
    command.args(["-B", DESCRIBING, how]).env_remove("CYCLONEDDS_URI");
    ready(command)
}

/// The honest one by Fast DDS, as [`fast_dds`] compiled it.
pub fn describing_by(network: &Network, program: &Path) -> Running {
    ready(network.command(program))
}

fn ready(command: Command) -> Running {
    let mut running = Running::start(command);
    running.wait_for_text("\"ready\"", 60);
    running
}

/// A real DDS publisher with ROS 2's names.
#[derive(Debug)]
pub struct Talker(Running);

impl Talker {
    /// Starts it; it waits for a subscriber unless its topic is latched. The arguments are the script's.
    pub fn start(network: &Network, arguments: &[&str]) -> Self {
        let mut command = network.command(&python().expect("asked before"));
        command.arg(PUBLISHER).args(arguments).env_remove("CYCLONEDDS_URI");
        Self(ready(command))
    }

    /// The same by another program.
    pub fn by(network: &Network, program: &Path, arguments: &[&str]) -> Self {
        let mut command = network.command(program);
        command.args(arguments);
        Self(ready(command))
    }

    /// Waits until it has published everything; returns what it says about that.
    pub fn sent(&mut self, seconds: u64) -> Value {
        let text = self.0.wait_for_text("\"sha256\"", seconds);
        let line = text.lines().find(|line| line.contains("\"sha256\"")).expect("said");
        serde_json::from_str(line).expect("JSON")
    }

    /// Waits until it has this number of subscribers; it must have published everything.
    pub fn is_heard_by(&self, subscribers: u64, seconds: u64) {
        let last = || {
            let said = self.0.stdout();
            let lines = said.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
            lines.filter_map(|line| line["readers"].as_u64()).next_back()
        };
        poll(seconds, || (last() == Some(subscribers)).then_some(()))
            .unwrap_or_else(|| panic!("{subscribers} subscribers: {:?}", last()));
    }

    /// Kills it, so that it vanishes without a word.
    pub fn kill(&mut self) {
        self.0.signal("KILL");
        poll(10, || (!self.0.is_running()).then_some(()));
    }
}

/// A real DDS subscriber with ROS 2's names.
#[derive(Debug)]
pub struct Listener(Running);

impl Listener {
    /// Starts it in a domain. The arguments are the script's.
    pub fn start(network: &Network, domain: &str, arguments: &[&str]) -> Self {
        let mut command = network.command(&python().expect("asked before"));
        command.args(["-B", SUBSCRIBER, domain]).args(arguments).env_remove("CYCLONEDDS_URI");
        Self(ready(command))
    }

    fn said(&self, key: &str) -> Vec<Value> {
        let text = self.0.stdout();
        let lines = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        lines.filter_map(|line| line.get(key).cloned()).collect()
    }

    /// SHA-256 of each message so far as it arrived, header included, in order.
    pub fn heard(&self) -> Vec<Value> {
        self.said("sha256")
    }

    /// Waits until it has heard this number of messages; returns them as [`Self::heard`] does.
    pub fn hears(&self, count: usize, seconds: u64) -> Vec<Value> {
        let enough = || Some(self.heard()).filter(|heard| heard.len() >= count);
        poll(seconds, enough).unwrap_or_else(|| panic!("{} of {count} heard: {}", self.heard().len(), self.0.stderr()))
    }

    /// Waits until it is connected to this number of publishers.
    pub fn meets(&self, publishers: u64, seconds: u64) {
        let met = || (self.said("publishers").last() == Some(&publishers.into())).then_some(());
        poll(seconds, met).unwrap_or_else(|| panic!("{publishers} publishers: {:?}", self.said("publishers")));
    }
}

/// What mcap finds in a recording beside its messages; `tests/peers/mcap_beside.py` names the fields.
pub fn beside_by_others(recording: &Path) -> Vec<Value> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/mcap_beside.py");
    let mut command = Command::new(python_with("mcap").expect("asked before"));
    command.args(["-B", script]).arg(recording);
    let read = Running::start(command).wait(60).expect_code(0).document();
    read.as_array().expect("a list").clone()
}

/// Runs the script that writes and reads odd MCAP files: `write` or `read`, with its folder and the seconds it may take.
pub fn odd_mcaps(act: &str, folder: &Path, seconds: u64) -> String {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/odd_mcap.py");
    let mut command = Command::new(python_with("mcap").expect("asked before"));
    command.args(["-B", script, act]).arg(folder);
    Running::start(command).wait(seconds).expect_code(0).stdout
}

/// A recorder that writes MCAP into a new folder as rosbag2 does: for seconds, at messages a second, with seconds until
/// the next file; `how` is the compression of its chunks, or `unchunked`.
pub fn recorder(folder: &Path, seconds: u64, rate: u64, split: u64, how: &str) -> Running {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_follow.py");
    let mut command = Command::new(python_with("mcap").expect("asked before"));
    command.args(["-B", script]).arg(folder).args([seconds, rate, split].map(|number| number.to_string())).arg(how);
    Running::start(command)
}

/// The same with `.db3` files; also writes a list of what was recorded beside the folder. It ends with an error where somebody
/// else's lock is in its way.
pub fn database_recorder(folder: &Path, seconds: u64, rate: u64, split: u64) -> Running {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/db3_follow.py");
    let mut command = Command::new(python_with("mcap").expect("asked before"));
    command.args(["-B", script]).arg(folder).args([seconds, rate, split].map(|number| number.to_string()));
    Running::start(command)
}

/// Whether there are others who write and read folders of rosbag2 ([`folders_of_others`]).
pub fn others_write_folders() -> bool {
    python_with("rosbags").is_some()
}

/// Runs the script that writes and reads recordings of rosbag2 with rosbags: `write`, `read` or `files`, with its folder and the
/// seconds it may take.
pub fn folders_of_others(act: &str, folder: &Path, seconds: u64) -> String {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/rosbags_folders.py");
    let mut command = Command::new(python_with("rosbags").expect("asked before"));
    command.args(["-B", script, act]).arg(folder);
    Running::start(command).wait(seconds).expect_code(0).stdout
}
