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
    assert!(deleted.starts_with("1 record of") && deleted.contains("retention"), "{deleted}");
    assert!(early.starts_with("1 record of") && early.contains("not stored yet"), "{early}");
    assert!(unanchored.starts_with("3 records") && unanchored.contains("left out: not anchored yet"));
    // A closed one is exported as it is; and what is named is wanted in any case.
    assert_eq!(left(false, &[]).0, [1, 2, 3, 6, 7]);
    assert_eq!(left(true, &["record3"]).0, [1, 3, 6]);
}

#[test]
fn a_pattern_discloses_chosen_messages_and_their_definitions_and_nothing_that_a_site_says_of_itself() {
    let of = |number: u8, topic: &str, kind: RecordKind| RecordRow {
        topic: topic.to_owned(),
        kind,
        ..row(number, RecordState::Verified, Some(7))
    };
    let rows = [
        of(1, "/robot1/odom", RecordKind::Definition),
        of(2, "/robot1/odom", RecordKind::Data),
        of(3, "/robot2/odom", RecordKind::Data),
        of(4, "/robot2/scan", RecordKind::Data),
        of(5, "authros/recorder", RecordKind::Audit),
        of(6, "/robot1/odom", RecordKind::Gap),
        of(7, "authros/attachments", RecordKind::Attachment),
    ];
    let disclosed = |wishes: &EvidenceWishes| -> Result<Vec<u64>, String> {
        let found = of_topics(&rows, wishes).map_err(|failure| failure.message)?;
        Ok(found.values().flatten().map(|row| row.seq).collect::<Vec<_>>())
    };
    let patterns = |patterns: &[&str]| EvidenceWishes {
        reveal_topics: patterns.iter().map(|one| one.parse().expect("a pattern")).collect(),
        ..EvidenceWishes::default()
    };
    assert_eq!(disclosed(&patterns(&[])), Ok(Vec::new()));
    assert_eq!(disclosed(&patterns(&["/robot?/odom"])), Ok(vec![1, 2, 3]));
    assert_eq!(disclosed(&patterns(&["/robot1/**", "/robot2/scan"])), Ok(vec![1, 2, 4]));
    assert_eq!(disclosed(&patterns(&["**"])), Ok(vec![1, 2, 3, 4, 7]));
    let all = EvidenceWishes { reveal_all: true, ..EvidenceWishes::default() };
    assert_eq!(disclosed(&all), Ok(vec![1, 2, 3, 4, 7]));
    let unmet = disclosed(&patterns(&["/robot1/*", "/robot3/*"]));
    assert!(unmet.is_err_and(|why| why.contains("matches /robot3/*; nothing is disclosed")));
    let reveal = BTreeSet::from([1, 2, 3].map(|number| Digest([number; 32])));
    let told: Vec<(String, u64)> =
        disclosed_topics(&rows, &reveal).into_iter().map(|one| (one.topic, one.records)).collect();
    assert_eq!(told, [("/robot1/odom".to_owned(), 2), ("/robot2/odom".to_owned(), 1)]);
}
