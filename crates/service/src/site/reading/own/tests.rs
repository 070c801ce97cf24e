//! Where a record comes from, as it is told.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::model::{Digest, Hash, RecordKind, Signature, SignerId};
use crate::site::testing::Ground;
use crate::store::{NewBatch, NewRecord, RootSighting, Sighting};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_record_uploaded_alone_after_its_batch_names_one_anchor_only() {
    let ground = Ground::with(&[]);
    let ledger = &ground.parts.plant.ledger;
    let (owner, digest) = (Address([1; 20]), Digest([2; 32]));
    let record = NewRecord {
        digest,
        owner,
        topic_id: TopicId([3; 16]),
        seq: 1,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([4; 32]),
        signature: Signature([5; 64]),
        filters: Vec::new(),
        topic: "/odom".to_owned(),
        type_name: "a/B".to_owned(),
        bytes: 9,
        captured_at: Timestamp::from_seconds(10),
        simulated: false,
        state: RecordState::Stored,
        blob: None,
    };
    ledger.records.append(vec![record]).expect("acknowledged");
    let root = ledger.records.find(digest).expect("read").expect("there").leaf().hash();
    ledger.batches.close(NewBatch { owner, root, leaves: vec![(digest, Vec::new())] }).expect("closed");
    let (of_batch, alone) = (Hash([6; 32]), Hash([7; 32]));
    let seen =
        RootSighting { account: owner, root, count: 1, transaction: of_batch, block: 5, block_hash: Hash([15; 32]) };
    assert_eq!(ledger.batches.anchored(&[seen]), Ok(1));
    let told = || {
        let placed = ledger.records.placed(digest).expect("read").expect("there");
        anchor_steps(placed, 10, 3)
    };
    let words = |steps: &[(String, String)]| steps.iter().map(|(word, _)| word.clone()).collect::<Vec<_>>();
    let steps = told();
    assert_eq!(words(&steps), ["batch", "proof", "anchored by", "transaction", "block", "confirmations"]);
    assert_eq!(steps[3].1, of_batch.to_string());
    assert_eq!(steps[5].1, "6, of which 3 required");

    let sighting = Sighting { owner, digest, transaction: alone, block: 9, block_hash: Hash([19; 32]) };
    assert_eq!(ledger.batches.mined(&[sighting]), Ok(1));
    let steps = told();
    assert_eq!(words(&steps), ["transaction", "block", "confirmations"], "its batch is in another block");
    assert_eq!(steps[0].1, alone.to_string());
    assert_eq!(steps[2].1, "2, of which 3 required");
}
