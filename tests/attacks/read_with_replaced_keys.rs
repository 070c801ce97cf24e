//! A thief of a reader's transport key keeps reading after the reader has replaced the stolen keys: by the request that waited
//! before, and by new ones in the same session.

use std::time::Duration;

use authros::gateway::{Code, Feed, GatewayError};

use crate::judge;
use crate::parts::Parts;
use crate::read_while_suspended::send;
use crate::support::gate::Gate;
use crate::support::member::{Live, Member, connect};

#[tokio::test(flavor = "multi_thread")]
async fn read_with_replaced_keys() {
    let gate = Gate::new();
    let (alice, bob) = (gate.home.profile("alice"), gate.home.profile("bob"));
    let (_, reader) = (alice.enrol(), bob.enrol());
    alice.json(&["grant", "add", &reader]);
    let [owner, member] = ["alice", "bob"].map(|name| Member::of(&gate.home, name, gate.gateway.domain));
    let credentials = owner.allocate(&gate.gateway, "robot-7").await.expect("allocates");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let stolen = member.allocate(&gate.gateway, "bob-reads").await.expect("allocates");
    let (mut listening, mut idle) = (connect(&gate.gateway, &stolen).await, connect(&gate.gateway, &stolen).await);
    let mut asking = connect(&gate.gateway, &stolen).await;
    let all = Feed::of(owner.address());
    let mut follower = Live::begin(&mut listening, all.clone()).await.expect("granted");
    let known = send(&owner, &mut robot, 1).await;
    let (entry, _) = follower.next(&mut listening, Duration::from_secs(20)).await.expect("granted");
    assert_eq!(entry.digest, known, "the line that was sent");
    // One who has nothing to be told: no record of this topic ever comes.
    let nothing = Feed { topics: vec![owner.topic("/never").0], ..all.clone() };
    let mut idler = Live::begin(&mut idle, nothing).await.expect("granted");

    let key = gate.home.file("sm2", "7".repeat(64), 0o600);
    bob.run(&["keys", "load", "--sm2", &key]).expect_code(0);
    send(&owner, &mut robot, 2).await;
    let (mut parts, cut) = (Parts::default(), [Code::NotAuthorised, Code::NotRegistered]);
    let mut live = 0;
    let ended = loop {
        match follower.next(&mut listening, Duration::from_secs(5)).await {
            Ok(_) => live += 1,
            Err(error) => break error,
        }
    };
    if live > 0 {
        parts.reached(format!("{live} live records after the change of keys"));
    }
    for (what, ended) in [
        ("the request that waited", ended),
        ("the idle one", idler.next(&mut idle, Duration::from_secs(5)).await.expect_err("no record")),
    ] {
        match ended {
            GatewayError::TimedOut => parts.reached(format!("{what} is open still")),
            ended => parts.answered(what, Err(ended), &cut),
        }
    }
    let list = asking.feed(&all).await.map(|page| format!("a list of {} records", page.entries.len()));
    let record = asking.fetch(&known).await.map(|record| format!("a record of {} bytes", record.blob.len()));
    for (what, answer) in [("Feed", list), ("Records", record)] {
        parts.answered(what, answer, &[Code::NotRegistered]);
    }
    judge("read_with_replaced_keys", parts.outcome());
}
