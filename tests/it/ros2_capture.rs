//! ROS 2 topics of a real DDS peer (Eclipse Cyclone DDS with ROS 2's names and QoS), captured in a network namespace of
//! the test's own. Real nodes of ROS 2 are in `ros2_leaving.rs`.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::path::Path;
use std::time::Duration;

use serde_json::Value;
use support::ros2::{Network, Talker, network, noise};
use support::{Authros, Home, Running, count, heavy, list, long, skipped, text, wait_until};

/// The hash of `std_msgs/msg/String`, as ROS 2 gives it.
const STRING: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

/// A site that captures ROS 2 of domain 0, and its first profile.
fn begin(network: &Network, home: &Home, options: &[&str]) -> (Running, Authros) {
    let site = network.inside(&home.authros().with(&["--ros2", "0"]).with(options)).serve(home);
    let alice = home.profile("alice");
    alice.enrol();
    (site, alice)
}

fn row(alice: &Authros, topic: &str) -> Value {
    let view = alice.json(&["topics", "list"]);
    let found = list(&view, "topics").into_iter().find(|row| row["topic"] == topic);
    found.unwrap_or_else(|| panic!("{topic} in {view}"))
}

fn figures(summary: &Value) -> (u64, u64, u64) {
    (count(summary, "captured"), count(summary, "verified"), count(summary, "lost"))
}

#[test]
fn a_thousand_messages_a_second_arrive_whole_reliable_or_not() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let (_site, alice) = begin(&network, &home, &[]);
    let each = if long() { 5000 } else { 2000 };
    let number = each.to_string();
    let capture = ["capture", "--topic", "/fast", "--topic", "/loose", "--count", &number];
    let capture = alice.with(&["--json"]).spawn(&capture);
    let mut fast = Talker::start(&network, &["/fast", "string", &number, "1000", "100", "hash"]);
    let mut loose = Talker::start(&network, &["/loose", "string", &number, "200", "100", "best_effort"]);
    assert_eq!((count(&fast.sent(60), "sent"), count(&loose.sent(60), "sent")), (each, each));
    let summary = capture.wait(240).expect_code(0).document();
    assert_eq!(figures(&summary), (2 * each, 2 * each, 0), "{summary}");

    let (fast, loose) = (row(&alice, "/fast"), row(&alice, "/loose"));
    assert_eq!(
        (&fast["ros"], &fast["type_hash"], &fast["qos"]),
        (&2.into(), &STRING.into(), &"reliable volatile".into())
    );
    assert_eq!(
        (&loose["ros"], &loose["type_hash"], &loose["qos"]),
        (&2.into(), &Value::Null, &"best_effort volatile".into())
    );
    assert_eq!(fast["type"], "std_msgs/msg/String");
    let records = alice.records(&["records", "list", "--oldest", "--topic", "/fast"]);
    let opened = alice.json(&["records", "open", &text(&records[0], "id")]);
    let tag = |name: &str| {
        let found = list(&opened, "tags").into_iter().find(|tag| tag[0] == name);
        found.unwrap_or_else(|| panic!("{name} in {opened}"))[1].as_str().expect("a text").to_owned()
    };
    assert_eq!((tag("encoding").as_str(), tag("mcap.channel.topic_type_hash").as_str()), ("cdr", STRING));
    assert!(tag("mcap.channel.offered_qos_profiles").contains("reliability: reliable"));
    assert_eq!(tag("mcap.channel.writer_id").len(), 32);
    assert_eq!(opened["message"]["data"].as_str().map(str::len), Some(100), "{opened}");
    assert!(text(&opened, "note").contains("its type hash matches the message"), "{opened}");
    let records = alice.records(&["records", "list", "--oldest", "--topic", "/loose"]);
    let opened = alice.json(&["records", "open", &text(&records[0], "id")]);
    assert!(opened["message"]["data"].is_string(), "{opened}");
    assert!(text(&opened, "note").contains("has no type hash"), "{opened}");
    let shown = alice.run(&["topics", "list"]).expect_code(0).stdout;
    let cells = |start: &str| {
        let line = shown.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{start} in {shown}"));
        line.split_whitespace().nth(1).map(str::to_owned)
    };
    assert_eq!((cells("topic").as_deref(), cells("/fast").as_deref()), (Some("ROS"), Some("2")), "{shown}");
}

#[test]
fn what_the_site_was_given_open_is_not_open_in_the_reading_program() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let left = home.file("left-open", "not for everybody", 0o600);
    let authros = home.authros();
    let lines = format!("#!/bin/sh\nexec 7< {left}\nexec {} \"$@\"\n", authros.program().display());
    let started = home.file("started", &lines, 0o700);
    let site = network.inside(&authros.with_program(Path::new(&started)).with(&["--ros2", "0"])).serve(&home);
    let open = |process: &str| -> Vec<String> {
        let entries = fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten().flatten();
        entries.filter_map(|entry| Some(fs::read_link(entry.path()).ok()?.display().to_string())).collect()
    };
    assert!(open(&site.id().to_string()).contains(&left), "the site has it");
    let reader = reader_of(&site);
    let own =
        |link: &String| ["pipe:", "socket:", "anon_inode:", "/dev/null"].iter().any(|kind| link.starts_with(kind));
    wait_until(20, "nothing open but its own", || {
        let links = open(&reader);
        (links.iter().any(|link| link.starts_with("socket:")) && links.iter().all(own)).then_some(())
    });
}

#[test]
fn pictures_arrive_byte_for_byte_and_latched_messages_late() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let (_site, alice) = begin(&network, &home, &[]);
    let mut latched = Talker::start(&network, &["/tf_static", "string", "1", "1", "50", "latched"]);
    latched.sent(30);
    let pictures = if long() { 100 } else { 10 };
    let number = pictures.to_string();
    let capture = alice.with(&["--json"]).spawn(&["capture", "--topic", "/camera", "--count", &number]);
    let mut camera = Talker::start(&network, &["/camera", "image", &number, "10", "1000000"]);
    let sent = camera.sent(60);
    let summary = capture.wait(240).expect_code(0).document();
    assert_eq!(figures(&summary), (pictures, pictures, 0), "{summary}");
    let mut records = alice.records(&["records", "list", "--oldest", "--topic", "/camera"]);
    records.sort_by_key(|record| count(record, "seq"));
    let (path, mut all) = (home.root().join("picture.bin"), Vec::new());
    for record in &records {
        alice.json(&["records", "open", &text(record, "id"), "--out", path.to_str().expect("UTF-8")]);
        all.extend(fs::read(&path).expect("written"));
        fs::remove_file(&path).expect("removed");
    }
    fs::write(&path, &all).expect("written");
    let found = support::process::output_of("sha256sum", &[path.to_str().expect("UTF-8")]);
    assert_eq!(found.split(' ').next(), sent["sha256"].as_str(), "header and body of every picture");

    // Each subscriber gets what was published before it connected.
    for _ in 0..2 {
        let summary = alice.json(&["capture", "--topic", "/tf_static", "--for", "500ms"]);
        assert_eq!(figures(&summary), (1, 1, 0), "{summary}");
    }
    assert_eq!(row(&alice, "/tf_static")["qos"], "reliable transient_local");
}

/// The process that reads for a site, by its name and parent.
fn reader_of(site: &Running) -> String {
    let own = |folder: &std::path::Path| -> Option<String> {
        let stat = fs::read_to_string(folder.join("stat")).ok()?;
        let (before, after) = stat.rsplit_once(')')?;
        let parent = after.split_whitespace().nth(1)?;
        let is_burying = fs::read_to_string(folder.join("cmdline")).ok()?.contains("--bury");
        (before.ends_with("(authros-ros2") && !is_burying && parent == site.id().to_string())
            .then(|| before.split(' ').next().unwrap_or_default().to_owned())
    };
    let find = || fs::read_dir("/proc").expect("/proc").flatten().find_map(|entry| own(&entry.path()));
    wait_until(20, "the process that reads ROS 2", find)
}

/// Captures 4 s of a talker while `harm` is done to the reader; the number of missing messages is known exactly.
fn expect_known_gap(network: &Network, topic: &str, flag: &str, harm: impl Fn(&str)) {
    let home = Home::new();
    let (site, alice) = begin(network, &home, &[]);
    // It waits for its reader; capture goes on until after its last message, also on a busy machine.
    let mut talker = Talker::start(network, &[topic, "string", "6000", "500", "60", flag]);
    let capture = alice.with(&["--json"]).spawn(&["capture", "--topic", topic, "--for", "24s"]);
    let arrived = || list(&alice.json(&["topics", "list"]), "topics").into_iter().find(|row| row["topic"] == topic);
    wait_until(60, "the first messages", || arrived().filter(|row| count(row, "messages") > 300));
    let reader = reader_of(&site);
    harm(&reader);
    assert_ne!(reader_of(&site), reader, "another one was started");
    assert_eq!(count(&talker.sent(60), "sent"), 6000);
    let outcome = capture.wait(240);
    let summary = outcome.document();
    let (captured, verified, lost) = figures(&summary);
    // The exit code reports losses, too.
    assert_eq!(outcome.code, Some(if lost > 0 { 8 } else { 0 }), "{outcome}");
    assert_eq!((captured + lost, captured - verified), (6000, 0), "{summary}");
    assert!(captured > 1000, "capture went on: {summary}");
    let said = site.stderr() + &site.stdout();
    assert!(said.contains("reading ROS 2 broke off"), "{said}");
    assert!(lost == 0 || said.contains("never arrived: counted as lost in transport"), "{said}");
}

#[test]
fn a_killed_reader_leaves_a_gap_of_known_size() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    expect_known_gap(&network, "/killed", "best_effort", |reader| {
        support::process::signal("KILL", reader);
        std::thread::sleep(Duration::from_millis(100));
    });
}

#[test]
fn a_stopped_reader_is_replaced_and_what_it_missed_is_known() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    expect_known_gap(&network, "/stopped", "reliable", |reader| {
        support::process::signal("STOP", reader);
        std::thread::sleep(Duration::from_secs(2));
        support::process::signal("CONT", reader);
        let folder = std::path::Path::new("/proc").join(reader);
        wait_until(30, "the end of the stopped reader", || (!folder.exists()).then_some(()));
    });
}

/// A participant that goes without a word is kept by others for a minute; one that leaves is gone at once.
#[test]
fn on_every_way_out_the_reader_leaves_the_domain() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    for signal in ["TERM", "KILL"] {
        let home = Home::new();
        let (site, alice) = begin(&network, &home, &[]);
        alice.json(&["topics", "watch", "/left"]);
        let mut talker = Talker::start(&network, &["/left", "string", "1", "1", "60"]);
        talker.sent(60);
        talker.is_heard_by(1, 20);
        // Killed, it can end nothing: the end of the pipe tells the program that reads.
        site.stop(signal, 20);
        talker.is_heard_by(0, 60);
    }
}

#[test]
fn malformed_datagrams_do_no_harm() {
    let _alone = heavy();
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let (site, alice) = begin(&network, &home, &[]);
    let before = reader_of(&site);
    noise(&network, if long() { 100_000 } else { 5000 }).wait(120).expect_code(0);
    let capture = alice.with(&["--json"]).spawn(&["capture", "--topic", "/after", "--count", "1000"]);
    let mut talker = Talker::start(&network, &["/after", "string", "1000", "1000", "60"]);
    talker.sent(30);
    let summary = capture.wait(240).expect_code(0).document();
    assert_eq!(figures(&summary), (1000, 1000, 0), "{summary}");
    assert_eq!(reader_of(&site), before, "it was never started anew");
}

/// What the doctor says about ROS 2.
fn doctor(network: &Network, home: &Home) -> Value {
    let doctor = network.inside(&home.authros().with(&["--ros2", "0", "--json"]));
    let view = doctor.run(&["doctor"]).document();
    let check = list(&view, "checks").into_iter().find(|check| check["name"] == "ros 2");
    check.unwrap_or_else(|| panic!("no check of ROS 2 in {view}"))
}

#[test]
fn nobody_there_and_no_topics_are_told_apart_in_words() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    home.authros().with(&["--robots", "0"]).enrol();
    let check = doctor(&network, &home);
    assert_eq!(check["status"], "warn", "{check}");
    for word in ["no participants", "LARGE_DATA", "shared memory", "Discovery Server", "SROS2"] {
        assert!(text(&check, "detail").contains(word), "{word} in {check}");
    }
    let mut site = network.inside(&home.authros().with(&["--ros2"])).serve(&home);
    let said = site.wait_for_text("ROS 2 domain 0: no participants", 60);
    assert!(said.contains("LARGE_DATA"), "{said}");
    site.stop("TERM", 20).expect_code(0);
    let _other = Talker::start(&network, &["Square", "string", "1", "1", "20", "latched", "foreign"]);
    let check = doctor(&network, &home);
    assert!(text(&check, "detail").contains("1 participant and"), "{check}");
    let absent =
        home.authros().with(&["--ros2", "0", "--json"]).with_variable("AUTHROS_ROS2_PROGRAM", "/nowhere/reader");
    let view = absent.run(&["doctor"]).document().to_string();
    assert!(view.contains("/nowhere/reader") && view.contains("cargo build -p authros-ros2"), "{view}");
}

#[test]
fn a_name_in_both_graphs_is_captured_from_one_and_a_prefix_is_asked_for() {
    let network = match network() {
        Ok(network) => network,
        Err(reason) => skipped!(reason),
    };
    let home = Home::new();
    let (mut site, alice) = begin(&network, &home, &["--robots", "1"]);
    let _talker = Talker::start(&network, &["/robot1/odom", "string", "1", "1", "20", "latched"]);
    let summary = alice.json(&["capture", "--topic", "/robot1/odom", "--for", "4s"]);
    assert!(count(&summary, "captured") > 10, "{summary}");
    assert_eq!(summary["topics"][0]["type"], "nav_msgs/Odometry", "{summary}");
    let said = site.wait_for_text("the name exists in ROS 1 and in ROS 2", 60);
    assert!(said.contains("prefix") && said.contains("/ros2/robot1/odom"), "{said}");
    assert_eq!(row(&alice, "/robot1/odom")["ros"], 1);
}
