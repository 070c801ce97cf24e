//! The program that speaks with the network: found, started without environment, ended.

use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use crate::ros::RosError;

/// Its name.
pub const PROGRAM: &str = "authros-ros2";
/// The user and the group `nobody` of Linux.
const NOBODY: u32 = 65534;
/// How long it may take to leave its domain before it is killed.
const LEAVING: Duration = Duration::from_millis(1500);

/// The program's path: from the settings, or else beside this one.
///
/// # Errors
/// [`RosError::NoReader`] if there is none.
pub fn find(named: Option<&Path>) -> Result<PathBuf, RosError> {
    let beside = || std::env::current_exe().ok().and_then(|own| Some(own.parent()?.join(PROGRAM)));
    let path = named.map(Path::to_owned).or_else(beside).unwrap_or_else(|| PathBuf::from(PROGRAM));
    if path.is_file() { Ok(path) } else { Err(RosError::no_reader(&path)) }
}

/// What it is started for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Reading a domain.
    Read,
    /// Publishing in it.
    Publish,
}

/// Starts it: no environment, no terminal, a process group of its own, nothing open but the two pipes. Where this process
/// may choose, as root may, it runs as the user who owns nothing.
///
/// # Errors
/// [`RosError::System`] if it does not start.
pub fn start(program: &Path, domain: u16, purpose: Purpose) -> Result<(Child, ChildStdin, ChildStdout), RosError> {
    use std::os::unix::process::CommandExt;
    let system = |error: &std::io::Error| RosError::system("start the program that speaks ROS 2", error);
    let mut nobody = command(program, domain, purpose);
    nobody.gid(NOBODY).uid(NOBODY);
    // Nobody may not be known here, or not read the program.
    let started = nobody.spawn().or_else(|_| command(program, domain, purpose).spawn());
    let mut child = started.map_err(|error| system(&error))?;
    match (child.stdin.take(), child.stdout.take()) {
        (Some(to), Some(from)) => Ok((child, to, from)),
        _ => Err(system(&std::io::Error::other("it has no pipes"))),
    }
}

fn command(program: &Path, domain: u16, purpose: Purpose) -> Command {
    use std::os::unix::process::CommandExt;
    let mut command = Command::new(program);
    command
        .args(["--domain", &domain.to_string()])
        .args((purpose == Purpose::Publish).then_some("--publish"))
        .env_clear()
        .current_dir("/")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .process_group(0);
    command
}

/// Waits until it has ended on its own, and kills it if that takes too long.
pub fn end(child: &mut Child) {
    let begun = Instant::now();
    while begun.elapsed() < LEAVING {
        if !matches!(child.try_wait(), Ok(None)) {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    drop(child.kill());
    drop(child.wait());
}
