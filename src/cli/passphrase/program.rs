//! A passphrase from a program: the first line that it prints. No shell takes part, output and time are bounded, and
//! what it prints is wiped.

use std::io::Read;
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::str::FromStr;
use std::sync::mpsc::channel;
use std::thread;
use std::time::{Duration, Instant};

use zeroize::Zeroizing;

use super::{LONGEST, first_line};
use crate::config::command_words;
use crate::model::clean;
use crate::service::{Failure, SecretText, reply::input};

/// It may ask its user for something.
const PATIENCE: Duration = Duration::from_secs(30);
const LOOK: Duration = Duration::from_millis(10);

/// A program and its arguments.
#[derive(Debug, Clone)]
pub struct Program(Vec<String>);

impl FromStr for Program {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        command_words(text, r#"'["/usr/bin/pass", "show", "authros"]'"#).map(Self)
    }
}

impl Program {
    pub fn passphrase(&self) -> Result<SecretText, Failure> {
        self.passphrase_within(PATIENCE)
    }

    fn passphrase_within(&self, patience: Duration) -> Result<SecretText, Failure> {
        let (program, arguments) =
            self.0.split_first().ok_or_else(|| input("--passphrase-command names no program"))?;
        let shown = clean(program, 100);
        let failed = |what: String| input(format!("no passphrase from --passphrase-command: {shown} {what}"));
        let mut command = Command::new(program);
        // Its messages reach the terminal, and a question of its own is asked there.
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|error| failed(format!("cannot be started: {error}")))?;
        let printed = printed(&mut child, patience);
        if printed.is_err() {
            // It may have ended already.
            drop(child.kill());
            drop(child.wait());
        }
        let printed = printed.map_err(failed)?;
        let text =
            std::str::from_utf8(&printed).map_err(|_| failed("printed something that is not text".to_owned()))?;
        let line = first_line(text);
        if line.expose().is_empty() {
            return Err(failed("printed an empty first line; it has to print the passphrase".to_owned()));
        }
        Ok(line)
    }
}

/// Everything that a program prints until it ends with success, or what is wrong with it.
fn printed(child: &mut Child, patience: Duration) -> Result<Zeroizing<Vec<u8>>, String> {
    let begun = Instant::now();
    let late = || format!("was still running after {} s and was ended; run it by hand", patience.as_secs());
    let output = child.stdout.take().ok_or("has no output")?;
    let (sender, receiver) = channel();
    // After the patience is over, nobody listens.
    thread::spawn(move || drop(sender.send(read(output))));
    let read = receiver.recv_timeout(patience).map_err(|_| late())?;
    let printed = read.map_err(|error| format!("cannot be read: {error}"))?;
    if printed.len() > LONGEST {
        return Err(format!("printed more than {LONGEST} bytes; it has to print the passphrase alone"));
    }
    let status = ended(child, patience.saturating_sub(begun.elapsed())).ok_or_else(late)?;
    if status.success() { Ok(printed) } else { Err(format!("failed ({status}); run it by hand")) }
}

/// At most one byte more than a passphrase may have.
fn read(output: ChildStdout) -> std::io::Result<Zeroizing<Vec<u8>>> {
    // Reserved in one piece: growing it would leave copies behind.
    let mut bytes = Zeroizing::new(Vec::with_capacity(2 * LONGEST));
    output.take(LONGEST as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn ended(child: &mut Child, patience: Duration) -> Option<ExitStatus> {
    let begun = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Some(status),
            Ok(None) if begun.elapsed() < patience => thread::sleep(LOOK),
            Ok(None) | Err(_) => return None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(line: &str) -> Program {
        Program(["/bin/sh", "-c", line].map(str::to_owned).to_vec())
    }

    fn refusal(line: &str, patience: Duration) -> String {
        shell(line).passphrase_within(patience).expect_err("refused").message
    }

    #[test]
    fn the_first_line_of_a_programs_output_is_the_passphrase() {
        let printed = shell("printf 'correct horse \\nuser: bob\\n'").passphrase().expect("printed");
        assert_eq!(printed.expose(), "correct horse ");
        let words: Program = r#"["/usr/bin/printf", "%s", "$HOME; echo `id`"]"#.parse().expect("a list");
        assert_eq!(words.passphrase().expect("printed").expose(), "$HOME; echo `id`", "no shell reads it");
    }

    #[test]
    fn what_is_no_list_with_an_absolute_path_is_refused() {
        for bad in ["pass show authros", "/usr/bin/pass", "[]", "[1]", r#"["pass"]"#] {
            assert!(bad.parse::<Program>().is_err(), "{bad}");
        }
    }

    #[test]
    fn a_program_that_gives_no_passphrase_is_named_with_the_reason() {
        let long = Duration::from_secs(60);
        assert!(refusal("echo a-good-passphrase; exit 3", long).contains("/bin/sh failed (exit status: 3)"));
        assert!(refusal("true", long).contains("empty first line"));
        assert!(refusal("printf '\\nthe second line'", long).contains("empty first line"));
        assert!(refusal("head -c 1048576 /dev/zero | tr '\\0' x", long).contains("more than 4096 bytes"));
        assert!(refusal("printf '\\377\\376'", long).contains("not text"));
        let absent = Program(vec!["/nowhere/at/all".to_owned()]).passphrase().expect_err("absent").message;
        assert!(absent.contains("/nowhere/at/all cannot be started"), "{absent}");
    }

    #[test]
    fn a_program_that_hangs_is_ended_also_when_it_has_printed_something() {
        for line in ["exec sleep 1000", "echo a-good-passphrase; exec sleep 1000", "exec >&-; exec sleep 1000"] {
            assert!(refusal(line, Duration::from_millis(300)).contains("still running"), "{line}");
        }
    }
}
