//! Losses: counted once, reported once, and those between reading and reporting are reported next.

use super::*;

const OWNER: Address = Address([1; 20]);

fn report(seq: u64) -> NewRecord {
    NewRecord { kind: RecordKind::Gap, ..record(1, 1, seq) }
}

#[test]
fn losses_are_merged_until_a_gap_record_tells_of_them() {
    let (_home, ledger) = open();
    let later =
        |numbers| Loss { numbers, first_at: Timestamp(7), last_at: Timestamp(8), ..loss(LossReason::Memory, 4) };
    ledger.losses.count(vec![Loss { numbers: None, ..loss(LossReason::Memory, 3) }]).expect("counted");
    ledger.losses.count(vec![later(Some((20, 24))), loss(LossReason::Transport, 2)]).expect("counted");
    let open = |by| ledger.losses.open_gaps(OWNER, Timestamp(by), 1).expect("read").pop();
    assert_eq!(open(4), None, "not begun by then");
    let gap = open(5).expect("open");
    assert_eq!((gap.count, gap.numbers, gap.first_at, gap.last_at), (7, Some((20, 24)), Timestamp(5), Timestamp(8)));
    assert_eq!((gap.reason.as_str(), gap.report), ("memory full", None));

    ledger.losses.count(vec![later(Some((30, 31)))]).expect("counted");
    ledger.losses.close_gap(&gap, report(1)).expect("told");
    let again = ledger.losses.close_gap(&gap, report(2));
    assert!(matches!(again, Err(StoreError::NotReady { .. })), "{again:?}");
    assert_eq!(ledger.records.find(report(2).digest), Ok(None), "nothing of a refused telling stays");
    let rest: Vec<_> = std::iter::from_fn(|| {
        let gap = open(9)?;
        ledger.losses.close_gap(&gap, report(10 + gap.count)).expect("told");
        Some((gap.reason, gap.count))
    })
    .collect();
    assert_eq!(rest, [("transport".to_owned(), 2), ("memory full".to_owned(), 4)]);
    let gaps = ledger.losses.gaps(OWNER, 9).expect("read");
    assert_eq!(gaps.iter().map(|gap| gap.count).sum::<u64>(), 13);
    assert!(gaps.iter().all(|gap| gap.report.is_some()));
    assert_eq!(ledger.losses.open_gaps(Address([2; 20]), Timestamp(9), 9), Ok(Vec::new()));
}

#[test]
fn captured_is_counted_by_itself_and_held_against_the_states() {
    let (_home, ledger) = open();
    ledger.records.append((1..=4).map(|seq| record(1, 1, seq)).collect()).expect("acknowledged");
    ledger.records.append(vec![record(1, 1, 1), report(9)]).expect("known, and no message");
    ledger.losses.count(vec![loss(LossReason::Disk, 3), loss(LossReason::Transport, 2)]).expect("counted");
    let counts = ledger.counts.by_state(Some(OWNER)).expect("counts");
    assert_eq!((counts.captured(), counts.acknowledged, counts.lost_in_recorder), (7, 4, 3));
    assert_eq!((counts.lost_in_transport, counts.is_conserved()), (2, true));
    let gone = "UPDATE counters SET records = records - 1 WHERE records > 1";
    ledger.database.write(|session| Ok(session.connection.changed(gone, [])?)).expect("written");
    assert!(!ledger.counts.by_state(None).expect("counts").is_conserved(), "a record that no state counts is noticed");
}
