//! The comparison of lists: by hand, and for random lists against the same question asked number by number.
#![allow(clippy::expect_used, clippy::indexing_slicing, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::lacking::{Compared, Gathering, Here, Lack, Listing, Numbers, Series};
use crate::gateway::{Entry, Standing};
use crate::model::{Address, Digest, Ranges, RecordKind, RecorderId, Timestamp, TopicId};

const OWNER: Address = Address([1; 20]);
const SERIES: Series = Series { owner: OWNER, recorder: RecorderId([7; 16]), topic_id: TopicId([2; 16]) };

fn entry(series: Series, seq: u64, standing: Standing, epoch: u64) -> Entry {
    Entry {
        digest: Digest([0; 32]),
        owner: series.owner,
        recorder: series.recorder,
        seq,
        topic_id: series.topic_id,
        epoch,
        captured_at: Timestamp(seq),
        length: 1,
        kind: RecordKind::Data,
        standing,
    }
}

/// The list of a gateway that tells of the owner, for a reader who was granted epoch 1 and later ones.
fn listing(entries: &[Entry]) -> Listing {
    let mut gathering = Gathering::default();
    assert!(entries.iter().all(|entry| gathering.add(entry, || Some(1))));
    gathering.listing([OWNER].into())
}

fn compare(gateways: &[Option<Listing>], here: &Here) -> Compared {
    super::lacking::compare(&gateways.iter().map(Option::as_ref).collect::<Vec<_>>(), here)
}

fn verified(series: Series, numbers: impl IntoIterator<Item = u64>) -> Vec<Entry> {
    numbers.into_iter().map(|seq| entry(series, seq, Standing::Verified, 1)).collect()
}

fn pairs(ranges: &Ranges) -> Vec<(u64, u64)> {
    ranges.iter().collect()
}

/// Ranges, who has them, and whether they are here.
type Told = (Vec<(u64, u64)>, Vec<usize>, bool);

fn told(lacks: &[Lack]) -> Vec<Told> {
    lacks.iter().map(|lack| (pairs(&lack.numbers), lack.holders.clone(), lack.is_here)).collect()
}

fn here(numbers: impl IntoIterator<Item = u64>) -> Here {
    let numbers = Ranges::of(numbers.into_iter().collect());
    let first = numbers.ends().map(|(first, _)| first);
    let numbers = Numbers { known: numbers.clone(), held: numbers.clone(), verified: numbers, first };
    Here { series: [(SERIES, numbers)].into(), ..Here::default() }
}

#[test]
fn each_gateway_is_told_what_it_lacks_and_who_has_it() {
    let one = listing(&verified(SERIES, (1..=16).chain(205..=299)));
    let other = listing(&verified(SERIES, 1..=300));
    let third = listing(&verified(SERIES, 200..=301));
    let found = compare(&[Some(one), None, Some(other), Some(third)], &here([10, 400]));
    assert_eq!(
        told(&found.lacking[0]),
        [
            (vec![(17, 199)], vec![2], false),
            (vec![(200, 204), (300, 300)], vec![2, 3], false),
            (vec![(301, 301)], vec![3], false),
            (vec![(400, 400)], vec![], true),
        ]
    );
    assert_eq!(found.lacking[1], [], "of what was not told nothing is said");
    assert_eq!(told(&found.lacking[2]), [(vec![(301, 301)], vec![3], false), (vec![(400, 400)], vec![], true)]);
    assert_eq!(found.nowhere, [(SERIES, Ranges::of((302..=399).collect()))]);
    assert_eq!((found.short_of(1), found.short_of(2)), (1, 183 + 2), "400; 17 to 199, 301 and 400");
}

#[test]
fn a_gateway_alone_is_compared_with_this_home_and_may_have_holes() {
    let found = compare(&[Some(listing(&verified(SERIES, [3, 4, 8])))], &here(3..=5));
    assert_eq!(told(&found.lacking[0]), [(vec![(5, 5)], vec![], true)]);
    assert_eq!(found.nowhere, [(SERIES, Ranges::of(vec![6, 7]))], "numbers before the first one are not asked for");
    let found = compare(&[Some(Listing { told: [OWNER].into(), ..Listing::default() })], &here(1..=2));
    assert_eq!(told(&found.lacking[0]), [(vec![(1, 2)], vec![], true)], "it lists nothing at all");
    let found = compare(&[Some(Listing::default())], &here(1..=2));
    assert_eq!(found.lacking, [[]], "it told nothing of this owner");
}

#[test]
fn what_was_deleted_or_recorded_here_is_lacked_by_nobody() {
    let gateways = [Some(listing(&verified(SERIES, [1, 2, 5]))), Some(listing(&verified(SERIES, [2])))];
    let mut home = here([9]);
    home.own.insert(SERIES);
    home.gone.insert(SERIES, Ranges::of(vec![1, 3]));
    let found = compare(&gateways, &home);
    assert_eq!((found.lacking[0].len(), told(&found.lacking[1])), (0, vec![(vec![(5, 5)], vec![0], false)]));
    assert_eq!(found.nowhere, [(SERIES, Ranges::of(vec![4, 6, 7, 8]))], "3 was deleted, 9 is here");
}

#[test]
fn the_numbers_of_a_ring_and_those_before_the_grant_are_no_holes() {
    let ring = Series { recorder: RecorderId::of_ring([1; 8]), ..SERIES };
    let found = compare(&[Some(listing(&verified(ring, [1, 9]))), Some(listing(&[]))], &Here::default());
    assert_eq!((found.nowhere.len(), told(&found.lacking[1])), (0, vec![(vec![(1, 1), (9, 9)], vec![0], false)]));
    let early = [entry(SERIES, 1, Standing::Verified, 0), entry(SERIES, 5, Standing::Verified, 0)];
    let later = verified(SERIES, [8, 10]);
    let found = compare(&[Some(listing(&[&early[..], &later].concat()))], &Here::default());
    assert_eq!(found.nowhere, [(SERIES, Ranges::of(vec![9]))], "of 2 to 4, and of 6 and 7, this reader cannot know");
    let found = compare(&[Some(listing(&early))], &Here::default());
    assert_eq!(found.nowhere, [], "no epoch of these was granted");
}

#[test]
fn what_nobody_has_verified_yet_is_on_its_way_and_what_was_altered_is_lacking() {
    let way =
        [Standing::Acknowledged, Standing::Anchored, Standing::Verified, Standing::Quarantined, Standing::Unknown];
    let one: Vec<Entry> = (1..).zip(way).map(|(seq, standing)| entry(SERIES, seq, standing, 1)).collect();
    let other = [entry(SERIES, 3, Standing::Tampered, 1), entry(SERIES, 7, Standing::Tampered, 1)];
    let found = compare(&[Some(listing(&one)), Some(listing(&other))], &Here::default());
    assert_eq!(found.waiting, [0, 2], "1 and 2");
    assert_eq!(told(&found.lacking[1]), [(vec![(3, 3)], vec![0], false)]);
    assert_eq!(found.lacking[0], [], "nobody has 7 as it was");
    assert_eq!(found.nowhere, [(SERIES, Ranges::of(vec![6]))]);
}

#[test]
fn what_a_gateway_is_asked_once_more_counts_too() {
    let mut first = listing(&verified(SERIES, [2, 3]));
    first.add(listing(&verified(SERIES, [1, 4])));
    assert_eq!(first, listing(&verified(SERIES, 1..=4)));
}

#[test]
fn a_list_of_numbers_without_order_ends_before_it_fills_the_memory() {
    let mut gathering = Gathering::default();
    let scattered = (1..).map(|number| entry(SERIES, number * 2, Standing::Verified, 1));
    let taken = scattered.take_while(|entry| gathering.add(entry, || None)).take(1_000_000).count();
    assert!(taken <= Gathering::MOST / 3, "{taken}");
    let mut gathering = Gathering::default();
    let in_order = (1..=1_000_000).map(|number| entry(SERIES, number, Standing::Verified, 1));
    assert!(in_order.into_iter().all(|entry| gathering.add(&entry, || None)));
}

/// Of each number: which of three gateways list it and how, and whether it is here.
type Cell = ([Option<u8>; 3], bool);

fn standing(code: u8) -> Standing {
    Standing::from_code(code).expect("a standing")
}

fn cells() -> impl Strategy<Value = Vec<Cell>> {
    let gateway = || proptest::option::weighted(0.7, prop_oneof![4 => Just(3_u8), 1 => 0..=5_u8]);
    proptest::collection::vec(([gateway(), gateway(), gateway()], any::<bool>()), 0..40)
}

proptest! {
    #[test]
    fn ranges_say_what_each_number_says(cells in cells(), away in 0..4_usize) {
        let numbers = || (1_u64..).zip(&cells);
        let gateway = |place: usize| {
            let listed = numbers().filter_map(|(seq, (there, _))| Some(entry(SERIES, seq, standing(there[place]?), 1)));
            (place != away).then(|| listing(&listed.collect::<Vec<_>>()))
        };
        let home = here(numbers().filter(|(_, (_, here))| *here).map(|(seq, _)| seq));
        let found = compare(&[gateway(0), gateway(1), gateway(2)], &home);
        let asked: Vec<usize> = (0..3).filter(|place| *place != away).collect();
        let has = |place: usize, cell: &Cell| matches!(cell.0[place], Some(1..=3));
        let is_verified = |cell: &Cell| cell.1 || asked.iter().any(|place| cell.0[*place] == Some(3));

        let mut expected: Vec<BTreeMap<u64, (Vec<usize>, bool)>> = vec![BTreeMap::new(); 3];
        for place in &asked {
            for (seq, cell) in numbers().filter(|(_, cell)| is_verified(cell) && !has(*place, cell)) {
                let holders = asked.iter().copied().filter(|other| has(*other, cell)).collect();
                expected[*place].insert(seq, (holders, cell.1));
            }
        }
        let mut lacking: Vec<BTreeMap<u64, (Vec<usize>, bool)>> = vec![BTreeMap::new(); 3];
        for (place, lacks) in found.lacking.iter().enumerate() {
            for lack in lacks {
                for seq in lack.numbers.iter().flat_map(|(first, last)| first..=last) {
                    let twice = lacking[place].insert(seq, (lack.holders.clone(), lack.is_here));
                    prop_assert!(twice.is_none(), "{seq} is told twice");
                }
            }
        }
        prop_assert_eq!(&lacking, &expected);
        let short = |copies: usize| {
            let few = expected.iter().flatten().filter(|(_, (holders, _))| holders.len() < copies);
            few.map(|(seq, _)| *seq).collect::<BTreeSet<_>>().len() as u64
        };
        for copies in 0..4 {
            prop_assert_eq!(found.short_of(copies), short(copies));
        }
        let known = |cell: &Cell| cell.1 || asked.iter().any(|place| cell.0[*place].is_some());
        let seen: Vec<u64> = numbers().filter(|(_, cell)| known(cell)).map(|(seq, _)| seq).collect();
        let between = |seq: &u64| seen.first().is_some_and(|first| first < seq) && seen.last().is_some_and(|last| seq < last);
        let holes: Vec<u64> = (1..=40).filter(|seq| between(seq) && !seen.contains(seq)).collect();
        let told: Vec<u64> = found.nowhere.iter().flat_map(|(_, numbers)| numbers.iter()).flat_map(|(first, last)| first..=last).collect();
        prop_assert_eq!(told, holes);
        for place in &asked {
            let waits = numbers().filter(|(_, cell)| {
                !is_verified(cell) && !has(*place, cell) && asked.iter().any(|other| has(*other, cell))
            });
            prop_assert_eq!(found.waiting[*place], waits.count() as u64);
        }
    }
}
