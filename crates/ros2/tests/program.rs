//! The program by itself. Its reading is tested with real peers in `tests/it/ros2_capture.rs`; joining a domain here
//! would reach the tester's network.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::process::Command;

#[test]
fn it_says_that_it_is_not_started_by_hand() {
    for arguments in
        [&[][..], &["--domain"], &["--domain", "233"], &["--domain", "1", "x"], &["--publish"], &["--help"]]
    {
        let output = Command::new(env!("CARGO_BIN_EXE_authros-ros2")).args(arguments).output().expect("it starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(said.contains("authros --ros2 starts this program") && output.stdout.is_empty(), "{said}");
    }
}
