//! A program without keys that speaks with the network in the site's place: found, started, supervised, ended.

mod run;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::os::fd::AsRawFd as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use crate::ros::RosError;

#[cfg(test)]
pub use run::State;
pub use run::{Declined, Run};

/// The user and the group `nobody` of Linux.
const NOBODY: u32 = 65534;
/// Said where the kernel raises no walls around such a program.
pub const UNCONFINED: &str = "this kernel does not confine the program that speaks with the network (Landlock and seccomp \
                              are needed): taken over, it could open what its user can open";
/// How long it may take to leave its domain before it is killed.
pub(crate) const LEAVING: Duration = Duration::from_millis(1500);

/// The path of the program called `name`: from the settings, or else beside this one.
///
/// # Errors
/// Where it was looked for, if it is not there.
pub fn find(name: &str, given: Option<&Path>) -> Result<PathBuf, PathBuf> {
    let beside = || std::env::current_exe().ok().and_then(|own| Some(own.parent()?.join(name)));
    let path = given.map(Path::to_owned).or_else(beside).unwrap_or_else(|| PathBuf::from(name));
    if path.is_file() { Ok(path) } else { Err(path) }
}

/// What is started.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Errand {
    /// The program's path.
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<String>,
    /// Its whole environment.
    pub environment: Vec<(&'static str, String)>,
}

/// Starts it: no environment but the errand's, no terminal, a process group of its own, nothing open but the two pipes.
/// Under root it runs as the user who owns nothing, or not at all.
///
/// # Errors
/// [`RosError::System`] if it does not start, [`RosError::NotAsNobody`] if that user cannot run it.
pub fn start(errand: &Errand) -> Result<(Child, ChildStdin, ChildStdout), RosError> {
    let system = |error: &std::io::Error| RosError::system("start the program that speaks with the network", error);
    // In a user namespace without that user, root is an ordinary user of the machine.
    let map = std::fs::read_to_string("/proc/self/uid_map").unwrap_or_default();
    let mut child = if rustix::process::geteuid().is_root() && has_nobody(&map) {
        start_as_nobody(errand).map_err(|error| RosError::not_as_nobody(&errand.program, &error))?
    } else {
        command(errand, &errand.program).spawn().map_err(|error| system(&error))?
    };
    match (child.stdin.take(), child.stdout.take()) {
        (Some(to), Some(from)) => Ok((child, to, from)),
        _ => Err(system(&std::io::Error::other("it has no pipes"))),
    }
}

/// Whether a user namespace has the user who owns nothing, by its map: first user, the same outside, how many. An unknown map
/// has.
fn has_nobody(map: &str) -> bool {
    let span = |line: &str| {
        let mut numbers = line.split_whitespace().map(str::parse::<u32>);
        Some((numbers.next()?.ok()?, numbers.nth(1)?.ok()?))
    };
    let mut spans = map.lines().filter_map(span).peekable();
    spans.peek().is_none() || spans.any(|(first, count)| NOBODY.checked_sub(first).is_some_and(|place| place < count))
}

fn start_as_nobody(errand: &Errand) -> std::io::Result<Child> {
    let spawn = |path: &Path| command(errand, path).gid(NOBODY).uid(NOBODY).spawn();
    spawn(&errand.program).or_else(|_| {
        // It may lie where only root gets to, as below /root; what counts is that everybody may execute the file itself.
        let opened = File::open(&errand.program)?;
        spawn(Path::new(&format!("/proc/self/fd/{}", opened.as_raw_fd())))
    })
}

fn command(errand: &Errand, path: &Path) -> Command {
    let mut command = Command::new(path);
    command
        .arg0(&errand.program)
        .args(&errand.arguments)
        .env_clear()
        .envs(errand.environment.iter().map(|(name, value)| (name, value)))
        .current_dir("/")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .process_group(0);
    command
}

/// Waits until it has ended on its own, and kills it if that takes too long. Whether it has left its domain in order.
pub fn end(child: &mut Child) -> bool {
    let begun = Instant::now();
    while begun.elapsed() < LEAVING {
        match child.try_wait() {
            Ok(None) => std::thread::sleep(Duration::from_millis(10)),
            ended => return ended.is_ok_and(|status| status.is_some_and(|status| status.success())),
        }
    }
    drop(child.kill());
    drop(child.wait());
    false
}

/// The participant of a program in its domain of ROS 2.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Participant {
    domain: u16,
    /// The prefix of its ids, 12 bytes as hex.
    prefix: String,
}

impl Participant {
    /// As a program names it; `None` for what is no name.
    pub fn new(domain: u16, prefix: String) -> Option<Self> {
        let is_name = prefix.len() == 24 && prefix.bytes().all(|byte| byte.is_ascii_hexdigit());
        is_name.then_some(Self { domain, prefix })
    }

    /// Has a run of `program` say in the domain that this participant is gone, because it was killed and could not: nodes
    /// would wait for it. Does not wait for that run, which lasts four seconds.
    pub fn bury(self, program: &Path) {
        let arguments = ["--domain".to_owned(), self.domain.to_string(), "--bury".to_owned(), self.prefix];
        let errand = Errand { program: program.to_owned(), arguments: arguments.into(), environment: Vec::new() };
        // Where this fails the participant is forgotten after its lease.
        let Ok((mut child, ..)) = start(&errand) else { return };
        drop(std::thread::Builder::new().name("ros2 last".to_owned()).spawn(move || drop(child.wait())));
    }
}
