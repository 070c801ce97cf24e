//! Deliveries to a program of this machine: its words as they are, JSON on its standard input, an end to its time.

use std::io::Write as _;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use crate::model::{ErrorKind, clean};
use crate::service::failure::refused;
use crate::service::reply::Failure;

/// How long it may run.
pub const PATIENCE: Duration = Duration::from_secs(30);
/// Between two looks whether it has ended.
const LOOK: Duration = Duration::from_millis(20);
/// What it gets of this process's environment.
const ENVIRONMENT: [&str; 3] = ["PATH", "HOME", "LANG"];

/// Runs it to its end, for `patience` at most and only while it is wanted, and says how it ended.
///
/// # Errors
/// Of kind `Unreachable` where it cannot be started, `Refused` where it failed or took too long.
pub fn run(words: &[String], body: &[u8], patience: Duration, wanted: &AtomicBool) -> Result<String, Failure> {
    let Some((program, arguments)) = words.split_first() else { return Err(refused("alerts.command is empty")) };
    let shown = clean(program, 100);
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).env_clear();
    command.envs(ENVIRONMENT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
    // A group of its own, so that what it started ends with it.
    let child = command.process_group(0).current_dir("/").spawn();
    let mut child = child.map_err(|error| {
        let text = format!("{shown} cannot be started: {error}; see alerts.command");
        Failure::new(ErrorKind::Unreachable, text)
    })?;
    // A pipe holds many such bodies; a program that does not read is no fault.
    if let Some(mut stdin) = child.stdin.take() {
        drop(stdin.write_all(body));
    }
    match ended(&mut child, patience, wanted) {
        Some(status) if status.success() => Ok(format!("{shown} ended well")),
        Some(status) => Err(refused(format!("{shown} ended with {status}; run it by hand with the same words"))),
        None => Err(refused(format!("{shown} did not end within {} s and was killed", patience.as_secs()))),
    }
}

/// How it ended; `None` = it was killed.
fn ended(child: &mut Child, patience: Duration, wanted: &AtomicBool) -> Option<ExitStatus> {
    let begun = Instant::now();
    while begun.elapsed() < patience && wanted.load(Ordering::Acquire) {
        match child.try_wait() {
            Ok(Some(status)) => return Some(status),
            Ok(None) => std::thread::sleep(LOOK),
            Err(_) => break,
        }
    }
    // It may have ended in between; then there is nothing to kill.
    let _ = kill_process_group(Pid::from_child(child), Signal::KILL);
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
        run(&words(given), body, patience, &AtomicBool::new(true))
    }

    #[test]
    fn words_reach_the_program_as_they_are_and_the_body_its_input() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("a b; $HOME");
        // dd opens what it is told to by name, and copies its input there.
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
        let unwanted = run(&words(&["/bin/sleep", "1000"]), b"", PATIENCE, &AtomicBool::new(false));
        assert!(unwanted.is_err(), "nobody waits for it any more");
    }
}
