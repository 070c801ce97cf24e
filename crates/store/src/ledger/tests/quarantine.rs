//! Quarantined records: kept from the chain until they are released, and always counted.

use super::*;
use RecordState::{Dropped, Mined, Quarantined, Tampered};

fn held(seq: u64, copy: bool) -> NewRecord {
    NewRecord { state: Quarantined, blob: copy.then(|| vec![1, 2]), ..record(1, 1, seq) }
}

fn hold(record: &NewRecord) -> Hold {
    Hold { digest: record.digest, reason: "new", publisher: "/evil@h:a/B:0".to_owned() }
}

fn all() -> HeldQuery {
    HeldQuery { limit: 100, decided: true, ..HeldQuery::default() }
}

#[test]
fn held_records_are_neither_batched_nor_submitted_nor_moved_by_a_worker() {
    let (_home, ledger) = open();
    let (good, bad) = (record(1, 1, 1), held(2, false));
    ledger.quarantine.append_held(vec![good.clone(), bad.clone()], vec![hold(&bad)]).expect("acknowledged");
    let owner = Address([1; 20]);
    let leaves = ledger.batches.stored_leaves(owner, 10).expect("leaves");
    assert_eq!(leaves.iter().map(|leaf| leaf.digest).collect::<Vec<_>>(), [good.digest]);
    assert_eq!(ledger.batches.unbatched(owner).expect("read").0, 1);
    let batch = NewBatch { owner, root: Hash([1; 32]), leaves: vec![(bad.digest, Vec::new())] };
    assert!(matches!(ledger.batches.close(batch), Err(StoreError::NotReady { .. })));
    assert!(matches!(ledger.lanes.submit(transaction(1, &[bad.digest])), Err(StoreError::NotReady { .. })));
    assert!(matches!(ledger.records.advance(&[bad.digest], Quarantined, Stored), Err(StoreError::IllegalEdge { .. })));
    assert_eq!(ledger.batches.mined(&[sighting(&bad, 3)]), Ok(0));
    assert_eq!((state_of(&ledger, &bad), ledger.batches.mined(&[sighting(&good, 3)])), (Quarantined, Ok(1)));
    assert_eq!(state_of(&ledger, &good), Mined);
    let counts = ledger.counts.by_state(None).expect("counts");
    let topic = &counts.topics[0];
    assert_eq!((topic.captured, topic.quarantined, topic.pending), (2, 1, 1));
    // Found damaged, it is never released.
    assert_eq!(ledger.records.advance(&[bad.digest], Quarantined, Tampered), Ok(1));
    assert_eq!(ledger.quarantine.release(&[bad.digest]), Ok(0));
}

#[test]
fn released_ones_go_on_and_discarded_ones_never() {
    let (home, ledger) = open();
    let records = [held(1, false), held(2, true), held(3, true), held(4, false)];
    let holds = records.iter().map(hold).collect();
    ledger.quarantine.append_held(records.to_vec(), holds).expect("acknowledged");
    let [stored, whole, gone, left] = records.each_ref().map(|record| record.digest);
    assert_eq!((ledger.quarantine.release(&[stored, whole]), ledger.quarantine.release(&[stored])), (Ok(2), Ok(0)));
    assert_eq!((ledger.quarantine.discard(&[gone]), ledger.quarantine.discard(&[gone, stored])), (Ok(1), Ok(0)));
    let states: Vec<_> = records.iter().map(|record| state_of(&ledger, record)).collect();
    assert_eq!(states, [Stored, Stored, Dropped, Quarantined]);
    assert_eq!(ledger.quarantine.release(&[gone]), Ok(0));
    let counts = ledger.counts.by_state(None).expect("counts");
    let topic = &counts.topics[0];
    assert_eq!((topic.captured, topic.pending, topic.quarantined, topic.dropped), (4, 2, 1, 1));
    let undecided = HeldQuery { decided: false, ..all() };
    let open: Vec<_> = ledger.quarantine.held(Address([1; 20]), &undecided).expect("held");
    assert_eq!(open.iter().map(|row| row.record.digest).collect::<Vec<_>>(), [left]);
    let definition = NewRecord { kind: RecordKind::Definition, ..held(5, false) };
    ledger.quarantine.append_held(vec![definition.clone()], vec![hold(&definition)]).expect("acknowledged");
    let messages = HeldQuery { messages: true, ..undecided.clone() };
    let count = |query: &HeldQuery| ledger.quarantine.held(Address([1; 20]), query).expect("held").len();
    assert_eq!((count(&messages), count(&undecided), ledger.quarantine.release(&[definition.digest])), (1, 2, Ok(1)));
    assert!(ledger.quarantine.held(Address([2; 20]), &all()).expect("held").is_empty());
    let order = |newest_first: bool| {
        let rows = ledger.quarantine.held(Address([1; 20]), &HeldQuery { newest_first, ..all() }).expect("held");
        rows.into_iter().map(|row| row.record.digest).collect::<Vec<_>>()
    };
    assert_eq!(order(true), order(false).into_iter().rev().collect::<Vec<_>>());
    // It survives the process.
    ledger.close().expect("closed");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
    let decisions: Vec<_> =
        ledger.quarantine.held(Address([1; 20]), &all()).expect("held").into_iter().map(|row| row.decision).collect();
    assert_eq!(
        decisions,
        [Some("released".into()), Some("released".into()), Some("discarded".into()), None, Some("released".into())]
    );
}

#[test]
fn a_hold_comes_with_its_record_or_not_at_all() {
    let (_home, ledger) = open();
    let (good, bad) = (record(1, 1, 1), held(2, false));
    let wrong = ledger.quarantine.append_held(vec![good.clone(), bad.clone()], vec![hold(&good)]);
    assert!(matches!(wrong, Err(StoreError::NotReady { .. })), "{wrong:?}");
    assert_eq!(ledger.records.find(bad.digest), Ok(None), "all or none");
    for _ in 0..2 {
        ledger.quarantine.append_held(vec![bad.clone()], vec![hold(&bad)]).expect("idempotent");
    }
    assert_eq!(ledger.quarantine.held(Address([1; 20]), &all()).expect("held").len(), 1);
}

#[test]
fn a_report_counts_each_record_once() {
    let (_home, ledger) = open();
    let records = [held(1, false), held(2, false)];
    ledger.quarantine.append_held(records.to_vec(), records.iter().map(hold).collect()).expect("acknowledged");
    let due = ledger.quarantine.unreported(Address([1; 20]), 1).expect("read").expect("due");
    assert_eq!((due.minute, due.topic.as_str()), (0, "/robot1/odom"));
    assert_eq!(due.records, records.each_ref().map(|record| (record.seq, record.digest)));
    assert_eq!(ledger.quarantine.unreported(Address([1; 20]), 0), Ok(None), "its minute is not over");
    let report = NewRecord { kind: RecordKind::Quarantine, ..record(1, 9, 1) };
    ledger.quarantine.report(report.clone(), vec![records[0].digest]).expect("kept");
    let twice = ledger
        .quarantine
        .report(NewRecord { kind: RecordKind::Quarantine, ..record(1, 9, 2) }, vec![records[0].digest]);
    assert!(matches!(twice, Err(StoreError::NotReady { .. })));
    assert_eq!(ledger.records.find(record(1, 9, 2).digest), Ok(None), "all or none");
    let due = ledger.quarantine.unreported(Address([1; 20]), 1).expect("read").expect("due");
    assert_eq!(due.records, [(2, records[1].digest)]);
}
