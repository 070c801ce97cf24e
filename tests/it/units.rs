//! The systemd units: systemd finds nothing wrong with them, and their commands are ones that the program takes.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::Path;
use std::process::Command;

use support::{Home, Running, skipped, system_program};

const UNITS: [&str; 2] = ["authros-agent.service", "authros-serve.service"];

fn unit(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd").join(name)).expect("a unit")
}

#[test]
fn systemd_accepts_the_units() {
    let Some(program) = system_program("systemd-analyze") else { skipped!("no systemd-analyze") };
    let home = Home::new();
    for name in UNITS {
        let text = unit(name).replace("/usr/bin/authros", env!("CARGO_BIN_EXE_authros"));
        let path = home.file(name, text, 0o644);
        let mut command = Command::new(&program);
        command.args(["verify", "--recursive-errors=no", "--man=no", &path]);
        let outcome = Running::start(command).wait(60).expect_code(0);
        let own: Vec<&str> = outcome.stderr.lines().filter(|line| line.contains(name)).collect();
        assert!(own.is_empty(), "{own:?}");
    }
}

#[test]
fn their_commands_are_known_and_no_secret_is_in_them() {
    for name in UNITS {
        let text = unit(name);
        let line = text.lines().find_map(|line| line.strip_prefix("ExecStart=/usr/bin/authros ")).expect("a command");
        assert!(line.contains("--passphrase-file ${CREDENTIALS_DIRECTORY}/passphrase"), "{line}");
        let home = Home::new();
        let arguments: Vec<&str> = line.split(' ').filter(|word| *word != "$AGENT_ARGUMENTS").collect();
        // Known to the parser: it fails later, at the file that is not there.
        let outcome = authros(&home).run(&arguments).expect_code(3);
        assert!(outcome.stderr.contains("passphrase cannot be read"), "{outcome}");
    }
}

fn authros(home: &Home) -> support::Authros {
    support::Authros::bare(home.root())
}
