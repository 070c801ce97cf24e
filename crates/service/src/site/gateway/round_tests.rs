//! Rounds with gateways that lie: nothing is taken, and what they cost is bounded.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

use super::super::fetching::{Claim, Fetching, Which};
use super::super::visit::{MOST_LATER, MOST_PAGES, MOST_REFUSED, MOST_REQUESTS};
use super::*;
use crate::model::{Header, PublicKey, Signature};

pub(in crate::site::gateway) const RECORDER: RecorderId = RecorderId([2; 16]);
pub(in crate::site::gateway) const TOPIC: TopicId = TopicId([3; 16]);
pub(in crate::site::gateway) const FRIEND: Address = Address([1; 20]);
const STRANGER: Address = Address([9; 20]);

/// The record with a number, as [`Shelf`] reads it: the number is all of its bytes, where it has no header.
pub(in crate::site::gateway) fn record(number: u64) -> Fetched {
    let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
    Fetched { signer, signature, proof: Vec::new(), blob: number.to_be_bytes().to_vec() }
}

pub(in crate::site::gateway) fn held(owner: Address, numbers: impl IntoIterator<Item = u64>) -> Held {
    Held { owner, recorder: RECORDER, topic_id: TOPIC, ranges: Ranges::of(numbers.into_iter().collect()) }
}

/// A place that holds numbers, and takes records that are not forged: those with a number below a thousand.
#[derive(Default)]
pub(in crate::site::gateway) struct Shelf {
    held: Mutex<BTreeSet<u64>>,
    pub takes: Mutex<usize>,
    pub fetching: Arc<Fetching>,
    copies: Copies,
    stale: bool,
    /// What is on its way to an anchor here.
    twice: Vec<Digest>,
    /// From this number on the blocks of anchors are not known.
    unseen: Option<u64>,
}

impl Shelf {
    pub fn numbers(&self) -> Vec<u64> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).iter().copied().collect()
    }
}

#[async_trait]
impl Here for Shelf {
    fn welcomes(&self, owner: &Address) -> Result<(), Refusal> {
        match owner {
            _ if self.stale => Err(Refusal::new(Code::Stale, "no recent block")),
            owner if *owner == FRIEND => Ok(()),
            _ => Err(Refusal::new(Code::NotAuthorised, "not admitted")),
        }
    }

    fn copies(&self) -> Copies {
        self.copies.clone()
    }

    fn lacking(&self, told: &[Held]) -> Result<Vec<Lacking>, Refusal> {
        let held = self.held.lock().expect("not poisoned");
        let lacking = |told: &Held| {
            let numbers = told.ranges.iter().flat_map(|(first, last)| first..=last);
            let numbers = numbers.filter(|number| !held.contains(number)).collect();
            Lacking { numbers: Ranges::of(numbers), twice: self.twice.clone() }
        };
        Ok(told.iter().map(lacking).collect())
    }

    fn claim(&self, which: Which, wanted: Vec<u64>) -> Claim {
        self.fetching.claim(which, wanted)
    }

    async fn take(&self, parts: Vec<Handed>) -> Result<Took, Refusal> {
        *self.takes.lock().expect("not poisoned") += 1;
        let Took { mut taken, mut later, mut refused, silent } = Took::default();
        let records = parts.into_iter().flat_map(|part| part.records.into_iter().map(move |one| (part.wanted, one)));
        for (wanted, record) in records {
            let number = Header::parse(&record.blob).map(|(header, _)| header.seq);
            let number = number.unwrap_or_else(|_| u64::from_be_bytes(record.blob.try_into().expect("eight bytes")));
            let one = (wanted.owner, wanted.recorder, wanted.topic_id, number);
            if self.unseen.is_some_and(|unseen| number >= unseen) {
                later.insert(one);
            } else if (700..800).contains(&number) {
                refused.push(Refusal::new(Code::NotYours, "of another network"));
            } else if number < 1000 && (wanted.first..=wanted.last).contains(&number) {
                self.held.lock().expect("not poisoned").insert(number);
                taken.insert(one);
            } else {
                refused.push(Refusal::new(Code::Signature, "forged"));
            }
        }
        Ok(Took { taken, later, refused, silent })
    }

    async fn erase(&self, _: Vec<ToldErasure>, _: bool, _: &mut Round) -> Result<TookErased, Refusal> {
        Ok(TookErased::default())
    }
}

/// A gateway by a script: what it tells after a place, and what it hands over.
pub(in crate::site::gateway) struct Script<Tell, Hand> {
    tell: Tell,
    hand: Hand,
    asked: usize,
}

#[async_trait]
impl<Tell, Hand> Other for Script<Tell, Hand>
where
    Tell: FnMut(HoldingPlace) -> Holdings + Send,
    Hand: FnMut(Wanted) -> HandedOver + Send,
{
    async fn holdings(&mut self, after: HoldingPlace) -> Result<Holdings, GatewayError> {
        self.asked += 1;
        Ok((self.tell)(after))
    }

    async fn hand_over(&mut self, wanted: Wanted) -> Result<HandedOver, GatewayError> {
        self.asked += 1;
        Ok((self.hand)(wanted))
    }

    async fn hand_over_many(&mut self, _: &[Wanted]) -> Result<Option<ManyHandedOver>, GatewayError> {
        Ok(None)
    }

    async fn erasures(&mut self, _: ErasurePlace) -> Result<Option<Erasures>, GatewayError> {
        Ok(None)
    }
}

pub(in crate::site::gateway) fn script<Tell, Hand>(tell: Tell, hand: Hand) -> Script<Tell, Hand>
where
    Tell: FnMut(HoldingPlace) -> Holdings + Send,
    Hand: FnMut(Wanted) -> HandedOver + Send,
{
    Script { tell, hand, asked: 0 }
}

pub(in crate::site::gateway) fn place(block: u64) -> HoldingPlace {
    HoldingPlace { block, ..HoldingPlace::default() }
}

/// An honest one: two numbers a block, at most four records at once.
fn honest(upto: u64) -> Script<impl FnMut(HoldingPlace) -> Holdings, impl FnMut(Wanted) -> HandedOver> {
    let tell = move |after: HoldingPlace| {
        let block = after.block + 1;
        let numbers = (block * 2 - 1..=block * 2).filter(|number| *number <= upto);
        let more = block * 2 < upto;
        Holdings { held: vec![held(FRIEND, numbers)], next: place(if more { block } else { upto / 2 }), more }
    };
    let hand = |wanted: Wanted| {
        let last = wanted.last.min(wanted.first + 3);
        let records = (wanted.first..=last).map(record).collect();
        HandedOver { records, next: (last < wanted.last).then_some(last + 1) }
    };
    script(tell, hand)
}

async fn rounds(other: &mut impl Other, here: &Shelf, most: usize) -> (Course, Round, Result<(), Ended>) {
    let mut course = Course::default();
    let mut sum = Round::default();
    for _ in 0..most {
        let mut round = Round::default();
        let ended = reconcile(other, here, &mut course, &mut round).await;
        sum.taken += round.taken;
        sum.twice += round.twice;
        (sum.lacking, sum.more) = (round.lacking, round.more);
        round.refused.iter().for_each(|(code, count)| *sum.refused.entry(*code).or_default() += count);
        if ended.is_err() || !sum.more {
            return (course, sum, ended);
        }
    }
    (course, sum, Ok(()))
}

#[tokio::test]
async fn what_is_lacking_is_taken_once_and_a_round_is_resumed() {
    let (mut other, here) = (honest(99), Shelf::default());
    let (mut course, sum, ended) = rounds(&mut other, &here, 1).await;
    assert!(ended.is_ok() && sum.more && sum.taken == 2 * MOST_PAGES as u64, "one round has an end: {sum:?}");
    let mut round = Round { more: true, ..Round::default() };
    while round.more {
        round = Round::default();
        reconcile(&mut other, &here, &mut course, &mut round).await.expect("goes on");
    }
    assert_eq!(here.numbers(), (1..=99).collect::<Vec<_>>());
    assert!(course.is_at_end());
    // Another life of this gateway: nothing but what is held is left of the first one.
    let (course, sum, ended) = rounds(&mut other, &here, 50).await;
    assert!(ended.is_ok() && course.is_at_end() && sum.taken == 0, "{sum:?}");
}

/// Tells all of these numbers at once, and nothing behind them.
pub(in crate::site::gateway) fn all_at_once(
    upto: u64,
) -> Script<impl FnMut(HoldingPlace) -> Holdings, impl FnMut(Wanted) -> HandedOver> {
    let tell = move |after: HoldingPlace| {
        let held = if after < place(90) { vec![held(FRIEND, 1..=upto)] } else { Vec::new() };
        Holdings { held, next: place(90), more: false }
    };
    let hand = |wanted: Wanted| {
        let records = (wanted.first..=wanted.last).map(record).collect();
        HandedOver { records, next: None }
    };
    script(tell, hand)
}

#[tokio::test]
async fn only_what_falls_to_this_gateway_is_taken_and_the_rest_when_more_falls_to_it() {
    let keys = [1, 2, 3, 4].map(|key| crate::model::SignerId([key; 32]));
    let provider = crate::crypto::provider(crate::crypto::ProviderName::default());
    let told = Ranges::of((1..=690).collect());
    // Of four gateways, one to which some of it falls, and not all.
    let some = |copies: &Copies| {
        let kept = copies.kept((&FRIEND, &RECORDER, &TOPIC), &told).count();
        kept > 0 && kept < told.count()
    };
    let mut all = keys.map(|own| Copies::of(provider, Some(1), own, keys.to_vec())).into_iter();
    let copies = all.find(some).expect("three parts fall to one of four, or not");
    let falls: u64 = copies.kept((&FRIEND, &RECORDER, &TOPIC), &told).count();
    let (mut other, mut here, mut course) = (all_at_once(690), Shelf { copies, ..Shelf::default() }, Course::default());
    let mut round = Round::default();
    reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
    assert_eq!((round.taken, round.lacking), (falls, 0), "the rest is not lacking");
    let mut round = Round::default();
    reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
    assert_eq!(round.taken, 0);
    here.copies = Copies::All;
    let mut round = Round::default();
    reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
    assert_eq!((round.taken, round.lacking), (690 - falls, 0), "it is read from the beginning again");
}

#[test]
fn the_blocks_that_were_new_are_read_again_now_and_then_and_no_oftener() {
    let begun = Instant::now();
    let mut course = Course::default();
    let mut rest = |newest: u64, lagged: bool, seconds: u64| {
        let before = course.newest;
        course.newest = newest;
        course.rest(place(newest), before, lagged, begun + Duration::from_secs(seconds));
        course.after.block
    };
    assert_eq!(rest(100, false, 0), 100);
    assert_eq!(rest(105, false, 5), 105, "it goes on where the list ended");
    assert_eq!(rest(110, false, 10), 100 - AGAIN, "before what was read ten seconds ago");
    assert_eq!(rest(115, false, 15), 115);
    assert_eq!(rest(130, false, 20), 110 - AGAIN, "no block is left out between two readings");
    assert_eq!(rest(140, true, 21), 130 - AGAIN, "the chain here did not have the newest blocks");
}

#[tokio::test]
async fn a_list_without_an_end_is_read_a_part_at_a_time_and_one_that_stands_still_is_a_lie() {
    let mut endless = script(
        |after: HoldingPlace| Holdings { held: Vec::new(), next: place(after.block + 1), more: true },
        |_| HandedOver::default(),
    );
    let here = Shelf::default();
    let (_, sum, ended) = rounds(&mut endless, &here, 1).await;
    assert!(ended.is_ok() && sum.more, "{sum:?}");
    assert_eq!(endless.asked, MOST_PAGES);
    let mut still =
        script(|after| Holdings { next: after, more: true, ..Holdings::default() }, |_| HandedOver::default());
    let (_, _, ended) = rounds(&mut still, &here, 9).await;
    assert!(matches!(ended, Err(Ended::Lies(_))), "{ended:?}");
    assert_eq!(still.asked, 1);
    let mut back = script(|_| Holdings::default(), |_| HandedOver::default());
    let mut course =
        Course { after: place(9), begun: Some(Instant::now()), copies: Some(Copies::All), ..Course::default() };
    let ended = reconcile(&mut back, &here, &mut course, &mut Round::default()).await;
    assert!(matches!(ended, Err(Ended::Lies(_))), "{ended:?}");
}

#[tokio::test]
async fn forged_records_are_not_taken_and_their_sender_is_left_alone_after_a_few() {
    let numbers = 1..=500_u64;
    let mut forger = script(
        |_| Holdings { held: vec![held(FRIEND, 1..=500)], next: place(1), more: false },
        |wanted: Wanted| HandedOver {
            records: (wanted.first..=wanted.last.min(wanted.first + 3)).map(|number| record(number + 5000)).collect(),
            next: (wanted.first + 4 <= wanted.last).then_some(wanted.first + 4),
        },
    );
    let here = Shelf::default();
    let (_, sum, ended) = rounds(&mut forger, &here, 9).await;
    let Err(Ended::Lies(why)) = ended else { panic!("{ended:?}") };
    assert!(why.contains("forged"), "{why}");
    assert_eq!((here.numbers(), sum.refused.get(&Code::Signature)), (Vec::new(), Some(&(MOST_REFUSED as u64))));
    assert!(forger.asked <= 1 + MOST_REFUSED && numbers.count() == 500, "{}", forger.asked);
}

#[tokio::test]
async fn what_is_told_and_not_handed_over_is_asked_for_once_and_not_without_end() {
    let mut empty = script(
        |after: HoldingPlace| {
            let first = after.block * 8192 + 1;
            Holdings { held: vec![held(FRIEND, first..first + 8192)], next: place(after.block + 1), more: true }
        },
        |_| HandedOver::default(),
    );
    let here = Shelf::default();
    let (_, sum, ended) = rounds(&mut empty, &here, 9).await;
    assert!(matches!(ended, Err(Ended::Lies(_))), "{ended:?}");
    assert_eq!(sum.taken, 0);
    assert!(empty.asked <= 6, "{}", empty.asked);
    let mut slow = script(
        |_| Holdings { held: vec![held(FRIEND, 1..=8000)], next: place(1), more: false },
        |wanted: Wanted| HandedOver {
            records: Vec::new(),
            next: (wanted.first < wanted.last).then(|| wanted.first + 1),
        },
    );
    let (_, sum, ended) = rounds(&mut slow, &here, 1).await;
    assert!(ended.is_ok() && sum.more, "{ended:?}");
    assert_eq!(slow.asked, 1 + MOST_REQUESTS, "a round has an end");
    for next in [0, 5, 6, 11, u64::MAX] {
        let mut lost = script(
            |_| Holdings { held: vec![held(FRIEND, 6..=10)], next: place(1), more: false },
            move |_| HandedOver { records: Vec::new(), next: Some(next) },
        );
        let (_, _, ended) = rounds(&mut lost, &here, 1).await;
        assert!(matches!(ended, Err(Ended::Lies(_))), "{next}: {ended:?}");
    }
}

#[tokio::test]
async fn a_node_that_lags_makes_nobody_a_liar_and_what_it_has_not_got_is_asked_for_again() {
    let all = || {
        script(
            |_| Holdings { held: vec![held(FRIEND, 1..=40)], next: place(90), more: false },
            |wanted: Wanted| HandedOver { records: (wanted.first..=wanted.last).map(record).collect(), next: None },
        )
    };
    let (mut here, mut course) = (Shelf { unseen: Some(11), ..Shelf::default() }, Course::default());
    for taken in [10, 0] {
        let mut round = Round::default();
        reconcile(&mut all(), &here, &mut course, &mut round).await.expect("no lie");
        assert_eq!((round.taken, round.lacking, round.refused.len()), (taken, 30, 0));
        assert_eq!(course.after, HoldingPlace::default(), "their blocks are read again, however many there are");
    }
    here.unseen = None;
    let mut round = Round::default();
    reconcile(&mut all(), &here, &mut course, &mut round).await.expect("goes on");
    assert_eq!((round.taken, round.lacking, course.after), (30, 0, place(90)));
    // One that tells of blocks that never come is left alone like one that does not answer.
    let mut ahead = script(
        |_| Holdings { held: vec![held(FRIEND, 1..=8000)], next: place(1), more: false },
        |wanted: Wanted| HandedOver {
            records: (wanted.first..=wanted.first + 99).map(record).collect(),
            next: (wanted.first + 100 <= wanted.last).then_some(wanted.first + 100),
        },
    );
    let here = Shelf { unseen: Some(1), ..Shelf::default() };
    let (_, sum, ended) = rounds(&mut ahead, &here, 1).await;
    assert!(matches!(&ended, Err(Ended::Here(refusal)) if refusal.code == Code::Stale), "{ended:?}");
    assert!(sum.taken == 0 && ahead.asked <= 2 + MOST_LATER / 100 + 1, "{}", ahead.asked);
}

#[tokio::test]
async fn records_of_another_contract_do_not_keep_those_of_the_present_one_away() {
    let mut mixed = script(
        |_| Holdings { held: vec![held(FRIEND, 701..=810)], next: place(1), more: false },
        |wanted: Wanted| HandedOver { records: (wanted.first..=wanted.last).map(record).collect(), next: None },
    );
    let (here, mut course, mut round) = (Shelf::default(), Course::default(), Round::default());
    reconcile(&mut mixed, &here, &mut course, &mut round).await.expect("no lie");
    assert_eq!((round.taken, round.lacking, round.refused.get(&Code::NotYours)), (11, 99, Some(&99)));
}

#[tokio::test]
async fn what_is_not_handed_over_stays_lacking_until_it_is_here_another_way() {
    let mut damaged = script(
        |_| Holdings { held: vec![held(FRIEND, 1..=10)], next: place(1), more: false },
        |wanted: Wanted| {
            let kept = (wanted.first..=wanted.last).filter(|number| ![3, 4, 9].contains(number));
            HandedOver { records: kept.map(record).collect(), next: None }
        },
    );
    let (here, mut course) = (Shelf::default(), Course::default());
    for asked in [2, 1] {
        let (before, mut round) = (damaged.asked, Round::default());
        reconcile(&mut damaged, &here, &mut course, &mut round).await.expect("no lie");
        assert!(round.lacking == 3 && course.is_at_end(), "{round:?}");
        assert_eq!(damaged.asked - before, asked, "it is not asked for again in this pass");
    }
    here.held.lock().expect("not poisoned").extend([3, 9]);
    let mut round = Round::default();
    reconcile(&mut damaged, &here, &mut course, &mut round).await.expect("no lie");
    assert_eq!(round.lacking, 1, "a robot brought two of them");
}

#[tokio::test]
async fn records_of_owners_who_are_not_admitted_are_not_even_asked_for() {
    let mut other = script(
        |_| Holdings { held: vec![held(STRANGER, 1..=50)], next: place(1), more: false },
        |_| panic!("asked for"),
    );
    let here = Shelf::default();
    let (course, sum, ended) = rounds(&mut other, &here, 1).await;
    assert!(ended.is_ok() && course.passed_over() == 1 && sum.refused.is_empty(), "{sum:?}");
    let stale = Shelf { stale: true, ..Shelf::default() };
    let (_, _, ended) = rounds(&mut other, &stale, 1).await;
    assert!(
        matches!(ended, Err(Ended::Here(refusal)) if refusal.code == Code::Stale),
        "without its chain it takes nothing"
    );
}

#[tokio::test]
async fn what_both_anchored_is_counted_once_and_asked_for_never() {
    let own = [1, 2].map(|byte| Digest([byte; 32])).to_vec();
    let here = Shelf { held: Mutex::new((1..=10).collect()), twice: own, ..Shelf::default() };
    let mut other = honest(10);
    let (mut course, round, ended) = rounds(&mut other, &here, 9).await;
    assert!(ended.is_ok() && round.twice == 2, "told of on each page, counted once: {round:?}");
    let mut again = Round::default();
    reconcile(&mut other, &here, &mut course, &mut again).await.expect("honest");
    assert_eq!((again.twice, *here.takes.lock().expect("not poisoned")), (0, 0));
}
