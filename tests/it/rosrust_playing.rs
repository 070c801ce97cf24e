//! rosrust as a node beside ours: what a real recorder hears of it, that its process holds no key, and robots that are
//! such nodes.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::path::Path;

use serde_json::Value;
use support::keyless::{self, expect_no_key_in, process_of};
use support::{
    Authros, Home, Roscore, Running, count, heavy, is_verified, list, list_bag, make_bag, skipped, wait_until,
};

const NO_ROS: &str = "no roscore, rosbag and rostopic in /usr/bin";
const NO_ROSRUST: &str = "authros-rosrust is not built: cargo build -p authros-rosrust";
const PROGRAM: &str = "authros-rosrust";
const TOPICS: [&str; 3] = ["/odom", "/words", LATCHED];
const LATCHED: &str = "/calibration";
const REFUSED: i32 = 5;

/// A site on a real graph that plays by rosrust, with two profiles, of which the first watches the topics.
struct Plant {
    home: Home,
    site: Running,
    alice: Authros,
    bob: Authros,
    bob_address: String,
}

fn plant(robot: &Roscore) -> Plant {
    let home = Home::new();
    let authros = home.authros().with(&["--ros-master", &robot.uri()]).with_variable("AUTHROS_PUBLISHER", "rosrust");
    let site = authros.serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    for topic in TOPICS {
        alice.json(&["topics", "watch", topic]);
    }
    Plant { home, site, alice, bob, bob_address }
}

/// Plays the bag at the robot until all of it is verified for the `times`-th time.
fn drive(robot: &Roscore, plant: &Plant, bag: &Path, times: usize) {
    robot.play_as("robot", bag, 2).wait(120).expect_code(0);
    let expected = list_bag(bag).len() * times;
    wait_until(120, "all is verified", || {
        let records = plant.alice.records(&["records", "list", "--oldest"]);
        (records.len() == expected && records.iter().all(is_verified)).then_some(())
    });
}

/// The content of a bag per topic: type, md5sum, definition and bytes, in order.
fn messages(bag: &Path, topic: &str) -> Vec<Value> {
    let all = list_bag(bag).into_iter().filter(|entry| entry[0] == topic);
    all.map(|entry| Value::from(vec![entry[1].clone(), entry[2].clone(), entry[4].clone(), entry[6].clone()])).collect()
}

#[test]
fn a_real_recorder_hears_by_rosrust_what_the_robot_said_until_the_revoke_and_its_process_holds_no_key() {
    let _alone = heavy();
    let Some(_) = keyless::program(PROGRAM) else { skipped!(NO_ROSRUST) };
    let (Some(robot), Some(reader)) = (Roscore::start(), Roscore::start()) else { skipped!(NO_ROS) };
    let plant = plant(&robot);
    let path = |name: &str| plant.home.root().join(name);
    let bag = path("drive.bag");
    make_bag(&["latched", bag.to_str().expect("UTF-8")]);
    drive(&robot, &plant, &bag, 1);
    plant.alice.json(&["grant", "add", &plant.bob_address]);

    // All that is there, as fast as it is read.
    let recorded = path("at-once.bag");
    let recorder = reader.record(&recorded, &TOPICS);
    let played = plant.bob.spawn(&["--json", "received", "play", "--to", &reader.uri()]).wait(120);
    let played = played.expect_code(0).document();
    let figures = ["published", "refused", "missing", "dropped"].map(|figure| count(&played, figure));
    assert_eq!(figures, [list_bag(&bag).len() as u64, 0, 0, 0], "{played}");
    Roscore::stop_recording(recorder);
    for topic in TOPICS {
        let (heard, expected) = (messages(&recorded, topic), messages(&bag, topic));
        assert_eq!(heard.len(), expected.len(), "{topic}");
        assert!(heard == expected, "{topic}: the same bytes, md5sum, type and definition in the same order");
    }

    // Live: what was latched reaches who comes late, also after the process was killed.
    let live = path("live.bag");
    let recorder = reader.record(&live, &["/odom", "/words"]);
    let player = plant.bob.spawn(&["--json", "received", "play", "--follow", "--to", &reader.uri()]);
    let is_played = || reader.publishers(LATCHED).contains("/authros_play_").then_some(());
    wait_until(60, "the latched topic is there", is_played);
    let process = process_of(&plant.site, PROGRAM, "authros_play_");
    let calibration: Vec<Value> = messages(&bag, LATCHED).into_iter().map(|message| message[3].clone()).collect();
    let latched = || list(&reader.hear(1, &[LATCHED]), LATCHED);
    assert!(latched().last().is_some_and(|message| calibration.contains(message)));
    let variables = ["ROS_HOSTNAME", "ROS_MASTER_URI"];
    expect_no_key_in(&plant.home.path(), &process, "authros-rosrust --node authros_play_", &variables, LATCHED);
    support::process::signal("KILL", &process);
    wait_until(60, "another process", || {
        let now = process_of(&plant.site, PROGRAM, "authros_play_");
        (now != process).then_some(())
    });
    assert!(latched().last().is_some_and(|message| calibration.contains(message)), "again after the restart");

    let ear = reader.listen(messages(&bag, "/odom").len() + messages(&bag, "/words").len(), &["/odom", "/words"]);
    drive(&robot, &plant, &bag, 2);
    ear.wait(120).expect_code(0);
    assert_eq!(latched().last(), calibration.last(), "the last one is latched");
    plant.alice.json(&["grant", "end", &plant.bob_address]);
    let played = player.wait(60).expect_code(REFUSED).document();
    assert_eq!((&played["ended_by"], count(&played, "refused")), (&"revoked".into(), 0), "{played}");
    assert_eq!(reader.publishers(LATCHED), "", "nobody publishes it any more");
    drive(&robot, &plant, &bag, 3);
    Roscore::stop_recording(recorder);
    for topic in ["/odom", "/words"] {
        assert!(messages(&live, topic) == messages(&bag, topic), "{topic}: what was verified live, and nothing after");
    }
}

#[test]
fn simulated_robots_may_be_nodes_of_rosrust_each_in_a_process_of_its_own() {
    let Some(_) = keyless::program(PROGRAM) else { skipped!(NO_ROSRUST) };
    let home = Home::new();
    let site = home.authros().with(&["--robots", "2", "--robots-by", "rosrust"]).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    alice.capture(&["/robot1/odom", "/robot2/camera/compressed"], 4);
    wait_until(60, "all is verified", || {
        let records = alice.records(&["records", "list", "--oldest"]);
        (records.len() >= 4 && records.iter().all(is_verified)).then_some(())
    });
    let processes = ["robot1_sim", "robot2_sim"].map(|node| process_of(&site, PROGRAM, node));
    assert_ne!(processes[0], processes[1]);
}

#[test]
fn a_missing_program_is_told_of_with_the_way_to_get_it() {
    let home = Home::new();
    let absent = home.authros().with(&["--robots", "1"]).with_variable("AUTHROS_PUBLISHER", "rosrust");
    let site = absent.with_variable("AUTHROS_ROSRUST_PROGRAM", "/nowhere/speaker").serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    alice.json(&["grant", "add", &bob_address]);
    let said = bob.run(&["received", "play", "--prefix", "/shared/alice"]);
    assert!(said.code != Some(0) && said.stderr.contains("/nowhere/speaker"), "{said}");
    assert!(said.stderr.contains("cargo build -p authros-rosrust"), "{said}");
    site.stop("TERM", 20).expect_code(0);

    let absent = home.authros().with(&["--robots", "1", "--robots-by", "rosrust"]);
    let _site = absent.with_variable("AUTHROS_ROSRUST_PROGRAM", "/nowhere/speaker").serve(&home);
    wait_until(60, "the site says so", || {
        let said = alice.run(&["status"]);
        (said.stdout.contains("/nowhere/speaker") && said.stdout.contains("authros-rosrust")).then_some(())
    });
    let refused = home.authros().with(&["--robots-by", "roscpp"]).run(&["config", "show"]);
    assert!(refused.code != Some(0) && refused.stderr.contains("choose own or rosrust"), "{refused}");
}
