//! A record as a gateway reports it: entry, standing, proof.

use crate::chain::AnchorProof;
use crate::gateway::{Entry, Standing};
use crate::model::RecordState;
use crate::store::{BatchPlace, RecordRow};

/// The standing of a record in this state.
pub(super) fn standing(state: RecordState) -> Standing {
    match state {
        RecordState::Captured | RecordState::Dropped => Standing::Unknown,
        RecordState::Sealed
        | RecordState::Stored
        | RecordState::Batched
        | RecordState::Submitted
        | RecordState::RightEnded => Standing::Acknowledged,
        RecordState::Mined | RecordState::Confirmed => Standing::Anchored,
        RecordState::Verified => Standing::Verified,
        RecordState::Tampered => Standing::Tampered,
        RecordState::Quarantined => Standing::Quarantined,
    }
}

/// A record's entry in a list.
pub(super) fn entry(row: &RecordRow) -> Entry {
    Entry {
        digest: row.digest,
        owner: row.owner,
        recorder: row.recorder,
        seq: row.seq,
        topic_id: row.topic_id,
        epoch: row.epoch,
        captured_at: row.captured_at,
        length: row.bytes,
        kind: row.kind,
        standing: standing(row.state),
    }
}

/// The record's place on the chain; `None` before it is in a block.
pub(super) fn proof(row: &RecordRow, place: Option<BatchPlace>) -> Option<AnchorProof> {
    let (transaction, block, block_hash) = (row.transaction?, row.block?, row.block_hash?);
    match place {
        Some(place) => {
            let account = place.account?;
            Some(AnchorProof { account, transaction, block, block_hash, inclusion: Some(place.inclusion) })
        }
        None => Some(AnchorProof { account: row.owner, transaction, block, block_hash, inclusion: None }),
    }
}
