//! Robot users at the console: leaving in each situation, and finding and exporting a record of the past while others
//! come, with columns of one's own.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use support::{Authros, Console, Home, Terminal, heavy, text, wait_until};

const ODOMETRY: &str = "/robot1/odom";
const CAMERA: &str = "/robot1/camera/compressed";
const PASSPHRASE: &str = "an operator's passphrase";
/// Seconds allowed for anything on a busy machine.
const PATIENCE: u64 = 60;

/// An operator at a terminal.
struct Operator(Console);

impl Operator {
    fn opens(authros: &Authros, (columns, rows): (u16, u16)) -> Self {
        Self(Console::open_in(&Terminal::of(columns, rows), authros, &[]))
    }

    fn presses(&mut self, keys: &str) -> &mut Self {
        self.0.press(keys);
        self
    }

    fn sees(&mut self, text: &str) -> &mut Self {
        self.0.wait_for(text, PATIENCE);
        self
    }

    fn no_longer_sees(&mut self, text: &str) -> &mut Self {
        wait_until(PATIENCE, &format!("'{text}' to go"), || Some(()).filter(|()| !self.0.shown().contains(text)));
        self
    }

    /// Leaves the site running, up to the question for the passphrase. One asked before is still on the screen.
    fn is_asked_before_leaving(&mut self) -> &mut Self {
        let questions = |operator: &Self| String::from_utf8_lossy(&operator.0.raw()).matches("enter alone").count();
        let before = questions(self);
        self.presses("q").sees("leave it running").presses("s");
        wait_until(PATIENCE, "the question", || Some(()).filter(|()| questions(self) > before));
        self
    }

    /// Quits, even while records are pending.
    fn leaves(&mut self) {
        self.presses("\u{3}");
        let gone = |operator: &mut Self| {
            operator.0.has_ended() || operator.0.shown().contains("Quit?") && operator.presses("y").0.has_ended()
        };
        wait_until(PATIENCE, "the console to end", || Some(()).filter(|()| gone(self)));
        self.0.expect_restored();
    }

    fn is_gone(&mut self) {
        wait_until(PATIENCE, "the console to end", || Some(()).filter(|()| self.0.has_ended()));
        self.0.expect_restored();
    }
}

fn one_robot(home: &Home) -> Authros {
    home.authros().with(&["--robots", "1"])
}

/// A profile with a keyring that only its operator can open.
fn locked_profile(home: &Home) -> Authros {
    let authros = one_robot(home);
    let passphrase = home.file("passphrase", PASSPHRASE, 0o600);
    authros.with(&["--passphrase-file", &passphrase]).enrol();
    authros
}

#[test]
fn leaving_says_what_stops_in_each_of_four_situations() {
    let _alone = heavy();
    for size in [(80, 24), (200, 50)] {
        // Nothing would stop: no question.
        let home = Home::new();
        let authros = locked_profile(&home);
        let mut operator = Operator::opens(&authros, size);
        operator.sees("Unlock the keyring").presses(PASSPHRASE).presses("\r").sees("HOST").no_longer_sees("LOCKED");
        operator.presses("q").is_gone();

        // It captures: what stops is named, and no key but y or d ends it.
        let mut operator = Operator::opens(&authros, size);
        operator.sees("Unlock the keyring").presses(PASSPHRASE).presses("\r").no_longer_sees("LOCKED");
        operator.presses("2").sees(CAMERA).presses("/odom\r").no_longer_sees(CAMERA).presses("w").sees("watched");
        operator.presses("q").sees("Quitting stops the capture of /robot1/odom.").presses("x");
        operator.no_longer_sees("Quitting stops").presses("q").sees("Quitting stops").presses("y").is_gone();

        // It waits for the key: it does not pretend that anything is captured.
        let mut operator = Operator::opens(&authros, size);
        operator.sees("Unlock the keyring").presses("\u{1b}").no_longer_sees("Unlock the keyring");
        operator.presses("2").sees("waits for key").presses("q");
        wait_until(PATIENCE, "the console to leave or to ask", || {
            Some(()).filter(|()| operator.0.has_ended() || operator.0.shown().contains("Quit?"))
        });
        if !operator.0.has_ended() {
            let shown = operator.0.shown();
            assert!(!shown.contains("Quitting stops"), "nothing is captured:\n{shown}");
            operator.presses("y");
        }
        operator.is_gone();

        // It joined a site: capture continues there.
        let passphrase = home.file("passphrase", PASSPHRASE, 0o600);
        let mut site = authros.with(&["--passphrase-file", &passphrase]).serve(&home);
        wait_until(PATIENCE, "the site to listen", || home.socket());
        let mut operator = Operator::opens(&authros, size);
        operator.sees(&format!("JOINED {}", site.id())).presses("2").sees("watched").presses("q");
        wait_until(PATIENCE, "the console to leave or to ask", || {
            Some(()).filter(|()| operator.0.has_ended() || operator.0.shown().contains("continues in the site"))
        });
        if !operator.0.has_ended() {
            operator.presses("y");
        }
        operator.is_gone();
        assert!(site.is_running(), "the site goes on");
    }
}

/// Ends a process that outlives its parents, also if the test fails.
struct Ended(String);

impl Drop for Ended {
    fn drop(&mut self) {
        support::process::signal("KILL", &self.0);
    }
}

#[test]
fn a_site_is_left_running_in_the_consoles_place() {
    let _alone = heavy();
    let home = Home::new();
    let authros = locked_profile(&home);
    let mut operator = Operator::opens(&authros, (80, 24));
    operator.sees("Unlock the keyring").presses(PASSPHRASE).presses("\r").sees("HOST").no_longer_sees("LOCKED");
    operator.presses("2").sees(CAMERA).presses("/odom\r").no_longer_sees(CAMERA).presses("w").sees("watched");
    wait_until(PATIENCE, "a first record", || {
        Some(()).filter(|()| !authros.records(&["records", "list", "--oldest"]).is_empty())
    });
    // Neither wrong passphrases nor none end anything: the console comes back, and the site captures all the time.
    let count = || authros.records(&["records", "list", "--oldest"]).len();
    for keys in ["a wrong guess\ra wrong guess\ra wrong guess\r", "\r", "half a secret\u{3}"] {
        let before = count();
        operator.is_asked_before_leaving().presses(keys).sees("the site continues in this console").sees("HOST");
        operator.sees("watched");
        wait_until(PATIENCE, "more records", || Some(()).filter(|()| count() > before));
    }
    // A wrong one, and the right one typed while that is tried.
    operator.is_asked_before_leaving().presses(&format!("another passphrase\r{PASSPHRASE}\r"));
    operator.sees("serving").sees("stop it with: kill -INT");
    operator.is_gone();
    let shown = operator.0.shown();
    for typed in [PASSPHRASE, "another passphrase", "a wrong guess", "half a secret"] {
        assert!(!support::holds(&operator.0.raw(), typed.as_bytes()), "'{typed}' was shown:\n{shown}");
    }
    let process = shown.split("kill -INT ").nth(1).and_then(|rest| rest.split_whitespace().next()).expect("a process");
    let _ended = Ended(process.to_owned());
    // The terminal is closed; the site is in no session of it, and captures.
    drop(operator);
    let line = fs::read(format!("/proc/{process}/cmdline")).expect("it runs");
    assert!(!support::holds(&line, PASSPHRASE.as_bytes()), "no passphrase among the arguments");
    let before = authros.records(&["records", "list", "--oldest"]).len();
    wait_until(PATIENCE, "more records", || {
        Some(()).filter(|()| authros.records(&["records", "list", "--oldest"]).len() > before)
    });
    // A second one is refused, in words.
    let refused = authros.run(&["serve", "--detach"]).expect_code(7);
    assert!(refused.stderr.contains("already running"), "{}", refused.stderr);
    support::process::signal("INT", process);
    wait_until(PATIENCE, "the site to end", || Some(()).filter(|()| home.socket().is_none()));
    // Nothing acknowledged was lost on the way: what is there is whole.
    authros.run(&["audit", "--deep"]).expect_code(0);
}

#[test]
fn a_record_of_the_past_is_found_and_exported_while_others_come() {
    let _alone = heavy();
    for size in [(80, 24), (200, 50)] {
        let home = Home::new();
        let authros = one_robot(&home);
        authros.enrol();
        authros.run(&["capture", "--count", "60", "--topic", ODOMETRY]).expect_code(0);
        let old = authros.records(&["records", "list", "--oldest"]);
        let first = text(&old[0], "id");
        authros.run(&["topics", "watch", CAMERA]).expect_code(0);
        fs::create_dir_all(home.root().join("cases/7")).expect("a folder");
        let mut operator = Operator::opens(&authros, size);
        operator.presses("3").sees(CAMERA).presses("f").sees("FROZEN");
        operator.presses("\u{1b}[6~\u{1b}[6~").sees("page").sees("as of");
        operator.presses(&format!("/topic:{ODOMETRY} state:verified\r")).no_longer_sees(CAMERA).sees(ODOMETRY);
        operator.presses("S").sees("oldest first").presses(":columns topic,id\r").sees("Id");
        operator.sees(&first);
        // The folder is completed as in a shell.
        operator.presses("\u{1b}[H").presses("e").sees("Export 1 record").presses("\u{15}~/cas\t").sees("~/cases/");
        operator.presses("\t").sees("~/cases/7/").presses("\r");
        let folder = home.root().join("cases/7");
        let written = wait_until(PATIENCE, "the record's folder", || {
            let folders = fs::read_dir(&folder).ok()?.flatten().map(|entry| entry.path()).collect::<Vec<_>>();
            Some(folders).filter(|folders| folders.len() == 1)
        });
        assert!(written.iter().all(|path| path.to_string_lossy().contains(&first)), "{written:?}: {first}");
        operator.presses("f").no_longer_sees("FROZEN");
        operator.leaves();
        // The columns are there again at the next start.
        let mut operator = Operator::opens(&authros, size);
        operator.sees("oldest first").sees(&first);
        let shown = operator.0.shown();
        // On a wide terminal the pane is beside the list.
        let mut lists = shown.lines().map(|line| line.split('│').next().unwrap_or_default());
        let heads = lists.find(|line| line.contains("Topic ") && line.contains("Id")).expect("heads");
        assert!(!heads.contains("State") && !heads.contains("Seq"), "{shown}");
        operator.presses(":columns usual\r").sees("State").presses("/\u{15}\r").presses("S").sees("newest first");
        operator.leaves();
    }
}
