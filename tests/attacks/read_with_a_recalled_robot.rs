//! The thief of a robot keeps reading after its owner has recalled it: lists, records, live ones, notices.

use std::time::Duration;

use authros::gateway::{Client, Code, GatewayError, Selection};
use authros::model::{Digest, RecordKind};

use crate::enrolled_robot::{Robot, Scene, all_of, of, session};
use crate::judge;
use crate::parts::Parts;

/// Asks for everything there is.
async fn ask(parts: &mut Parts, client: &mut Client, robot: &authros::crypto::Enrolment, known: Digest) {
    let notices =
        Selection { topic_id: Some(robot.notice_id), kind: Some(RecordKind::Key), ..Selection::all(robot.owner) };
    let list = client.query(&all_of(robot)).await.map(|page| format!("a list of {} records", page.entries.len()));
    let record = client.fetch(&known).await.map(|record| format!("a record of {} bytes", record.blob.len()));
    let live = client.subscribe(&Selection::all(robot.owner)).await.map(|_| "live records".to_owned());
    let told = client.query(&of(notices.clone())).await.map(|page| format!("{} notices", page.entries.len()));
    let telling = client.subscribe(&notices).await.map(|_| "live notices".to_owned());
    let answers =
        [("Query", list), ("Fetch", record), ("Subscribe", live), ("notices", told), ("live notices", telling)];
    for (what, answer) in answers {
        parts.answered(what, answer, &[Code::NotAuthorised]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn read_with_a_recalled_robot() {
    let scene = Scene::new();
    let (lost, other) = (Robot::enrol(&scene, "scout-1", &[]), Robot::enrol(&scene, "scout-2", &[]));
    lost.capture(3);
    other.capture(3);
    let stolen = lost.stolen();
    let records = scene.alice.records(&["uploads", "list"]);
    let known: Digest = crate::support::text(&records[0], "digest").parse().expect("a digest");
    let mut client = session(&stolen).await.expect("it is not recalled yet");
    // Opened before, on everything he may have.
    let notices =
        Selection { topic_id: Some(stolen.notice_id), kind: Some(RecordKind::Key), ..Selection::all(stolen.owner) };
    let mut listening = session(&stolen).await.expect("it is not recalled yet");
    if listening.subscribe(&Selection::all(stolen.owner)).await.is_err() {
        listening.subscribe(&notices).await.expect("its own notices");
    }
    let recalled = scene.alice.json(&["devices", "recall", &lost.device]);
    let begun = std::time::Instant::now();
    let mut parts = Parts::default();
    ask(&mut parts, &mut client, &stolen, known).await;
    println!("recalled in block {}; asked {} ms later", recalled["block"], begun.elapsed().as_millis());
    other.capture(3);
    scene.alice.json(&["keys", "rotate"]);
    let mut live = 0;
    let ended = loop {
        match listening.next_event(Duration::from_secs(5)).await {
            Ok(_) => live += 1,
            Err(error) => break error,
        }
    };
    if live > 0 {
        parts.reached(format!("{live} live records, ended by {ended}"));
    }
    // A subscription that only has nothing to tell is open still.
    match ended {
        GatewayError::TimedOut => parts.reached("a subscription that is open still".to_owned()),
        ended => parts.answered("the open subscription", Err(ended), &[Code::NotAuthorised]),
    }
    // The name belongs to nobody any more: its key cannot be told from a wrong one, and the refusal is in clear,
    // because there is no session.
    match session(&stolen).await {
        Ok(mut client) => ask(&mut parts, &mut client, &stolen, known).await,
        Err(GatewayError::RefusedInClear(Code::Tag)) => parts.refused("a new session", Code::Tag.text(), "another key"),
        Err(error) => parts.otherwise(format!("a new session: {error}")),
    }
    judge("read_with_a_recalled_robot", parts.outcome());
    scene.site.stop("TERM", 20);
}
