//! Numbers: each belongs to the key that signs, and nothing from elsewhere is among the ledger's own.

use super::*;
use crate::model::RecorderPrefix;

const OWNER: Address = Address([1; 20]);
const TOPIC: TopicId = TopicId([1; 16]);
const OWN: SignerId = SignerId([1; 32]);
const ROBOT: SignerId = SignerId([77; 32]);
const LAST: u64 = 1 << 40;

fn from(recorder: RecorderId, signer: SignerId, seq: u64) -> NewRecord {
    let mut digest = [signer.0[0]; 32];
    digest[..8].copy_from_slice(&seq.to_be_bytes());
    let foreign = Some(Foreign { recorder, keeper: Address([9; 20]) });
    NewRecord { digest: Digest(digest), foreign, signer, seq, ..record(1, 1, seq % 1_000) }
}

fn refused(ledger: &Ledger, record: &NewRecord) {
    let answer = ledger.records.append(vec![record.clone()]);
    assert!(matches!(answer, Err(StoreError::Conflict { .. })), "{answer:?}: {record:?}");
}

#[test]
fn nothing_from_elsewhere_moves_or_blocks_the_ledgers_own_numbers() {
    let (_home, ledger) = open();
    ledger.records.append(vec![record(1, 1, 1)]).expect("acknowledged");
    let recorder = ledger.records.recorder().of_signer(&OWN);
    for (recorder, signer) in [(recorder, OWN), (recorder, ROBOT), (ledger.records.recorder().of_signer(&ROBOT), ROBOT)]
    {
        for seq in [2, 9, LAST - 1, LAST] {
            refused(&ledger, &from(recorder, signer, seq));
        }
    }
    let elsewhere = RecorderPrefix::ledger([5; 7]).of_signer(&ROBOT);
    ledger.records.append(vec![from(elsewhere, ROBOT, 2), from(elsewhere, ROBOT, LAST)]).expect("its own numbers");
    assert_eq!(ledger.records.next_seq(OWNER, OWN, TOPIC), Ok(2));
    ledger.records.append(vec![record(1, 1, 2)]).expect("nothing is in the way");
    // One id, two keys: two histories of two keys, and no contradiction.
    ledger.records.append(vec![from(elsewhere, OWN, 2)]).expect("another key's");
    assert_eq!(
        ledger.inspection.holder(OWNER, (ROBOT, elsewhere), TOPIC, 2),
        Ok(Some(from(elsewhere, ROBOT, 2).digest))
    );
    refused(&ledger, &NewRecord { digest: Digest([6; 32]), ..from(elsewhere, ROBOT, 2) });
    assert_eq!(ledger.records.next_seq(OWNER, OWN, TOPIC), Ok(3));
    let back = NewRecord { foreign: Some(Foreign { recorder, keeper: Address([9; 20]) }), ..record(1, 1, 1) };
    ledger.records.append(vec![back]).expect("its own record that came back is known");
    assert_eq!(ledger.inspection.contradictions().expect("looked"), Vec::<String>::new());
}

#[test]
fn a_number_out_of_bounds_is_refused() {
    let (_home, ledger) = open();
    let elsewhere = RecorderPrefix::ledger([5; 7]).of_signer(&ROBOT);
    for seq in [0, LAST + 1, i64::MAX.cast_unsigned(), u64::MAX] {
        refused(&ledger, &from(elsewhere, ROBOT, seq));
        let own = ledger.records.append(vec![NewRecord { seq, ..record(1, 1, 1) }]);
        assert!(matches!(own, Err(StoreError::Conflict { .. })), "{seq}: {own:?}");
    }
    assert_eq!(ledger.inspection.size(), Ok(0));
}

#[test]
fn a_new_key_numbers_anew_and_its_recorder_follows_that_of_the_key_before() {
    let (_home, ledger) = open();
    ledger.records.append(vec![record(1, 1, 1), record(1, 1, 2)]).expect("acknowledged");
    let next = SignerId([2; 32]);
    assert_eq!(ledger.records.next_seq(OWNER, next, TOPIC), Ok(1));
    let before = Some(ledger.records.recorder().of_signer(&OWN));
    assert_eq!(ledger.counts.predecessor(OWNER, next), Ok(before));
    ledger
        .records
        .append(vec![NewRecord { signer: next, digest: Digest([8; 32]), ..record(1, 1, 1) }])
        .expect("acknowledged");
    assert_eq!((ledger.counts.predecessor(OWNER, next), ledger.counts.predecessor(OWNER, OWN)), (Ok(before), Ok(None)));
    assert_eq!(ledger.counts.heights(OWNER, next, ["", ""]), Ok(vec![(TOPIC, 1)]));
    assert_eq!(ledger.counts.heights(OWNER, OWN, ["", ""]), Ok(vec![(TOPIC, 2)]));
    let newest = ledger.counts.newest_of(OWNER, OWN).expect("read").expect("there");
    assert_eq!((newest.epoch, newest.captured_at), (1, Timestamp(1_002)));
}

server::on_a_server! {
    nothing_from_elsewhere_moves_or_blocks_the_ledgers_own_numbers, a_number_out_of_bounds_is_refused, a_new_key_numbers_anew_and_its_recorder_follows_that_of_the_key_before,
}
