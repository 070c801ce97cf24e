//! Several lines that fetch the same records, and many topics in one visit.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::gateway::{HandedOver, Holdings};
use crate::model::TopicId;
use crate::site::gateway::round::reconcile;
use crate::site::gateway::round::tests::{FRIEND, RECORDER, Shelf, TOPIC, all_at_once, held, place, record, script};

#[tokio::test]
async fn what_another_line_is_fetching_is_left_to_it_and_asked_for_when_that_one_did_not_bring_it() {
    let (mut other, here, mut course) = (all_at_once(20), Shelf::default(), Course::default());
    let claimed = here.fetching.claim((FRIEND, RECORDER, TOPIC), 5..=8);
    for taken in [16, 0] {
        let mut round = Round::default();
        reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
        assert_eq!((round.taken, round.lacking, round.more), (taken, 4, false));
    }
    drop(claimed);
    // It is told of these numbers no more.
    let mut round = Round::default();
    reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
    assert_eq!((round.taken, round.lacking), (4, 0));
    assert_eq!(here.numbers(), (1..=20).collect::<Vec<_>>());
    assert_eq!(here.fetching.claim((FRIEND, RECORDER, TOPIC), 1..=20).numbers.len(), 20, "all are free again");
}

#[tokio::test]
async fn what_was_left_to_another_line_is_not_forgotten_when_the_gateway_fails_meanwhile() {
    let (mut other, here, mut course) = (all_at_once(20), Shelf::default(), Course::default());
    let claimed = here.fetching.claim((FRIEND, RECORDER, TOPIC), 5..=8);
    reconcile(&mut other, &here, &mut course, &mut Round::default()).await.expect("a round");
    drop(claimed);
    let mut liar = script(
        |after| Holdings { next: after, ..Holdings::default() },
        |wanted: Wanted| HandedOver { records: vec![record(wanted.first)], next: Some(u64::MAX) },
    );
    let ended = reconcile(&mut liar, &here, &mut course, &mut Round::default()).await;
    assert!(matches!(ended, Err(Ended::Lies(_))), "{ended:?}");
    assert_eq!(here.numbers().len(), 16);
    let mut round = Round::default();
    reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
    assert_eq!((round.taken, here.numbers()), (4, (1..=20).collect()));
}

#[tokio::test]
async fn a_few_records_of_each_of_many_topics_are_taken_together() {
    let topic = |number: u64| TopicId([u8::try_from(number / 8).expect("few"); 16]);
    let mut other = script(
        move |_| {
            let held =
                (0..20).map(|part| Held { topic_id: topic(part * 8), ..held(FRIEND, part * 8 + 1..=part * 8 + 7) });
            Holdings { held: held.collect(), next: place(1), more: false }
        },
        |wanted: Wanted| HandedOver { records: (wanted.first..=wanted.last).map(record).collect(), next: None },
    );
    let (here, mut course, mut round) = (Shelf::default(), Course::default(), Round::default());
    reconcile(&mut other, &here, &mut course, &mut round).await.expect("a round");
    assert_eq!((round.taken, round.lacking, course.is_at_end()), (140, 0, true));
    assert_eq!(
        *here.takes.lock().expect("not poisoned"),
        3,
        "seven to see whether they are true, 70 at once, the rest"
    );
    assert_eq!(here.fetching.claim((FRIEND, RECORDER, topic(8)), 1..=20).numbers.len(), 20, "all are free again");
}

#[tokio::test]
async fn what_came_before_a_line_fails_is_taken_all_the_same() {
    let topic = |number: u8| TopicId([number; 16]);
    let mut other = script(
        move |_| {
            let held = (1..=9_u8).map(|part| Held { topic_id: topic(part), ..held(FRIEND, [u64::from(part)]) });
            Holdings { held: held.collect(), next: place(1), more: false }
        },
        |wanted: Wanted| {
            // With the fourth topic it fails.
            let next = (wanted.first == 4).then_some(u64::MAX);
            HandedOver { records: vec![record(wanted.first)], next }
        },
    );
    let (here, mut course, mut round) = (Shelf::default(), Course::default(), Round::default());
    let ended = reconcile(&mut other, &here, &mut course, &mut round).await;
    assert!(matches!(ended, Err(Ended::Lies(_))), "{ended:?}");
    assert_eq!((round.taken, here.numbers()), (3, vec![1, 2, 3]));
}
