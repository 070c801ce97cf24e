//! A reader whom the administrator has suspended wants to keep reading: through the subscription opened before, and by
//! new requests in the same session.

use std::time::Duration;

use authros::gateway::{Client, Code, Selection, Standing};
use authros::model::Digest;

use crate::enrolled_robot::of;
use crate::judge;
use crate::parts::Parts;
use crate::support::gate::Gate;
use crate::support::member::{Member, connect};

const TOPIC: &str = "/robot7/log";

/// Sends one more line of the owner's, and waits until it is verified.
pub async fn send(owner: &Member, robot: &mut Client, seq: u64) -> Digest {
    let record = owner.record(&owner.keyring.signing, TOPIC, seq, b"a line");
    let digest = Digest(owner.provider().sm3(&[&record.blob]));
    robot.upload(vec![record]).await.expect("accepted");
    for _ in 0..300 {
        if robot.check(&[digest]).await.expect("answers").standings() == [Standing::Verified] {
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
    let mut parts = Parts::default();
    parts.answered("the open subscription", Err(ended), &[Code::NotAuthorised, Code::Suspended]);
    if live > 0 {
        parts.reached(format!("{live} live records after it"));
    }
    let list = asking.query(&of(all.clone())).await.map(|page| format!("a list of {} records", page.entries.len()));
    let record = asking.fetch(&known).await.map(|record| format!("a record of {} bytes", record.blob.len()));
    let anew = asking.subscribe(&all).await.map(|_| "live records".to_owned());
    for (what, answer) in [("Query", list), ("Fetch", record), ("Subscribe", anew)] {
        parts.answered(what, answer, &[Code::Suspended]);
    }
    judge("read_while_suspended", parts.outcome());
}
