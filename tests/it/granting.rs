//! From when on a grant opens records: from now on, from an earlier moment, in a row; checked by opening.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeSet;
use std::time::Instant;

use authros::model::Timestamp;
use serde_json::Value;
use support::{
    Authros, Cable, Home, Running, count, heavy, ids, is_verified, list, long, text, two_profiles, wait_until,
};

const TOPIC: &str = "/robot1/odom";
const INPUT: i32 = 3;

fn captured(record: &Value) -> Timestamp {
    serde_json::from_value(record["captured_at"].clone()).expect("a time")
}

/// Opens each, and returns them.
pub fn opened(reader: &Authros) -> BTreeSet<String> {
    let shared = ids(&reader.records(&["received", "list", "--oldest"]));
    for id in &shared {
        assert_eq!(reader.json(&["records", "open", id])["verdict"], "verified", "{id}");
    }
    shared
}

/// Nothing of this is listed or opened.
pub fn is_closed(reader: &Authros, records: &[Value]) {
    let shared = ids(&reader.records(&["received", "list", "--oldest"]));
    for record in records {
        let id = text(record, "id");
        assert!(!shared.contains(&id), "{record}");
        reader.is_refused(&["records", "open", &id]);
    }
}

#[test]
fn from_now_on_opens_nothing_that_was_captured_before_while_messages_go_on() {
    let two = two_profiles(1);
    two.alice.run(&["topics", "watch", TOPIC]).expect_code(0);
    wait_until(60, "records come", || (two.alice.records(&["records", "list", "--oldest"]).len() >= 5).then_some(()));
    let dry = two.alice.json(&["grant", "add", &two.bob_address, "--from", "now", "--dry-run"]);
    assert_eq!(
        (&dry["epochs"], &dry["nothing_older"], &dry["transactions"]),
        (&1.into(), &true.into(), &2.into()),
        "{dry}"
    );
    assert!(list(&two.alice.json(&["grant", "list"]), "grants").is_empty(), "nothing was done");

    let asked = Timestamp::now();
    let granted = two.alice.json(&["grant", "add", &two.bob_address, "--topic", TOPIC, "--from", "now"]);
    assert_eq!(granted["epoch"], 2, "{granted}");
    assert!(text(&granted, "text").contains("from now on, nothing older"), "{granted}");
    wait_until(60, "what comes afterwards is read", || {
        (two.bob.records(&["received", "list", "--oldest"]).len() >= 5).then_some(())
    });
    two.alice.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    let all = two.alice.records(&["records", "list", "--oldest"]);
    let (before, after): (Vec<Value>, Vec<Value>) = all.into_iter().partition(|record| captured(record) < asked);
    assert!(before.len() >= 5 && after.len() >= 5, "{} before, {} after", before.len(), after.len());
    is_closed(&two.bob, &before[..2]);
    is_closed(&two.bob, &before[before.len() - 2..]);
    for record in two.bob.records(&["received", "list", "--oldest"]) {
        assert!(captured(&record) >= asked && record["epoch"] == 2, "{record}");
    }
    let newest = text(&two.bob.records(&["received", "list"])[0], "id");
    let verified = || two.bob.json(&["records", "open", &newest])["verdict"] == "verified";
    wait_until(60, "the newest is in a block", || verified().then_some(()));
}

#[test]
fn what_was_foreseen_is_what_opens_from_every_moment() {
    let two = two_profiles(1);
    two.alice.capture(&[TOPIC], 3);
    two.alice.json(&["keys", "rotate"]);
    let moment = Timestamp::now().to_string();
    two.alice.capture(&[TOPIC], 2);
    two.alice.json(&["keys", "rotate"]);
    two.alice.capture(&[TOPIC], 4);
    for (name, from, first, records) in [
        ("carol", "start", 1, 9),
        ("dave", moment.as_str(), 2, 6),
        ("erin", "epoch", 3, 4),
        ("frank", "1h", 1, 9),
        ("gina", "2", 2, 6),
    ] {
        let reader = two.home.profile(name);
        let address = reader.enrol();
        let grant = ["grant", "add", &address, "--from", from];
        let dry = two.alice.json(&[&grant[..], &["--dry-run"]].concat());
        assert_eq!((count(&dry, "epoch"), count(&dry["opens"], "records")), (first, records), "{name}: {dry}");
        assert_eq!((count(&dry, "epochs"), count(&dry, "transactions")), (0, 1), "{name}: {dry}");
        let said = text(&two.alice.json(&grant), "text");
        assert!(said.contains(&format!(", {records} records")), "{said}");
        assert_eq!(opened(&reader).len() as u64, records, "{name}");
        let rows = list(&two.alice.json(&["grant", "list"]), "grants");
        let row = rows.iter().find(|row| row["grantee"] == address.as_str()).expect("its row");
        assert_eq!((count(row, "from"), count(&row["opens"], "records")), (first, records), "{row}");
    }
    for wrong in ["soon", "9", "0", "2100-01-01T00:00:00Z"] {
        two.alice.fails(INPUT, &["grant", "add", &two.bob_address, "--from", wrong]);
    }
    let told = two.alice.run(&["grant", "list"]).expect_code(0).stdout;
    assert!(told.contains(" UTC, 6 records"), "{told}");
}

#[test]
fn everything_of_a_robot_until_friday_is_one_grant() {
    let two = two_profiles(2);
    let camera = "/robot1/camera/compressed";
    two.alice.capture(&[TOPIC, camera, "/robot2/odom"], 2);
    let grant =
        ["grant", "add", &two.bob_address, "--robot", "robot1", "--expires", "friday 18:00 UTC", "--from", "start"];
    let dry = two.alice.json(&[&grant[..], &["--dry-run"]].concat());
    assert_eq!(count(&dry, "transactions"), 1, "{dry}");
    let topics: BTreeSet<String> = names(&list(&dry, "topics"));
    assert!([TOPIC, camera].iter().all(|topic| topics.contains(*topic)), "{dry}");
    assert!(topics.iter().all(|topic| topic.starts_with("/robot1/")), "{dry}");
    two.alice.json(&grant);
    let grants = list(&two.alice.json(&["grant", "list"]), "grants");
    assert_eq!((grants.len(), names(&list(&grants[0], "topics"))), (1, topics));
    let expires = text(&grants[0], "expires");
    assert!(expires.contains("T18:00:00"), "{expires}");
    assert_eq!(opened(&two.bob).len(), 4, "two of each of its topics, and nothing of the other robot");
    let told = two.alice.fails(INPUT, &["grant", "add", &two.bob_address, "--robot", "nobody-here"]);
    assert!(told.contains("no robot of this profile is called 'nobody-here'"), "{told}");
}

fn names(topics: &[Value]) -> BTreeSet<String> {
    topics.iter().map(|topic| topic.as_str().expect("a name").to_owned()).collect()
}

/// A robot that seals out of reach of its gateway.
struct Away {
    home: Home,
    line: Cable,
    enrolment: String,
    agent: Running,
    gateway: Running,
}

impl Away {
    const TOPIC: &str = "/robot1/camera/compressed";

    /// Enrolled by the owner at a gateway of that home, and out of reach once the gateway has records of it.
    fn enrolled_at(home: &Home, owner: &Authros) -> Self {
        let mut gateway =
            home.profile("keeper").with(&["--json"]).spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
        gateway.wait_for_text("fingerprint", 60);
        let told: Value = serde_json::from_str(gateway.stdout().lines().next().expect("a line")).expect("JSON");
        let (address, key) = (text(&told["gateway"], "address"), text(&told["gateway"], "gateway"));
        let port = address.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
        let (line, robot) = (Cable::to(port), Home::new());
        let reach = line.address();
        let enrolment = robot.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
        let enrol = ["robot", "enrol", "--gateway", &reach, "--gateway-key", &key, "--name", "scout"];
        owner.json(&[&enrol[..], &["--topic", Self::TOPIC, "--out", &enrolment]].concat());
        let agent = robot.authros().with(&["--json", "--robots", "1"]).spawn(&["robot", "run", &enrolment]);
        let away = Self { home: robot, line, enrolment, agent, gateway };
        away.figures("the gateway takes records", |figures| count(figures, "accepted") > 0);
        away.line.cut();
        away.figures("its outbox fills", |figures| count(figures, "pending") > 2);
        away
    }

    fn figures(&self, what: &str, test: impl Fn(&Value) -> bool) -> Value {
        wait_until(180, what, || {
            let newest = self.agent.stdout().lines().rev().find_map(|line| serde_json::from_str::<Value>(line).ok());
            newest.filter(|figures| test(figures))
        })
    }

    /// In reach again until `hears` is true; then it ends, once everything it sealed is proven. Returns the gateway.
    fn comes_back(self, hears: impl Fn() -> bool) -> Running {
        self.line.mend();
        wait_until(300, "it has the new key", || hears().then_some(()));
        self.agent.stop("TERM", 60).expect_code(0);
        let agent = self.home.authros().with(&["--json", "--robots", "1"]);
        let rest = agent.spawn(&["robot", "run", &self.enrolment, "--count", "1"]).wait(180).expect_code(0);
        let told: Value = serde_json::from_str(rest.stdout.lines().last().expect("a document")).expect("JSON");
        assert_eq!((count(&told, "pending"), count(&told, "lost")), (0, 0), "{told}");
        self.gateway
    }
}

/// Grants to many beside a robot that is out of reach: each begins an epoch, and nobody who read before misses anything,
/// whatever the robot sealed meanwhile and however late it arrives.
#[test]
fn many_grants_from_now_on_in_a_row_take_nothing_from_anybody() {
    let _alone = heavy();
    let two = two_profiles(1);
    two.alice.json(&["grant", "add", &two.bob_address]);
    let robot = Away::enrolled_at(&two.home, &two.alice);
    let readers: Vec<Authros> =
        (1..=if long() { 32 } else { 3 }).map(|number| two.home.profile(&format!("reader{number}"))).collect();
    let addresses: Vec<String> = readers.iter().map(Authros::enrol).collect();
    let nonce = || count(&two.alice.json(&["chain", "status"]), "nonce");
    let (before, begun, mut cost, mut epochs) = (nonce(), Instant::now(), 0, Vec::new());
    for address in &addresses {
        two.alice.capture(&[TOPIC], 1);
        let grant = ["grant", "add", address, "--from", "now"];
        let dry = two.alice.json(&[&grant[..], &["--dry-run"]].concat());
        assert_eq!((count(&dry, "epochs"), &dry["robots"]), (1, &serde_json::json!(["scout"])), "{dry}");
        cost += count(&dry, "transactions");
        epochs.push(count(&two.alice.json(&grant), "epoch"));
    }
    let (took, sent) = (begun.elapsed().as_secs_f64(), nonce() - before);
    let grants = addresses.len() as u64;
    assert_eq!(epochs, (2..2 + grants).collect::<Vec<_>>(), "one each");
    // An epoch and a grant each, and the envelopes of those who read before: eight go into a transaction.
    assert_eq!(cost, 2 * grants + (1..=grants).map(|readers| readers.div_ceil(8)).sum::<u64>());
    println!(
        "{grants} grants from now on beside a robot out of reach: {cost} transactions foreseen, {sent} sent with the anchors \
         of a record before each, {took:.0} s"
    );
    two.alice.capture(&[TOPIC], 1);
    let newest = *epochs.last().expect("grants");
    let all = || two.alice.records(&["records", "list", "--oldest"]);
    let is_of_robot = |record: &&Value| record["topic"] == Away::TOPIC;
    let _gateway = robot.comes_back(|| all().iter().filter(is_of_robot).any(|record| count(record, "epoch") == newest));
    let all = wait_until(180, "all is verified", || Some(all()).filter(|all| all.iter().all(is_verified)));
    let sealed_away = all.iter().filter(is_of_robot).filter(|record| count(record, "epoch") == 1).count();
    assert!(sealed_away > 2, "{sealed_away}");

    // Who read before has everything; who came later has what was sealed since, and nothing older.
    let lists = |reader: &Authros| ids(&reader.records(&["received", "list", "--oldest"]));
    let since =
        |epoch: u64| ids(&all.iter().filter(|record| count(record, "epoch") >= epoch).cloned().collect::<Vec<_>>());
    wait_until(120, "the first reader has all", || (lists(&two.bob) == ids(&all)).then_some(()));
    for (reader, epoch) in readers.iter().zip(&epochs) {
        wait_until(120, "a later reader has the rest", || (lists(reader) == since(*epoch)).then_some(()));
    }
    let newest_of = |topic: &str| all.iter().rfind(|record| record["topic"] == topic).expect("a record");
    for record in [&all[0], newest_of(TOPIC), newest_of(Away::TOPIC)]
        .into_iter()
        .chain(all.iter().step_by((all.len() / 12).max(1)))
    {
        let id = text(record, "id");
        assert_eq!(two.bob.json(&["records", "open", &id])["verdict"], "verified", "{record}");
    }
    let last = readers.last().expect("readers");
    assert_eq!(opened(last), since(newest));
    let older: Vec<Value> = all.iter().filter(|record| count(record, "epoch") < newest).cloned().collect();
    is_closed(last, &[&older[..1], &older[older.len() - 1..]].concat());
}
