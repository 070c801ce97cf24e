//! The thief of a robot keeps reading after its owner has recalled it: lists, records, live ones, notices.

use std::time::Duration;

use authros::gateway::{Client, GatewayError, Selection};
use authros::model::{Digest, RecordKind};

use crate::enrolled_robot::{Robot, Scene, all_of, of, session};
use crate::{Outcome, judge};

/// What the thief gets, or the refusal he reads.
async fn reaches(client: &mut Client, robot: &authros::crypto::Enrolment, known: Digest) -> Result<String, String> {
    let notices =
        Selection { topic_id: Some(robot.notice_id), kind: Some(RecordKind::Key), ..Selection::all(robot.owner) };
    let mut refusals: Vec<String> = Vec::new();
    let mut tried = |what: &str, outcome: Result<String, GatewayError>| match outcome {
        Ok(reached) => Some(reached),
        Err(error) => {
            refusals.push(format!("{what}: {error}"));
            None
        }
    };
    let list = client.query(&all_of(robot)).await.map(|page| format!("a list of {} records", page.entries.len()));
    let record = client.fetch(&known).await.map(|record| format!("a record of {} bytes", record.blob.len()));
    let live = client.subscribe(&Selection::all(robot.owner)).await.map(|_| "live records".to_owned());
    let told = client.query(&of(notices.clone())).await.map(|page| format!("{} notices", page.entries.len()));
    let telling = client.subscribe(&notices).await.map(|_| "live notices".to_owned());
    let outcomes =
        [("Query", list), ("Fetch", record), ("Subscribe", live), ("notices", told), ("live notices", telling)];
    let reached: Vec<String> = outcomes.into_iter().filter_map(|(what, outcome)| tried(what, outcome)).collect();
    if reached.is_empty() { Err(refusals.join("; ")) } else { Ok(reached.join(", ")) }
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
    let early = reaches(&mut client, &stolen, known).await;
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
    let anew = match session(&stolen).await {
        Ok(mut client) => reaches(&mut client, &stolen, known).await,
        Err(error) => Err(format!("a new session: {error}")),
    };
    // A subscription that merely has nothing to report is still open.
    let cut = !matches!(ended, GatewayError::TimedOut);
    let outcome = match (early, live, anew) {
        (Err(early), 0, Err(anew)) if cut => {
            Outcome::Refused(format!("{early}; the open subscription: {ended}; {anew}"))
        }
        (early, live, anew) => {
            Outcome::Succeeded(format!("at once {early:?}; {live} live records, ended by {ended}; anew {anew:?}"))
        }
    };
    judge("read_with_a_recalled_robot", outcome);
    scene.site.stop("TERM", 20);
}
