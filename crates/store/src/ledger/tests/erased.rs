//! Erasing: who and why stay with the records, and the bytes of their copies are in no file any more. And retention by
//! name, also of topics that only robots recorded.

use super::*;
use crate::notes::Erased;
use crate::sql::params;

const OWNER: Address = Address([1; 20]);
const ROBOT: SignerId = SignerId([0x60; 32]);

/// A record as a robot brings it to a gateway: without names.
fn brought(topic: u8, seq: u64) -> NewRecord {
    let foreign = Some(Foreign { recorder: RecorderId([9; 16]), keeper: Address([5; 20]) });
    NewRecord { foreign, signer: ROBOT, topic: String::new(), type_name: String::new(), ..record(1, topic, seq) }
}

fn move_to(ledger: &Ledger, digests: Vec<Digest>, state: RecordState) {
    let moved = ledger.database.write(move |session| {
        let sql = "UPDATE records SET state = ?1 WHERE digest = ?2";
        let connection = session.connection;
        digests.iter().try_for_each(|digest| Ok(connection.changed(sql, params![state.code(), digest.0]).map(drop)?))
    });
    moved.expect("moved");
}

fn pseudonym(topic: u8) -> String {
    crate::model::bytes::hex(&[topic; 16])
}

#[test]
fn retention_knows_topics_that_only_robots_recorded_by_the_names_that_were_learned() {
    let (_home, ledger) = open();
    let records = vec![brought(4, 1), brought(4, 2), brought(6, 1)];
    let digests = records.iter().map(|record| record.digest).collect();
    ledger.records.append(records).expect("acknowledged");
    move_to(&ledger, digests, Verified);
    ledger.names.keep(OWNER, pseudonym(4), "/robot4/odom".to_owned()).expect("learned");
    let mut topics = ledger.retention.topics(OWNER).expect("read");
    topics.sort_by_key(|topic| topic.topic_id);
    let named: Vec<(String, bool, u64)> =
        topics.iter().map(|topic| (topic.name.clone(), topic.is_named(), topic.bytes)).collect();
    // 101 + 102 bytes, as `record` has them; of the other one nothing is known but its pseudonym.
    let expected = [("/robot4/odom".to_owned(), true, 203), (format!("id:{}", pseudonym(6)), false, 101)];
    assert_eq!(named, expected);
    let of_robot = ledger.counts.signer_topics(OWNER, Some(SignerId([1; 32]))).expect("read");
    let told: Vec<(SignerId, &str, u64)> =
        of_robot.iter().map(|one| (one.signer, one.topic.as_str(), one.records.values().sum())).collect();
    assert_eq!(told[0], (ROBOT, "/robot4/odom", 2));
    assert_eq!(
        (told.len(), ledger.counts.signer_topics(OWNER, Some(ROBOT)).expect("read").len()),
        (2, 0),
        "not the owner's own"
    );

    // What was named waits while an incident holds it, by the learned name, too.
    let due = ledger.retention.oldest(&topics[0], (Timestamp(0), Timestamp(9_999)), 9).expect("read");
    let due: Vec<_> = due.into_iter().map(|record| (record, vec![1])).collect();
    let report = NewRecord { kind: RecordKind::Retention, topic: "authros/retention".to_owned(), ..record(1, 9, 1) };
    ledger.retention.give_up(&topics[0], report.clone(), due).expect("named");
    move_to(&ledger, vec![report.digest], Verified);
    assert_eq!(ledger.retention.to_delete(OWNER, 9).expect("read").len(), 2);
    let span = IncidentSpan { since: Timestamp(0), until: None, topics: "/robot4/odom".parse().expect("a topic") };
    ledger.incidents.open(OWNER, &"crash".parse().expect("a name"), &span, None).expect("opened");
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(Vec::new()));
}

#[test]
fn who_had_a_record_erased_and_why_stays_with_it() {
    let (_home, ledger) = open();
    let (one, other) = (record(1, 1, 1), record(1, 1, 2));
    ledger.records.append(vec![one.clone(), other.clone()]).expect("acknowledged");
    move_to(&ledger, vec![one.digest], Verified);
    let report = NewRecord { kind: RecordKind::Retention, topic: "authros/retention".to_owned(), ..record(1, 9, 1) };
    let erasure = Erasure { at: Timestamp::from_seconds(1), by: "alice".to_owned(), reason: "a \u{1b}face".to_owned() };
    assert_eq!(ledger.erasures.has_named(), Ok(false));
    let both = vec![(one.digest, vec![1]), (other.digest, vec![2])];
    ledger.erasures.erase(report.clone(), &erasure, both).expect_err("one of them is not verified");
    assert_eq!(ledger.retention.find(one.digest), Ok(None), "all or nothing");
    ledger.erasures.erase(report.clone(), &erasure, vec![(one.digest, vec![1])]).expect("named");
    assert_eq!(
        (ledger.erasures.has_named(), ledger.erasures.erased_among(&[one.digest, other.digest])),
        (Ok(true), Ok(vec![one.digest]))
    );
    move_to(&ledger, vec![report.digest], Verified);
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(vec![one.digest]));
    ledger.retention.deleted(&[one.digest]).expect("noted");
    let retained = ledger.retention.find(one.digest).expect("read").expect("kept");
    assert_eq!((retained.erased.clone(), retained.report), (Some(erasure.clone()), report.digest));
    assert_eq!(
        (ledger.erasures.has_named(), ledger.notes.read(&Erased { report: report.digest })),
        (Ok(false), Ok(Some(erasure)))
    );
    let words = retained.erased.expect("erased").to_string();
    assert!(words.starts_with("erased 1970-01-01T00:00:01Z by alice, a ") && !words.contains('\u{1b}'), "{words}");
}

#[test]
fn what_a_rule_has_named_is_an_erasures_as_long_as_its_bytes_are_here() {
    let (_home, ledger) = open();
    let (waits, gone) = (record(1, 1, 1), record(1, 1, 2));
    ledger.records.append(vec![waits.clone(), gone.clone()]).expect("acknowledged");
    move_to(&ledger, vec![waits.digest, gone.digest], Verified);
    let topic = ledger.retention.topics(OWNER).expect("read").remove(0);
    let due = ledger.retention.oldest(&topic, (Timestamp(0), Timestamp(9_999)), 9).expect("read");
    let due: Vec<_> = due.into_iter().map(|record| (record, vec![1])).collect();
    let report =
        |seq| NewRecord { kind: RecordKind::Retention, topic: "authros/retention".to_owned(), ..record(1, 9, seq) };
    ledger.retention.give_up(&topic, report(1), due).expect("a rule names both");
    ledger.retention.deleted(&[gone.digest]).expect("noted");
    move_to(&ledger, vec![report(1).digest], Verified);
    let erasure = Erasure { at: Timestamp::from_seconds(1), by: "alice".to_owned(), reason: "a face".to_owned() };
    ledger.erasures.erase(report(2), &erasure, vec![(waits.digest, vec![1])]).expect("named");
    assert_eq!(ledger.erasures.erased_among(&[waits.digest, gone.digest]), Ok(vec![waits.digest]));
    let retained = ledger.retention.find(waits.digest).expect("read").expect("named");
    assert_eq!((retained.report, retained.erased), (report(2).digest, Some(erasure.clone())));
    assert_eq!(
        ledger.retention.to_delete(OWNER, 9),
        Ok(Vec::new()),
        "the record of the erasure is to be anchored first"
    );
    move_to(&ledger, vec![report(2).digest], Verified);
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(vec![waits.digest]));
    assert_eq!(ledger.retention.given_up(OWNER), Ok(2), "counted once");
    for record in [&waits, &gone] {
        let again = ledger.erasures.erase(report(3), &erasure, vec![(record.digest, vec![1])]);
        assert!(matches!(again, Err(StoreError::NotReady { .. })), "{again:?}");
    }
}

#[test]
fn bytes_that_are_named_or_deleted_do_not_come_back() {
    let (_home, ledger) = open();
    let (named, deleted, kept) = (brought(4, 1), brought(4, 2), brought(4, 3));
    let all = [named.clone(), deleted.clone(), kept];
    ledger.records.append(all.to_vec()).expect("acknowledged");
    move_to(&ledger, vec![named.digest], Verified);
    let report = NewRecord { kind: RecordKind::Retention, topic: "authros/retention".to_owned(), ..record(1, 9, 1) };
    let erasure = Erasure { at: Timestamp::from_seconds(1), by: "alice".to_owned(), reason: "a face".to_owned() };
    ledger.erasures.erase(report, &erasure, vec![(named.digest, vec![1])]).expect("named");
    ledger.retention.deleted(&[deleted.digest]).expect("noted");
    let again = all.clone().map(|record| NewRecord { blob: Some(vec![7; 9]), ..record });
    ledger.records.append(again.to_vec()).expect("acknowledged as known");
    let bytes = Ciphertext::of(&ledger).get_many(&all.map(|record| record.digest));
    assert_eq!(bytes, Ok(vec![None, None, Some(vec![7; 9])]));
}

#[test]
fn a_scoured_copy_is_in_no_file() {
    let (home, ledger) = open();
    let copy = |seed: u8| {
        (0..20_000u32).map(|at| (at * 7 + u32::from(seed) * 31).to_le_bytes()[0] ^ seed).collect::<Vec<u8>>()
    };
    let with = |seq: u64, blob: Vec<u8>| NewRecord { blob: Some(blob), ..record(1, 1, seq) };
    let (large, small) = (copy(3), copy(9)[..200].to_vec());
    let records = [with(1, large.clone()), with(2, small.clone()), with(3, copy(5))];
    let digests: Vec<Digest> = records.iter().map(|record| record.digest).collect();
    ledger.records.append(records.to_vec()).expect("acknowledged");
    let is_in = |piece: &[u8]| {
        let files = std::fs::read_dir(home.path()).expect("readable").flatten();
        let mut all = files.map(|file| std::fs::read(file.path()).expect("read"));
        all.any(|bytes| bytes.windows(piece.len()).any(|window| window == piece))
    };
    let pieces = [&large[100..148], &large[10_000..10_048], &small[20..68]];
    assert!(pieces.iter().all(|piece| is_in(piece)), "the search finds what is there");
    let store = Ciphertext::of(&ledger);
    store.scour(&digests[..2]).expect("scoured");
    assert!(!pieces.iter().any(|piece| is_in(piece)));
    assert_eq!(store.get_many(&digests), Ok(vec![None, None, Some(copy(5))]), "others stay");
}

#[test]
fn scouring_what_an_earlier_attempt_deleted_empties_the_log_all_the_same() {
    let (home, ledger) = open();
    let blob: Vec<u8> = (0..3_000u32).map(|at| (at * 11 + 5).to_le_bytes()[0]).collect();
    let one = NewRecord { blob: Some(blob.clone()), ..record(1, 1, 1) };
    ledger.records.append(vec![one.clone()]).expect("acknowledged");
    let log = home.path().join("ledger.db-wal");
    let is_in_log = || std::fs::read(&log).expect("read").windows(48).any(|window| window == &blob[100..148]);
    // As an attempt leaves it that failed because somebody read an earlier state.
    let deleted = ledger.database.write(|session| {
        let connection = session.connection;
        database::overwriting(connection.file().expect("a file"), || connection.run("DELETE FROM ciphertext", []))
    });
    deleted.expect("deleted");
    assert!(is_in_log(), "its bytes are still in the log");
    Ciphertext::of(&ledger).scour(&[one.digest]).expect("the second attempt");
    assert!(!is_in_log());
}

#[test]
fn an_owners_statement_speaks_for_its_own_record_and_for_no_other() {
    let (_home, ledger) = open();
    let mine = record(1, 1, 1);
    ledger.records.append(vec![mine.clone()]).expect("acknowledged");
    move_to(&ledger, vec![mine.digest], Verified);
    let topic = ledger.retention.topics(OWNER).expect("read").remove(0);
    let due = ledger.retention.oldest(&topic, (Timestamp(0), Timestamp(9_999)), 9).expect("read");
    let due = due.into_iter().map(|record| (record, vec![1])).collect();
    let report = NewRecord { kind: RecordKind::Retention, topic: "authros/retention".to_owned(), ..record(1, 9, 1) };
    ledger.retention.give_up(&topic, report.clone(), due).expect("a rule names it");
    ledger.retention.deleted(&[mine.digest]).expect("noted");
    move_to(&ledger, vec![report.digest], Verified);

    // Another owner names a retention record of this one in its statement.
    let foreign = Some(Foreign { recorder: RecorderId([9; 16]), keeper: Address([5; 20]) });
    let theirs = NewRecord { foreign, topic: String::new(), ..record(2, 4, 1) };
    let (signer, signature) = (crate::model::PublicKey([1; 64]), Signature([2; 64]));
    let at = Timestamp::from_seconds(5);
    let statement = crate::crypto::ErasedStatement { report: report.digest, at, signer, signature }.encode();
    let taken = TakenErased { header: vec![3; 9], report: report.digest, at, statement: statement.clone() };
    assert_eq!(ledger.erasures.take(theirs.clone(), taken.clone()), Ok(true));
    let own = ledger.retention.find(mine.digest).expect("read").expect("kept");
    assert_eq!((own.anchored, own.erased, own.stated), (true, None, None), "deleted by a rule, as before");
    let told = ledger.retention.find(theirs.digest).expect("read").expect("kept");
    assert_eq!((told.anchored, told.stated), (false, Some(statement)), "it is for others to check");
    assert_eq!(
        told.erased.map(|erasure| erasure.to_string()).as_deref(),
        Some("erased 1970-01-01T00:00:05Z by its owner, its proof remains")
    );
    let row = ledger.records.find(theirs.digest).expect("read").expect("listed");
    assert_eq!((row.deleted_at, told.deleted_at), (Some(at), Some(at)));

    assert_eq!(ledger.erasures.take(theirs, taken.clone()), Ok(true), "known");
    assert_eq!(ledger.retention.given_up(Address([2; 20])), Ok(1), "counted once");
    let here = NewRecord { foreign, ..record(2, 4, 2) };
    ledger.records.append(vec![here.clone()]).expect("acknowledged");
    assert_eq!(ledger.erasures.take(here.clone(), taken), Ok(false), "who has the bytes keeps them");
    assert_eq!(ledger.retention.find(here.digest), Ok(None));
}

server::on_a_server! {
    who_had_a_record_erased_and_why_stays_with_it, what_a_rule_has_named_is_an_erasures_as_long_as_its_bytes_are_here, bytes_that_are_named_or_deleted_do_not_come_back, an_owners_statement_speaks_for_its_own_record_and_for_no_other,
}
