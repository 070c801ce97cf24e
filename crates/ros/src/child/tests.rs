//! Under root the program runs as nobody, wherever it lies, or not at all.

use std::io::{Read as _, Write as _};
use std::os::unix::fs::{PermissionsExt, symlink};

use super::*;

/// Whether this test runs under root, without which there is nothing to give up.
fn is_root() -> bool {
    let map = std::fs::read_to_string("/proc/self/uid_map").expect("a map");
    let is_root = rustix::process::geteuid().is_root() && has_nobody(&map);
    if !is_root {
        let line = "\nSKIPPED ros::child: not root, so there are no rights to give up\n";
        // Bypasses the harness's capture, in one write.
        drop(std::io::stderr().write_all(line.as_bytes()));
    }
    is_root
}

fn errand(program: PathBuf) -> Errand {
    Errand { program, arguments: vec!["-u".to_owned()], environment: Vec::new() }
}

#[test]
fn below_a_folder_of_roots_alone_it_runs_as_nobody() {
    if !is_root() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o700)).expect("nobody cannot look into it");
    let program = folder.path().join("id");
    symlink("/usr/bin/id", &program).expect("a name for a program");
    let (mut child, _to, mut from) = start(&errand(program)).expect("it starts");
    let mut told = String::new();
    from.read_to_string(&mut told).expect("its words");
    assert!(child.wait().expect("its end").success());
    assert_eq!(told.trim(), "65534");
}

#[test]
fn a_program_that_nobody_may_execute_is_not_started_as_root_instead() {
    if !is_root() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("id");
    std::fs::copy("/usr/bin/id", &program).expect("a copy");
    std::fs::set_permissions(&program, PermissionsExt::from_mode(0o700)).expect("for root alone");
    let error = start(&errand(program.clone())).map(|_| ()).expect_err("not at all");
    assert!(matches!(error, RosError::NotAsNobody { .. }), "{error:?}");
    let told = error.to_string();
    assert!(told.contains(&program.display().to_string()) && told.contains("every user may execute"), "{told}");
}

#[test]
fn a_namespace_of_one_user_has_no_nobody() {
    let all = "         0          0 4294967295\n";
    // As `unshare --user --map-root-user` and rootless containers have it.
    let alone = "         0       1000          1\n";
    let container = "         0       1000          1\n         1     100000      65536\n";
    let short = "         0     100000      65534\n";
    assert_eq!([all, alone, container, short, ""].map(has_nobody), [true, false, true, false, true]);
}

#[test]
fn only_the_name_of_a_participant_becomes_an_argument() {
    let name = "0112c66704731022c3826304";
    let argument = |prefix: &str| Participant::new(7, prefix.to_owned()).map(|participant| participant.prefix);
    assert_eq!(argument(name).as_deref(), Some(name));
    for other in
        ["", "--publish", "0112c66704731022c382630", "0112c66704731022c38263041", "0112c66704731022c382630\u{e9}"]
    {
        assert_eq!(argument(other), None, "{other}");
    }
}
