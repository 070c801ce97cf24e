//! A record as a gateway reports it: entry and standing.

use crate::gateway::{Entry, Standing};
use crate::model::RecordState;
use crate::store::RecordRow;

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
