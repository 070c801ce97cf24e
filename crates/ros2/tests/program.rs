//! The program by itself. Its reading is tested with real peers in `tests/it/ros2_capture.rs`; joining a domain here
//! would reach the tester's network.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::process::Command;

#[test]
fn it_says_that_it_is_not_started_by_hand() {
    for arguments in [
        &[][..],
        &["--domain"],
        &["--domain", "233"],
        &["--domain", "1", "x"],
        &["--publish"],
        &["--help"],
        &["--domain", "1", "--bury", "0112"],
        &["--domain", "1", "--renew-after", "few"],
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_authros-ros2")).args(arguments).output().expect("it starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(said.contains("authros --ros2 starts this program") && output.stdout.is_empty(), "{said}");
    }
}

/// Everything that it begins with for a site has happened when it tries: the walls stand, or it says that they do not.
#[test]
fn it_opens_neither_a_file_nor_a_socket_of_its_own_user() {
    let folder = std::env::temp_dir().join(format!("ros2-walls-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let (file, socket) = (folder.join("keyring"), folder.join("site.sock"));
    std::fs::write(&file, "secret").expect("a file");
    let listener = std::os::unix::net::UnixListener::bind(&socket).expect("a socket");
    drop(std::os::unix::net::UnixStream::connect(&socket).expect("this user may"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_authros-ros2"));
    let output = command.arg("--attempt").args([&file, &socket]).arg("/proc/self/status").output().expect("it starts");
    let said = String::from_utf8(output.stdout).expect("UTF-8");
    drop((listener, std::fs::remove_dir_all(&folder)));
    let (first, rest) = said.split_once('\n').expect("a line");
    if first == "confined false" {
        return; // This kernel has no Landlock or no seccomp; the flows say SKIPPED.
    }
    let denied = |path: &std::path::Path| format!("PermissionDenied {}\n", path.display());
    let expected = format!("{}{}reached /proc/self/status\n", denied(&file), denied(&socket));
    assert_eq!((first, rest), ("confined true", &*expected));
}
