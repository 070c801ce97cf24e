//! What is left out of an incident's bundle, and that it is said.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::model::{Address, RecordKind, RecorderId, Signature, SignerId, Timestamp, TopicId};

fn row(number: u8, state: RecordState, block: Option<u64>) -> RecordRow {
    let time = Timestamp::from_seconds(u64::from(number));
    RecordRow {
        id: format!("record{number}"),
        digest: Digest([number; 32]),
        owner: Address([1; 20]),
        recorder: RecorderId([2; 16]),
        topic_id: TopicId([3; 16]),
        seq: u64::from(number),
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([4; 32]),
        signature: Signature([5; 64]),
        topic: "/odom".to_owned(),
        type_name: "a/B".to_owned(),
        bytes: 9,
        captured_at: time,
        acknowledged_at: time,
        simulated: false,
        state,
        transaction: None,
        block,
        block_hash: None,
        deleted_at: None,
    }
}

fn incident(open: bool) -> IncidentView {
    IncidentView {
        name: "crash".parse().expect("a name"),
        open,
        since: Timestamp::from_seconds(1),
        until: None,
        opened_at: Timestamp::from_seconds(1),
        closed_at: None,
        topics: Vec::new(),
        notes: Vec::new(),
        records: 0,
        bytes: 0,
        coverage: Vec::new(),
    }
}

#[test]
fn an_open_incident_leaves_out_what_is_not_anchored_and_says_how_much() {
    let all = || {
        vec![
            row(1, RecordState::Verified, Some(7)),
            row(2, RecordState::Batched, None),
            row(3, RecordState::Submitted, None),
            row(4, RecordState::Captured, None),
            RecordRow { deleted_at: Some(Timestamp::from_seconds(9)), ..row(5, RecordState::Verified, Some(7)) },
            row(6, RecordState::Mined, Some(8)),
            row(7, RecordState::RightEnded, None),
        ]
    };
    let left = |open: bool, named: &[&str]| {
        let mut rows = all();
        let named: Vec<String> = named.iter().map(|id| (*id).to_owned()).collect();
        let notes = leave_out(&mut rows, &incident(open), &named);
        (rows.iter().map(|row| row.seq).collect::<Vec<_>>(), notes)
    };
    let (kept, notes) = left(true, &[]);
    assert_eq!(kept, [1, 6]);
    let [deleted, early, unanchored] = notes.as_slice() else { panic!("three notes: {notes:?}") };
    assert!(deleted.starts_with("1 records") && deleted.contains("retention"), "{deleted}");
    assert!(early.starts_with("1 records") && early.contains("not stored yet"), "{early}");
    assert!(unanchored.starts_with("3 records") && unanchored.contains("not anchored yet and are left out"));
    // A closed one is exported as it is; and what is named is wanted in any case.
    assert_eq!(left(false, &[]).0, [1, 2, 3, 6, 7]);
    assert_eq!(left(true, &["record3"]).0, [1, 3, 6]);
}
