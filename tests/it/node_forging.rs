//! Node forging on a real roscore: anyone but the pinned publisher raises an alarm, and nothing of theirs is anchored.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::Value;
use support::{Authros, Home, Roscore, Running, count, heavy, is_verified, list, poll, skipped, text};

const NO_ROS: &str = "no roscore, rosbag and rostopic in /usr/bin";
const TOPIC: &str = "/words";
const MD5: &str = "992ce8a1687cec8c8bd883ec73ca41d1";
/// The messages of the pinned publisher, and those of the others: distinguished by their lengths.
const GOOD: (&str, u64) = ("good", 8);
const FORGED: (&str, u64) = ("forged", 10);

/// A watched topic with its pinned publisher.
struct Scene {
    authros: Authros,
    home: Home,
    roscore: Roscore,
    pinned: Option<Running>,
    _site: Running,
}

impl Scene {
    fn open() -> Option<Self> {
        let roscore = Roscore::start()?;
        let home = Home::new();
        let authros = home.authros().with(&["--ros-master", &roscore.uri()]);
        let site = authros.serve(&home);
        authros.enrol();
        authros.run(&["topics", "watch", TOPIC]).expect_code(0);
        let pinned = roscore.publish_as("driver", TOPIC, GOOD.0, 20);
        let scene = Self { authros, home, roscore, pinned: Some(pinned), _site: site };
        scene.wait_for(GOOD.1, "verified", 5);
        Some(scene)
    }

    fn records(&self) -> Vec<Value> {
        self.authros.records(&["records", "list", "--oldest", "--topic", TOPIC])
    }

    /// Ids of the messages of this length, and their states.
    fn of(&self, bytes: u64) -> Vec<(String, String)> {
        let own = self.records().into_iter().filter(|record| count(record, "bytes") == bytes);
        own.map(|record| (text(&record, "id"), text(&record, "state"))).collect()
    }

    fn wait_for(&self, bytes: u64, state: &str, least: usize) {
        let found = || self.of(bytes).iter().filter(|(_, found)| found == state).count();
        assert!(poll(60, || (found() >= least).then_some(())).is_some(), "{least} {state}: {:?}", self.of(bytes));
    }

    fn alarms(&self) -> Vec<Value> {
        list(&self.authros.json(&["topics", "pins", "--topic", TOPIC]), "alarms")
    }

    /// Waits for an alarm of this kind; it is reported, and marked on the topic.
    fn wait_for_alarm(&self, reason: &str) -> Value {
        let of_kind = || self.alarms().into_iter().find(|alarm| alarm["reason"] == reason);
        let alarm = poll(60, of_kind).unwrap_or_else(|| panic!("no alarm '{reason}': {:?}", self.alarms()));
        let rows = list(&self.authros.json(&["topics", "list"]), "topics");
        assert!(rows.iter().any(|row| row["topic"] == TOPIC && row["alarm"] == true), "{rows:?}");
        alarm
    }

    /// No message of a forger has ever been on the way to the chain, and every one of the pinned publisher is verified.
    /// The pinned publisher ends first: while it continues there is always one on the way.
    fn expect_clean(&mut self) {
        self.pinned = None;
        let forged = self.of(FORGED.1);
        assert!(forged.iter().all(|(_, state)| state == "quarantined"), "{forged:?}");
        let open = || self.of(GOOD.1).into_iter().filter(|(_, state)| state != "verified").collect::<Vec<_>>();
        assert!(poll(60, || open().is_empty().then_some(())).is_some(), "{:?}", open());
        let anchored = |record: &Value| !record["transaction"].is_null() || !record["block"].is_null();
        let forged = |record: &Value| count(record, "bytes") == FORGED.1;
        assert!(!self.records().iter().any(|record| forged(record) && anchored(record)));
    }

    fn held(&self) -> Value {
        self.authros.json(&["topics", "quarantine", "list", "--topic", TOPIC, "--limit", "1000"])
    }
}

#[test]
fn a_second_publisher_is_quarantined_and_the_operator_decides() {
    let Some(mut scene) = Scene::open() else { skipped!(NO_ROS) };
    let pins = list(&scene.authros.json(&["topics", "pins"]), "pins");
    assert_eq!(
        (pins.len(), text(&pins[0], "caller_id"), text(&pins[0], "source")),
        (1, "/driver".into(), "first".into())
    );
    assert_eq!(text(&pins[0], "md5sum"), MD5);

    let forger = scene.roscore.publish_as("stranger", TOPIC, FORGED.0, 20);
    scene.wait_for(FORGED.1, "quarantined", 10);
    let alarm = scene.wait_for_alarm("new");
    assert!(text(&alarm, "publisher").starts_with("/stranger@127.0.0.1:std_msgs/String:"), "{alarm}");
    let before = scene.of(GOOD.1).len();
    scene.wait_for(GOOD.1, "verified", before + 10);
    drop(forger);
    scene.pinned = None;
    scene.expect_clean();
    let forged = scene.of(FORGED.1);

    // The tag is in the sealed head, and only the owner is shown what is quarantined.
    let opened = scene.authros.json(&["records", "open", &forged[0].0]);
    let tags = list(&opened, "tags");
    assert!(tags.iter().any(|tag| tag[0] == "quarantined" && tag[1] == "new"), "{opened}");
    assert_eq!((opened["verdict"].as_str(), opened["message"]["data"].as_str()), (Some("unanchored"), Some(FORGED.0)));
    let told = scene.authros.run(&["records", "open", &forged[0].0]);
    assert!(told.stdout.lines().next().is_some_and(|heading| heading.ends_with("QUARANTINED")), "{told}");
    let reader = scene.home.profile("reader");
    scene.authros.json(&["grant", "add", &reader.enrol()]);
    let shared = reader.records(&["received", "list", "--oldest", "--topic", TOPIC]);
    assert_eq!(shared.len(), scene.of(GOOD.1).len());
    reader.fails(3, &["records", "open", &forged[0].0]);

    let held = scene.held();
    assert_eq!(count(&held, "messages"), forged.len() as u64);
    assert!(list(&held, "records").iter().all(|row| row["reason"] == "new"));
    let (released, discarded) = (&forged[0].0, &forged[1].0);
    scene.authros.fails(2, &["topics", "quarantine", "discard", discarded]);
    let decided = scene.authros.json(&["topics", "quarantine", "discard", discarded, "--yes"]);
    assert_eq!((count(&decided, "messages"), list(&decided, "reports").is_empty()), (1, false));
    let decided = scene.authros.json(&["topics", "quarantine", "release", released]);
    assert_eq!(count(&decided, "messages"), 1);
    let state = |id: &str| scene.of(FORGED.1).into_iter().find(|(found, _)| found == id).map(|(_, state)| state);
    assert!(poll(60, || (state(released)? == "verified").then_some(())).is_some(), "{:?}", state(released));
    let opened = scene.authros.json(&["records", "open", released]);
    assert!(list(&opened, "tags").iter().any(|tag| tag[0] == "quarantined"), "the tag stays: {opened}");
    assert_eq!(opened["message"]["data"], FORGED.0, "its definition was released along");
    assert_eq!(state(discarded).as_deref(), Some("dropped"));
    scene.authros.fails(6, &["records", "open", discarded]);
    scene.authros.fails(3, &["topics", "quarantine", "release", discarded]);

    // The rest of the topic at once; the alarm is acknowledged.
    let decided = scene.authros.json(&["topics", "quarantine", "discard", "--topic", TOPIC, "--yes"]);
    assert_eq!(count(&decided, "messages"), forged.len() as u64 - 2);
    assert!(scene.alarms().iter().all(|alarm| alarm["open"] == false));
    assert_eq!(count(&scene.held(), "messages"), 0);
    let dropped = scene.of(FORGED.1).iter().filter(|(_, state)| state == "dropped").count();
    assert_eq!(dropped, forged.len() - 1);
    // The quarantine records count everything quarantined, and are anchored like data.
    let reports = || scene.authros.records(&["records", "list", "--oldest", "--kind", "quarantine"]);
    let anchored = || (!reports().is_empty() && reports().iter().all(is_verified)).then_some(());
    assert!(poll(60, anchored).is_some(), "{:?}", reports());
}

#[test]
fn a_node_that_takes_the_pinned_ones_name_is_quarantined() {
    let Some(mut scene) = Scene::open() else { skipped!(NO_ROS) };
    // The master shuts down the older of two nodes with the same name, so this is all it takes in ROS 1.
    let _forger = scene.roscore.publish_as("driver", TOPIC, FORGED.0, 20);
    scene.wait_for(FORGED.1, "quarantined", 10);
    let alarm = scene.wait_for_alarm("replaced");
    assert!(text(&alarm, "publisher").starts_with("/driver@127.0.0.1:"), "{alarm}");
    let mut pinned = scene.pinned.take().expect("it was there");
    assert!(poll(30, || (!pinned.is_running()).then_some(())).is_some(), "the master ended it");
    scene.expect_clean();
    // Nobody can tell who comes next under this name: quarantined too, until the operator decides.
    scene.authros.run(&["topics", "pin", TOPIC]).expect_code(0);
    assert!(scene.alarms().is_empty());
    scene.wait_for(FORGED.1, "verified", 5);
}

#[test]
fn a_restarted_node_is_accepted() {
    let Some(mut scene) = Scene::open() else { skipped!(NO_ROS) };
    for end in ["INT", "KILL"] {
        let before = scene.of(GOOD.1).len();
        let mut pinned = scene.pinned.take().expect("it is there");
        pinned.signal(end);
        assert!(poll(30, || (!pinned.is_running()).then_some(())).is_some(), "it ended by {end}");
        scene.pinned = Some(scene.roscore.publish_as("driver", TOPIC, GOOD.0, 20));
        scene.wait_for(GOOD.1, "verified", before + 20);
        assert!(scene.alarms().is_empty(), "{end}: {:?}", scene.alarms());
    }
    scene.expect_clean();
}

#[test]
fn a_raw_publisher_update_is_an_alarm_and_no_connection() {
    let Some(mut scene) = Scene::open() else { skipped!(NO_ROS) };
    // A real publisher of the topic, known only to another master.
    let elsewhere = Roscore::start().expect("a second roscore");
    let forger = elsewhere.publish_as("driver", TOPIC, FORGED.0, 20);
    let uri = elsewhere.uri_of("/driver");
    assert!(uri.starts_with("http://"), "{uri}");
    for _ in 0..3 {
        assert!(scene.roscore.announce(TOPIC, &uri).contains("[1,"), "the node took the call");
    }
    let alarm = scene.wait_for_alarm("unconfirmed");
    assert_eq!(text(&alarm, "publisher"), uri);
    let before = scene.of(GOOD.1).len();
    scene.wait_for(GOOD.1, "verified", before + 10);
    assert_eq!((scene.of(FORGED.1), scene.alarms().len()), (Vec::new(), 1));
    drop(forger);
    scene.expect_clean();
}

#[test]
fn a_list_says_who_may_publish() {
    let _alone = heavy();
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    let home = Home::new();
    let listed = format!("{TOPIC}=/driver@127.0.0.1:std_msgs/String:{MD5}");
    let authros = home.authros().with(&["--ros-master", &roscore.uri()]);
    let authros = authros.with_variable("AUTHROS_PINS", "list").with_variable("AUTHROS_PUBLISHERS", &listed);
    let _site = authros.serve(&home);
    let _stranger = roscore.publish_as("stranger", TOPIC, FORGED.0, 20);
    let _driver = roscore.publish_as("driver", TOPIC, GOOD.0, 20);
    let capture = authros.with(&["--json"]).spawn(&["capture", "--topic", TOPIC, "--for", "15s"]);
    let outcome = capture.wait(120).expect_code(8);
    let summary = outcome.document();
    let (captured, verified, held) =
        (count(&summary, "captured"), count(&summary, "verified"), count(&summary, "quarantined"));
    assert!(verified > 0 && held > 0 && captured == verified + held, "{summary}");
    assert!(outcome.stderr.contains("quarantined"), "{outcome}");
    let records = authros.records(&["records", "list", "--oldest", "--topic", TOPIC]);
    let of = |bytes| records.iter().filter(move |record| count(record, "bytes") == bytes);
    assert_eq!(of(GOOD.1).filter(|record| is_verified(record)).count() as u64, verified);
    assert!(of(FORGED.1).all(|record| record["state"] == "quarantined") && of(FORGED.1).count() as u64 >= held);
    assert_eq!(count(&summary["topics"][0], "quarantined"), held);
    let pins = authros.json(&["topics", "pins"]);
    assert_eq!((text(&pins, "mode"), text(&list(&pins, "pins")[0], "source")), ("list".into(), "settings".into()));
    let message = authros.fails(3, &["topics", "unpin", TOPIC, "/driver"]);
    assert!(message.contains("ros.publishers"), "{message}");
}
