//! The legal state transitions of a record, and which part of the program may make each.

use crate::model::RecordState::{
    self, Batched, Confirmed, Dropped, Mined, Quarantined, RightEnded, Sealed, Stored, Submitted, Tampered, Verified,
};

/// The cause of a transition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum By {
    /// A worker, with `advance`.
    Worker,
    /// The anchorer closes a batch.
    Batch,
    /// The sender signs a transaction.
    Submit,
    /// The sender's transaction failed or was replaced.
    Close,
    /// The watcher found the anchor in a block.
    Sight,
    /// The block is deep enough.
    Confirm,
    /// The block was replaced.
    Reorg,
    /// A gateway took the record over, or reported its standing.
    Gateway,
    /// The operator decides about a quarantined record.
    Operator,
    /// The signer's right ended or returned, or its anchor does not count for lack of it.
    Right,
}

const EDGES: [(RecordState, RecordState, By); 52] = [
    (Sealed, Stored, By::Worker),
    (Sealed, Quarantined, By::Worker),
    (Stored, Quarantined, By::Worker),
    (Stored, Batched, By::Batch),
    (Confirmed, Verified, By::Worker),
    (Sealed, Tampered, By::Worker),
    (Stored, Tampered, By::Worker),
    (Batched, Tampered, By::Worker),
    (Submitted, Tampered, By::Worker),
    (Mined, Tampered, By::Worker),
    (Confirmed, Tampered, By::Worker),
    (Verified, Tampered, By::Worker),
    (Quarantined, Tampered, By::Worker),
    (Tampered, Quarantined, By::Worker),
    (Quarantined, Stored, By::Operator),
    (Quarantined, Sealed, By::Operator),
    (Quarantined, Dropped, By::Operator),
    (Tampered, Stored, By::Worker),
    (Tampered, Batched, By::Worker),
    (Tampered, Submitted, By::Worker),
    (Tampered, Mined, By::Worker),
    (Tampered, Confirmed, By::Worker),
    (Stored, Submitted, By::Submit),
    (Batched, Submitted, By::Submit),
    (Submitted, Stored, By::Close),
    (Submitted, Batched, By::Close),
    (Sealed, Mined, By::Sight),
    (Stored, Mined, By::Sight),
    (Batched, Mined, By::Sight),
    (Submitted, Mined, By::Sight),
    (Mined, Confirmed, By::Confirm),
    (Mined, Submitted, By::Reorg),
    (Mined, Batched, By::Reorg),
    (Mined, Stored, By::Reorg),
    (Confirmed, Mined, By::Reorg),
    (Confirmed, Submitted, By::Reorg),
    (Confirmed, Batched, By::Reorg),
    (Confirmed, Stored, By::Reorg),
    (Verified, Mined, By::Reorg),
    (Verified, Submitted, By::Reorg),
    (Verified, Batched, By::Reorg),
    (Verified, Stored, By::Reorg),
    (Stored, Submitted, By::Gateway),
    (Submitted, Stored, By::Gateway),
    (Submitted, Verified, By::Gateway),
    (Submitted, Tampered, By::Gateway),
    (Stored, RightEnded, By::Right),
    (Batched, Stored, By::Right),
    (Confirmed, Stored, By::Right),
    (RightEnded, Stored, By::Right),
    (RightEnded, Mined, By::Sight),
    (RightEnded, Tampered, By::Worker),
];

/// Whether a record may ever go from one state to another in one step.
pub fn is_legal(from: RecordState, to: RecordState) -> bool {
    EDGES.iter().any(|edge| (edge.0, edge.1) == (from, to))
}

/// Whether `by` may make this transition.
pub(super) fn may(by: By, from: RecordState, to: RecordState) -> bool {
    EDGES.contains(&(from, to, by))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_distinct_and_leave_no_state_stuck() {
        for (index, edge) in EDGES.iter().enumerate() {
            assert!(!EDGES[..index].contains(edge), "{edge:?}");
            assert_ne!(edge.0, edge.1);
        }
        for state in [Sealed, Stored, Batched, Submitted, Mined, Confirmed] {
            assert!(EDGES.iter().any(|edge| edge.0 == state && edge.1 > state && edge.1 <= Verified), "{state:?}");
        }
    }

    #[test]
    fn nobody_verifies_by_leaping() {
        for state in RecordState::ALL {
            assert_eq!(is_legal(state, Verified), matches!(state, Confirmed | Submitted));
            assert_eq!(may(By::Gateway, state, Verified), state == Submitted);
            assert_eq!(may(By::Worker, state, Verified), state == Confirmed);
        }
        assert!(!may(By::Worker, Quarantined, Stored) && !is_legal(Quarantined, Batched) && !is_legal(Dropped, Stored));
        assert!(!is_legal(RightEnded, Batched) && !is_legal(RightEnded, Submitted), "nobody here anchors it");
        assert!(!may(By::Worker, Stored, Submitted) && !may(By::Worker, Submitted, Mined));
    }
}
