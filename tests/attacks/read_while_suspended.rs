//! A reader whom the administrator has suspended wants to keep reading: through the subscription opened before, and by
//! new requests in the same session.

use std::time::Duration;

use authros::gateway::{Client, Selection, Standing};
use authros::model::Digest;

use crate::enrolled_robot::of;
use crate::support::gate::Gate;
use crate::support::member::{Member, connect};
use crate::{Outcome, judge};

const TOPIC: &str = "/robot7/log";

/// Sends another of the owner's lines, and waits until it is verified.
async fn send(owner: &Member, robot: &mut Client, seq: u64) -> Digest {
    let record = owner.record(&owner.keyring.signing, TOPIC, seq, b"a line");
    let digest = Digest(owner.provider().sm3(&[&record.blob]));
    robot.upload(vec![record]).await.expect("accepted");
    for _ in 0..300 {
        if robot.check(&[digest]).await.expect("answers") == [Standing::Verified] {
            return digest;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("not verified in 30 s");
}

#[tokio::test(flavor = "multi_thread")]
async fn read_while_suspended() {
    let gate = Gate::new();
    let (alice, bob) = (gate.home.profile("alice"), gate.home.profile("bob"));
    let (_, reader) = (alice.enrol(), bob.enrol());
    alice.json(&["grant", &reader]);
    let [owner, member] = ["alice", "bob"].map(|name| Member::of(&gate.home, name, gate.gateway.domain));
    let credentials = owner.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let credentials = member.allocate(&gate.gateway, "bob-reads").await.expect("allocates");
    let mut listening = connect(&gate.gateway, &credentials).await;
    let mut asking = connect(&gate.gateway, &credentials).await;
    let all = Selection::all(owner.address());
    listening.subscribe(&all).await.expect("granted");
    let known = send(&owner, &mut robot, 1).await;
    let (_, entry, _) = listening.next_event(Duration::from_secs(20)).await.expect("granted");
    assert_eq!(entry.digest, known, "the line that was sent");

    gate.home.profile("gateway").json(&["chain", "suspend", &reader]);
    send(&owner, &mut robot, 2).await;
    let mut live = 0;
    let ended = loop {
        match listening.next_event(Duration::from_secs(5)).await {
            Ok(_) => live += 1,
            Err(error) => break error,
        }
    };
    let mut reached = Vec::new();
    let mut refusals = vec![format!("the open subscription: {ended}")];
    let list = asking.query(&of(all.clone())).await.map(|page| format!("a list of {} records", page.entries.len()));
    let record = asking.fetch(&known).await.map(|record| format!("a record of {} bytes", record.blob.len()));
    let anew = asking.subscribe(&all).await.map(|_| "live records".to_owned());
    for (what, outcome) in [("Query", list), ("Fetch", record), ("Subscribe", anew)] {
        match outcome {
            Ok(got) => reached.push(got),
            Err(error) => refusals.push(format!("{what}: {error}")),
        }
    }
    let outcome = match (live, reached.as_slice()) {
        (0, []) => Outcome::Refused(refusals.join("; ")),
        (live, reached) => Outcome::Succeeded(format!("{live} live records after it, asked anew {reached:?}")),
    };
    judge("read_while_suspended", outcome);
}
