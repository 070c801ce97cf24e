//! Random queries: pages hold what filtering and sorting all rows gives, and no text breaks cursors or ids.

use proptest::prelude::*;

use super::*;
use crate::model::FilterId;
use RecordState::Quarantined;

fn tag(number: u64) -> FilterId {
    FilterId(number.to_be_bytes())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: if server::is_here() { 12 } else { 48 }, ..ProptestConfig::default() })]

    /// Any filter, direction and page size, with few topics or with many (which are read differently), gives the same
    /// as filtering and sorting all rows.
    #[test]
    fn pages_are_complete_and_in_order(
        times in prop::collection::vec((1u8..3, 1u8..40, 0u64..20, any::<bool>()), 1..80),
        owner in prop::option::of(1u8..4),
        topic in prop::option::of(1u8..4),
        stored in prop::option::of(any::<bool>()),
        since in prop::option::of(0u64..20),
        until in prop::option::of(0u64..20),
        newest_first in any::<bool>(),
        limit in 1usize..9,
        tagged in prop::option::of(1u64..5),
    ) {
        let (_home, ledger) = open();
        let records: Vec<NewRecord> = (1u64..).zip(&times).map(|(seq, (owner, topic, time, stored))| NewRecord {
            captured_at: Timestamp(*time),
            state: if *stored { Stored } else { Quarantined },
            // Some topics never, some occasionally.
            filters: (1..5).filter(|tag| (u64::from(*topic) + seq / 7).is_multiple_of(*tag)).map(tag).collect(),
            ..record(*owner, *topic, seq)
        }).collect();
        ledger.records.append(records.clone()).expect("acknowledged");
        let state = stored.map(|stored| if stored { Stored } else { Quarantined });
        let mut query = RecordQuery {
            owner: owner.map(|owner| Address([owner; 20])),
            topic: topic.map(|topic| record(1, topic, 1).topic),
            state,
            since: since.map(Timestamp),
            until: until.map(Timestamp),
            limit,
            newest_first,
            filters: tagged.map(|number| tag(number).into()).into_iter().collect(),
            ..RecordQuery::default()
        };
        let mut expected: Vec<&NewRecord> = records.iter().filter(|record| {
            query.owner.is_none_or(|owner| owner == record.owner)
                && query.topic.as_ref().is_none_or(|topic| *topic == record.topic)
                && state.is_none_or(|state| state == record.state)
                && since.is_none_or(|since| record.captured_at.0 >= since)
                && until.is_none_or(|until| record.captured_at.0 < until)
                && tagged.is_none_or(|number| record.filters.contains(&tag(number)))
        }).collect();
        expected.sort_by_key(|record| (record.captured_at, record.seq));
        if newest_first {
            expected.reverse();
        }
        let mut found = Vec::new();
        loop {
            let page = ledger.records.list(&query).expect("page");
            prop_assert!(page.rows.len() <= limit);
            found.extend(page.rows.into_iter().map(|row| row.digest));
            let Some(next) = page.next else { break };
            query.after = Some(next);
        }
        prop_assert_eq!(found, expected.iter().map(|record| record.digest).collect::<Vec<_>>());
    }

    #[test]
    fn any_text_as_cursor_or_id_is_an_answer_or_a_clear_error(text in ".{0,40}|[0-9a-f]{0,70}") {
        let (_home, ledger) = open();
        if let Err(error) = ledger.records.by_id(&text) {
            prop_assert_eq!(error.kind(), ErrorKind::Input);
        }
        let query = RecordQuery { after: Some(text), ..RecordQuery::default() };
        if let Err(error) = ledger.records.list(&query) {
            prop_assert_eq!(error.kind(), ErrorKind::Input);
        }
    }
}

#[test]
fn a_record_is_found_by_all_of_its_tags_and_no_other() {
    let (_home, ledger) = open();
    let tagged = NewRecord { filters: vec![tag(1), tag(2)], ..record(1, 1, 1) };
    ledger.records.append(vec![tagged.clone(), record(1, 2, 1)]).expect("acknowledged");
    let found = |filters: Vec<FilterId>| {
        let page = ledger
            .records
            .list(&RecordQuery { filters: filters.into_iter().map(Into::into).collect(), ..RecordQuery::default() })
            .expect("page");
        page.rows.iter().map(|row| row.digest).collect::<Vec<_>>()
    };
    assert_eq!(found(vec![tag(1), tag(2)]), [tagged.digest]);
    assert_eq!(found(vec![tag(1), tag(3)]), []);
    assert_eq!(found(Vec::new()).len(), 2);
}

#[test]
fn a_choice_finds_the_id_of_all_topics_and_that_of_its_own() {
    let (_home, ledger) = open();
    let with = |topic: u8, number: u64, seq: u64| NewRecord { filters: vec![tag(number)], ..record(1, topic, seq) };
    // Tag 1 is from IK; 2 and 3 are what the filter keys of topics 1 and 2 make of the same words.
    let rows = [with(1, 1, 1), with(1, 2, 2), with(2, 3, 1), with(2, 2, 2), with(3, 4, 1)];
    ledger.records.append(rows.to_vec()).expect("acknowledged");
    let by_topic = [(TopicId([1; 16]), tag(2)), (TopicId([2; 16]), tag(3))].into();
    let choice = crate::FilterChoice { id: tag(1), by_topic };
    let found = |filters: Vec<crate::FilterChoice>| {
        let page = ledger.records.list(&RecordQuery { filters, ..RecordQuery::default() }).expect("page");
        page.rows.iter().map(|row| row.digest).collect::<std::collections::BTreeSet<_>>()
    };
    let expected = rows[..3].iter().map(|row| row.digest).collect();
    assert_eq!(found(vec![choice.clone()]), expected, "that of topic 1 says nothing on topic 2");
    assert!(found(vec![choice, tag(4).into()]).is_empty());
}

server::on_a_server! {
    pages_are_complete_and_in_order, a_record_is_found_by_all_of_its_tags_and_no_other, a_choice_finds_the_id_of_all_topics_and_that_of_its_own,
}
