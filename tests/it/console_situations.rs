//! Robot users at the console: leaving in each situation, and finding and exporting a record of the past while others
//! come, with columns of one's own.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use support::{Authros, Home, Operator, PASSPHRASE, heavy, locked_profile, text, wait_until};

const ODOMETRY: &str = "/robot1/odom";
const CAMERA: &str = "/robot1/camera/compressed";
/// Seconds allowed for anything on a busy machine.
const PATIENCE: u64 = 60;

fn one_robot(home: &Home) -> Authros {
    home.authros().with(&["--robots", "1"])
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
