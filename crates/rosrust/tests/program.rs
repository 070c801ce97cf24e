//! The program by itself. Its publishing is tested with a real roscore in `tests/it/rosrust_playing.rs`.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::process::Command;

const PROGRAM: &str = env!("CARGO_BIN_EXE_authros-rosrust");

#[test]
fn it_says_that_it_is_not_started_by_hand() {
    let wrong = [&[][..], &["--node"], &["--node", "1x"], &["--node", "a:=b"], &["--node", "a", "b:=c"], &["--help"]];
    for arguments in wrong {
        let mut command = Command::new(PROGRAM);
        let output = command.args(arguments).env("ROS_MASTER_URI", "http://127.0.0.1:1").output().expect("it starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(said.contains("do not run it by hand") && output.stdout.is_empty(), "{said}");
    }
    let output = Command::new(PROGRAM).args(["--node", "a"]).env_remove("ROS_MASTER_URI").output().expect("it starts");
    assert!(String::from_utf8_lossy(&output.stderr).contains("ROS_MASTER_URI=URI"));
}

#[test]
fn a_master_that_does_not_answer_is_the_reason_that_the_site_is_told() {
    let mut command = Command::new(PROGRAM);
    command.args(["--node", "a"]).env("ROS_MASTER_URI", "http://127.0.0.1:1/").env("ROS_HOSTNAME", "127.0.0.1");
    let output = command.stdin(std::process::Stdio::null()).output().expect("it starts");
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(told.contains(r#""report":"failed""#) && told.contains("the ROS master refuses rosrust"), "{told}");
}

/// Everything that it begins with for a site has happened when it tries: the walls stand, or it says that they do not.
#[test]
fn it_opens_neither_a_file_nor_a_socket_of_its_own_user() {
    let folder = std::env::temp_dir().join(format!("rosrust-walls-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let (file, socket) = (folder.join("keyring"), folder.join("site.sock"));
    std::fs::write(&file, "secret").expect("a file");
    let listener = std::os::unix::net::UnixListener::bind(&socket).expect("a socket");
    drop(std::os::unix::net::UnixStream::connect(&socket).expect("this user may"));
    let mut command = Command::new(PROGRAM);
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
