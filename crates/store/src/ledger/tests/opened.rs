//! What a grant of some epochs opens.

use super::*;
use RecordState::Quarantined;

const OWNER: Address = Address([1; 20]);

fn sealed(topic: u8, epoch: u64, seq: u64) -> NewRecord {
    NewRecord { epoch, ..record(1, topic, seq) }
}

#[test]
fn epochs_have_what_was_sealed_under_their_keys_by_topic() {
    let (_home, ledger) = open();
    let definition = NewRecord { kind: RecordKind::Definition, ..sealed(1, 1, 1) };
    let records = vec![definition, sealed(1, 1, 2), sealed(1, 1, 3), sealed(2, 2, 1), sealed(1, 3, 4), record(2, 3, 9)];
    ledger.records.append(records).expect("acknowledged");
    let one = |topic: u8, epoch, records, first: u64, last: u64| SealedInEpoch {
        topic: TopicId([topic; 16]),
        epoch,
        records,
        first: Timestamp(1_000 + first),
        last: Timestamp(1_000 + last),
    };
    let mut found = ledger.counts.by_epoch(OWNER, 1..=2).expect("counted");
    found.sort_by_key(|one| one.epoch);
    assert_eq!(found, [one(1, 1, 2, 2, 3), one(2, 2, 1, 1, 1)]);
    assert_eq!(ledger.counts.opened_by(OWNER, 1..=3), Ok((4, Some(Timestamp(1_001)))));
    assert_eq!(ledger.counts.opened_by(OWNER, 4..=9), Ok((0, None)));
    // A late record of a robot that was out of reach.
    ledger.records.append(vec![sealed(1, 1, 90)]).expect("acknowledged");
    assert_eq!(ledger.counts.by_epoch(OWNER, 1..=1), Ok(vec![one(1, 1, 3, 2, 90)]));
}

#[test]
fn what_no_reader_may_have_is_not_counted_and_uses_its_epoch_all_the_same() {
    let (_home, ledger) = open();
    let held = NewRecord { state: Quarantined, ..sealed(1, 2, 2) };
    let hold = Hold { digest: held.digest, reason: "new", publisher: "/evil@h:a/B:0".to_owned() };
    ledger.quarantine.append_held(vec![sealed(1, 1, 1), held.clone()], vec![hold]).expect("acknowledged");
    let records = |epoch| ledger.counts.opened_by(OWNER, epoch..=epoch).map(|(records, _)| records);
    assert_eq!((records(1), records(2)), (Ok(1), Ok(0)));
    assert_eq!((ledger.counts.is_epoch_used(OWNER, 2), ledger.counts.is_epoch_used(OWNER, 3)), (Ok(true), Ok(false)));
    assert_eq!(ledger.quarantine.release(&[held.digest]), Ok(1));
    assert_eq!((records(1), records(2)), (Ok(1), Ok(1)));
    // Notices to robots are sealed under keys of their own.
    ledger.records.append(vec![NewRecord { kind: RecordKind::Key, ..sealed(3, 3, 3) }]).expect("acknowledged");
    assert_eq!(ledger.counts.is_epoch_used(OWNER, 3), Ok(false));
}

server::on_a_server! {
    epochs_have_what_was_sealed_under_their_keys_by_topic,
}
