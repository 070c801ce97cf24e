//! Deliveries to a program on this machine: its command line as configured, JSON on its standard input, and a time
//! limit.

use std::io::Write as _;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use crate::model::{ErrorKind, clean};
use crate::service::failure::refused;
use crate::service::reply::Failure;

/// How long it may run.
pub const PATIENCE: Duration = Duration::from_secs(30);
/// How often to check whether it has ended.
const LOOK: Duration = Duration::from_millis(20);
/// The part of this process's environment that it gets.
const ENVIRONMENT: [&str; 3] = ["PATH", "HOME", "LANG"];

/// Whether somebody waits for a program. Whoever ends the waiting kills it, because a process that is ending may leave
/// no time for the thread that supervises it.
#[derive(Debug, Default)]
pub struct Wanted(Mutex<State>);

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum State {
    /// Not started.
    #[default]
    Waits,
    /// Running, in a process group of its own.
    Runs(Pid),
    /// Nobody waits any more, or it has ended.
    Over,
}

impl Wanted {
    /// Nobody waits any more: a running program is killed, and none is started.
    pub fn end(&self) {
        end(&mut self.state());
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn end(state: &mut State) {
    if let State::Runs(group) = std::mem::replace(state, State::Over) {
        // It may have ended in the meantime; then there is nothing to kill.
        let _ = kill_process_group(group, Signal::KILL);
    }
}

/// Runs it to its end, for at most `patience` and only while it is wanted, and returns how it ended.
///
/// # Errors
/// Kind `Unreachable` if it cannot be started, `Refused` if it failed, took too long or is no longer wanted.
pub fn run(words: &[String], body: &[u8], patience: Duration, wanted: &Wanted) -> Result<String, Failure> {
    let Some((program, arguments)) = words.split_first() else { return Err(refused("alerts.command is empty")) };
    let shown = clean(program, 100);
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).env_clear();
    command.envs(ENVIRONMENT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
    // A process group of its own, so that its children end with it.
    command.process_group(0).current_dir("/");
    let mut child = begun(&mut command, wanted, &shown)?;
    // A pipe holds many such bodies; a program that does not read its input is not an error.
    if let Some(mut stdin) = child.stdin.take() {
        drop(stdin.write_all(body));
    }
    match ended(&mut child, patience, wanted) {
        Some(status) if status.success() => Ok(format!("{shown} succeeded")),
        Some(status) => Err(refused(format!("{shown} failed with {status}; run it by hand with the same arguments"))),
        None => Err(refused(format!("{shown} did not finish within {} s and was killed", patience.as_secs()))),
    }
}

fn begun(command: &mut Command, wanted: &Wanted, shown: &str) -> Result<Child, Failure> {
    let mut state = wanted.state();
    if *state == State::Over {
        return Err(refused(format!("{shown} was not started: nobody is waiting for it any more")));
    }
    let child = command.spawn().map_err(|error| {
        let text = format!("{shown} cannot be started: {error}; check alerts.command");
        Failure::new(ErrorKind::Unreachable, text)
    })?;
    *state = State::Runs(Pid::from_child(&child));
    Ok(child)
}

/// How it ended; `None` = it was killed.
fn ended(child: &mut Child, patience: Duration, wanted: &Wanted) -> Option<ExitStatus> {
    let begun = Instant::now();
    while begun.elapsed() < patience {
        let mut state = wanted.state();
        match child.try_wait() {
            Ok(Some(status)) => {
                // Its number may belong to another process from now on.
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

    fn ran(given: &[&str], body: &[u8], patience: Duration) -> Result<String, Failure> {
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
        let wanted = std::sync::Arc::new(Wanted::default());
        let other = std::sync::Arc::clone(&wanted);
        let running = std::thread::spawn(move || run(&words(&["/bin/sleep", "1000"]), b"", PATIENCE, &other));
        while !matches!(*wanted.state(), State::Runs(_)) {
            std::thread::sleep(LOOK);
        }
        wanted.end();
        assert!(running.join().expect("ends").is_err(), "killed by who waited");
    }
}
