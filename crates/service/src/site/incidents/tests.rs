//! Valid names and subjects of incidents; each act is logged first; and an incident belongs to its owner alone.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::model::{Digest, ErrorKind, RecordKind, RecordState, Signature, SignerId, TopicId};
use crate::site::testing::{Ground, profile};
use crate::store::NewRecord;

fn incidents(ground: &Ground) -> Incidents {
    Incidents { parts: ground.parts.clone() }
}

fn name(text: &str) -> IncidentName {
    text.parse().expect("a name")
}

/// Acknowledges a message of an owner, as the sealer does.
fn capture(ground: &Ground, owner: Address, topic: &str, second: u64) {
    let digest = Digest(crate::crypto::sm3::sm3(&[&owner.0, topic.as_bytes(), &second.to_be_bytes()]));
    let record = NewRecord {
        digest,
        owner,
        topic_id: TopicId(digest.0[..16].try_into().expect("16 bytes")),
        seq: second,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: topic.to_owned(),
        type_name: "a/B".to_owned(),
        bytes: 9,
        captured_at: Timestamp::from_seconds(second),
        simulated: false,
        state: RecordState::Stored,
        blob: None,
    };
    ground.parts.plant.ledger.records.append(vec![record]).expect("acknowledged");
}

fn of(since: u64, until: Option<u64>, topics: &[&str], note: Option<&str>) -> Result<Wanted> {
    let topics = topics.iter().map(|topic| topic.parse().expect("a topic")).collect();
    wanted(name("crash"), (Timestamp::from_seconds(since), until.map(Timestamp::from_seconds)), topics, note)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_incident_is_opened_noted_closed_and_removed_and_each_act_is_written_down() {
    let ground = Ground::with(&[]);
    let (alice, bob) = (ground.owner("alice").address, ground.owner("bob").address);
    let (incidents, by) = (incidents(&ground), profile("alice"));
    for second in [10, 20, 30] {
        capture(&ground, alice, "/odom", second);
    }
    capture(&ground, alice, "/scan", 20);
    capture(&ground, bob, "/odom", 20);
    let asked = of(15, None, &["/odom", "/never"], Some("hit\u{1b}[2J a \u{202e}wall\nat bay 3")).expect("good");
    let view = incidents.open(&by, alice, asked).await.expect("opened");
    assert_eq!((view.records, view.bytes, view.open, view.until), (2, 18, true, None));
    let told: Vec<_> = view.coverage.iter().map(|one| (one.topic.as_str(), one.records, one.first)).collect();
    assert_eq!(told, [("/never", 0, None), ("/odom", 2, Some(Timestamp::from_seconds(20)))]);
    let note = &view.notes.first().expect("a note").text;
    assert!(note.lines().count() == 2 && !note.contains(['\u{1b}', '\u{202e}']), "{note:?}");

    let again = incidents.open(&by, alice, of(1, None, &[], None).expect("good")).await.expect_err("the same name");
    assert_eq!(again.kind, ErrorKind::Input);
    incidents.note(&by, alice, &name("crash"), "second").await.expect("noted");
    assert!(incidents.show(bob, &name("crash")).is_err() && incidents.list(bob).expect("none").is_empty());
    let closed = incidents.close(&by, alice, &name("crash")).await.expect("closed");
    assert!(!closed.open && closed.until == closed.closed_at && closed.notes.len() == 2);
    assert!(incidents.close(&by, alice, &name("crash")).await.is_err(), "once");
    assert_eq!(incidents.list(alice).expect("a list"), [closed]);
    assert_eq!(incidents.remove(&by, alice, &name("crash")).await.expect("removed"), []);
    for failure in [
        incidents.remove(&by, alice, &name("crash")).await.expect_err("gone"),
        incidents.note(&by, alice, &name("crash"), "x").await.expect_err("gone"),
        incidents.close(&by, alice, &name("crash")).await.expect_err("gone"),
    ] {
        assert!(failure.kind == ErrorKind::Input && failure.message.contains("no incident crash"), "{failure}");
    }
    for action in ["open incident", "note incident", "close incident", "remove incident"] {
        let written = ground.audited(action);
        assert!(written.iter().all(|(subject, _)| subject.starts_with("crash")), "{action}: {written:?}");
        let outcomes: Vec<&str> = written.iter().map(|(_, outcome)| outcome.as_str()).collect();
        assert_eq!(outcomes, ["begun", "done"], "{action}");
    }
}

#[test]
fn bounds_are_held_before_anything_is_written() {
    let future = Timestamp::now().0 / 1_000_000_000 + 3600;
    let long = "a".repeat(LONGEST_NOTE + 1);
    for bad in [
        of(future, None, &[], None),
        of(10, Some(10), &[], None),
        of(10, Some(9), &[], None),
        of(10, None, &[], Some(&long)),
        of(10, None, &[], Some(" \n  ")),
    ] {
        assert_eq!(bad.map(drop).expect_err("refused").kind, ErrorKind::Input);
    }
    assert!(of(10, Some(future), &[], Some(&long[1..])).is_ok(), "a span may end later");
    let many: Vec<String> = (0..=MOST_TOPICS).map(|number| format!("/t{number}")).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    assert!(of(10, None, &many, None).is_err() && of(10, None, &many[1..], None).is_ok());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_query_is_narrowed_to_the_incident_and_never_widened() {
    let ground = Ground::with(&[]);
    let (alice, bob) = (ground.owner("alice").address, ground.owner("bob").address);
    let asked = of(15, Some(25), &["/odom"], None).expect("good");
    incidents(&ground).open(&profile("alice"), alice, asked).await.expect("opened");
    let ledger = &ground.parts.plant.ledger;
    let within = |since: Option<u64>, until: Option<u64>| {
        let (since, until) = (since.map(Timestamp::from_seconds), until.map(Timestamp::from_seconds));
        let query = RecordQuery { since, until, ..RecordQuery::default() };
        let query = narrowed(&ledger.incidents, alice, &name("crash"), query).expect("there");
        assert_eq!(query.topics, ["/odom".parse::<TopicPatterns>().expect("a topic")]);
        (query.since.map(|at| at.seconds()), query.until.map(|at| at.seconds()))
    };
    assert_eq!(within(None, None), (Some(15), Some(25)));
    assert_eq!(within(Some(1), Some(99)), (Some(15), Some(25)));
    assert_eq!(within(Some(17), Some(19)), (Some(17), Some(19)));
    assert!(narrowed(&ledger.incidents, bob, &name("crash"), RecordQuery::default()).is_err(), "another's");
}
