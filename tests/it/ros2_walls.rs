//! The walls around the programs without keys: they open neither a keyring nor the site's socket, though their user may, and
//! where the kernel raises no walls it is said.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs::File;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

use support::keyless::{attempts, keyrings_and_sockets, program};
use support::{Home, list, tell_skipped, text};

/// The programs, and whether they look up names of hosts.
const PROGRAMS: [(&str, bool); 2] = [("authros-ros2", false), ("authros-rosrust", true)];

/// Says hello as a program does that no wall surrounds, and then that it lives.
const BARE: &str = r#"#!/bin/sh
frame() { printf "\\$(printf '%03o' ${#1})\\000\\000\\000\\000\\000\\000\\000%s" "$1"; }
frame '{"told":"hello","version":1,"domain":0,"confined":false}'
while frame '{"told":"alive","participants":0,"writers":0,"foreign":0}'; do sleep 0.3; done
"#;

#[test]
fn a_program_without_keys_opens_neither_a_keyring_nor_the_socket_though_its_user_may() {
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    home.profile("alice").enrol();
    let wanted = keyrings_and_sockets(&home.path());
    assert!(wanted.iter().any(|path| path.ends_with("site.sock")) && wanted.len() >= 2, "{wanted:?}");
    for path in &wanted {
        let opened =
            if path.ends_with("site.sock") { UnixStream::connect(path).map(drop) } else { File::open(path).map(drop) };
        opened.expect("this user may");
    }
    let own = PathBuf::from("/proc/self/status");
    let names = PathBuf::from("/etc/hosts");
    for (name, resolves) in PROGRAMS {
        let Some(program) = program(name) else {
            tell_skipped("ros2_walls", "a program without keys is not built: cargo build --workspace");
            continue;
        };
        let paths: Vec<PathBuf> = wanted.iter().chain([&names, &own]).cloned().collect();
        let Some(outcomes) = attempts(&program, &paths) else { continue };
        let line = |word: &str, path: &Path| format!("{word} {}", path.display());
        let mut expected: Vec<String> = wanted.iter().map(|path| line("PermissionDenied", path)).collect();
        // What it needs it does reach.
        expected.push(line(if resolves { "reached" } else { "PermissionDenied" }, &names));
        expected.push(line("reached", &own));
        assert_eq!(outcomes, expected, "{name}");
    }
}

#[test]
fn where_the_kernel_raises_no_walls_the_log_and_the_doctor_say_so() {
    let home = Home::new();
    // Under root it is run by nobody, who has to get to it.
    std::fs::set_permissions(home.root(), PermissionsExt::from_mode(0o755)).expect("its mode is set");
    let bare = home.file("bare", BARE, 0o755);
    let authros = home.authros().with(&["--ros2", "0"]).with_variable("AUTHROS_ROS2_PROGRAM", &bare);
    let mut site = authros.serve(&home);
    let said = site.wait_for_text("this kernel does not confine", 30);
    assert!(said.contains("Landlock") && said.contains("anything its user can open"), "{said}");
    site.stop("TERM", 20).expect_code(0);

    let view = authros.with(&["--json"]).run(&["doctor"]).document();
    let check = list(&view, "checks").into_iter().find(|check| check["name"] == "ros 2 walls");
    let check = check.unwrap_or_else(|| panic!("no check of the walls in {view}"));
    assert_eq!(check["status"], "warn", "{check}");
    assert!(text(&check, "advice").contains("/sys/kernel/security/lsm"), "{check}");
}
