//! The record of the tests that need nothing special.

use crate::NewRecord;
use crate::model::{Address, Digest, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId};

/// A stored record of owner 1 that is this number in all.
pub(in super::super) fn numbered(number: u8) -> NewRecord {
    NewRecord {
        digest: Digest([number; 32]),
        owner: Address([1; 20]),
        topic_id: TopicId([2; 16]),
        seq: u64::from(number),
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([3; 32]),
        signature: Signature([4; 64]),
        filters: Vec::new(),
        topic: "/a".to_owned(),
        type_name: "a/B".to_owned(),
        bytes: 1,
        captured_at: Timestamp(u64::from(number)),
        simulated: false,
        state: RecordState::Stored,
        blob: None,
    }
}
