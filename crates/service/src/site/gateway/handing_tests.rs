//! One look at what is held tells all who ask from a place in it, and an answer says where to go on.

use std::cell::Cell;

use super::*;

/// Two records of each of these blocks, of two topics.
fn rows(blocks: std::ops::RangeInclusive<u64>) -> Vec<HoldingRow> {
    let one = |(block, leaf): (u64, u64)| HoldingRow {
        place: (block, 1, leaf),
        owner: Address([1; 20]),
        recorder: RecorderId([2; 16]),
        topic_id: TopicId([u8::try_from(leaf).expect("small"); 16]),
        seq: block,
    };
    blocks.flat_map(|block| [(block, 0), (block, 1)]).map(one).collect()
}

/// What a ledger with these records finds behind a place, at most `limit` of them.
fn found(held: &[HoldingRow], after: HoldingPlace, limit: usize) -> HoldingPage {
    let behind: Vec<HoldingRow> = held.iter().filter(|row| place(row.place) > after).copied().take(limit).collect();
    HoldingPage { last: behind.last().map(|row| row.place), more: behind.len() >= limit, rows: behind }
}

/// Whoever asks, from wherever, gets what a look of its own would have told.
#[test]
fn one_look_tells_all_who_ask_from_a_place_in_it() {
    let (told, held, looks) = (Told::default(), rows(1..=20), Cell::new(0));
    let ask = |after| {
        told.at(after, || {
            looks.set(looks.get() + 1);
            Ok(found(&held, after, 100))
        })
        .expect("told")
    };
    let from = |block, batch, leaf| HoldingPlace { block, batch, leaf };
    ask(from(5, 0, 0));
    for after in [from(5, 0, 0), from(5, 1, 0), from(7, 0, 0), from(12, 1, 1), from(20, 1, 0), from(20, 1, 1)] {
        let own = Part::new(after, found(&held, after, 100)).behind(after);
        assert_eq!(ask(after), own, "{after:?}");
    }
    assert_eq!(looks.get(), 1);
    assert_eq!(ask(from(20, 1, 1)), Holdings { held: Vec::new(), next: from(20, 1, 1), more: false });
    assert_eq!(ask(from(4, 1, 1)).held.iter().map(|held| held.ranges.count()).sum::<u64>(), 32);
    assert_eq!(looks.get(), 2, "what is before the place that was looked from was not seen");
}

#[test]
fn behind_the_end_of_a_part_that_is_not_the_last_one_it_is_looked_anew() {
    let (told, held, looks) = (Told::default(), rows(1..=20), Cell::new(0));
    let mut after = HoldingPlace::default();
    let mut numbers = 0;
    loop {
        let look = || {
            looks.set(looks.get() + 1);
            Ok(found(&held, after, 7))
        };
        let holdings = told.at(after, look).expect("told");
        numbers += holdings.held.iter().map(|held| held.ranges.count()).sum::<u64>();
        assert!(!holdings.more || holdings.next > after, "a list that does not advance is a lie");
        after = holdings.next;
        if !holdings.more {
            break;
        }
    }
    assert_eq!((numbers, looks.get()), (40, 6));
}

#[test]
fn what_was_looked_up_long_ago_is_not_told() {
    let (told, after) = (Told::default(), HoldingPlace::default());
    told.at(after, || Ok(found(&rows(1..=1), after, 9))).expect("told");
    for part in told.0.lock().expect("not poisoned").iter_mut() {
        part.looked -= TOLD_AGAIN;
    }
    let holdings = told.at(after, || Ok(found(&rows(1..=2), after, 9))).expect("told");
    assert_eq!(holdings.next, place((2, 1, 1)));
}
