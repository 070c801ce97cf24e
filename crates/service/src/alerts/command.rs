//! Deliveries by a command: without a shell, and ended with its children once nobody waits for it.

use std::io::Write as _;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use crate::model::{ErrorKind, clean, locked};
use crate::reply::{Failure, Result, internal, refused};

const PATIENCE: Duration = Duration::from_secs(30);
const LOOK: Duration = Duration::from_millis(20);
/// The environment variables that the command inherits.
const ENVIRONMENT: [&str; 3] = ["PATH", "HOME", "LANG"];

/// Killed by the caller that stops waiting: an ending process may leave its supervising thread no time.
#[derive(Debug, Default)]
struct Wanted(Mutex<State>);

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum State {
    #[default]
    Waits,
    Runs(Pid),
    Over,
}

impl Wanted {
    fn end(&self) {
        if let State::Runs(group) = std::mem::replace(&mut *self.state(), State::Over) {
            // It may have ended already.
            let _ = kill_process_group(group, Signal::KILL);
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        locked(&self.0)
    }
}

struct Waiting(Arc<Wanted>);

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.end();
    }
}

pub(super) async fn carry(words: Vec<String>, body: Vec<u8>) -> Result<String> {
    let wanted = Arc::new(Wanted::default());
    let _waiting = Waiting(Arc::clone(&wanted));
    let ran = tokio::task::spawn_blocking(move || run(&words, &body, PATIENCE, &wanted)).await;
    ran.unwrap_or_else(|_| Err(internal("the task that runs alerts.command failed; retrying")))
}

fn run(words: &[String], body: &[u8], patience: Duration, wanted: &Wanted) -> Result<String> {
    let Some((program, arguments)) = words.split_first() else { return Err(refused("alerts.command is empty")) };
    let shown = clean(program, 100);
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).env_clear();
    command.envs(ENVIRONMENT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
    // Its own process group, so that its children end with it.
    command.process_group(0).current_dir("/");
    let mut child = begun(&mut command, wanted, &shown)?;
    // The pipe holds the whole body; a program may ignore its input.
    if let Some(mut stdin) = child.stdin.take() {
        drop(stdin.write_all(body));
    }
    match ended(&mut child, patience, wanted) {
        Some(status) if status.success() => Ok(format!("{shown} succeeded")),
        Some(status) => Err(refused(format!("{shown} failed with {status}; run it by hand with the same arguments"))),
        None => Err(refused(format!("{shown} did not finish within {} s and was killed", patience.as_secs()))),
    }
}

fn begun(command: &mut Command, wanted: &Wanted, shown: &str) -> Result<Child> {
    let mut state = wanted.state();
    if *state == State::Over {
        return Err(refused(format!("{shown} was not started: nothing is waiting for it any more")));
    }
    let child = command.spawn().map_err(|error| {
        let text = format!("{shown} cannot be started: {error}; check alerts.command");
        Failure::new(ErrorKind::Unreachable, text)
    })?;
    *state = State::Runs(Pid::from_child(&child));
    Ok(child)
}

fn ended(child: &mut Child, patience: Duration, wanted: &Wanted) -> Option<ExitStatus> {
    let begun = Instant::now();
    while begun.elapsed() < patience {
        let mut state = wanted.state();
        match child.try_wait() {
            Ok(Some(status)) => {
                // Another process may reuse its number.
                let killed = std::mem::replace(&mut *state, State::Over) == State::Over;
                return Some(status).filter(|_| !killed);
            }
            Ok(None) => {}
            Err(_) => break,
        }
        drop(state);
        std::thread::sleep(LOOK);
    }
    wanted.end();
    drop(child.wait());
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(words: &[&str]) -> Vec<String> {
        words.iter().map(|word| (*word).to_owned()).collect()
    }

    fn ran(given: &[&str], body: &[u8], patience: Duration) -> Result<String> {
        run(&words(given), body, patience, &Wanted::default())
    }

    #[test]
    fn words_reach_the_program_as_they_are_and_the_body_its_input() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("a b; $HOME");
        // dd opens the file named in its arguments, and copies its input there.
        let of = format!("of={}", out.display());
        ran(&["/bin/dd", &of], br#"{"authros_alert":1}"#, PATIENCE).expect("it runs");
        assert_eq!(std::fs::read(&out).expect("written"), br#"{"authros_alert":1}"#);
    }

    #[test]
    fn one_that_fails_is_missing_or_never_ends_is_told_apart() {
        assert_eq!(ran(&["/bin/false"], b"", PATIENCE).expect_err("fails").kind, ErrorKind::Refused);
        assert_eq!(ran(&["/not/there"], b"", PATIENCE).expect_err("missing").kind, ErrorKind::Unreachable);
        let killed = ran(&["/bin/sleep", "1000"], b"", Duration::from_millis(200)).expect_err("killed");
        assert!(killed.message.contains("was killed"), "{killed}");
        let wanted = Wanted::default();
        wanted.end();
        assert!(run(&words(&["/bin/sleep", "1000"]), b"", PATIENCE, &wanted).is_err(), "nobody waits for it any more");
        let wanted = Arc::new(Wanted::default());
        let other = Arc::clone(&wanted);
        let running = std::thread::spawn(move || run(&words(&["/bin/sleep", "1000"]), b"", PATIENCE, &other));
        while !matches!(*wanted.state(), State::Runs(_)) {
            std::thread::sleep(LOOK);
        }
        wanted.end();
        assert!(running.join().expect("ends").is_err(), "killed by who waited");
    }
}
