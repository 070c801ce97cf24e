//! Lists that are read to their end, and gateways that tell what they were not asked, or never come to an end.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use async_trait::async_trait;

use super::listing::{Listed, Lister, Wanted, list};
use crate::gateway::{Code, Entry, GatewayError, Page, Query, Standing};
use crate::model::{Address, Digest, ErrorKind, RecordKind, RecorderId, Scope, Timestamp, TopicId};
use crate::pipeline::mirror::lacking::Gathering;
use crate::service::reply::Failure;

const OWNER: Address = Address([1; 20]);
const TOPIC: TopicId = TopicId([2; 16]);

fn entry(owner: Address, topic_id: TopicId, seq: u64) -> Entry {
    Entry {
        digest: Digest([0; 32]),
        owner,
        recorder: RecorderId([7; 16]),
        seq,
        topic_id,
        epoch: 1,
        captured_at: Timestamp(seq),
        length: 1,
        kind: RecordKind::Data,
        standing: Standing::Verified,
    }
}

/// A gateway whose pages a function makes, from the number of the page and the query.
struct Pages<Make> {
    make: Make,
    asked: Vec<Query>,
}

impl<Make: FnMut(u64, &Query) -> Result<Page, GatewayError> + Send> Pages<Make> {
    fn new(make: Make) -> Self {
        Self { make, asked: Vec::new() }
    }

    async fn listed(&mut self, wanted: &[Wanted]) -> Result<Listed, Failure> {
        list(self, wanted, &|_, _| Some(1)).await
    }
}

#[async_trait]
impl<Make: FnMut(u64, &Query) -> Result<Page, GatewayError> + Send> Lister for Pages<Make> {
    #[expect(clippy::unnecessary_literal_bound, reason = "the form of the trait")]
    fn address(&self) -> &str {
        "gateway:7420"
    }

    async fn page(&mut self, query: &Query) -> Result<Page, GatewayError> {
        self.asked.push(query.clone());
        (self.make)(self.asked.len() as u64, query)
    }
}

fn all_of(owner: Address) -> Wanted {
    Wanted { owner, scope: Scope::All, topics: None }
}

fn numbers(listed: &Listed) -> Vec<(Address, Vec<(u64, u64)>)> {
    let series = listed.listing.series.iter();
    series.map(|(series, numbers)| (series.owner, numbers.held.iter().collect())).collect()
}

#[tokio::test]
async fn all_pages_of_all_owners_are_read_and_one_that_is_refused_keeps_no_other_away() {
    let other = Address([2; 20]);
    let mut stale = true;
    let mut gateway = Pages::new(|page, query: &Query| {
        if std::mem::take(&mut stale) {
            return Err(GatewayError::Refused(Code::Stale));
        }
        if query.selection.owner == other {
            return Err(GatewayError::Refused(Code::NotAuthorised));
        }
        let next = (page < 4).then_some(u128::from(page));
        Ok(Page { entries: vec![entry(query.selection.owner, TOPIC, page)], next })
    });
    let third = Address([3; 20]);
    let wanted = [all_of(OWNER), all_of(other), all_of(third)];
    let listed = gateway.listed(&wanted).await.expect("told");
    assert_eq!(numbers(&listed), [(OWNER, vec![(2, 4)]), (third, vec![(6, 6)])]);
    assert_eq!(listed.listing.told, [OWNER, third].into());
    assert_eq!(listed.untold.iter().map(|(owner, _)| *owner).collect::<Vec<_>>(), [other]);
    let cursors: Vec<u128> = gateway.asked.iter().map(|query| query.cursor).collect();
    assert_eq!(cursors, [0, 0, 2, 3, 0, 0], "asked again where its chain was not fresh");
}

#[tokio::test]
async fn topics_that_were_named_are_asked_for_one_by_one_and_no_others() {
    let (named, beyond) = (TopicId([4; 16]), TopicId([5; 16]));
    let mut gateway = Pages::new(|_, query: &Query| {
        let topic = query.selection.topic_id.expect("one topic");
        Ok(Page { entries: vec![entry(OWNER, topic, 1)], next: None })
    });
    let topics = Some([TOPIC, named, beyond].into());
    let wanted = Wanted { owner: OWNER, scope: Scope::Topics(vec![TOPIC, named]), topics };
    let listed = gateway.listed(&[wanted]).await.expect("told");
    assert_eq!((gateway.asked.len(), listed.listing.series.len()), (2, 2));
}

#[tokio::test]
async fn a_gateway_that_tells_what_it_was_not_asked_is_not_compared() {
    let topics = Wanted { owner: OWNER, scope: Scope::Topics(vec![TOPIC]), topics: None };
    for (wanted, lie) in
        [(all_of(OWNER), entry(Address([9; 20]), TOPIC, 1)), (topics, entry(OWNER, TopicId([9; 16]), 1))]
    {
        let mut gateway = Pages::new(|_, _: &Query| Ok(Page { entries: vec![lie], next: None }));
        let Err(failure) = gateway.listed(&[wanted]).await else { panic!("it is compared") };
        assert!(failure.message.contains("not asked for"), "{}", failure.message);
    }
}

#[tokio::test]
async fn a_list_without_end_ends() {
    let mut same = Pages::new(|page, _: &Query| Ok(Page { entries: Vec::new(), next: Some(u128::from(page)) }));
    let mut scattered = Pages::new(|page, _: &Query| {
        let entries = (0..500).map(|place| entry(OWNER, TOPIC, (page * 500 + place) * 2)).collect();
        Ok(Page { entries, next: Some(1) })
    });
    let ends = [same.listed(&[all_of(OWNER)]).await, scattered.listed(&[all_of(OWNER)]).await];
    for end in ends {
        let Err(failure) = end else { panic!("it is compared") };
        assert_eq!(failure.kind, ErrorKind::Refused);
        assert!(failure.message.contains("gateway:7420") && failure.message.contains("--topic"), "{}", failure.message);
    }
    assert!(scattered.asked.len() <= Gathering::MOST / 500, "{}", scattered.asked.len());
}
