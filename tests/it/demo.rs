//! `authros tour --plain`: the mission from capture to refusal, without a terminal and without questions.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use serde_json::Value;
use support::{Authros, Home, count, faulty, heavy, skipped};

/// The checks that `AUTHROS_FAULT` can switch off.
const CHECKS: [&str; 9] = ["digest", "signature", "commit", "tag", "anchor", "proof", "revoke", "restore", "authorise"];

/// The story must hold whatever the number of robots and the length.
fn expect_the_whole_story(told: &Value) {
    let captured = count(told, "captured");
    assert!(captured > 0, "{told}");
    assert_eq!(count(told, "verified"), captured, "every captured record is verified: {told}");
    assert!(count(told, "anchored") >= captured, "{told}");
    assert_eq!(count(told, "lost"), 0, "{told}");
    let opened = count(told, "opened_by_grantee");
    assert!(opened > 0 && opened < captured, "what came after the revoke stays closed: {told}");
    assert_eq!(count(told, "opened_after_revoke"), 0, "{told}");
    let pictures = count(told, "restored_images");
    assert!(pictures > 0 && pictures < opened, "{told}");
    assert_eq!(told["refused_stranger"], true, "{told}");
    assert_eq!(told["refused_tampered"], true, "{told}");
    // Three registrations, a grant, a revoke, four batches that may come early, and one batch a second: of 20 records a
    // robot and more, or of a quarter of that where the machine is slow.
    let transactions = count(&told["chain"], "transactions");
    assert!(transactions >= 7 && transactions < 11 + captured / 5, "{told}");
    assert!(count(&told["chain"], "gas") > 21_000 * count(&told["chain"], "transactions"), "{told}");
    assert_eq!(told["ok"], true, "{told}");
}

#[test]
fn the_demo_of_the_readme_shows_the_whole_mission() {
    let _alone = heavy();
    let home = Home::new();
    let temporary = home.root().to_str().expect("UTF-8");
    let told = Authros::bare(home.root()).with_variable("TMPDIR", temporary).json_within(180, &["tour", "--plain"]);
    expect_the_whole_story(&told);
    // Four robots for ten seconds at 20 Hz odometry and 2 Hz pictures: 880; a slow machine may be a third behind.
    assert!((580..=960).contains(&count(&told, "captured")), "{told}");
    assert_eq!(fs::read_dir(home.root()).expect("HOME").count(), 0, "a demo without --home leaves nothing behind");
}

#[test]
fn the_demo_with_robots_of_ros_2_shows_the_whole_mission() {
    let _alone = heavy();
    let network = match support::ros2::network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let demo = ["tour", "--plain", "--seconds", "4", "--robots", "2", "--ros2"];
    let told = network.inside(&home.authros()).json_within(240, &demo);
    expect_the_whole_story(&told);
    // Two robots for four seconds at 20 Hz odometry and 2 Hz pictures: 176; a slow machine may be half behind.
    assert!((88..=400).contains(&count(&told, "captured")), "{told}");

    let absent = home.authros().with_variable("AUTHROS_ROS2_PROGRAM", "/nowhere/speaker");
    let said = network.inside(&absent).run(&demo);
    assert!(said.code != Some(0) && said.stderr.contains("cargo build -p authros-ros2"), "{said}");
}

#[test]
fn a_home_with_foreign_files_is_kept_and_they_stay() {
    let _alone = heavy();
    let home = Home::new();
    fs::create_dir(home.path()).expect("the home");
    fs::write(home.path().join("notes.txt"), "not mine").expect("a foreign file");
    let told = home.authros().json_within(180, &["tour", "--plain", "--seconds", "3", "--robots", "1"]);
    expect_the_whole_story(&told);
    assert_eq!(fs::read_to_string(home.path().join("notes.txt")).expect("still there"), "not mine");
    assert!(support::authros::files_below(&home.path()).len() > 1, "the demo's home is kept");
}

#[test]
fn without_json_it_is_a_story_with_figures_and_no_escape_codes() {
    let _alone = heavy();
    let home = Home::new();
    let outcome =
        home.authros().spawn(&["tour", "--plain", "--seconds", "2", "--robots", "2"]).wait(180).expect_code(0);
    assert!(outcome.stdout.lines().count() >= 8, "{outcome}");
    assert!(outcome.stdout.chars().any(|character| character.is_ascii_digit()), "{outcome}");
    for word in ["verified", "grant", "refused", "revoke"] {
        assert!(outcome.stdout.to_lowercase().contains(word), "no word of '{word}': {outcome}");
    }
    assert!(!outcome.stdout.contains('\u{1b}'), "{outcome}");
}

#[test]
fn each_check_switched_off_makes_the_demo_say_that_it_is_not_ok() {
    let Some(program) = faulty() else {
        skipped!("authros-faulty is not built; cargo test builds it with the examples");
    };
    let _alone = heavy();
    let demo = |fault: &str, home: &Home| {
        let authros = home.authros().with_program(&program).with_variable("AUTHROS_FAULT", fault).with(&["--json"]);
        authros.spawn(&["tour", "--plain", "--seconds", "2", "--robots", "1"])
    };
    // Three at a time: each waits most of the time.
    for faults in CHECKS.chunks(3) {
        let homes = faults.iter().map(|_| Home::new()).collect::<Vec<_>>();
        let demos = faults.iter().zip(&homes).map(|(fault, home)| (fault, demo(fault, home))).collect::<Vec<_>>();
        for (fault, running) in demos {
            let told = running.wait(180).expect_code(1).document();
            assert_eq!(told["ok"], false, "without the check '{fault}': {told}");
        }
    }
    let home = Home::new();
    let told = demo("", &home).wait(120).expect_code(0).document();
    assert_eq!(told["ok"], true, "with every check on: {told}");
    // The product itself heeds none of it.
    let home = Home::new();
    let product = home.authros().with_variable("AUTHROS_FAULT", CHECKS[0]).with(&["--json"]);
    let told =
        product.spawn(&["tour", "--plain", "--seconds", "2", "--robots", "1"]).wait(180).expect_code(0).document();
    assert_eq!(told["ok"], true, "{told}");
}
