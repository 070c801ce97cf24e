//! Records that wait for a right, and anchors that do not count.

use super::*;
use crate::model::RecordState::{Batched, Mined, RightEnded};

const OWNER: Address = Address([1; 20]);
const SIGNER: SignerId = SignerId([1; 32]);

fn batch(ledger: &Ledger, root: u8, records: &[NewRecord]) {
    let leaves = records.iter().map(|record| (record.digest, vec![Hash([root; 32])])).collect();
    ledger.batches.close(NewBatch { owner: OWNER, root: Hash([root; 32]), leaves }).expect("closed");
}

fn anchored(ledger: &Ledger, root: u8, count: u64, block: u64) -> u64 {
    let (root, transaction, block_hash) = (Hash([root; 32]), Hash([90; 32]), Hash([91; 32]));
    let sighting = RootSighting { account: OWNER, root, count, transaction, block, block_hash };
    ledger.batches.anchored(&[sighting]).expect("seen")
}

/// Whether the chain has this record in a block that does not count.
fn was_passed_over(ledger: &Ledger, digest: Digest) -> Result<bool, StoreError> {
    let sql = "SELECT 1 FROM passed_over JOIN records ON n = record WHERE digest = ?1";
    ledger.database.read(|connection| Ok(connection.has(sql, [digest.0])?))
}

fn states(ledger: &Ledger, records: &[NewRecord]) -> Vec<RecordState> {
    assert!(ledger.counts.by_state(None).expect("counts").is_conserved());
    assert_eq!(ledger.inspection.contradictions(), Ok(Vec::new()));
    for batch in ledger.inspection.audit_batches(0, 9).expect("batches") {
        assert_eq!(batch.held, batch.count, "no place of a batch is lost");
    }
    records.iter().map(|record| state_of(ledger, record)).collect()
}

#[test]
fn a_signer_without_the_right_is_held_out_of_batches_and_let_go_again() {
    let (home, ledger) = open();
    let other = NewRecord { signer: SignerId([2; 32]), ..record(1, 2, 1) };
    let records = [record(1, 1, 1), record(1, 1, 2), other, record(1, 1, 3)];
    ledger.records.append(records.to_vec()).expect("acknowledged");
    batch(&ledger, 50, &records[..3]);
    let all = ledger.batches.waiting_signers(OWNER).expect("read");
    assert_eq!(all.len(), 2);
    assert!(all.iter().all(|waiting| waiting.ready && !waiting.held && waiting.owner == OWNER), "{all:?}");
    assert_eq!(ledger.batches.waiting_signers(Address([9; 20])), Ok(Vec::new()), "another's");
    assert_eq!(ledger.batches.hold_signer(OWNER, Address([2; 20]), SIGNER), Ok(0), "of another owner");
    assert_eq!(ledger.batches.hold_signer(OWNER, OWNER, SIGNER), Ok(3));
    assert_eq!(states(&ledger, &records), [RightEnded, RightEnded, Stored, RightEnded]);
    assert_eq!(ledger.batches.waiting(OWNER, 9), Ok(Vec::new()), "it fell apart");
    assert_eq!(ledger.batches.unbatched(OWNER).map(|(count, _)| count), Ok(1));
    let held =
        ledger.batches.waiting_signers(OWNER).expect("read").into_iter().find(|waiting| waiting.signer == SIGNER);
    assert!(held.is_some_and(|held| held.held && !held.ready));
    let counts = ledger.counts.by_state(Some(OWNER)).expect("counts");
    assert_eq!((counts.pending(), counts.data_in(RightEnded), counts.captured()), (1, 3, 4));
    assert_eq!(ledger.inspection.newest_stored(9).map(|found| found.len()), Ok(4), "kept like all others");
    // A restart does not change it, nor does a late root of ours.
    ledger.close().expect("closed");
    let ledger = open_again(&home);
    assert_eq!(anchored(&ledger, 50, 3, 7), 0);
    assert_eq!(ledger.batches.free_signer(OWNER, OWNER, SIGNER), Ok(3));
    assert_eq!(ledger.batches.free_signer(OWNER, OWNER, SIGNER), Ok(0));
    assert_eq!(states(&ledger, &records), [Stored; 4]);
}

#[test]
fn a_batch_that_all_its_records_left_waits_anew_when_it_is_closed_again() {
    let (_home, ledger) = open();
    let records = [record(1, 1, 1), record(1, 1, 2)];
    ledger.records.append(records.to_vec()).expect("acknowledged");
    batch(&ledger, 60, &records);
    assert_eq!(anchored(&ledger, 60, 2, 5), 2);
    assert_eq!(ledger.batches.pass_over(&[records[0].digest]), Ok(0), "not confirmed yet");
    ledger.batches.confirm(5).expect("confirmed");
    assert_eq!(ledger.batches.pass_over(&[records[0].digest]), Ok(1));
    assert_eq!(states(&ledger, &records), [Stored, Confirmed], "its neighbour may have had the right");
    assert_eq!(was_passed_over(&ledger, records[0].digest), Ok(true));
    let row = ledger.records.find(records[0].digest).expect("read").expect("there");
    assert_eq!((row.block, row.transaction, row.block_hash), (None, None, None));
    assert_eq!(ledger.batches.passed_over_leaves(OWNER, 9).map(|leaves| leaves.len()), Ok(1));
    assert_eq!(ledger.batches.pass_over(&[records[1].digest]), Ok(1));
    batch(&ledger, 60, &records);
    assert_eq!(states(&ledger, &records), [Batched, Batched]);
    assert_eq!(ledger.batches.waiting(OWNER, 9).map(|batches| batches.len()), Ok(1));
    assert_eq!(anchored(&ledger, 60, 2, 8), 2);
    assert_eq!(states(&ledger, &records), [Mined, Mined]);
    assert_eq!(
        ledger.records.placed(records[1].digest).map(|placed| placed.and_then(|placed| placed.place?.block)),
        Ok(Some(8))
    );
    // The blocks are replaced: nothing is left to be ignored.
    ledger.batches.take_back(5).expect("taken back");
    assert_eq!(was_passed_over(&ledger, records[0].digest), Ok(false));
    assert_eq!(states(&ledger, &records), [Batched, Batched]);
}

#[test]
fn an_upload_by_itself_is_still_seen_while_the_record_waits() {
    let (_home, ledger) = open();
    let records = [record(1, 1, 1)];
    ledger.records.append(records.to_vec()).expect("acknowledged");
    assert_eq!(ledger.batches.hold_signer(OWNER, OWNER, SIGNER), Ok(1));
    let digest = records[0].digest;
    let early = ledger.lanes.submit(transaction(1, &[digest]));
    assert!(matches!(early, Err(StoreError::NotReady { .. })), "nobody here anchors it: {early:?}");
    assert_eq!(ledger.batches.mined(&[sighting(&records[0], 4)]), Ok(1));
    assert_eq!(states(&ledger, &records), [Mined]);
}

server::on_a_server! {
    a_signer_without_the_right_is_held_out_of_batches_and_let_go_again, a_batch_that_all_its_records_left_waits_anew_when_it_is_closed_again, an_upload_by_itself_is_still_seen_while_the_record_waits,
}
