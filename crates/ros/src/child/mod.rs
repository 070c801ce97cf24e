//! A program without keys that speaks with the network in the site's place: found, started, supervised, ended.

mod run;

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
const LEAVING: Duration = Duration::from_millis(1500);

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
/// Where this process may choose, as root may, it runs as the user who owns nothing.
///
/// # Errors
/// [`RosError::System`] if it does not start.
pub fn start(errand: &Errand) -> Result<(Child, ChildStdin, ChildStdout), RosError> {
    use std::os::unix::process::CommandExt;
    let system = |error: &std::io::Error| RosError::system("start the program that speaks with the network", error);
    let mut nobody = command(errand);
    nobody.gid(NOBODY).uid(NOBODY);
    // Nobody may not be known here, or not read the program.
    let started = nobody.spawn().or_else(|_| command(errand).spawn());
    let mut child = started.map_err(|error| system(&error))?;
    match (child.stdin.take(), child.stdout.take()) {
        (Some(to), Some(from)) => Ok((child, to, from)),
        _ => Err(system(&std::io::Error::other("it has no pipes"))),
    }
}

fn command(errand: &Errand) -> Command {
    use std::os::unix::process::CommandExt;
    let mut command = Command::new(&errand.program);
    command
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
