//! The systemd units: systemd finds no fault with them, and the program accepts their commands.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;

use support::{Home, Running, skipped, system_program, wait_until};

const UNITS: [&str; 4] =
    ["authros-agent.service", "authros-serve.service", "authros-gateway.service", "authros-backup.service"];

fn unit(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd").join(name)).expect("a unit")
}

#[test]
fn systemd_accepts_the_units() {
    let Some(program) = system_program("systemd-analyze") else { skipped!("no systemd-analyze") };
    let home = Home::new();
    for name in UNITS.into_iter().chain(["authros-backup.timer"]) {
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
fn systemd_accepts_the_manuals_lines_for_operators() {
    let Some(program) = system_program("systemd-analyze") else { skipped!("no systemd-analyze") };
    let manual = include_str!("../../docs/operations.md");
    let lines = manual.split("```ini\n").nth(1).and_then(|rest| rest.split("```").next()).expect("lines for a unit");
    for needed in
        ["Group=", "RuntimeDirectory=", "RuntimeDirectoryMode=0750", "PrivateUsers=no", "AUTHROS_OPERATORS_SOCKET="]
    {
        assert!(lines.contains(needed), "{needed}: {lines}");
    }
    let complaints = |lines: &str| {
        let home = Home::new();
        let name = "authros-serve.service";
        let path = home.file(name, unit(name).replace("/usr/bin/authros", env!("CARGO_BIN_EXE_authros")), 0o644);
        fs::create_dir(home.root().join(format!("{name}.d"))).expect("a folder");
        home.file(&format!("{name}.d/operators.conf"), lines, 0o644);
        let mut command = Command::new(&program);
        command.args(["verify", "--recursive-errors=no", "--man=no", &path]);
        let outcome = Running::start(command).wait(60);
        outcome.stderr.lines().filter(|line| line.contains("operators.conf")).count()
    };
    assert_eq!(complaints(lines), 0);
    assert_eq!(complaints(&lines.replace("Group=", "Grup=")), 1, "it was read");
}

#[test]
fn their_commands_are_known_and_no_secret_is_in_them() {
    for name in UNITS {
        let text = unit(name);
        let line = text.lines().find_map(|line| line.strip_prefix("ExecStart=/usr/bin/authros ")).expect("a command");
        assert!(line.contains("--passphrase-file ${CREDENTIALS_DIRECTORY}/passphrase"), "{line}");
        let home = Home::new();
        let line = line.replace("${GATEWAY_LISTEN}", "127.0.0.1:7420");
        let arguments: Vec<&str> = line.split(' ').filter(|word| *word != "$AGENT_ARGUMENTS").collect();
        // Known to the parser: it fails later, at the missing file, or at the missing home where it would make none.
        let outcome = authros(&home).run(&arguments).expect_code(3);
        let missing = ["passphrase cannot be read", "no home at"];
        assert!(missing.iter().any(|words| outcome.stderr.contains(words)), "{outcome}");
    }
}

#[test]
fn what_faces_the_network_is_hardened_alike() {
    let lines = |name: &str| {
        let text = unit(name);
        let from = text.find("NoNewPrivileges").expect("hardening");
        text[from..].to_owned()
    };
    for name in ["authros-gateway.service", "authros-agent.service"] {
        assert_eq!(lines(name), lines("authros-serve.service"), "{name}");
    }
}

#[test]
fn systemd_is_told_that_a_site_is_ready_alive_and_at_its_end() {
    let home = Home::new();
    let place = home.root().join("notify");
    let listening = UnixDatagram::bind(&place).expect("a socket");
    listening.set_nonblocking(true).expect("set");
    let heard = |wanted: &str| {
        wait_until(60, wanted, || {
            let mut bytes = [0; 64];
            let count = listening.recv(&mut bytes).ok()?;
            (bytes.get(..count) == Some(wanted.as_bytes())).then_some(())
        });
    };
    let authros =
        home.authros().with(&["--robots", "0"]).with_variable("NOTIFY_SOCKET", place.to_str().expect("UTF-8"));
    let site = authros.with_variable("WATCHDOG_USEC", "200000").spawn(&["serve"]);
    heard("READY=1");
    heard("WATCHDOG=1");
    heard("WATCHDOG=1");
    site.signal("INT");
    heard("STOPPING=1");
    site.wait(30).expect_code(0);
}

#[test]
fn a_site_and_a_gateway_log_in_json_where_that_is_asked_for() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let place = taken.local_addr().expect("its address").to_string();
    for command in [&["serve"][..], &["gateway", "serve", "--listen", "127.0.0.1:0"]] {
        let home = Home::new();
        let logging = home.authros().with(&["--robots", "0", "--log", "json"]);
        let mut site = logging.with_variable("AUTHROS_METRICS_LISTEN", &place).spawn(command);
        site.wait_for_text("stop it with Ctrl-C", 120);
        wait_until(60, "a warning", || site.stderr().contains("metrics cannot be served").then_some(()));
        let outcome = site.stop("INT", 60).expect_code(0);
        let lines = outcome.log();
        let warning = lines.iter().find(|line| line["message"].to_string().contains("metrics cannot be served"));
        let warning = warning.expect("the warning");
        assert_eq!((&warning["level"], &warning["source"]), (&"error".into(), &"site".into()));
        assert!(lines.iter().any(|line| line["source"] == "authros"), "{outcome}");
    }
    let failed = Home::new().authros().with(&["--log", "json"]).run(&["backup", "create", "/not/there"]);
    assert_eq!(failed.log().last().map(|line| line["level"].clone()), Some("error".into()), "{failed}");
}

fn authros(home: &Home) -> support::Authros {
    support::Authros::bare(home.root())
}
