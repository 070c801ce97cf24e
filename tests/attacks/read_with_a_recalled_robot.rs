//! The thief of a robot keeps reading after its owner has recalled it: lists, records, live ones, notices.

use std::time::Duration;

use authros::gateway::{Client, Code, Feed, GatewayError};
use authros::model::{Digest, RecorderId};

use crate::enrolled_robot::{Robot, Scene, notices, session};
use crate::judge;
use crate::parts::Parts;
use crate::support::member::Live;

/// Asks for everything there is.
async fn ask(parts: &mut Parts, client: &mut Client, robot: &authros::crypto::Enrolment, known: Digest) {
    let own = Feed { recorders: vec![RecorderId([1; 16])], ..Feed::of(robot.owner) };
    let asked = [("the owner's feed", Feed::of(robot.owner)), ("notices", notices(robot)), ("its own records", own)];
    for (what, feed) in asked {
        let answer = client.feed(&feed).await.map(|page| format!("{} records", page.entries.len()));
        parts.answered(what, answer, &[Code::NotAuthorised]);
    }
    let record = client.fetch(&known).await.map(|record| format!("a record of {} bytes", record.blob.len()));
    parts.answered("Records", record, &[Code::NotAuthorised]);
}

#[tokio::test(flavor = "multi_thread")]
async fn read_with_a_recalled_robot() {
    let scene = Scene::new();
    let (lost, other) = (Robot::enrol(&scene, "scout-1", &[]), Robot::enrol(&scene, "scout-2", &[]));
    lost.capture(3);
    other.capture(3);
    let stolen = lost.stolen();
    let records = scene.alice.records(&["records", "list", "--oldest"]);
    let known: Digest = crate::support::text(&records[0], "digest").parse().expect("a digest");
    let mut client = session(&stolen).await.expect("it is not recalled yet");
    // Opened before, on everything he may have.
    let mut listening = session(&stolen).await.expect("it is not recalled yet");
    let mut follower = match Live::begin(&mut listening, Feed::of(stolen.owner)).await {
        Ok(follower) => follower,
        Err(_) => Live::begin(&mut listening, notices(&stolen)).await.expect("its own notices"),
    };
    let recalled = scene.alice.json(&["robot", "revoke", &lost.device]);
    let begun = std::time::Instant::now();
    let mut parts = Parts::default();
    ask(&mut parts, &mut client, &stolen, known).await;
    println!("recalled in block {}; asked {} ms later", recalled["block"], begun.elapsed().as_millis());
    other.capture(3);
    scene.alice.json(&["keys", "rotate"]);
    let mut live = 0;
    let ended = loop {
        match follower.next(&mut listening, Duration::from_secs(5)).await {
            Ok(_) => live += 1,
            Err(error) => break error,
        }
    };
    if live > 0 {
        parts.reached(format!("{live} live records, ended by {ended}"));
    }
    match ended {
        GatewayError::TimedOut => parts.reached("a request that waits still".to_owned()),
        ended => parts.answered("the request that waited", Err(ended), &[Code::NotAuthorised]),
    }
    // Anyone who has its key learns that it was recalled, and nothing else.
    match session(&stolen).await {
        Ok(mut client) => ask(&mut parts, &mut client, &stolen, known).await,
        Err(error @ GatewayError::Recalled(_)) => parts.refused("a new session", &error.to_string(), "revoked it at"),
        Err(error) => parts.otherwise(format!("a new session: {error}")),
    }
    judge("read_with_a_recalled_robot", parts.outcome());
    scene.site.stop("TERM", 20);
}
