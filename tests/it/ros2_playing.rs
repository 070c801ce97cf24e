//! Shared records of ROS 2 in the reader's own domain: what a real DDS subscriber (Eclipse Cyclone DDS with ROS 2's names and
//! QoS) hears there, and when it ends. All in a network namespace of the test's own.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::Value;
use support::keyless::{expect_no_key_in, process_of};
use support::ros2::{Listener, Network, Talker, network};
use support::{Authros, Home, Running, count, heavy, is_verified, skipped, wait_until};

const INCOMPLETE: i32 = 8;
const REFUSED: i32 = 5;
/// Where the reader plays; the robots are in domain 0.
const OUT: &str = "7";
const READER: &str = "authros-ros2";

/// A site that captures ROS 2 of domain 0, with two profiles.
struct Plant {
    home: Home,
    site: Running,
    alice: Authros,
    bob: Authros,
    bob_address: String,
}

fn plant(network: &Network, options: &[&str]) -> Plant {
    let home = Home::new();
    let site = network.inside(&home.authros().with(&["--ros2", "0"]).with(options)).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    Plant { home, site, alice, bob, bob_address }
}

fn figures(played: &Value) -> [u64; 4] {
    ["published", "refused", "missing", "dropped"].map(|figure| count(played, figure))
}

/// Waits until this number of records of a topic is verified.
fn expect_verified(alice: &Authros, topic: &str, number: usize) {
    wait_until(120, "all is verified", || {
        let records = alice.records(&["records", "list", "--oldest", "--topic", topic]);
        (records.len() == number && records.iter().all(is_verified)).then_some(())
    });
}

#[test]
fn a_real_subscriber_in_the_reader_s_domain_hears_what_the_robot_said() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let plant = plant(&network, &[]);
    // The lengths are no multiples of four, which DDS fills up.
    let kinds = [
        ("/words", "string", "300", "300", "37", ""),
        ("/loose", "string", "300", "100", "121", "best_effort"),
        ("/camera", "image", "10", "20", "60001", ""),
    ];
    let originals = kinds.map(|(topic, kind, .., flag)| Listener::start(&network, "0", &[topic, kind, flag]));
    for (topic, ..) in kinds {
        plant.alice.json(&["topics", "watch", topic]);
    }
    let talkers = kinds.map(|(topic, kind, number, hertz, size, flag)| {
        Talker::start(&network, &[topic, kind, number, hertz, size, flag, "readers2"])
    });
    for (topic, _, number, ..) in kinds {
        expect_verified(&plant.alice, topic, number.parse().expect("a number"));
    }
    drop(talkers);

    let refused = plant.bob.fails(REFUSED, &["received", "play", "--ros2", OUT]);
    assert!(refused.contains("shares"), "without a grant there is nothing to play: {refused}");
    plant.alice.json(&["grant", "add", &plant.bob_address]);
    let refused = plant.bob.fails(REFUSED, &["received", "play", "--ros2", "0"]);
    assert!(refused.contains("--prefix"), "a loop is refused: {refused}");

    let readers = kinds.map(|(topic, kind, .., flag)| Listener::start(&network, OUT, &[topic, kind, flag]));
    let played = plant.bob.run(&["--json", "received", "play", "--ros2", OUT]).expect_code(0).document();
    assert_eq!((figures(&played), &played["ended_by"]), ([610, 0, 0, 0], &"whole".into()), "{played}");
    for ((original, reader), (topic, _, number, ..)) in originals.iter().zip(&readers).zip(kinds) {
        let expected = original.hears(number.parse().expect("a number"), 20);
        let heard = reader.hears(expected.len(), 20);
        assert!(heard == expected, "{topic}: the same bytes, header included, in the same order");
        reader.meets(0, 20);
    }

    // Somebody else publishes the name there; and the domain that is captured, under a prefix.
    let _other = Talker::start(&network, &["/words", "string", "1", "1", "20", "latched", "domain7"]);
    let played = plant.bob.run(&["--json", "received", "play", "--ros2", OUT]).expect_code(INCOMPLETE).document();
    assert_eq!(figures(&played), [310, 300, 0, 0], "{played}");
    assert!(played["reasons"].to_string().contains("a cyclonedds publisher already publishes"), "{played}");
    let under = Listener::start(&network, "0", &["/shared/alice/words", "string"]);
    let arguments = ["--json", "received", "play", "--ros2", "0", "--prefix", "/shared/alice", "--topic", "/words"];
    let played = plant.bob.run(&arguments).expect_code(0).document();
    assert_eq!(figures(&played), [300, 0, 0, 0], "{played}");
    assert!(under.hears(300, 20) == originals[0].heard(), "under the prefix, too");
}

#[test]
fn what_is_played_live_into_a_domain_ends_with_the_grant_and_late_subscribers_get_what_was_latched() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let plant = plant(&network, &[]);
    for topic in ["/words", "/tf_static"] {
        plant.alice.json(&["topics", "watch", topic]);
    }
    let original = Listener::start(&network, "0", &["/tf_static", "string", "latched"]);
    let _latched = Talker::start(&network, &["/tf_static", "string", "1", "1", "50", "latched"]);
    expect_verified(&plant.alice, "/tf_static", 1);
    plant.alice.json(&["grant", "add", &plant.bob_address]);

    let reader = Listener::start(&network, OUT, &["/words", "string"]);
    let player = plant.bob.spawn(&["--json", "received", "play", "--follow", "--ros2", OUT]);
    let late = Listener::start(&network, OUT, &["/tf_static", "string", "latched"]);
    assert_eq!(late.hears(1, 60), original.hears(1, 20));
    let process = process_of(&plant.site, READER, "--publish");
    expect_no_key_in(
        &plant.home.path(),
        &process,
        "authros-ros2 --domain 7 --publish ",
        &["MALLOC_MMAP_THRESHOLD_"],
        "/tf_static",
    );

    let heard = Listener::start(&network, "0", &["/words", "string"]);
    let talker = Talker::start(&network, &["/words", "string", "200", "100", "60", "readers2"]);
    assert!(reader.hears(200, 60) == heard.hears(200, 20), "the same bytes in the same order");
    drop(talker);
    let later = Listener::start(&network, OUT, &["/tf_static", "string", "latched"]);
    assert_eq!(later.hears(1, 60), original.heard());

    // The program is started anew, with what was latched.
    support::process::signal("KILL", &process);
    let anew = Listener::start(&network, OUT, &["/tf_static", "string", "latched"]);
    assert_eq!(anew.hears(1, 60), original.heard());

    // In the middle of another run of messages.
    let _running = Talker::start(&network, &["/words", "string", "6000", "50", "60"]);
    reader.hears(250, 60);
    let revoked = plant.alice.json(&["grant", "end", &plant.bob_address]);
    assert!(revoked["transaction"].is_string(), "{revoked}");
    let played = player.wait(60).expect_code(REFUSED).document();
    assert_eq!((&played["ended_by"], count(&played, "refused")), (&"revoked".into(), 0), "{played}");
    // The others have met writers of the killed program, too, and wait until their leases run out.
    anew.meets(0, 20);
    // What comes after the revoke is never heard, and nothing is latched any more.
    let (before, seen) =
        (reader.heard().len(), plant.alice.records(&["records", "list", "--oldest", "--topic", "/words"]).len());
    wait_until(60, "more is verified", || {
        let records = plant.alice.records(&["records", "list", "--oldest", "--topic", "/words"]);
        (records.iter().filter(|record| is_verified(record)).count() > seen + 50).then_some(())
    });
    assert_eq!(reader.heard().len(), before);
    assert!(u64::try_from(before).is_ok_and(|before| before <= count(&played, "published")), "{before} {played}");
}

#[test]
fn records_of_ros_1_are_not_translated_and_a_missing_program_is_told_of() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let site = network.inside(&home.authros().with(&["--robots", "1"])).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    alice.json(&["grant", "add", &bob_address]);
    alice.capture(&["/robot1/odom"], 3);
    let outcome = bob.run(&["--json", "received", "play", "--ros2", OUT]).expect_code(INCOMPLETE);
    let played = outcome.document();
    assert_eq!((figures(&played), &played["ended_by"]), ([0, 3, 0, 0], &"whole".into()), "{played}");
    assert!(played["reasons"].to_string().contains("a message of ROS 1 is not translated into ROS 2"), "{played}");
    let said = bob.run(&["received", "play", "--ros2", "7", "--to", "http://127.0.0.1:1"]);
    assert!(said.code != Some(0) && said.stderr.contains("--to"), "{said}");

    site.stop("TERM", 20).expect_code(0);
    let absent = home.authros().with_variable("AUTHROS_ROS2_PROGRAM", "/nowhere/speaker");
    let _site = network.inside(&absent).serve(&home);
    let said = bob.run(&["received", "play", "--ros2", OUT]);
    assert!(said.stderr.contains("/nowhere/speaker") && said.stderr.contains("cargo build -p authros-ros2"), "{said}");
}
