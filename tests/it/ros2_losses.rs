//! Messages of ROS 2 that a machine with small buffers cannot take: as many are reported as are missing.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::Command;

use support::ros2::{Talker, network, reader_program};
use support::{Home, count, heavy, skipped, system_program};

#[test]
fn with_a_small_receive_buffer_what_is_reported_lost_is_what_was_sent_and_not_received() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let Some(compiler) = system_program("cc") else { skipped!("no C compiler") };
    let home = Home::new();
    let shim = home.root().join("shim.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/receive_buffer_shim.c");
    let mut command = Command::new(compiler);
    command.args(["-shared", "-fPIC", "-O2", "-o"]).args([&shim, &source]).arg("-ldl");
    assert!(command.status().expect("the compiler runs").success(), "the shim compiles");
    // Under root the script is run by nobody, who has to get to it, to the shim and to the program.
    fs::set_permissions(home.root(), fs::Permissions::from_mode(0o755)).expect("its mode is set");
    let reader = home.root().join("authros-ros2");
    fs::copy(reader_program().expect("asked before"), &reader).expect("copied");
    let lines = format!("#!/bin/sh\nLD_PRELOAD={} exec {} \"$@\"\n", shim.display(), reader.display());
    let wrapper = home.file("reader", lines, 0o755);
    let options = ["--ros2", "0"];
    let authros = home.authros().with(&options).with_variable("AUTHROS_ROS2_PROGRAM", &wrapper);
    let _site = network.inside(&authros).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();

    // The first and the last message are small: between two that arrive every number is accounted for.
    let flags = ["best_effort", "small_ends"];
    let mut camera = Talker::start(&network, &[&["/camera", "image", "40", "10", "1000000"], &flags[..]].concat());
    // It waits for its reader; capture goes on until after its last message.
    let capture = alice.with(&["--json"]).spawn(&["capture", "--topic", "/camera", "--for", "16s"]);
    assert_eq!(count(&camera.sent(60), "sent"), 40);
    let outcome = capture.wait(240);
    let summary = outcome.document();
    let (captured, lost) = (count(&summary, "captured"), count(&summary, "lost"));
    assert!(lost > 0, "the buffer is too small for a picture: {summary}");
    assert_eq!((captured + lost, outcome.code), (40, Some(8)), "{outcome}");
}
