//! Quarantine records: complete, without duplicates, in the order of acknowledgement, and readable.

use std::sync::Arc;

use super::super::fixture::Notes;
use super::super::tests::owner_with_keys;
use super::*;
use crate::crypto::{ProviderName, provider};
use crate::model::{RecordState, SignerId};
use crate::store::{Ciphertext, HeldQuery, Ledger, NewRecord};

const MINUTE: u64 = 60_000_000_000;

fn plant(home: &std::path::Path) -> Plant {
    let ledger = Ledger::open(&home.join("ledger.db")).expect("ledger");
    Plant {
        ciphertext: Ciphertext::of(&ledger),
        ledger,
        provider: provider(ProviderName::RustCrypto),
        observer: Arc::new(Notes::default()),
    }
}

fn record(owner: Address, topic: u8, seq: u64, at: u64) -> NewRecord {
    NewRecord {
        digest: Digest(crate::crypto::sm3::sm3(&[&[topic], &seq.to_be_bytes()])),
        owner,
        topic_id: TopicId([topic; 16]),
        seq,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: crate::model::Signature([7; 64]),
        filters: Vec::new(),
        topic: format!("/t{topic}"),
        type_name: "a/B".to_owned(),
        bytes: 9,
        captured_at: Timestamp(at),
        simulated: false,
        state: RecordState::Quarantined,
        blob: Some(b"ciphertext".to_vec()),
    }
}

fn keep(plant: &Plant, record: NewRecord) -> Digest {
    let digest = record.digest;
    let hold = Hold { digest, reason: "new", publisher: "/evil@h:a/B:0".to_owned() };
    plant.ledger.quarantine.append_held(vec![record], vec![hold]).expect("held");
    digest
}

#[test]
fn every_topic_and_minute_is_counted_once_and_in_order() {
    let home = tempfile::tempdir().expect("folder");
    let plant = plant(home.path());
    let (owner, domain) = owner_with_keys(plant.provider, home.path());
    let at = |minute: u64, second: u64| minute * MINUTE + second * 1_000_000_000;
    let one = keep(&plant, record(owner.address, 1, 1, at(10, 5)));
    let other = keep(&plant, record(owner.address, 2, 1, at(10, 6)));
    let two = keep(&plant, record(owner.address, 1, 2, at(10, 59)));
    let later = keep(&plant, record(owner.address, 1, 3, at(11, 0)));
    assert_eq!(report(&plant, &owner.author, 10).expect("nothing is due"), 0);
    assert_eq!(report(&plant, &owner.author, 11).expect("one minute is due"), 2);
    assert_eq!(report(&plant, &owner.author, 11).expect("once only"), 0);
    assert_eq!(report(&plant, &owner.author, u64::MAX).expect("all"), 1);

    let rows = plant.ledger.records.in_state(Some(owner.address), RecordState::Stored, 100).expect("rows");
    assert!(rows.iter().all(|row| row.kind == RecordKind::Quarantine && row.topic == TOPIC));
    let mut found = Vec::new();
    for row in &rows {
        let blob = plant.ciphertext.get(row.digest).expect("read").expect("there");
        let keys = owner.sealing().expect("keys");
        let body = super::super::tests::body_of(plant.provider, &keys, row, &blob);
        found.push((row.digest, QuarantineReport::parse(&body).expect("a report")));
    }
    let stream = (owner.address, plant.ledger.records.recorder().of_signer(&owner.sealing().expect("keys").signer));
    for (topic, minute, digests, seqs) in
        [(1, 10, vec![one, two], (1, 2)), (2, 10, vec![other], (1, 1)), (1, 11, vec![later], (3, 3))]
    {
        let topic_id = TopicId([topic; 16]);
        let (digest, report) =
            found.iter().find(|(_, report)| (report.topic_id, report.minute) == (topic_id, minute)).expect("counted");
        let rolling = rolling(&plant, &domain, stream, topic_id, minute, digests.iter().copied());
        assert_eq!((report.count, report.rolling), (digests.len() as u64, rolling));
        assert_eq!(
            (report.first_seq, report.last_seq, report.topic.as_str()),
            (seqs.0, seqs.1, &*format!("/t{topic}"))
        );
        let held = plant
            .ledger
            .quarantine
            .held(owner.address, &HeldQuery { limit: 100, ..HeldQuery::default() })
            .expect("held");
        let counted = held.iter().filter(|row| row.report == Some(*digest)).map(|row| row.record.digest);
        assert_eq!(counted.collect::<Vec<_>>(), digests);
    }
    // Another order, another selection or another minute gives another hash.
    let of = |minute, digests: &[Digest]| {
        rolling(&plant, &domain, stream, TopicId([1; 16]), minute, digests.iter().copied())
    };
    let all = [of(10, &[one, two]), of(10, &[two, one]), of(10, &[one]), of(11, &[one, two]), of(10, &[])];
    assert!((0..all.len()).all(|i| !all[..i].contains(&all[i])));
}

#[test]
fn what_is_discarded_is_gone_and_still_counted() {
    let home = tempfile::tempdir().expect("folder");
    let plant = plant(home.path());
    let (owner, _) = owner_with_keys(plant.provider, home.path());
    let digests: Vec<Digest> = (1..=3).map(|seq| keep(&plant, record(owner.address, 1, seq, seq))).collect();
    assert_eq!(report(&plant, &owner.author, u64::MAX).expect("counted"), 1);
    assert_eq!(discard(&plant, &digests[..2]).expect("discarded"), 2);
    assert_eq!(discard(&plant, &digests[..2]).expect("again"), 0);
    assert_eq!(plant.ciphertext.get(digests[0]), Ok(None));
    assert!(plant.ciphertext.get(digests[2]).expect("read").is_some());
    let counts = plant.ledger.counts.by_state(Some(owner.address)).expect("counts");
    let topic = &counts.topics[0];
    assert_eq!((topic.captured, topic.dropped, topic.quarantined, topic.pending), (3, 2, 1, 0));
    let all =
        HeldQuery { decided: true, limit: 9, topic: Some("/t1".to_owned()), messages: true, ..HeldQuery::default() };
    let rows = plant.ledger.quarantine.held(owner.address, &all).expect("held");
    assert!(rows.iter().all(|row| row.report.is_some()));
    let decisions: Vec<_> = rows.iter().map(|row| row.decision.as_deref()).collect();
    assert_eq!(decisions, [Some("discarded"), Some("discarded"), None]);
}

#[test]
fn without_keys_nothing_is_counted_and_nothing_is_lost() {
    let home = tempfile::tempdir().expect("folder");
    let plant = plant(home.path());
    let (owner, _) = super::super::tests::owner_without_keys(plant.provider, home.path());
    keep(&plant, record(owner.address, 1, 1, 1));
    assert_eq!(report(&plant, &owner.author, u64::MAX).expect("waits"), 0);
    assert!(plant.ledger.quarantine.unreported(owner.address, u64::MAX).expect("read").is_some());
}
