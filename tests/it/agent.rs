//! Robots that run no chain client: enrolled by their owners, captured by `authros robot run`, passed on over TCP to
//! one gateway, which anchors for all of them.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::collections::BTreeMap;
use std::path::Path;

use authros::crypto::{Passphrase, SealedEnrolment, SealingKey};
use serde_json::Value;
use support::{Authros, Cable, Home, Running, Wire, count, free_port, heavy, holds, is_verified, text, wait_until};

/// A gateway's home with its own profile, and owners who use the same site.
struct Gateway {
    home: Home,
    port: u16,
    site: Option<Running>,
    fingerprint: String,
}

impl Gateway {
    fn new() -> Self {
        let mut gateway = Self { home: Home::new(), port: free_port(), site: None, fingerprint: String::new() };
        gateway.start();
        gateway
    }

    fn start(&mut self) {
        let listen = format!("127.0.0.1:{}", self.port);
        let authros = self.home.profile("keeper").with(&["--json"]);
        let mut site = authros.spawn(&["gateway", "serve", "--listen", &listen]);
        let said = site.wait_for_text("\"gateway\"", 120);
        let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document").to_owned();
        let document: Value = serde_json::from_str(&line).expect("JSON");
        self.fingerprint = text(&document["gateway"], "gateway");
        self.site = Some(site);
    }

    fn kill(&mut self) {
        self.site.take().expect("running").stop("KILL", 10);
    }

    /// An owner registered through the gateway's own site.
    fn owner(&self, name: &str) -> Authros {
        let owner = self.home.profile(name);
        owner.enrol();
        owner
    }
}

/// A robot with an outbox of its own.
struct Robot {
    home: Home,
    enrolment: String,
    device: String,
}

impl Robot {
    fn enrol(gateway: &Gateway, owner: &Authros, address: &str, name: &str, topics: &[&str]) -> Self {
        let home = Home::new();
        let enrolment = home.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
        let mut arguments = vec!["robot", "enrol", "--gateway", address, "--gateway-key", &gateway.fingerprint];
        arguments.extend(["--name", name, "--out", &enrolment]);
        arguments.extend(topics.iter().flat_map(|topic| ["--topic", topic]));
        arguments.extend(topics.is_empty().then_some("--all-topics"));
        let view = owner.json(&arguments);
        assert_eq!(
            (text(&view, "name").as_str(), view["gateway"]["key"] == gateway.fingerprint.as_str()),
            (name, true)
        );
        Self { home, enrolment, device: text(&view, "device") }
    }

    fn run(&self, arguments: &[&str]) -> Running {
        let agent = self.home.authros().with(&["--json"]);
        agent.spawn(&[&["robot", "run", &self.enrolment], arguments].concat())
    }

    fn secrets(&self) -> SealedEnrolment {
        let passphrase = std::fs::read_to_string(format!("{}.passphrase", self.enrolment)).expect("a passphrase");
        let passphrase = Passphrase::new(passphrase).expect("long enough");
        SealedEnrolment::open(Path::new(&self.enrolment), &passphrase).expect("opens")
    }
}

/// The newest document printed by a running agent.
fn figures(agent: &Running) -> Option<Value> {
    agent.stdout().lines().rev().find_map(|line| serde_json::from_str(line).ok())
}

fn last(stdout: &str) -> Value {
    serde_json::from_str(stdout.lines().last().expect("a document")).expect("JSON")
}

/// All of an owner's captured messages, once they are verified.
fn verified(owner: &Authros, least: usize) -> Vec<Value> {
    wait_until(120, "all records are verified", || {
        let records = owner.records(&["records", "list", "--oldest"]);
        let done = records.len() >= least && records.iter().all(is_verified);
        done.then_some(records)
    })
}

#[test]
fn four_robots_of_two_accounts_through_one_gateway() {
    let _alone = heavy();
    let gateway = Gateway::new();
    let wire = Wire::to(gateway.port);
    let (alice, bob) = (gateway.owner("alexandra"), gateway.owner("bartholomew"));
    let robots: Vec<Robot> = (1..=4)
        .map(|number| {
            let owner = if number <= 2 { &alice } else { &bob };
            // Some with EK, some only with topic keys.
            let topics: &[&str] = if number % 2 == 0 { &["/robot1/odom"] } else { &[] };
            Robot::enrol(&gateway, owner, &wire.address(), &format!("scout-{number}"), topics)
        })
        .collect();
    let each = 25;
    let wanted = each.to_string();
    let options = ["--topic", "/robot1/odom", "--count", &wanted, "--robots", "1", "--tag", "mission=harbour-watch"];
    let running: Vec<Running> = robots.iter().map(|robot| robot.run(&options)).collect();
    for agent in running {
        let outcome = agent.wait(180).expect_code(0);
        let summary = last(&outcome.stdout);
        assert_eq!(
            ["captured", "accepted", "verified", "pending", "lost"].map(|field| count(&summary, field)),
            [each, each, each, 0, 0],
            "{summary}"
        );
    }
    for owner in [&alice, &bob] {
        let records = verified(owner, 50);
        assert_eq!(records.len(), 50, "what was published, no more and no less");
        let opened = owner.json(&["records", "open", &text(&records[0], "id")]);
        assert_eq!(opened["verdict"], "verified", "{opened}");
        assert_eq!(opened["topic"], "/robot1/odom", "{opened}");
        assert!(opened["tags"].to_string().contains(r#"["mission","harbour-watch"]"#), "{opened}");
        let mut seqs: BTreeMap<u64, usize> = BTreeMap::new();
        records.iter().for_each(|record| *seqs.entry(count(record, "seq")).or_default() += 1);
        assert!(seqs.values().all(|robots| *robots == 2), "each of two robots has each number once: {seqs:?}");
    }
    nothing_shows(&wire.recorded(), &robots);
    assert!(robots.iter().all(|robot| { robot.home.path().join("ledger.db").exists() }));
}

/// The traffic between robots and gateway contains no key and no word of theirs.
fn nothing_shows(bytes: &[u8], robots: &[Robot]) {
    assert!(bytes.len() > 100 * 500, "the records went this way");
    // None so short that random bytes hold it by chance.
    for word in
        ["scout-", "alexandra", "bartholomew", "/robot1/odom", "nav_msgs", "Odometry", "mission", "harbour", "robot1"]
    {
        assert!(!holds(bytes, word.as_bytes()), "'{word}' on the wire");
    }
    for robot in robots {
        let sealed = robot.secrets();
        let enrolment = &sealed.enrolment;
        let mut secrets: Vec<&[u8]> = vec![
            enrolment.gateway.transport.expose(),
            enrolment.device.secret.expose(),
            enrolment.notice_key.expose(),
            &enrolment.token.0,
        ];
        secrets.extend(enrolment.index.iter().map(|key| &key.expose()[..]));
        assert_eq!(
            enrolment.index.is_some(),
            matches!(enrolment.keys.now.key, SealingKey::Epoch(_)),
            "IK for all alone"
        );
        match &enrolment.keys.now.key {
            SealingKey::Epoch(key) => secrets.push(key.expose()),
            SealingKey::Topics(topics) => {
                secrets.extend(topics.values().flat_map(|topic| [&topic.filters.expose()[..], &topic.key.expose()[..]]))
            }
        }
        assert!(secrets.iter().all(|secret| !holds(bytes, secret)), "a key on the wire");
    }
    assert!(holds(bytes, &robots[0].secrets().enrolment.domain.0), "the search finds what is there");
}

#[test]
fn the_outbox_outlives_gateway_and_agent() {
    let mut gateway = Gateway::new();
    let alice = gateway.owner("alice");
    let address = format!("127.0.0.1:{}", gateway.port);
    let robot = Robot::enrol(&gateway, &alice, &address, "scout", &["/robot1/odom"]);
    let agent = robot.run(&["--robots", "1"]);
    let with = |agent: &Running, what: &str, test: &dyn Fn(&Value) -> bool| {
        wait_until(90, what, || figures(agent).filter(|figures| test(figures)))
    };
    with(&agent, "the gateway takes records", &|figures| count(figures, "accepted") > 0);
    gateway.kill();
    let away = with(&agent, "the agent notices", &|figures| {
        !["connected", "connecting"].contains(&figures["gateway"].as_str().expect("text"))
    });
    let more = count(&away, "captured") + 20;
    let grown = with(&agent, "the outbox grows", &|figures| count(figures, "captured") >= more);
    assert!(count(&grown, "pending") >= 20, "{grown}");
    // Between seal and upload, without notice.
    agent.stop("KILL", 10);

    // The outbox keeps growing in the next run, still without a gateway; told to stop, it stops.
    let agent = robot.run(&["--robots", "1"]);
    let kept = count(&grown, "captured");
    with(&agent, "nothing that was acknowledged is missing", &|figures| count(figures, "captured") > kept);
    let outcome = agent.stop("TERM", 30).expect_code(0);
    let summary = last(&outcome.stdout);
    assert_eq!((text(&summary, "ended").as_str(), count(&summary, "lost")), ("stopped on request", 0), "{summary}");

    gateway.start();
    let outcome = robot.run(&["--robots", "1", "--count", "5"]).wait(180).expect_code(0);
    let settled = last(&outcome.stdout);
    let all = count(&settled, "captured");
    assert_eq!(all, count(&summary, "captured") + 5);
    assert_eq!((count(&settled, "verified"), count(&settled, "pending")), (all, 0), "{settled}");
    let records = verified(&alice, usize::try_from(all).expect("few"));
    assert_eq!(records.len() as u64, all, "none twice");
}

#[test]
fn a_gateway_that_comes_back_is_found_by_a_working_agent() {
    let mut gateway = Gateway::new();
    let alice = gateway.owner("alice");
    let address = format!("127.0.0.1:{}", gateway.port);
    let robot = Robot::enrol(&gateway, &alice, &address, "scout", &["/robot1/odom"]);
    let agent = robot.run(&["--robots", "1"]);
    let with = |what: &str, test: &dyn Fn(&Value) -> bool| {
        wait_until(90, what, || figures(&agent).filter(|figures| test(figures)))
    };
    with("the gateway takes records", &|figures| count(figures, "accepted") > 0);
    gateway.kill();
    let pending = |figures: &Value| count(figures, "pending") >= 60;
    let accepted = count(&with("the outbox grows", &pending), "accepted");
    gateway.start();
    let begun = std::time::Instant::now();
    with("it takes records again", &|figures| count(figures, "accepted") > accepted);
    // The target is ten seconds; a busy machine gets more.
    println!("the gateway is back: first record accepted after {:?}", begun.elapsed());
    with("nothing waits any more but the newest", &|figures| count(figures, "pending") < 60);
    agent.stop("TERM", 30).expect_code(0);
}

#[test]
fn a_recalled_device_and_a_topic_without_a_key_are_refused() {
    let gateway = Gateway::new();
    let alice = gateway.owner("alice");
    let address = format!("127.0.0.1:{}", gateway.port);
    let robot = Robot::enrol(&gateway, &alice, &address, "scout", &["/robot1/odom"]);
    let outcome = robot.run(&["--topic", "/robot1/camera/compressed", "--count", "1"]).wait(60).expect_code(5);
    assert!(outcome.stdout.contains("no key for topic /robot1/camera/compressed"), "{outcome}");
    let twice = alice.fails(
        3,
        &[
            "robot",
            "enrol",
            "--gateway",
            &address,
            "--trust-first",
            "--name",
            "scout",
            "--all-topics",
            "--out",
            &robot.enrolment,
        ],
    );
    assert!(twice.contains("never overwritten"), "{twice}");
    let other = "ab".repeat(32);
    let out = robot.home.root().join("other").to_str().expect("UTF-8").to_owned();
    let known = &gateway.fingerprint;
    let second = ["robot", "enrol", "--gateway", &address, "--gateway-key", known, "--name", "scout", "--out", &out];
    let second = alice.fails(5, &[&second[..], &["--all-topics"]].concat());
    assert!(second.contains("enrolled already") && second.contains(&robot.device), "one name, one robot: {second}");
    let enrol = ["robot", "enrol", "--gateway", &address, "--gateway-key", &other, "--name", "rover", "--out", &out];
    let wrong = alice.fails(5, &[&enrol[..], &["--all-topics"]].concat());
    assert!(wrong.contains("not the pinned gateway"), "{wrong}");
    let unsaid = alice.fails(2, &enrol);
    assert!(unsaid.contains("--topic") && unsaid.contains("--all-topics"), "both ways are told: {unsaid}");

    robot.run(&["--robots", "1", "--count", "3"]).wait(120).expect_code(0);
    let recalled = alice.json(&["robot", "revoke", &robot.device]);
    assert_eq!(count(&recalled, "epoch"), 2, "what it holds opens nothing new: {recalled}");
    let ended = robot.run(&["--robots", "1", "--count", "3"]).wait(120).expect_code(5);
    let summary: Value = serde_json::from_str(ended.stdout.lines().last().expect("a summary")).expect("JSON");
    assert_eq!((count(&summary, "verified"), count(&summary, "pending")), (3, 3), "in the outbox: {summary}");
    let owner = text(&alice.json(&["identity", "show"]), "address");
    let by_whom = format!("{owner} revoked this robot at 20");
    assert!(text(&summary, "gateway").starts_with(&by_whom), "by whom, when: {summary}");
    assert!(!ended.stderr.contains("altered"), "nobody forged anything: {ended}");
    assert_eq!(verified(&alice, 3).len(), 3, "none of a recalled device came through");
}

#[test]
fn a_new_epoch_reaches_the_robots() {
    let gateway = Gateway::new();
    let alice = gateway.owner("alice");
    let address = format!("127.0.0.1:{}", gateway.port);
    let robot = Robot::enrol(&gateway, &alice, &address, "scout", &["/robot1/odom"]);
    let agent = robot.run(&["--robots", "1"]);
    wait_until(90, "the gateway takes records", || figures(&agent).filter(|figures| count(figures, "accepted") > 0));
    assert_eq!(count(&alice.json(&["keys", "rotate"]), "epoch"), 2);
    let newer = wait_until(120, "records of the new epoch", || {
        let records = alice.records(&["records", "list", "--oldest"]);
        records.into_iter().find(|record| count(record, "epoch") == 2 && is_verified(record))
    });
    let opened = alice.json(&["records", "open", &text(&newer, "id")]);
    assert_eq!((&opened["verdict"], &opened["topic"]), (&"verified".into(), &"/robot1/odom".into()), "{opened}");
    agent.stop("TERM", 30).expect_code(0);
    // What it learnt survives the run; the enrolment file itself is unchanged.
    let outcome = robot.run(&["--robots", "1", "--count", "2", "--log", "json"]).wait(120).expect_code(0);
    outcome.log();
    assert_eq!(count(&last(&outcome.stdout), "pending"), 0);
    let epochs: Vec<u64> = verified(&alice, 3).iter().map(|record| count(record, "epoch")).collect();
    assert_eq!(epochs.last(), Some(&2), "{epochs:?}");
}

/// The digests that a search finds, once it finds this many.
fn found(who: &Authros, arguments: &[&str], least: usize) -> Vec<String> {
    wait_until(120, &arguments.join(" "), || {
        let records = who.records(arguments);
        (records.len() >= least).then(|| records.iter().map(|record| text(record, "id")).collect())
    })
}

#[test]
fn a_new_topic_and_a_new_tag_of_a_scoped_robot_are_found_by_owner_and_reader() {
    let gateway = Gateway::new();
    let (alice, bob) = (gateway.owner("alexandra"), gateway.owner("bartholomew"));
    let address = format!("127.0.0.1:{}", gateway.port);
    let owner = text(&alice.json(&["identity", "show"]), "address");
    alice.json(&["grant", "add", &text(&bob.json(&["identity", "show"]), "address")]);
    // One for all topics computes its pseudonyms like the owner: with IK.
    let rover = Robot::enrol(&gateway, &alice, &address, "rover", &[]);
    let tagged = ["--tag", "mission=harbour", "--robots", "1", "--count", "2"];
    rover.run(&[&["--topic", "/robot1/odom"], &tagged[..]].concat()).wait(120).expect_code(0);
    let scout = Robot::enrol(&gateway, &alice, &address, "scout", &["/robot1/odom"]);
    assert!(scout.secrets().enrolment.index.is_none());
    scout.run(&tagged).wait(120).expect_code(0);

    // A topic it was not given is refused and counted; after the owner's notice it is accepted automatically.
    let both = ["--topic", "/robot1/odom", "--topic", "/robot1/camera/compressed", "--robots", "1"];
    let mut agent = scout.run(&[&both[..], &["--tag", "shift=night"]].concat());
    wait_until(90, "it is refused and counted", || figures(&agent).filter(|figures| count(figures, "lost") > 0));
    agent.wait_for_text("robot topics add", 60);
    let told = alice.json(&["robot", "topics", "add", "scout", "/robot1/camera/compressed"]);
    assert_eq!(told["added"], serde_json::json!(["/robot1/camera/compressed"]), "{told}");
    alice.fails(5, &["robot", "topics", "add", "scout", "/robot1/camera/compressed"]);
    let camera = ["records", "list", "--oldest", "--topic", "/robot1/camera/compressed"];
    found(&alice, &camera, 1);
    agent.stop("TERM", 20);

    let all = verified(&alice, 5);
    let of_type = |name: &str| {
        let wanted = all.iter().filter(|record| record["type"] == name);
        wanted.map(|record| text(record, "id")).collect::<Vec<_>>()
    };
    let mine: (&[&str], &[&str]) = (&["records", "list", "--oldest"], &[]);
    let shared: (&[&str], &[&str]) = (&["received", "list", "--oldest"], &["--owner", &owner]);
    for (who, (list, owner)) in [(&alice, mine), (&bob, shared)] {
        let mission = found(who, &[list, owner, &["--tag", "mission=harbour"]].concat(), 4);
        assert_eq!(mission.len(), 4, "of the robot for all topics and of the scoped one");
        let night = found(who, &[list, owner, &["--tag", "shift=night"]].concat(), 2);
        assert!(night.iter().any(|id| of_type("sensor_msgs/CompressedImage").contains(id)), "also on the new topic");
        let images = found(who, &[list, &["--type", "sensor_msgs/CompressedImage"]].concat(), 1);
        assert_eq!(images.len(), of_type("sensor_msgs/CompressedImage").len());
        let odometry = found(who, &[list, &["--type", "nav_msgs/Odometry"]].concat(), 4);
        assert_eq!(odometry.len(), of_type("nav_msgs/Odometry").len());
        assert!(who.records(&[list, owner, &["--tag", "mission=other"]].concat()).is_empty());
    }
}

#[test]
fn what_a_robot_sealed_out_of_reach_before_a_grant_from_now_on_is_for_those_who_read_before() {
    let gateway = Gateway::new();
    let (alice, bob, carol) = (gateway.owner("alice"), gateway.owner("bob"), gateway.owner("carol"));
    let address = |of: &Authros| text(&of.json(&["identity", "show"]), "address");
    alice.json(&["grant", "add", &address(&bob)]);
    let line = Cable::to(gateway.port);
    let robot = Robot::enrol(&gateway, &alice, &line.address(), "scout", &["/robot1/odom"]);
    let agent = robot.run(&["--robots", "1"]);
    wait_until(90, "the gateway takes records", || figures(&agent).filter(|figures| count(figures, "accepted") > 0));
    line.cut();
    wait_until(90, "its outbox fills", || figures(&agent).filter(|figures| count(figures, "pending") >= 10));

    let dry = alice.json(&["grant", "add", &address(&carol), "--from", "now", "--dry-run"]);
    assert_eq!((&dry["robots"], &dry["epochs"]), (&serde_json::json!(["scout"]), &1.into()), "{dry}");
    let granted = alice.json(&["grant", "add", &address(&carol), "--from", "now"]);
    assert_eq!(count(&granted, "epoch"), 2, "{granted}");
    line.mend();
    // It empties its outbox, hears of the new key, and goes on under it.
    let all = wait_until(180, "records of both epochs", || {
        let records = alice.records(&["records", "list", "--oldest"]);
        let of =
            |epoch: u64| records.iter().filter(|record| count(record, "epoch") == epoch && is_verified(record)).count();
        (of(1) >= 10 && of(2) >= 2).then_some(records)
    });
    agent.stop("TERM", 30).expect_code(0);
    let (older, newer): (Vec<Value>, Vec<Value>) =
        all.into_iter().filter(is_verified).partition(|record| count(record, "epoch") == 1);
    let shared = |who: &Authros, least: usize| {
        wait_until(120, "shared records", || {
            let ids: Vec<String> =
                who.records(&["received", "list", "--oldest"]).iter().map(|record| text(record, "id")).collect();
            (ids.len() >= least).then_some(ids)
        })
    };
    let (of_bob, of_carol) = (shared(&bob, older.len() + newer.len()), shared(&carol, newer.len()));
    for record in older.iter().chain(&newer) {
        assert!(of_bob.contains(&text(record, "id")), "who read before misses nothing: {record}");
    }
    for record in &older {
        assert!(!of_carol.contains(&text(record, "id")), "{record}");
    }
    let id = |records: &[Value]| text(records.last().expect("some"), "id");
    carol.is_refused(&["records", "open", &id(&older)]);
    for (who, id) in [(&bob, id(&older)), (&bob, id(&newer)), (&carol, id(&newer))] {
        assert_eq!(who.json(&["records", "open", &id])["verdict"], "verified");
    }
}
