//! What owners state of erased records: told in an order that passes nothing over, and taken at a gateway.

use super::*;
use crate::crypto::ErasedStatement;
use crate::crypto::merkle::{Inclusion, Leaf, Tree};
use crate::model::{PublicKey, TopicId};
use crate::sql::params;

const OWNER: Address = Address([1; 20]);
const THERE: RecorderId = RecorderId([9; 16]);
const AT: Timestamp = Timestamp(5_000);

fn brought(seq: u64) -> NewRecord {
    let foreign = Some(Foreign { recorder: THERE, keeper: Address([5; 20]) });
    NewRecord { foreign, topic: String::new(), type_name: String::new(), ..record(1, 4, seq) }
}

fn report(seq: u64) -> NewRecord {
    NewRecord { kind: RecordKind::Retention, topic: "authros/retention".to_owned(), ..record(1, 9, seq) }
}

fn statement(report: u8, key: u8) -> Vec<u8> {
    let (signer, signature) = (PublicKey([key; 64]), Signature([2; 64]));
    ErasedStatement { report: Digest([report; 32]), at: AT, signer, signature }.encode()
}

fn move_to(ledger: &Ledger, record: &NewRecord, state: RecordState) {
    let digest = record.digest;
    let moved = ledger.database.write(move |session| {
        let sql = "UPDATE records SET state = ?1 WHERE digest = ?2";
        Ok(session.connection.changed(sql, params![state.code(), digest.0])?)
    });
    assert_eq!(moved, Ok(1));
}

/// Takes a record as its owner told of it, anchored alone in block 10.
fn take(ledger: &Ledger, record: &NewRecord, statement: Vec<u8>) -> Result<ToldErased, StoreError> {
    ledger.trail.walk_to((10, Hash([60; 32])), Vec::new()).expect("walked");
    let NewRecord { owner, signer, topic_id, seq, digest, .. } = *record;
    let leaf = Leaf { owner, signer, recorder: THERE, topic_id, seq, digest };
    let tree = Tree::new(Leaf::hashes(&[leaf])).expect("a leaf");
    let (root, transaction, block_hash) = (tree.root(), Hash([50; 32]), Hash([60; 32]));
    let inclusion = Inclusion { index: 0, count: 1, path: tree.path(0), root };
    let anchor = RootSighting { account: Address([8; 20]), root, count: 1, transaction, block: 10, block_hash };
    let report = Digest(statement[..32].try_into().expect("32 bytes"));
    let taken = TakenErased { header: vec![3; 9], report, at: AT, statement };
    ledger.erasures.take_told(record.clone(), (taken, vec![4; 65]), (inclusion, anchor))
}

fn told(ledger: &Ledger, after: u64) -> (Vec<Digest>, Option<u64>) {
    let page = ledger.erasures.list(after, 9).expect("read");
    (page.erasures.into_iter().map(|(digest, ..)| digest).collect(), page.last)
}

#[test]
fn what_is_erased_is_told_once_it_is_gone_and_again_when_it_is_stated_anew() {
    let (_home, ledger) = open();
    let records: Vec<NewRecord> = (1..=3).map(|seq| record(1, 1, seq)).collect();
    ledger.records.append(records.clone()).expect("acknowledged");
    records.iter().for_each(|record| move_to(&ledger, record, Verified));
    let erasure = Erasure { at: AT, by: "alice".to_owned(), reason: "a face".to_owned() };
    let named = records.iter().map(|record| (record.digest, vec![1])).collect();
    ledger.erasures.erase(report(1), &erasure, named).expect("named");
    let stated = |record: &NewRecord, key, account| StatedErasure {
        digest: record.digest,
        statement: statement(1, key),
        account,
    };
    let signed = |record, key| stated(record, key, Some(vec![4; 65]));
    ledger
        .erasures
        .keep(vec![signed(&records[0], 1), signed(&records[1], 1), stated(&records[2], 1, None)])
        .expect("kept");
    assert_eq!(told(&ledger, 0), (Vec::new(), None), "its bytes are here still");
    // The second one goes first; a reader who goes on from there does not miss the first one.
    ledger.retention.deleted(&[records[1].digest]).expect("noted");
    let (first, last) = told(&ledger, 0);
    assert_eq!(first, [records[1].digest]);
    ledger.retention.deleted(&[records[0].digest, records[2].digest]).expect("noted");
    let (then, last) = told(&ledger, last.expect("a number"));
    assert_eq!(then, [records[0].digest], "and not what the account did not sign for");
    assert_eq!(told(&ledger, last.expect("a number")), (Vec::new(), None));
    let unstated = |key| ledger.erasures.unstated(OWNER, &PublicKey([key; 64]), 9).expect("read");
    assert_eq!(unstated(1).iter().map(|one| one.digest).collect::<Vec<_>>(), [records[2].digest]);
    assert_eq!(unstated(2).len(), 3, "under another key all of it is stated anew");
    ledger.erasures.keep(vec![signed(&records[2], 2), signed(&records[1], 2)]).expect("kept");
    assert_eq!(told(&ledger, last.expect("a number")).0, [records[2].digest, records[1].digest]);
    assert_eq!(ledger.erasures.list(0, 2).map(|page| (page.erasures.len(), page.more)), Ok((2, true)));
    let retained = ledger.retention.find(records[0].digest).expect("read").expect("kept");
    assert_eq!((retained.erased, retained.stated), (Some(erasure), None), "who and why are known here");
}

#[test]
fn what_another_gateway_told_is_named_where_it_is_and_listed_where_it_is_not() {
    let (home, ledger) = open();
    let (copy, absent, gone) = (brought(1), brought(2), brought(3));
    ledger.records.append(vec![copy.clone(), gone.clone()]).expect("acknowledged");
    ledger.retention.deleted(&[gone.digest]).expect("by this home itself");
    let state = |ledger: &Ledger, record: &NewRecord| {
        ledger.records.find(record.digest).expect("read").map(|row| (row.state, row.deleted_at.is_some()))
    };
    assert_eq!(take(&ledger, &absent, statement(7, 1)), Ok(ToldErased::Listed));
    assert_eq!(state(&ledger, &absent), Some((RecordState::Mined, true)), "with its anchor, and without bytes");
    assert_eq!(take(&ledger, &copy, statement(7, 1)), Ok(ToldErased::Named));
    assert_eq!(state(&ledger, &copy), Some((RecordState::Mined, false)), "what was here without an anchor gets it");
    assert_eq!(take(&ledger, &gone, statement(7, 1)), Ok(ToldErased::Unchanged));
    assert_eq!(ledger.erasures.kept(gone.digest), Ok(None));
    assert_eq!(ledger.retention.given_up(OWNER), Ok(2));

    // What is verified is deleted, also by a run that was not there when it was told.
    assert_eq!(ledger.erasures.told_to_delete(9), Ok(Vec::new()), "its bytes are what is verified");
    move_to(&ledger, &copy, Verified);
    ledger.close().expect("closed");
    let ledger = open_again(&home);
    assert_eq!((ledger.erasures.has_named(), ledger.erasures.told_to_delete(9)), (Ok(true), Ok(vec![copy.digest])));
    assert_eq!(
        ledger.erasures.erased_among(&[copy.digest, gone.digest]),
        Ok(vec![copy.digest]),
        "overwritten, not only freed"
    );
    let again = [&copy, &absent, &gone].map(|record| NewRecord { blob: Some(vec![1]), ..record.clone() });
    ledger.records.append(again.to_vec()).expect("acknowledged as known");
    assert_eq!(Ciphertext::of(&ledger).usage(), Ok(Usage::default()), "nobody brings them again");
    // A gateway's desk has no incidents.
    if !server::is_here() {
        let name: IncidentName = "crash".parse().expect("a name");
        ledger.incidents.open(OWNER, &name, &IncidentSpan::default(), None).expect("opened");
        assert_eq!(ledger.erasures.told_to_delete(9), Ok(Vec::new()));
        assert_eq!(ledger.erasures.held_although_erased(), Ok(1));
        ledger.incidents.remove(OWNER, &name).expect("removed");
    }
    assert_eq!(told(&ledger, 0).0, [absent.digest], "what is here is not told to be gone");
    ledger.retention.deleted(&[copy.digest]).expect("noted");
    assert_eq!((ledger.erasures.told_to_delete(9), ledger.erasures.has_named()), (Ok(Vec::new()), Ok(false)));
    assert_eq!(told(&ledger, 0).0, [absent.digest, copy.digest]);
    assert_eq!(take(&ledger, &copy, statement(8, 2)), Ok(ToldErased::Restated));
    let retained = ledger.retention.find(copy.digest).expect("read").expect("accounted for");
    assert_eq!((retained.stated, retained.report), (Some(statement(8, 2)), Digest([8; 32])));
    assert_eq!(ledger.retention.given_up(OWNER), Ok(2), "counted once");
    // Another statement in its place does not become this home's own.
    let other = StatedErasure { digest: copy.digest, statement: statement(8, 3), account: None };
    ledger.erasures.keep(vec![other]).expect("kept");
    let kept = ledger.erasures.kept(copy.digest).expect("read").expect("kept");
    assert_eq!((kept.statement, kept.taken), (statement(8, 3), true));
}

#[test]
fn an_owners_word_takes_over_from_a_rule_and_not_from_a_person_of_this_home() {
    let (_home, ledger) = open();
    let (by_rule, by_person) = (brought(1), brought(2));
    ledger.records.append(vec![by_rule.clone(), by_person.clone()]).expect("acknowledged");
    [&by_rule, &by_person].iter().for_each(|record| move_to(&ledger, record, Verified));
    let erasure = Erasure { at: AT, by: "alice".to_owned(), reason: "a face".to_owned() };
    ledger.erasures.erase(report(1), &erasure, vec![(by_person.digest, vec![1])]).expect("named");
    let topic =
        ledger.retention.topics(OWNER).expect("read").into_iter().find(|topic| topic.topic_id == TopicId([4; 16]));
    let topic = topic.expect("a topic");
    let due = ledger.retention.oldest(&topic, (Timestamp(0), Timestamp(9_999)), 9).expect("read");
    ledger.retention.give_up(&topic, report(2), due.into_iter().map(|one| (one, vec![1])).collect()).expect("named");
    assert_eq!(take(&ledger, &by_person, statement(7, 1)), Ok(ToldErased::Unchanged));
    assert_eq!(take(&ledger, &by_rule, statement(7, 1)), Ok(ToldErased::Named));
    assert_eq!(ledger.erasures.told_to_delete(9), Ok(vec![by_rule.digest]));
    assert_eq!(ledger.retention.given_up(OWNER), Ok(2), "counted once");
}

#[test]
fn the_digest_of_another_owners_record_is_a_contradiction() {
    let (_home, ledger) = open();
    let copy = brought(1);
    ledger.records.append(vec![copy.clone()]).expect("acknowledged");
    let stolen = NewRecord { owner: Address([2; 20]), ..copy.clone() };
    let told = take(&ledger, &stolen, statement(7, 1));
    assert!(matches!(told, Err(StoreError::Conflict { .. })), "{told:?}");
    assert_eq!((ledger.retention.find(copy.digest), ledger.erasures.kept(copy.digest)), (Ok(None), Ok(None)));
}

server::on_a_server! {
    what_is_erased_is_told_once_it_is_gone_and_again_when_it_is_stated_anew, what_another_gateway_told_is_named_where_it_is_and_listed_where_it_is_not, an_owners_word_takes_over_from_a_rule_and_not_from_a_person_of_this_home, the_digest_of_another_owners_record_is_a_contradiction,
}
