//! Many pieces of work in one transaction: whatever fails among them takes nothing else with it and leaves nothing.

use std::sync::mpsc;

use proptest::prelude::*;

use super::*;

/// What a thread asks of the ledger.
#[derive(Debug, Clone, Copy)]
enum Ask {
    /// So many records.
    Append(u64),
    /// So many, and one whose number is taken: none may stay.
    Clash(u64),
    /// So many, then a panic: none may stay.
    Panic(u64),
}

fn ask() -> impl Strategy<Value = Ask> {
    // Above 32 a piece of work begins a transaction of its own.
    let size = || prop_oneof![1u64..4, 30u64..36, 60u64..80];
    prop_oneof![
        3 => size().prop_map(Ask::Append),
        1 => size().prop_map(Ask::Clash),
        1 => size().prop_map(Ask::Panic),
    ]
}

/// Records of a topic that nobody else has.
fn own(topic: u8, count: u64) -> Vec<NewRecord> {
    (1..=count).map(|seq| record(2, topic, seq)).collect()
}

/// Asks; whether it was acknowledged.
fn put(ledger: &Ledger, topic: u8, ask: Ask) -> bool {
    match ask {
        Ask::Append(count) => ledger.append(own(topic, count)).is_ok(),
        Ask::Clash(count) => {
            let clash = NewRecord { digest: Digest([topic; 32]), ..record(1, 1, 1) };
            ledger.append([own(topic, count), vec![clash]].concat()).is_ok()
        }
        Ask::Panic(count) => {
            let records = own(topic, count);
            let asked = usize::try_from(count).expect("few");
            let answer: Result<(), _> = ledger.write_many(asked, move |session| {
                records.iter().try_for_each(|record| append::add(session, record, 1))?;
                panic!("on purpose")
            });
            answer.is_ok()
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn what_fails_in_a_group_leaves_nothing_and_takes_nothing_with_it(asks in prop::collection::vec(ask(), 1..20)) {
        let (home, ledger) = open();
        ledger.append(vec![record(1, 1, 1)]).expect("acknowledged");
        let (go, wait) = mpsc::channel::<()>();
        let answers: Vec<bool> = thread::scope(|scope| {
            // The writing thread stands still until all have asked, so that they are done in one group.
            let holder = scope.spawn(|| ledger.write(move |_| Ok(wait.recv().is_ok())));
            let threads: Vec<_> = (1u8..).zip(&asks).map(|(topic, ask)| {
                let ledger = &ledger;
                scope.spawn(move || put(ledger, topic, *ask))
            }).collect();
            thread::sleep(std::time::Duration::from_millis(20));
            go.send(()).expect("held");
            assert_eq!(holder.join().expect("joined"), Ok(true));
            threads.into_iter().map(|thread| thread.join().expect("joined")).collect()
        });
        let mut expected = 1;
        for ((topic, ask), answer) in (1u8..).zip(&asks).zip(answers) {
            let kept = if let Ask::Append(count) = ask { *count } else { 0 };
            prop_assert_eq!(answer, kept > 0);
            prop_assert_eq!(ledger.next_seq(Address([2; 20]), TopicId([topic; 16])), Ok(kept + 1));
            expected += kept;
        }
        prop_assert_eq!(ledger.counts(None).expect("counts").captured(), expected);
        prop_assert_eq!(ledger.contradictions().expect("looked"), Vec::<String>::new());
        drop(ledger);
        let again = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        prop_assert_eq!(again.counts(None).expect("counts").captured(), expected);
    }
}

#[test]
fn lists_name_every_state_of_a_topic_in_the_order_of_capture() {
    let (_home, ledger) = open();
    let records = own(3, 40);
    ledger.append(records.clone()).expect("acknowledged");
    let digests: Vec<Digest> = records.iter().map(|record| record.digest).collect();
    let (tampered, held) = (&digests[10..20], &digests[30..35]);
    assert_eq!(ledger.advance(tampered, Stored, RecordState::Tampered), Ok(10));
    assert_eq!(ledger.advance(held, Stored, RecordState::Quarantined), Ok(5));
    let page = ledger.list(&RecordQuery { limit: 100, ..RecordQuery::default() }).expect("page");
    assert_eq!(page.rows.iter().map(|row| row.digest).collect::<Vec<_>>(), digests);
    let newest = RecordQuery { newest_first: true, limit: 12, ..RecordQuery::default() };
    let page = ledger.list(&newest).expect("page");
    assert_eq!(
        page.rows.iter().map(|row| row.digest).collect::<Vec<_>>(),
        digests.iter().rev().copied().take(12).collect::<Vec<_>>()
    );
}
