//! A reader whom the administrator has suspended wants to keep reading: by the request that waited
//! before, and by new ones in the same session.

use std::time::Duration;

use authros::gateway::{Client, Code, Feed};
use authros::model::Digest;

use crate::judge;
use crate::parts::Parts;
use crate::support::gate::Gate;
use crate::support::member::{Live, Member, connect, until_verified};

const TOPIC: &str = "/robot7/log";

/// Sends one more line of the owner's, and waits until it is verified.
pub async fn send(owner: &Member, robot: &mut Client, seq: u64) -> Digest {
    let record = owner.record(&owner.keyring.signing, TOPIC, seq, b"a line");
    let digest = Digest(owner.provider().sm3(&[&record.blob]));
    robot.upload(vec![record]).await.expect("accepted");
    until_verified(robot, Feed::of(owner.address()), &[digest]).await;
    digest
}

#[tokio::test(flavor = "multi_thread")]
async fn read_while_suspended() {
    let gate = Gate::new();
    let (alice, bob) = (gate.home.profile("alice"), gate.home.profile("bob"));
    let (_, reader) = (alice.enrol(), bob.enrol());
    alice.json(&["grant", "add", &reader]);
    let [owner, member] = ["alice", "bob"].map(|name| Member::of(&gate.home, name, gate.gateway.domain));
    let credentials = owner.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let credentials = member.allocate(&gate.gateway, "bob-reads").await.expect("allocates");
    let mut listening = connect(&gate.gateway, &credentials).await;
    let mut asking = connect(&gate.gateway, &credentials).await;
    let all = Feed::of(owner.address());
    let mut follower = Live::begin(&mut listening, all.clone()).await.expect("granted");
    let known = send(&owner, &mut robot, 1).await;
    let (entry, _) = follower.next(&mut listening, Duration::from_secs(20)).await.expect("granted");
    assert_eq!(entry.digest, known, "the line that was sent");

    gate.home.profile("gateway").json(&["chain", "admin", "suspend", &reader]);
    send(&owner, &mut robot, 2).await;
    let mut live = 0;
    let ended = loop {
        match follower.next(&mut listening, Duration::from_secs(5)).await {
            Ok(_) => live += 1,
            Err(error) => break error,
        }
    };
    let mut parts = Parts::default();
    parts.answered("the request that waited", Err(ended), &[Code::NotAuthorised, Code::Suspended]);
    if live > 0 {
        parts.reached(format!("{live} live records after it"));
    }
    let list = asking.feed(&all).await.map(|page| format!("a list of {} records", page.entries.len()));
    let record = asking.fetch(&known).await.map(|record| format!("a record of {} bytes", record.blob.len()));
    for (what, answer) in [("Feed", list), ("Records", record)] {
        parts.answered(what, answer, &[Code::Suspended]);
    }
    judge("read_while_suspended", parts.outcome());
}
