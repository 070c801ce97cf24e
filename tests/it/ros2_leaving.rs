//! Nothing of ours that leaves holds a robot's node: real nodes of Jazzy and Kilted that publish reliably and keep all until it
//! is acknowledged go on at their rate whichever way we leave, and see nobody of ours. A real subscriber that comes and goes is the
//! control.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::time::{Duration, Instant};

use support::figures::cpu_seconds;
use support::keyless::process_of;
use support::process::{own_memory, signal};
use support::ros2::{Network, network, reader_program};
use support::ros2_nodes::{Node, Python, all_real_nodes};
use support::{Authros, Home, count, heavy, is_verified, length, list, long, poll, skipped, wait_until};

/// Messages a second: a node of Fast DDS dies when 5000 are not acknowledged, ten seconds after its reader fell silent.
const HERTZ: u64 = 500;
/// How soon nobody of ours may be seen any more, and after a kill that leaves nobody to say so.
const GONE: u64 = 5;
const GONE_AFTER_A_KILL: u64 = 8;
/// A stopped program is noticed after five seconds.
const GONE_AFTER_A_STOP: u64 = 6 + GONE_AFTER_A_KILL;
/// How ids of this program's participants begin.
const OURS: &str = "0112";
const READER: &str = "authros-ros2";

/// One node of each distribution, which publishes under that distribution's name.
struct Robots {
    network: Network,
    pythons: Vec<(&'static str, Python)>,
    nodes: Vec<(String, Node)>,
    begun: Instant,
}

fn ours(ids: &[String]) -> usize {
    ids.iter().filter(|id| id.starts_with(OURS)).count()
}

impl Robots {
    fn start(network: Network, pythons: Vec<(&'static str, Python)>) -> Self {
        let rate = HERTZ.to_string();
        let start = |(name, python): &(&str, Python)| {
            let topic = format!("/{name}");
            let node = python.node(&network, "0", &["publish", &topic, "--rate", &rate, "--keep-all"]);
            (topic, node)
        };
        let nodes = pythons.iter().map(start).collect();
        Self { network, pythons, nodes, begun: Instant::now() }
    }

    fn topics(&self) -> Vec<&str> {
        self.nodes.iter().map(|(topic, _)| topic.as_str()).collect()
    }

    /// Waits until every node has so many subscribers of ours; returns all their ids.
    fn see(&self, number: usize, seconds: u64, way: &str) -> Vec<String> {
        let fits = |ids: &[String]| ours(ids) == number;
        let see = |(topic, node): &(String, Node)| {
            let what = format!("{way}: {number} of ours on {topic}");
            node.meets("subscribers", seconds, &what, fits)
        };
        let ids = self.nodes.iter().flat_map(see).collect();
        self.publish(way);
        ids
    }

    /// Waits until none of these ids is seen, but another reader of ours is.
    fn see_others_than(&self, former: &[String], seconds: u64, way: &str) {
        let is_former = |id: &String| id.starts_with(OURS) && former.contains(id);
        let fits = |ids: &[String]| ours(ids) == 1 && !ids.iter().any(is_former);
        for (topic, node) in &self.nodes {
            node.meets("subscribers", seconds, &format!("{way}: another of ours on {topic}"), fits);
        }
        self.publish(way);
    }

    /// Fails unless they publish at nearly their rate; a busy machine may delay them a little.
    fn publish(&self, way: &str) {
        for (topic, node) in &self.nodes {
            let before = node.number("sent");
            std::thread::sleep(Duration::from_secs(1));
            let sent = node.number("sent") - before;
            assert!(sent >= HERTZ / 4, "{way}: {topic} sends {sent} messages a second");
        }
    }

    /// Fails unless all of them went on to the end.
    #[allow(clippy::print_stdout, reason = "figures for who runs the long form")]
    fn end(self) {
        let seconds = self.begun.elapsed().as_secs();
        for (topic, node) in self.nodes {
            let sent = node.number("sent");
            println!("{topic}: {sent} sent in {seconds} s");
            assert!(sent >= seconds.saturating_sub(3) * HERTZ / 2, "{topic}: {sent} sent in {seconds} s");
            node.end();
        }
    }

    /// Lets them send more than a writer keeps for somebody who is gone.
    fn outlive(&self, way: &str) {
        let more = if long() { 17_500 } else { 6000 };
        for (topic, node) in &self.nodes {
            let before = node.number("sent");
            let all = || (node.number("sent") >= before + more).then_some(());
            wait_until(3 * more / HERTZ, &format!("{way}: {more} messages of {topic}"), all);
        }
        self.see(0, GONE, way);
    }
}

/// Real subscribers of the nodes, with what each had heard, and its node sent, when it began.
struct Controls(Vec<(Node, u64, u64)>);

impl Controls {
    fn start(robots: &Robots) -> Self {
        let start = |((_, python), topic): (&(&str, Python), &str)| {
            python.node(&robots.network, "0", &["subscribe", topic, "--keep-all"])
        };
        let controls: Vec<Node> = robots.pythons.iter().zip(robots.topics()).map(start).collect();
        let begun = controls.into_iter().zip(&robots.nodes).map(|(control, (_, robot))| {
            wait_until(20, "the control hears", || (control.number("heard") > 0).then_some(()));
            let figures = (control.number("heard"), robot.number("sent"));
            (control, figures.0, figures.1)
        });
        Self(begun.collect())
    }

    /// Fails unless each heard all that its node sent, but for what is on its way: both tell ten times a second.
    #[allow(clippy::print_stdout, reason = "figures for who runs the long form")]
    fn hear_all(&self, robots: &Robots) {
        for ((control, heard, sent), (topic, robot)) in self.0.iter().zip(&robots.nodes) {
            let figures = || (control.number("heard") - heard, robot.number("sent") - sent);
            let all = || Some(figures()).filter(|(heard, sent)| heard.abs_diff(*sent) <= HERTZ);
            wait_until(30, &format!("the control of {topic} heard all"), || all().map(|_| ()));
            let (heard, sent) = figures();
            println!("{topic}: its control heard {heard} while {sent} were sent");
        }
    }

    fn end(self) {
        self.0.into_iter().for_each(|(control, ..)| control.end());
    }
}

fn watch(alice: &Authros, robots: &Robots, command: &str) {
    robots.topics().iter().for_each(|topic| drop(alice.json(&["topics", command, topic])));
}

#[test]
fn a_robots_node_outlives_every_way_in_which_a_reader_leaves() {
    let _alone = heavy();
    let (network, pythons) = match (network(), all_real_nodes()) {
        (Ok(network), Ok(pythons)) => (network, pythons),
        (Err(reason), _) | (_, Err(reason)) => skipped!(reason),
    };
    let robots = Robots::start(network, pythons);
    // The control: real subscribers, which leave as ROS 2 does; in the long form they hear everything beside ours.
    let controls = Controls::start(&robots);
    let beside = if long() {
        Some(controls)
    } else {
        controls.end();
        None
    };

    let home = Home::new();
    let site = robots.network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();

    let topics = robots.topics();
    let summary = alice.json(&["capture", "--topic", topics[0], "--topic", topics[1], "--for", "10s"]);
    assert!(support::count(&summary, "captured") > HERTZ, "{summary}");
    robots.see(0, GONE, "a capture ended");

    watch(&alice, &robots, "watch");
    robots.see(1, 20, "watched");
    watch(&alice, &robots, "unwatch");
    robots.see(0, GONE, "unwatched");

    watch(&alice, &robots, "watch");
    let former = robots.see(1, 20, "watched again");
    let weaker: Vec<Node> = robots
        .pythons
        .iter()
        .zip(&topics)
        .map(|((_, python), topic)| {
            python.node(&robots.network, "0", &["publish", topic, "--best-effort", "--rate", "5", "--name", "weaker"])
        })
        .collect();
    robots.see_others_than(&former, 2 + GONE, "a weaker publisher joined");
    weaker.into_iter().for_each(Node::end);

    let former = robots.see(1, 20, "before the kill");
    signal("KILL", &process_of(&site, READER, "--domain"));
    robots.see_others_than(&former, GONE_AFTER_A_KILL, "its program was killed");

    let former = robots.see(1, 20, "before the stop");
    signal("STOP", &process_of(&site, READER, "--domain"));
    robots.see_others_than(&former, GONE_AFTER_A_STOP, "its program was stopped");

    site.stop("TERM", 20).expect_code(0);
    robots.see(0, GONE, "the site ended");

    let second = Home::new();
    let site = robots.network.inside(&second.authros().with(&["--ros2", "0"])).serve(&second);
    let bob = second.profile("bob");
    bob.enrol();
    watch(&bob, &robots, "watch");
    robots.see(1, 20, "another site came");
    site.stop("KILL", 20);
    robots.see(0, GONE, "the site was killed");
    robots.outlive("long after it");
    if let Some(controls) = beside {
        controls.hear_all(&robots);
        controls.end();
    }
    robots.end();
}

#[test]
fn what_was_played_leaves_the_domain_when_playing_ends() {
    let _alone = heavy();
    let (network, pythons) = match (network(), all_real_nodes()) {
        (Ok(network), Ok(pythons)) => (network, pythons),
        (Err(reason), _) | (_, Err(reason)) => skipped!(reason),
    };
    let home = Home::new();
    let site = network.inside(&home.authros().with(&["--ros2", "0"])).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    alice.enrol();
    let bob_address = bob.enrol();
    let (_, first) = &pythons[0];
    alice.json(&["topics", "watch", "/said"]);
    let robot = first.node(&network, "0", &["publish", "/said", "--latched", "--depth", "5", "--number", "5"]);
    wait_until(60, "all is verified", || {
        let records = alice.records(&["records", "list", "--oldest", "--topic", "/said"]);
        (records.len() == 5 && records.iter().all(is_verified)).then_some(())
    });
    robot.end();
    alice.json(&["grant", "add", &bob_address]);
    let subscribe = |(_, python): &(&str, Python)| python.node(&network, "7", &["subscribe", "/said"]);
    let readers: Vec<Node> = pythons.iter().map(subscribe).collect();
    let meet = |number: usize, seconds: u64, way: &str| {
        for reader in &readers {
            reader.meets("publishers", seconds, way, |ids| ids.len() == number);
        }
    };

    let play = ["--json", "received", "play", "--follow", "--ros2", "7"];
    let player = bob.spawn(&play);
    meet(1, 30, "played");
    player.stop("INT", 20);
    meet(0, GONE, "playing was ended");

    let player = bob.spawn(&play);
    meet(1, 30, "played again");
    signal("KILL", &process_of(&site, READER, "--publish"));
    player.stop("INT", 20);
    meet(0, GONE_AFTER_A_KILL, "the program that plays was killed");

    let player = bob.spawn(&play);
    meet(1, 30, "played a third time");
    alice.json(&["grant", "end", &bob_address]);
    meet(0, 10, "the grant was revoked");
    player.wait(60);
    readers.into_iter().for_each(Node::end);
}

/// A site's home with a program that reads as it always does, but replaces its participant after meeting so many endpoints of
/// others.
fn renewing(home: &Home, after: u64) -> Authros {
    // Under root the script is run by nobody, who has to get to it and to the program.
    fs::set_permissions(home.root(), fs::Permissions::from_mode(0o755)).expect("its mode is set");
    let reader = home.root().join(READER);
    fs::copy(reader_program().expect("asked before"), &reader).expect("copied");
    let own = reader.display();
    let lines = format!(
        "#!/bin/sh\ncase \"$*\" in\n*--bury*) exec {own} \"$@\" ;;\n*) exec {own} \"$@\" --renew-after {after} ;;\nesac\n"
    );
    let wrapper = home.file("reader", lines, 0o755);
    home.authros().with(&["--ros2", "0"]).with_variable("AUTHROS_ROS2_PROGRAM", &wrapper)
}

/// The participants of the program in the tests of its replacing: the first, and one after each time.
const RENEWED: usize = 4;
/// A node has about twenty writers and readers.
const A_NODE: u64 = 15;

#[test]
#[allow(clippy::print_stdout, reason = "figures for who runs the long form")]
fn a_program_that_replaces_its_participant_loses_nothing_repeats_nothing_and_holds_nobody() {
    let _alone = heavy();
    let (network, pythons) = match (network(), all_real_nodes()) {
        (Ok(network), Ok(pythons)) => (network, pythons),
        (Err(reason), _) | (_, Err(reason)) => skipped!(reason),
    };
    let home = Home::new();
    let site = network.inside(&renewing(&home, A_NODE)).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    let reader = process_of(&site, READER, "--domain");

    let robot = |(name, python): &(&str, Python)| {
        python.node(&network, "0", &["publish", &format!("/{name}"), "--rate", "200", "--keep-all", "--patient"])
    };
    let robots: Vec<Node> = pythons.iter().map(robot).collect();
    let (_, first) = &pythons[0];
    let latched = ["publish", "/said", "--latched", "--depth", "5", "--number", "5", "--name", "said"];
    let latched = first.node(&network, "0", &latched);
    let topics = ["--topic", "/jazzy", "--topic", "/kilted", "--topic", "/said"];
    let capture = alice.with(&["--json"]).spawn(&[&["capture", "--for", "600s"], &topics[..]].concat());

    // Every passer-by makes it replace its participant, if it is not doing that already.
    let (begun, mut seen) = (Instant::now(), BTreeSet::new());
    let wanted = if long() { 5 * RENEWED } else { RENEWED };
    for (_, python) in pythons.iter().cycle() {
        let passer = python.node(&network, "0", &["publish", "/passing", "--name", "passer"]);
        let before = seen.len();
        let more = || {
            let found = robots.iter().flat_map(|robot| robot.others("subscribers"));
            seen.extend(found.filter(|id| id.starts_with(OURS)).map(|id| id[..24].to_owned()));
            (seen.len() > before).then_some(())
        };
        poll(20, more);
        for robot in &robots {
            robot.meets("subscribers", 60, "the successor alone", |ids| ours(ids) == 1);
        }
        passer.end();
        if seen.len() >= wanted {
            break;
        }
        let patience = Duration::from_secs(60) * u32::try_from(wanted).expect("few");
        assert!(begun.elapsed() < patience, "{} participants: {seen:?}", seen.len());
    }
    println!("{} participants in {} s", seen.len(), begun.elapsed().as_secs());
    assert_eq!(latched.number("sent"), 5);
    let sent: u64 = robots.into_iter().map(Node::ends_having_sent).sum::<u64>() + 5;
    let alarms = list(&alice.json(&["topics", "pins"]), "alarms");
    assert!(alarms.is_empty(), "{alarms:?}");
    capture.signal("INT");
    let summary = capture.wait(240).expect_code(0).document();
    let figures = ["captured", "verified", "lost"].map(|figure| count(&summary, figure));
    assert_eq!(figures, [sent, sent, 0], "{summary}");
    assert_eq!(process_of(&site, READER, "--domain"), reader, "it was never started anew");
    latched.end();

    // Every way of ending it in the middle of that: a node that comes makes it replace its participant, and so does being found
    // by a program that was just started.
    alice.json(&["topics", "watch", "/jazzy"]);
    let last = robot(&pythons[0]);
    let both = last.meets("subscribers", 60, "two of ours", |ids| ours(ids) == 2);
    signal("KILL", &reader);
    let neither = |ids: &[String]| !ids.iter().any(|id| both.contains(id));
    last.meets("subscribers", GONE_AFTER_A_KILL, "its program was killed", neither);
    last.meets("subscribers", 60, "two of the next program", |ids| ours(ids) == 2 && neither(ids));
    site.stop("TERM", 20).expect_code(0);
    last.meets("subscribers", GONE, "the site ended", |ids| ours(ids) == 0);
    last.end();
}

/// Topics of the nodes that come and go, and how long each of them stays.
const CROWD: u64 = 100;
const STAY: Duration = Duration::from_secs(10);
/// What the reading program holds after replacing its participant may differ by so much in two parts of a run without growth, KiB.
/// In between it grows to more than twice that, which one looks at by chance.
const NOISE: u64 = 1024;
/// It replaces its participant about every minute and a half, so that each part of the run has several spans of that in it.
const OF_A_CROWD: u64 = 1000;

#[test]
#[allow(clippy::print_stdout, reason = "figures for who runs the long form")]
fn nodes_that_come_and_go_leave_nothing_behind_in_the_program_that_reads() {
    if !long() {
        return; // Takes 20 minutes: `tests/run --long`.
    }
    let _alone = heavy();
    let (network, pythons) = match (network(), all_real_nodes()) {
        (Ok(network), Ok(pythons)) => (network, pythons),
        (Err(reason), _) | (_, Err(reason)) => skipped!(reason),
    };
    let home = Home::new();
    let site = network.inside(&renewing(&home, OF_A_CROWD)).serve(&home);
    let alice = home.profile("alice");
    alice.enrol();
    for number in 0..CROWD {
        alice.json(&["topics", "watch", &format!("/crowd{number}")]);
    }
    let reader: u32 = process_of(&site, READER, "--domain").parse().expect("a process");
    let (begun, mut held, mut minutes) = (Instant::now(), Vec::new(), 0);
    let span = length(STAY, Duration::from_secs(1200));
    let topics = CROWD.to_string();
    for (_, python) in pythons.iter().cycle() {
        let node = python.node(&network, "0", &["publish", "/crowd", "--topics", &topics, "--rate", "2"]);
        std::thread::sleep(STAY);
        node.end();
        held.push(own_memory(reader));
        if begun.elapsed().as_secs() / 60 > minutes {
            minutes = begun.elapsed().as_secs() / 60;
            let (memory, processor) = (held[held.len() - 1], cpu_seconds(reader));
            println!("after {minutes} minutes: {memory} KiB, {processor:.1} s of processor");
        }
        if begun.elapsed() >= span {
            break;
        }
    }
    // The first third is for coming to its size.
    let (before, after) = held[held.len() / 3..].split_at(held.len() / 3);
    let least = |held: &[u64]| held.iter().copied().min().expect("a node came");
    assert!(least(after) <= least(before) + NOISE, "it grows: {held:?}");
}
