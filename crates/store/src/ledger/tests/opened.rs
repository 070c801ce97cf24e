//! What a grant of some epochs opens.

use super::*;
use RecordState::Quarantined;
use std::ops::RangeInclusive;

const OWNER: Address = Address([1; 20]);

fn sealed(topic: u8, epoch: u64, seq: u64) -> NewRecord {
    NewRecord { epoch, ..record(1, topic, seq) }
}

fn within(topic: Option<u8>, epochs: RangeInclusive<u64>, since: u64) -> SealedQuery {
    let topic = topic.map(|topic| TopicId([topic; 16]));
    SealedQuery { owner: OWNER, topic, epochs, since: Timestamp(since) }
}

#[test]
fn epochs_have_what_was_sealed_under_their_keys_by_topic() {
    let (_home, ledger) = open();
    let definition = NewRecord { kind: RecordKind::Definition, ..sealed(1, 1, 1) };
    let records = vec![definition, sealed(1, 1, 2), sealed(1, 1, 3), sealed(2, 2, 1), sealed(1, 3, 4), record(2, 3, 9)];
    ledger.records.append(records).expect("acknowledged");
    let opened = |topic: Option<u8>, epochs| ledger.counts.opened_by(&within(topic, epochs, 0));
    let at = |seq: u64| Some(Timestamp(1_000 + seq));
    assert_eq!((opened(None, 1..=3), opened(None, 4..=9)), (Ok((4, at(1))), Ok((0, None))));
    assert_eq!((opened(Some(1), 1..=2), opened(Some(2), 1..=3)), (Ok((2, at(2))), Ok((1, at(1)))));
    let first = |topic, since| ledger.counts.first_epoch(&within(topic, 1..=3, since));
    assert_eq!([first(None, 0), first(None, 1_004), first(None, 1_005)], [Ok(Some(1)), Ok(Some(3)), Ok(None)]);
    assert_eq!([first(Some(2), 0), first(Some(2), 1_002)], [Ok(Some(2)), Ok(None)], "another topic does not count");
    // A late record of a robot that was out of reach.
    ledger.records.append(vec![sealed(1, 1, 90)]).expect("acknowledged");
    assert_eq!((opened(Some(1), 1..=1), first(None, 1_090)), (Ok((3, at(2))), Ok(Some(1))));
}

#[test]
fn a_clock_ahead_counts_as_the_arrival() {
    let (_home, ledger) = open();
    let ahead = Timestamp(Timestamp::now().0 + 86_400_000_000_000);
    let before = Timestamp::now();
    ledger.records.append(vec![NewRecord { captured_at: ahead, ..sealed(1, 1, 1) }]).expect("acknowledged");
    let (records, since) = ledger.counts.opened_by(&within(None, 1..=1, 0)).expect("counted");
    let since = since.expect("a record");
    assert!(records == 1 && before <= since && since <= Timestamp::now(), "{since}");
    let later = Timestamp::now().0 + 3_600_000_000_000;
    assert_eq!(ledger.counts.first_epoch(&within(None, 1..=1, later)), Ok(None), "it does not reach into tomorrow");
    assert_eq!(ledger.inspection.contradictions(), Ok(Vec::new()));
}

#[test]
fn what_no_reader_may_have_is_not_counted_and_uses_its_epoch_all_the_same() {
    let (_home, ledger) = open();
    let held = NewRecord { state: Quarantined, ..sealed(1, 2, 2) };
    let hold = Hold { digest: held.digest, reason: "new", publisher: "/evil@h:a/B:0".to_owned() };
    ledger.quarantine.append_held(vec![sealed(1, 1, 1), held.clone()], vec![hold]).expect("acknowledged");
    let records = |epoch| ledger.counts.opened_by(&within(None, epoch..=epoch, 0)).map(|(records, _)| records);
    assert_eq!((records(1), records(2)), (Ok(1), Ok(0)));
    assert_eq!((ledger.counts.is_epoch_used(OWNER, 2), ledger.counts.is_epoch_used(OWNER, 3)), (Ok(true), Ok(false)));
    assert_eq!(ledger.quarantine.release(&[held.digest]), Ok(1));
    assert_eq!((records(1), records(2)), (Ok(1), Ok(1)));
    // Notices to robots are sealed under keys of their own.
    ledger.records.append(vec![NewRecord { kind: RecordKind::Key, ..sealed(3, 3, 3) }]).expect("acknowledged");
    assert_eq!(ledger.counts.is_epoch_used(OWNER, 3), Ok(false));
}

server::on_a_server! {
    epochs_have_what_was_sealed_under_their_keys_by_topic, a_clock_ahead_counts_as_the_arrival,
}
