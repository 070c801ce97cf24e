//! The site's side of publishing by rosrust, without rosrust: what a program that is missing, or none, does.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;

use super::RosrustPublisher;
use crate::model::ErrorKind;
use crate::ros::RosError;

const MASTER: &str = "http://127.0.0.1:11311/";

fn program(lines: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    // Under root a script is run by nobody, who has to get to it.
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o755)).expect("allowed");
    let path = folder.path().join("authros-rosrust");
    fs::write(&path, format!("#!/bin/sh\n{lines}\n")).expect("written");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("allowed");
    (folder, path)
}

#[test]
fn a_program_that_is_missing_or_none_is_told_of() {
    let missing = RosrustPublisher::start(MASTER, None, "/x", Some("/nowhere/authros-rosrust".as_ref())).err();
    let missing = missing.expect("missing");
    assert!(matches!(missing, RosError::NoRosrust(_)), "{missing}");
    let said = missing.to_string();
    assert!(
        said.contains("/nowhere/authros-rosrust") && said.contains("install the package authros-rosrust"),
        "{said}"
    );
    for lines in ["exit 1", "echo this is no frame at all, but it is long enough"] {
        let (_folder, path) = program(lines);
        let error = RosrustPublisher::start(MASTER, None, "/x", Some(&path)).err().expect("it does not join");
        assert_eq!(error.kind(), ErrorKind::Unreachable, "{error}");
        assert!(error.to_string().contains("http://127.0.0.1:11311"), "{error}");
    }
}

#[test]
fn it_gets_the_master_its_own_address_and_its_name_and_nothing_else() {
    // The script answers with its environment and arguments as the reason of its failure.
    let said = r#"{"report":"failed","reason":"'"$(tr '\0' ' ' < /proc/$$/environ) $*"'"}"#;
    let lines = format!(
        "SAID='{said}'\nprintf \"\\\\$(printf '%03o' $((${{#SAID}} % 256)))\\\\$(printf '%03o' $((${{#SAID}} / 256)))\\\\000\\\\000\\\\000\\\\000\\\\000\\\\000%s\" \"$SAID\""
    );
    let (_folder, path) = program(&lines);
    let error = RosrustPublisher::start(MASTER, Some("127.0.0.1"), "/mouth", Some(&path)).err().expect("it says so");
    let said = error.to_string();
    assert!(said.contains("ROS_HOSTNAME=127.0.0.1 ROS_MASTER_URI=http://127.0.0.1:11311"), "{said}");
    assert!(said.contains("--node mouth"), "{said}");
    assert!(!said.contains("HOME=") && !said.contains("PATH=") && !said.contains("AUTHROS"), "{said}");
}
