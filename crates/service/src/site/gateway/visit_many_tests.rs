//! Ranges of many topics in one request: with gateways that are honest, of an earlier version, or lie.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use async_trait::async_trait;

use super::super::fetching::Fetching;
use super::super::round::reconcile;
use super::super::round::tests::{FRIEND, RECORDER, Shelf, held, place, record};
use super::*;
use crate::gateway::{ErasurePlace, Erasures, Fetched, GatewayError, HoldingPlace, Holdings};
use crate::model::{Commit, Domain, RecordKind, Salt, SignerId, Timestamp, TopicId};

/// A number has seven neighbours in its topic.
fn topic(number: u64) -> TopicId {
    TopicId([u8::try_from(number / 8).unwrap_or(u8::MAX); 16])
}

/// The record with a number, in its topic.
fn whole(number: u64) -> Fetched {
    Fetched { blob: header(number).encode(), ..record(number) }
}

fn header(number: u64) -> Header {
    Header {
        kind: RecordKind::Data,
        domain: Domain([1; 32]),
        owner: FRIEND,
        signer: SignerId([1; 32]),
        epoch: 1,
        recorder: RECORDER,
        seq: number,
        topic_id: topic(number),
        filters: Vec::new(),
        captured_at: Timestamp(1),
        head_length: 16,
        body_length: 16,
        salt: Salt([1; 24]),
        commit: Commit([1; 32]),
    }
}

fn ranges(many: &[Wanted]) -> Vec<(u64, u64)> {
    many.iter().map(|wanted| (wanted.first, wanted.last)).collect()
}

/// Holds the numbers of twenty topics, and gives so many of them at once; some of them are not there any more.
struct Many {
    at_once: usize,
    earlier: bool,
    gone: Vec<u64>,
    /// The first numbers and the last ones of each request.
    asked: Vec<Vec<(u64, u64)>>,
    /// Changes an answer to a request for several ranges.
    lie: fn(&[Wanted], &mut ManyHandedOver),
}

impl Default for Many {
    fn default() -> Self {
        Self { at_once: MOST_HANDED, earlier: false, gone: Vec::new(), asked: Vec::new(), lie: |_, _| {} }
    }
}

impl Many {
    fn hand(&self, wanted: &[Wanted]) -> ManyHandedOver {
        let mut handed = HandedOver::default();
        for (range, wanted) in wanted.iter().enumerate() {
            for number in wanted.first..=wanted.last {
                if handed.records.len() >= self.at_once {
                    handed.next = Some(number);
                    return ManyHandedOver { handed, range: u16::try_from(range).expect("few") };
                }
                if !self.gone.contains(&number) {
                    handed.records.push(whole(number));
                }
            }
        }
        ManyHandedOver { handed, range: 0 }
    }
}

#[async_trait]
impl Other for Many {
    async fn holdings(&mut self, _: HoldingPlace) -> Result<Holdings, GatewayError> {
        let held = (0..20).map(|part| Held { topic_id: topic(part * 8), ..held(FRIEND, part * 8 + 1..=part * 8 + 7) });
        Ok(Holdings { held: held.collect(), next: place(1), more: false })
    }

    async fn hand_over(&mut self, wanted: Wanted) -> Result<HandedOver, GatewayError> {
        self.asked.push(vec![(wanted.first, wanted.last)]);
        Ok(self.hand(&[wanted]).handed)
    }

    async fn hand_over_many(&mut self, wanted: &[Wanted]) -> Result<Option<ManyHandedOver>, GatewayError> {
        self.asked.push(ranges(wanted));
        let mut many = self.hand(wanted);
        (self.lie)(wanted, &mut many);
        Ok((!self.earlier).then_some(many))
    }

    async fn erasures(&mut self, _: ErasurePlace) -> Result<Option<Erasures>, GatewayError> {
        Ok(None)
    }
}

async fn visited(other: &mut Many) -> (Shelf, Course, Round, Result<(), Ended>) {
    let (here, mut course, mut round) = (Shelf::default(), Course::default(), Round::default());
    // Of one that is not known to be honest each range is asked for by itself.
    course.was_true = true;
    let ended = reconcile(other, &here, &mut course, &mut round).await;
    (here, course, round, ended)
}

fn all() -> Vec<u64> {
    (0..160).filter(|number| number % 8 != 0).collect()
}

#[tokio::test]
async fn what_is_lacking_of_many_topics_is_asked_for_together_however_little_is_given_at_once() {
    let mut requests = Vec::new();
    for at_once in [1, 2, 3, 6, 7, 8, 20, 63, 64] {
        let mut other = Many { at_once, ..Many::default() };
        let (here, _, round, ended) = visited(&mut other).await;
        assert!(ended.is_ok(), "{at_once}: {ended:?}");
        assert_eq!((here.numbers(), round.taken, round.lacking), (all(), 140, 0), "{at_once}");
        assert!(other.asked.iter().all(|ranges| ranges.len() <= 9), "{at_once}: not more than can be given at once");
        requests.push(other.asked.len());
        let claimed = here.fetching.claim((FRIEND, RECORDER, topic(8)), 1..=20);
        assert_eq!(claimed.numbers.len(), 20, "all are free again");
    }
    assert_eq!(requests.last(), Some(&3), "nine topics at once: {requests:?}");
}

#[tokio::test]
async fn what_it_told_and_does_not_give_of_many_ranges_is_set_aside() {
    let gone = vec![1, 2, 20, 63, 81, 87, 153, 159];
    let mut other = Many { gone: gone.clone(), at_once: 9, ..Many::default() };
    let (here, course, round, ended) = visited(&mut other).await;
    assert!(ended.is_ok(), "{ended:?}");
    assert_eq!(round.lacking, gone.len() as u64);
    assert_eq!(here.numbers(), all().into_iter().filter(|number| !gone.contains(number)).collect::<Vec<_>>());
    let aside: Vec<u64> = course.set_aside.iter().map(|(.., number)| *number).collect();
    assert_eq!(aside, gone);
    assert!(course.set_aside.iter().all(|(_, _, topic_id, number)| *topic_id == topic(*number)));
}

#[tokio::test]
async fn a_gateway_of_an_earlier_version_is_asked_for_one_range_at_a_time() {
    let mut other = Many { earlier: true, ..Many::default() };
    let (here, mut course, _, ended) = visited(&mut other).await;
    assert!(ended.is_ok(), "{ended:?}");
    assert_eq!(here.numbers(), all());
    let sizes: Vec<usize> = other.asked.iter().map(Vec::len).collect();
    assert_eq!(sizes, [[9].to_vec(), vec![1; 20]].concat(), "it is not asked again in this session");
    course.connected();
    assert!(!course.one_by_one, "but in the next one");
}

/// Long ranges of several topics: while any of a topic is still to be asked for, no other line fetches it.
#[tokio::test]
async fn what_is_not_fetched_yet_stays_claimed_while_other_topics_are_taken() {
    let here = Shelf::default();
    let mut other = Long { fetching: std::sync::Arc::clone(&here.fetching), free: Vec::new() };
    let (mut course, mut round) = (Course::default(), Round::default());
    course.was_true = true;
    reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
    assert_eq!((round.taken, other.free), (600, Vec::new()));
    for number in [1, 201, 401] {
        let claimed = here.fetching.claim((FRIEND, RECORDER, hundreds(number)), 1..=600);
        assert_eq!(claimed.numbers.len(), 600, "all are free again");
    }
}

/// A number has a hundred and ninety-nine neighbours in its topic.
fn hundreds(number: u64) -> TopicId {
    TopicId([u8::try_from((number - 1) / 200).expect("few"); 16])
}

/// Holds three topics of two hundred numbers, and looks what is claimed whenever it is asked.
struct Long {
    fetching: std::sync::Arc<Fetching>,
    /// Numbers that were asked for and that another line could have claimed.
    free: Vec<u64>,
}

#[async_trait]
impl Other for Long {
    async fn holdings(&mut self, _: HoldingPlace) -> Result<Holdings, GatewayError> {
        let part = |first| Held { topic_id: hundreds(first), ..held(FRIEND, first..first + 200) };
        Ok(Holdings { held: [1, 201, 401].map(part).to_vec(), next: place(1), more: false })
    }

    async fn hand_over(&mut self, wanted: Wanted) -> Result<HandedOver, GatewayError> {
        let claimed = self.fetching.claim((FRIEND, RECORDER, wanted.topic_id), wanted.first..=wanted.last);
        self.free.extend(&claimed.numbers);
        let upto = wanted.last.min(wanted.first + MOST_HANDED as u64 - 1);
        let records = (wanted.first..=upto).map(|number| {
            let blob = Header { topic_id: wanted.topic_id, ..header(number) }.encode();
            Fetched { blob, ..record(number) }
        });
        Ok(HandedOver { records: records.collect(), next: (upto < wanted.last).then_some(upto + 1) })
    }

    async fn hand_over_many(&mut self, wanted: &[Wanted]) -> Result<Option<ManyHandedOver>, GatewayError> {
        let first = wanted.first().copied().expect("something");
        let handed = self.hand_over(first).await?;
        // The rest is asked for again.
        let (next, range) = handed.next.map_or((wanted.get(1).map(|one| one.first), 1), |next| (Some(next), 0));
        Ok(Some(ManyHandedOver { handed: HandedOver { next, ..handed }, range }))
    }

    async fn erasures(&mut self, _: ErasurePlace) -> Result<Option<Erasures>, GatewayError> {
        Ok(None)
    }
}

#[test]
fn a_range_that_is_longer_than_may_be_asked_for_is_asked_for_in_parts() {
    let parts = |range| requested(range).collect::<Vec<_>>();
    assert_eq!(parts((7, 7)), [(7, 7)]);
    assert_eq!(parts((1, MOST_TOLD)), [(1, MOST_TOLD)]);
    let (two, end) = (2 * MOST_TOLD, 2 * MOST_TOLD + 5);
    assert_eq!(parts((1, end)), [(1, MOST_TOLD), (MOST_TOLD + 1, two), (two + 1, end)]);
    assert_eq!(parts((u64::MAX - 1, u64::MAX)), [(u64::MAX - 1, u64::MAX)]);
}

/// What cannot be ends the visit, and nothing of such an answer is taken.
#[tokio::test]
async fn an_answer_that_does_not_advance_or_goes_on_elsewhere_is_a_lie() {
    let lies: [fn(&[Wanted], &mut ManyHandedOver); 7] = [
        |wanted, many| (many.handed.next, many.range) = (Some(wanted[0].first), 0),
        |wanted, many| (many.handed.next, many.range) = (Some(wanted[0].last + 1), 0),
        |wanted, many| (many.handed.next, many.range) = (Some(wanted[1].first), 0),
        |wanted, many| (many.handed.next, many.range) = (Some(wanted[0].first), 1),
        |wanted, many| (many.handed.next, many.range) = (Some(wanted[1].last + 1), 1),
        |_, many| (many.handed.next, many.range) = (Some(u64::MAX), u16::MAX),
        |wanted, many| (many.handed.next, many.range) = (Some(1), u16::try_from(wanted.len()).expect("few")),
    ];
    for (number, lie) in lies.into_iter().enumerate() {
        let mut other = Many { lie, ..Many::default() };
        let (here, _, round, ended) = visited(&mut other).await;
        assert!(matches!(ended, Err(Ended::Lies(_))), "{number}: {ended:?}");
        assert_eq!((here.numbers(), round.taken, other.asked.len()), (Vec::new(), 0, 1), "{number}");
    }
}

#[tokio::test]
async fn records_of_none_of_the_ranges_are_refused_and_what_they_cost_is_bounded() {
    // Of another topic; with a number beyond; and what is no record.
    let lies: [fn(&[Wanted], &mut ManyHandedOver); 3] = [
        |_, many| many.handed.records = vec![whole(200); 20],
        |_, many| many.handed.records = vec![whole(1_000); 20],
        |_, many| many.handed.records = vec![Fetched { blob: vec![9; 8], ..record(1) }; 20],
    ];
    for (number, lie) in lies.into_iter().enumerate() {
        let mut other = Many { lie, ..Many::default() };
        let (here, course, _, ended) = visited(&mut other).await;
        assert!(matches!(ended, Err(Ended::Lies(_))), "{ended:?}");
        assert_eq!((here.numbers(), course.was_true), (Vec::new(), false), "{number}");
        assert!(other.asked.len() <= 3, "{:?}", other.asked);
    }
}
