//! Several pieces of work in one transaction: one that fails takes no other with it and leaves nothing behind.

use std::sync::mpsc::{self, Receiver};

use proptest::prelude::*;

use super::*;

type Answer = Receiver<Result<(), StoreError>>;

/// A piece of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ask {
    Append(u64),
    /// This many, and one whose number is taken: none may stay.
    Clash(u64),
    /// This many, then a panic: none may stay.
    Panic(u64),
    /// This many, and the transaction is rolled back, as SQLite does if the disk fails.
    Lose(u64),
}

fn ask() -> impl Strategy<Value = Ask> {
    let size = || 1u64..9;
    prop_oneof![
        6 => size().prop_map(Ask::Append),
        2 => size().prop_map(Ask::Clash),
        2 => size().prop_map(Ask::Panic),
        1 => size().prop_map(Ask::Lose),
    ]
}

/// Records of a topic that nobody else has.
fn own(topic: u8, count: u64) -> Vec<NewRecord> {
    (1..=count).map(|seq| record(2, topic, seq)).collect()
}

/// Queues work; `large` says that it covers a great many records.
fn put(ledger: &Ledger, topic: u8, ask: Ask, large: bool) -> Answer {
    let (Ask::Append(count) | Ask::Clash(count) | Ask::Panic(count) | Ask::Lose(count)) = ask;
    let clash = NewRecord { digest: Digest([topic; 32]), ..record(1, 1, 1) };
    let mut records = own(topic, count);
    records.extend((matches!(ask, Ask::Clash(_))).then_some(clash));
    let size = if large { writer::MANY + 1 } else { records.len() };
    let work = move |session: &mut Session<'_>| {
        records.iter().try_for_each(|record| append::add(session, record, 1))?;
        assert!(!matches!(ask, Ask::Panic(_)), "on purpose");
        if matches!(ask, Ask::Lose(_)) {
            session.connection.script("ROLLBACK")?;
            return Err(StoreError::DiskFull { file: "ledger.db".into() });
        }
        Ok(())
    };
    ledger.database.shared.writer.ask(size, work).expect("open")
}

/// Which of these stay when done in one group. A large one starts a new transaction; a lost one takes the transaction
/// so far with it.
fn kept(asks: &[(Ask, bool)]) -> Vec<bool> {
    let (mut kept, mut begun) = (Vec::new(), 0);
    for (place, (ask, large)) in asks.iter().enumerate() {
        if *large {
            begun = place;
        }
        if matches!(ask, Ask::Lose(_)) {
            kept.iter_mut().skip(begun).for_each(|kept| *kept = false);
            begun = place + 1;
        }
        kept.push(matches!(ask, Ask::Append(_)));
    }
    kept
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn what_fails_in_a_group_leaves_nothing_and_takes_nothing_with_it(
        asks in prop::collection::vec((ask(), prop::bool::weighted(0.2)), 1..24),
    ) {
        let (home, ledger) = open();
        ledger.records.append(vec![record(1, 1, 1)]).expect("acknowledged");
        let ((begin, begun), (go, wait)) = (mpsc::channel(), mpsc::channel::<()>());
        // The writer thread is blocked until everything is queued, so that it is done in one group.
        let holder = ledger.database.shared.writer.ask(1, move |_| Ok(begin.send(()).is_ok() && wait.recv().is_ok()));
        let holder = holder.expect("open");
        begun.recv().expect("begun");
        let answers: Vec<Answer> =
            (1u8..).zip(&asks).map(|(topic, (ask, large))| put(&ledger, topic, *ask, *large)).collect();
        go.send(()).expect("held");
        prop_assert_eq!(holder.recv().expect("answered"), Ok(true));
        let mut expected = 1;
        for (((topic, (ask, _)), answer), kept) in (1u8..).zip(&asks).zip(answers).zip(kept(&asks)) {
            let answer = answer.recv().expect("answered");
            prop_assert_eq!(answer.is_ok(), kept, "{:?}: {:?}", ask, answer);
            prop_assert!(answer != Err(StoreError::Closed));
            let Ask::Append(count) = ask else { continue };
            let count = if kept { *count } else { 0 };
            prop_assert_eq!(ledger.records.next_seq(Address([2; 20]), SignerId([2; 32]), TopicId([topic; 16])), Ok(count + 1));
            expected += count;
        }
        prop_assert_eq!(ledger.counts.by_state(None).expect("counts").captured(), expected);
        prop_assert_eq!(ledger.inspection.contradictions().expect("looked"), Vec::<String>::new());
        drop(ledger);
        let again = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        prop_assert_eq!(again.counts.by_state(None).expect("counts").captured(), expected);
    }
}

#[test]
fn lists_name_every_state_of_a_topic_in_the_order_of_capture() {
    let (_home, ledger) = open();
    let records = own(3, 40);
    ledger.records.append(records.clone()).expect("acknowledged");
    let digests: Vec<Digest> = records.iter().map(|record| record.digest).collect();
    let (tampered, held) = (&digests[10..20], &digests[30..35]);
    assert_eq!(ledger.records.advance(tampered, Stored, RecordState::Tampered), Ok(10));
    assert_eq!(ledger.records.advance(held, Stored, RecordState::Quarantined), Ok(5));
    let found =
        |query| ledger.records.list(&query).expect("page").rows.iter().map(|row| row.digest).collect::<Vec<_>>();
    assert_eq!(found(RecordQuery { limit: 100, ..RecordQuery::default() }), digests);
    let newest: Vec<Digest> = digests.iter().rev().copied().take(12).collect();
    assert_eq!(found(RecordQuery { newest_first: true, limit: 12, ..RecordQuery::default() }), newest);
}

server::on_a_server! {
    lists_name_every_state_of_a_topic_in_the_order_of_capture,
}
