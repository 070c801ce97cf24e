//! Robots from their owner's site: what a ring kept of topics that nobody watched is there when somebody asks, also
//! after a crash of the robot, and stands in an incident and its bundle like any other record.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use authros::model::Timestamp;
use serde_json::Value;
use support::{Authros, Home, Running, count, free_port, is_verified, length, list, text, wait_until};

const INPUT: i32 = 3;
const USAGE: i32 = 2;
const WATCHED: &str = "/robot1/odom";
const UNWATCHED: &str = "/robot1/camera/compressed";
/// The beginning of the recorder id of a ring, in hex.
const RING: &str = "02";

/// A gateway in a home with the robot's owner.
pub struct Site {
    pub home: Home,
    address: String,
    key: String,
    _serving: Running,
}

impl Site {
    pub fn new() -> Self {
        let (home, address) = (Home::new(), format!("127.0.0.1:{}", free_port()));
        let keeper = home.profile("keeper").with(&["--json"]);
        let mut serving = keeper.spawn(&["gateway", "serve", "--listen", &address]);
        let said = serving.wait_for_text("\"gateway\"", 120);
        let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
        let document: Value = serde_json::from_str(line).expect("JSON");
        let key = text(&document["gateway"], "gateway");
        Self { home, address, key, _serving: serving }
    }

    pub fn owner(&self, name: &str) -> Authros {
        let owner = self.home.profile(name);
        owner.enrol();
        owner
    }
}

/// A robot with a ring.
pub struct Robot {
    home: Home,
    enrolment: String,
}

impl Robot {
    pub fn enrol(site: &Site, owner: &Authros, name: &str, topics: &[&str]) -> Self {
        let home = Home::new();
        let enrolment = home.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
        let mut arguments = vec!["robot", "enrol", "--gateway", &site.address, "--gateway-key", &site.key];
        arguments.extend(["--name", name, "--out", &enrolment]);
        arguments.extend(topics.iter().flat_map(|topic| ["--topic", topic]));
        owner.json(&arguments);
        Self { home, enrolment }
    }

    pub fn run(&self, keep: &str, topics: &str) -> Running {
        self.run_in(&self.home, keep, topics)
    }

    fn run_in(&self, home: &Home, keep: &str, topics: &str) -> Running {
        let agent = home.authros().with(&["--json", "--robots", "1"]);
        let agent = agent.with_variable("AUTHROS_RING_KEEP", keep).with_variable("AUTHROS_RING_TOPICS", topics);
        agent.spawn(&["robot", "run", &self.enrolment])
    }
}

/// The newest document of a running agent that passes.
pub fn when(agent: &Running, what: &str, test: impl Fn(&Value) -> bool) -> Value {
    wait_until(120, what, || {
        let newest = agent.stdout().lines().rev().find_map(|line| serde_json::from_str::<Value>(line).ok());
        newest.filter(|figures| test(figures))
    })
}

fn in_ring(figures: &Value) -> u64 {
    count(&figures["ring"], "messages")
}

fn texts(records: &[Value], field: &str) -> BTreeSet<String> {
    records.iter().map(|record| text(record, field)).collect()
}

#[test]
fn what_a_ring_kept_before_the_button_is_in_the_incident_though_nobody_watched_it() {
    let site = Site::new();
    let alice = site.owner("alice");
    let robot = Robot::enrol(&site, &alice, "scout", &[WATCHED, UNWATCHED]);
    let agent = robot.run("5m, 64MiB", "[\"/robot1/camera/**\"]");
    when(&agent, "the gateway has what is watched", |figures| count(figures, "verified") >= 3);
    let before = when(&agent, "the ring fills", |figures| in_ring(figures) >= 15);
    // Without a chance to write anything.
    agent.stop("KILL", 10);
    assert_eq!(
        alice.records(&["records", "list", "--oldest", "--topic", UNWATCHED]).len(),
        0,
        "nobody reads a ring unasked"
    );

    let agent = robot.run("5m, 64MiB", "[\"/robot1/camera/**\"]");
    let kept = in_ring(&before);
    let after = when(&agent, "the ring goes on", |figures| in_ring(figures) >= kept + 10);
    assert_eq!(count(&after["ring"], "fallen"), 0, "{after}");
    let opened = ["incident", "open", "crash", "--since", "-10m", "--topics", UNWATCHED, "--robot", "scout"];
    let told = alice.fails(INPUT, &[&opened[..], &["another"]].concat());
    assert!(told.contains("no robot of this profile has that name"), "{told}");
    assert!(list(&alice.json(&["incident", "list"]), "incidents").is_empty(), "of two robots one is not known");
    alice.json(&opened);
    let least = usize::try_from(kept + 10).expect("few");
    let records = wait_until(180, "the minutes before are here and proven", || {
        let records = alice.records(&["records", "list", "--oldest", "--incident", "crash"]);
        (records.len() >= least && records.iter().all(is_verified)).then_some(records)
    });
    assert_eq!(texts(&records, "topic"), BTreeSet::from([UNWATCHED.to_owned()]));
    let shown = alice.json(&["incident", "show", "crash"]);
    let coverage = list(&shown, "coverage");
    assert_eq!((coverage.len(), count(&coverage[0], "records") >= least as u64), (1, true), "{shown}");
    assert_eq!(coverage[0]["first"], records.iter().map(|record| text(record, "captured_at")).min().expect("some"));
    let read = alice.json(&["records", "open", &text(&records[0], "id")]);
    assert_eq!((text(&read, "verdict"), text(&read, "topic")), ("verified".to_owned(), UNWATCHED.to_owned()), "{read}");

    // What is asked for once more comes once.
    alice.json(&["robot", "pull", "scout", "--incident", "crash"]);
    alice.json(&["robot", "pull", "scout", "--since", "10m", "--topic", "/nothing/**"]);
    alice.fails(INPUT, &["robot", "pull", "nobody-here", "--since", "10m"]);
    alice.run(&["robot", "pull", "scout"]).expect_code(USAGE);
    alice.fails(INPUT, &["robot", "pull", "scout", "--since", "1m", "--until", "2m"]);
    when(&agent, "nothing waits any more but the newest", |figures| count(figures, "pending") < 20);
    agent.stop("TERM", 30).expect_code(0);

    let bundle = site.home.root().join("crash.authros");
    let place = bundle.to_str().expect("UTF-8");
    alice.json(&["evidence", "export", place, "--incident", "crash"]);
    // Its exporter seals the chain alone, and the suggested pins say so.
    let trust = site.home.root().join("trust.toml");
    std::fs::write(&trust, crate::evidence::unzipped(&bundle, "trust.toml")).expect("written");
    let report = crate::evidence::verified(&bundle, Some(&trust)).expect_code(8).document();
    let bytes = list(&report, "records");
    assert!(bytes.len() >= least && bytes.iter().all(|record| record["bytes"]["standing"] == "proven"), "{report}");
    let stretches = list(&report, "complete");
    let of_ring: Vec<&Value> = stretches.iter().filter(|one| text(one, "recorder").starts_with(RING)).collect();
    assert_eq!((of_ring.len(), stretches.len()), (2, 2), "a recorder for each run of the robot: {report}");
    assert!(of_ring.iter().all(|one| count(one, "missing") == 0), "{report}");
    assert!(of_ring.iter().all(|one| text(one, "text").contains("a robot's ring")), "{report}");
    crate::evidence::expect_agreement(&bundle, Some(&trust));
    // A ring has no holes: its numbers are whole wherever somebody asked.
    alice.run(&["audit"]).expect_code(0);
}

/// Times of the unwatched topic's records by their numbers, which must be given once.
fn by_number(records: &[Value]) -> BTreeMap<u64, Timestamp> {
    let at = |record: &Value| serde_json::from_value(record["captured_at"].clone()).expect("a time");
    let numbered: BTreeMap<u64, Timestamp> = records.iter().map(|record| (count(record, "seq"), at(record))).collect();
    assert_eq!(numbered.len(), records.len());
    numbered
}

/// Numbers of the unwatched topic's definitions: each file of a ring begins with one.
fn definitions(owner: &Authros) -> BTreeSet<u64> {
    let of_topic = ["records", "list", "--oldest", "--topic", UNWATCHED, "--kind", "definition"];
    owner.records(&of_topic).iter().map(|record| count(record, "seq")).collect()
}

#[test]
fn all_of_the_time_before_the_button_is_there_without_a_hole() {
    // Five minutes are the promise.
    let asked = length(Duration::from_secs(10), Duration::from_secs(300)).as_secs();
    let site = Site::new();
    let alice = site.owner("alice");
    let robot = Robot::enrol(&site, &alice, "scout", &[WATCHED, UNWATCHED]);
    let agent = robot.run(&format!("{}s, 256MiB", asked + 300), "[\"/robot1/camera/**\"]");
    let before = wait_until(asked + 120, "the ring reaches back further than what is asked for", || {
        let figures = agent.stdout().lines().rev().find_map(|line| serde_json::from_str::<Value>(line).ok())?;
        let since: Timestamp = serde_json::from_value(figures["ring"]["since"].clone()).ok()?;
        (Timestamp::now().0 - since.0 > (asked + 2) * 1_000_000_000).then_some(figures)
    });
    assert_eq!((count(&before["ring"], "fallen"), count(&before, "lost")), (0, 0), "{before}");
    let since = format!("-{asked}s");
    let opened =
        alice.json(&["incident", "open", "crash", "--since", &since, "--topics", UNWATCHED, "--robot", "scout"]);
    let since: Timestamp = serde_json::from_value(opened["since"].clone()).expect("a time");
    // Besides the messages a definition has a number.
    let last = in_ring(&before) + 1;
    let found = wait_until(240, "what was asked for is here and proven", || {
        let records = alice.records(&["records", "list", "--oldest", "--incident", "crash"]);
        let numbers = by_number(&records);
        let is_all = numbers.keys().next_back().is_some_and(|newest| *newest >= last);
        (is_all && records.iter().all(is_verified)).then_some(numbers)
    });
    let (first, at) = found.first_key_value().expect("some");
    assert!(*at >= since, "nothing but what was asked for");
    // What came right before it is of the time before.
    alice.json(&["robot", "pull", "scout", "--since", "20m", "--topic", UNWATCHED]);
    let earlier = wait_until(120, "what was before that", || {
        let records = alice.records(&["records", "list", "--oldest", "--topic", UNWATCHED]);
        let before = by_number(&records).range(..first).next_back().map(|(number, at)| (*number, *at));
        before.filter(|(number, _)| (number + 1..*first).all(|between| definitions(&alice).contains(&between)))
    });
    assert!(earlier.1 < since, "{earlier:?} was in the ring, and is of the time asked for since {since}");
    let definitions = definitions(&alice);
    let newest = found.keys().next_back().expect("some");
    let holes: Vec<u64> =
        (*first..=*newest).filter(|number| !found.contains_key(number) && !definitions.contains(number)).collect();
    assert!(holes.is_empty(), "{holes:?} of {first} to {newest}");
    agent.stop("TERM", 30).expect_code(0);
}

#[test]
fn a_ring_out_of_a_backup_has_the_minutes_before() {
    let (site, spare) = (Site::new(), Home::new());
    let alice = site.owner("alice");
    let robot = Robot::enrol(&site, &alice, "scout", &[WATCHED, UNWATCHED]);
    let topics = "[\"/robot1/camera/**\"]";
    let agent = robot.run("5m, 64MiB", topics);
    when(&agent, "the ring fills", |figures| in_ring(figures) >= 5 && count(figures, "verified") >= 1);
    let stopped = agent.stop("TERM", 30).expect_code(0);
    let kept =
        in_ring(&stopped.stdout.lines().rev().find_map(|line| serde_json::from_str(line).ok()).expect("figures"));
    let secret = robot.home.file("secret", "a passphrase of its own\n", 0o600);
    let file = robot.home.root().join("robot.backup").to_str().expect("UTF-8").to_owned();
    robot.home.authros().json(&["backup", "create", &file, "--passphrase-file", &secret]);
    let restored = spare.authros().json(&["backup", "restore", &file, "--passphrase-file", &secret]);
    assert!(restored["notes"].to_string().contains("robot pull"), "{restored}");

    // Asked before the robot is there again.
    alice.json(&["robot", "pull", "scout", "--since", "10m", "--topic", UNWATCHED]);
    let agent = robot.run_in(&spare, "5m, 64MiB", topics);
    let pulled = wait_until(180, "what the ring of the old disk had is here and proven", || {
        let records = alice.records(&["records", "list", "--oldest", "--topic", UNWATCHED]);
        (records.len() as u64 >= kept && records.iter().all(is_verified)).then_some(records)
    });
    assert_eq!(pulled.len() as u64, kept, "each once, and nothing that was captured after it was asked for");
    // Its new messages are of a recorder of their own, and asked for in vain until then.
    when(&agent, "the ring goes on", |figures| in_ring(figures) >= kept + 3);
    let opened = ["incident", "open", "crash", "--since", "-10m", "--topics", UNWATCHED, "--robot", "scout"];
    alice.json(&opened);
    let all = wait_until(180, "old and new", || {
        let records = alice.records(&["records", "list", "--oldest", "--incident", "crash"]);
        (records.len() as u64 >= kept + 3 && records.iter().all(is_verified)).then_some(records)
    });
    assert_eq!(texts(&all, "digest").len(), all.len(), "none twice");
    agent.stop("TERM", 30).expect_code(0);
    alice.run(&["audit"]).expect_code(0);
}

#[test]
fn two_robots_of_one_topic_have_a_timeline_each() {
    let site = Site::new();
    let alice = site.owner("alice");
    let robots = ["scout", "elder"].map(|name| Robot::enrol(&site, &alice, name, &[WATCHED]));
    // One after the other, on the same topic.
    for robot in &robots {
        let agent = robot.home.authros().with(&["--json", "--robots", "1"]);
        agent.run(&["robot", "run", &robot.enrolment, "--count", "3"]).expect_code(0);
    }
    let coverage = |more: &[&str]| alice.json(&[&["topics", "coverage", WATCHED, "--parts", "20"], more].concat());
    let time =
        |view: &Value, field: &str| -> Timestamp { serde_json::from_value(view[field].clone()).expect("a time") };
    let all = wait_until(120, "both are known by the topic's name", || {
        let all = coverage(&[]);
        all["robots"].as_array().is_some_and(|robots| robots.len() == 2).then_some(all)
    });
    assert_eq!(all["robots"], serde_json::json!(["elder", "scout"]), "{all}");
    let [scout, elder] = ["scout", "elder"].map(|name| coverage(&["--robot", name]));
    assert_eq!((&scout["robot"], &elder["robot"]), (&"scout".into(), &"elder".into()));
    assert!(time(&scout, "last") < time(&elder, "first"), "{scout} {elder}");
    assert_eq!((&all["first"], &all["last"]), (&scout["first"], &elder["last"]));
    let since = text(&all, "first");
    let strip = |name: &str| -> Vec<bool> {
        let view = coverage(&["--robot", name, "--since", &since, "--until", &text(&elder, "last")]);
        list(&view, "parts").iter().map(|part| part["data"] == true).collect()
    };
    let (of_scout, of_elder) = (strip("scout"), strip("elder"));
    assert!(of_scout[0] && !of_elder[0], "{of_scout:?} {of_elder:?}");
    let last_of_scout = of_scout.iter().rposition(|is| *is).expect("some");
    let first_of_elder = of_elder.iter().position(|is| *is).expect("some");
    assert!(last_of_scout < first_of_elder, "{of_scout:?} {of_elder:?}");
    let people = alice.run(&["topics", "coverage", WATCHED]).expect_code(0).stdout;
    assert!(people.contains("robots that recorded it: elder, scout"), "{people}");
    let told = alice.fails(INPUT, &["topics", "coverage", WATCHED, "--robot", "nobody"]);
    assert!(told.contains("no robot of this profile is called 'nobody'"), "{told}");
}

#[test]
fn a_grant_of_an_enrolled_robot_is_of_the_topics_it_may_record() {
    let site = Site::new();
    let alice = site.owner("alice");
    let _scout = Robot::enrol(&site, &alice, "scout-1", &[WATCHED, UNWATCHED]);
    let _other = Robot::enrol(&site, &alice, "scout-2", &["/tf"]);
    let bob = site.home.profile("bob").enrol();
    let given = alice.json(&["grant", "add", &bob, "--robot", "scout-1", "--expires", "friday 18:00 UTC"]);
    assert!(text(&given, "text").contains("as far as they have arrived here"), "robots may have more: {given}");
    let grants = list(&alice.json(&["grant", "list"]), "grants");
    let topics: BTreeSet<String> =
        list(&grants[0], "topics").iter().map(|topic| topic.as_str().expect("a name").to_owned()).collect();
    assert_eq!((grants.len(), topics), (1, BTreeSet::from([WATCHED, UNWATCHED].map(ToOwned::to_owned))));
}
