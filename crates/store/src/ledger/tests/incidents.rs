//! Incidents: their scope, what they exempt from retention, and that each belongs to one owner alone.

use super::*;
use crate::sql::params;

const OWNER: Address = Address([1; 20]);

fn name(text: &str) -> IncidentName {
    text.parse().expect("a name")
}

fn span(since: u64, until: Option<u64>, topics: &[&str]) -> IncidentSpan {
    let topics = TopicPatterns(topics.iter().map(|topic| topic.parse().expect("a pattern")).collect());
    IncidentSpan { since: Timestamp(since), until: until.map(Timestamp), topics }
}

/// Acknowledges records and moves them into a state, as the line does in many steps.
fn append_in(ledger: &Ledger, state: RecordState, records: Vec<NewRecord>) {
    let digests: Vec<Digest> = records.iter().map(|record| record.digest).collect();
    ledger.records.append(records).expect("acknowledged");
    let moved = ledger.database.write(move |session| {
        let sql = "UPDATE records SET state = ?1 WHERE digest = ?2";
        let connection = session.connection;
        digests.iter().try_for_each(|digest| Ok(connection.changed(sql, params![state.code(), digest.0]).map(drop)?))
    });
    moved.expect("moved");
}

/// Names these records of a topic in a verified retention record.
fn give_up(ledger: &Ledger, topic: &KeptTopic, limit: usize) {
    let due = ledger.retention.oldest(topic, (Timestamp(0), Timestamp(2_000)), limit).expect("read");
    let named = due.into_iter().map(|record| (record, vec![1])).collect();
    let number = record(1, 9, topic.key.unsigned_abs());
    let report = NewRecord { kind: RecordKind::Retention, topic: "authros/retention".to_owned(), ..number };
    ledger.retention.give_up(topic, report.clone(), named).expect("named");
    append_in(ledger, Verified, vec![report]);
}

#[test]
fn incidents_outlive_the_process_and_are_of_one_owner() {
    let (home, ledger) = open();
    let crash = span(5, Some(9), &["/odom", "/scan", "/odom"]);
    assert_eq!(ledger.incidents.open(OWNER, &name("crash"), &crash, Some("a\u{1b}b")), Ok(true));
    assert_eq!(ledger.incidents.open(OWNER, &name("crash"), &span(1, None, &[]), Some("other")), Ok(false));
    let other = Address([2; 20]);
    assert_eq!(ledger.incidents.open(other, &name("crash"), &span(1, None, &[]), None), Ok(true));
    assert_eq!(ledger.incidents.note(OWNER, &name("crash"), "second"), Ok(true));
    assert_eq!(ledger.incidents.note(OWNER, &name("none"), "lost"), Ok(false));
    ledger.close().expect("closed");

    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
    let rows = ledger.incidents.list(OWNER).expect("read");
    assert_eq!(rows.len(), 1);
    let row = ledger.incidents.find(OWNER, &name("crash")).expect("read").expect("there");
    assert_eq!(rows, std::slice::from_ref(&row));
    assert_eq!((row.name.as_str(), row.span, row.closed_at), ("crash", span(5, Some(9), &["/odom", "/scan"]), None));
    let notes: Vec<&str> = row.notes.iter().map(|note| note.text.as_str()).collect();
    assert_eq!(notes, ["a\u{1b}b", "second"]);

    assert_eq!(ledger.incidents.remove(OWNER, &name("crash")), Ok(true));
    assert_eq!(
        (ledger.incidents.remove(OWNER, &name("crash")), ledger.incidents.list(OWNER)),
        (Ok(false), Ok(Vec::new()))
    );
    assert_eq!(ledger.incidents.list(other).expect("read").len(), 1, "another's stays");
    assert_eq!(ledger.incidents.open(OWNER, &name("crash"), &span(1, None, &[]), None), Ok(true));
    let again = ledger.incidents.find(OWNER, &name("crash")).expect("read").expect("there");
    assert_eq!((again.notes.len(), again.span.topics.0.len()), (0, 0), "nothing of the one before");
}

#[test]
fn closing_ends_a_span_that_goes_on_and_leaves_one_that_has_ended() {
    let (_home, ledger) = open();
    let future = Timestamp::now().0 + 3_600_000_000_000;
    for (word, until) in [("past", Some(9)), ("endless", None), ("future", Some(future))] {
        ledger.incidents.open(OWNER, &name(word), &span(5, until, &[]), None).expect("written");
        assert_eq!(ledger.incidents.close(OWNER, &name(word)), Ok(true));
        assert_eq!(ledger.incidents.close(OWNER, &name(word)), Ok(false), "closed once");
    }
    assert_eq!(ledger.incidents.close(OWNER, &name("none")), Ok(false));
    let closed = |word| ledger.incidents.find(OWNER, &name(word)).expect("read").expect("there");
    assert_eq!(closed("past").span.until, Some(Timestamp(9)));
    for word in ["endless", "future"] {
        let row = closed(word);
        assert!(row.closed_at.is_some() && row.span.until == row.closed_at, "{row:?}");
    }
}

#[test]
fn coverage_tells_what_there_is_of_each_topic() {
    let (_home, ledger) = open();
    let definition = NewRecord { kind: RecordKind::Definition, ..record(1, 1, 8) };
    append_in(&ledger, Verified, vec![record(1, 1, 1), record(1, 1, 5), record(1, 2, 1)]);
    append_in(&ledger, RecordState::Quarantined, vec![record(1, 1, 7)]);
    append_in(&ledger, RecordState::Dropped, vec![record(1, 1, 9)]);
    ledger.records.append(vec![record(1, 1, 2), definition]).expect("acknowledged");
    ledger.records.append(vec![record(2, 1, 1)]).expect("another owner's");
    let lost = Loss {
        topic: "/robot1/odom".to_owned(),
        first_at: Timestamp(900),
        last_at: Timestamp(1_001),
        ..loss(LossReason::Memory, 3)
    };
    ledger.losses.count(vec![lost]).expect("counted");

    let found =
        ledger.incidents.span_coverage(OWNER, &span(1_001, Some(1_100), &["/robot1/odom", "/never"])).expect("read");
    let never = SpanCoverage { topic: "/never".to_owned(), ..SpanCoverage::default() };
    let odom = SpanCoverage {
        topic: "/robot1/odom".to_owned(),
        records: 3,
        // 101 + 102 + 105, as `record` has them.
        bytes: 308,
        first: Some(Timestamp(1_001)),
        last: Some(Timestamp(1_005)),
        deleted: 0,
        quarantined: 1,
        lost: 3,
    };
    assert_eq!(found, [never, odom]);
    let all = ledger.incidents.span_coverage(OWNER, &span(1_002, None, &[])).expect("read");
    let told: Vec<(&str, u64, u64)> = all.iter().map(|one| (one.topic.as_str(), one.records, one.lost)).collect();
    assert_eq!(told, [("/robot1/odom", 2, 0)], "the end of a span is not in it, and neither is a loss before it");
}

#[test]
fn what_was_named_and_not_yet_deleted_stays_as_long_as_an_incident_holds_it() {
    let (_home, ledger) = open();
    let old = [record(1, 1, 1), record(1, 1, 2)];
    append_in(&ledger, Verified, old.to_vec());
    let topic = ledger.retention.topics(OWNER).expect("read").pop().expect("a topic");
    give_up(&ledger, &topic, 9);
    let both = vec![old[0].digest, old[1].digest];
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(both.clone()));
    ledger.incidents.open(OWNER, &name("first"), &span(1_001, Some(1_002), &["/robot1/odom"]), None).expect("opened");
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(vec![old[1].digest]));
    ledger.incidents.open(OWNER, &name("all"), &span(0, None, &[]), None).expect("opened");
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(Vec::new()), "two overlap");
    ledger.incidents.remove(OWNER, &name("first")).expect("removed");
    ledger.incidents.close(OWNER, &name("all")).expect("closed");
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(Vec::new()), "one is left, closed or not");
    ledger.incidents.remove(OWNER, &name("all")).expect("removed");
    ledger.incidents.open(OWNER, &name("other"), &span(0, None, &["/robot2/odom"]), None).expect("opened");
    ledger.incidents.open(Address([2; 20]), &name("all"), &span(0, None, &[]), None).expect("another's");
    assert_eq!(ledger.retention.to_delete(OWNER, 9), Ok(both));
}

#[test]
fn bytes_of_a_stretch_leave_out_what_was_given_up_and_what_was_dropped() {
    let (_home, ledger) = open();
    append_in(&ledger, Verified, vec![record(1, 1, 1), record(1, 1, 2)]);
    append_in(&ledger, RecordState::Dropped, vec![record(1, 1, 4)]);
    ledger.records.append(vec![record(1, 1, 3)]).expect("acknowledged");
    let topic = ledger.retention.topics(OWNER).expect("read").pop().expect("a topic");
    let between =
        |since, until| ledger.incidents.bytes_between(topic.key, (Timestamp(since), Timestamp(until))).expect("read");
    assert_eq!((between(1_001, 1_003), between(0, 9_999), between(1_004, 9_999)), (203, 306, 0));
    give_up(&ledger, &topic, 1);
    assert_eq!(between(0, 9_999), 205);
}

#[test]
fn a_list_takes_records_of_several_topics_and_of_patterns() {
    let (_home, ledger) = open();
    ledger.records.append(vec![record(1, 1, 1), record(1, 2, 1), record(1, 3, 1)]).expect("acknowledged");
    let listed = |topics: &[&str]| -> Vec<String> {
        let topics = topics.iter().map(|patterns| patterns.parse().expect("patterns")).collect();
        let page = ledger.records.list(&RecordQuery { topics, ..RecordQuery::default() }).expect("listed");
        page.rows.into_iter().map(|row| row.topic).collect()
    };
    assert_eq!(listed(&["/robot1/odom, /robot3/odom, /none"]), ["/robot1/odom", "/robot3/odom"]);
    assert_eq!(listed(&["/robot*/odom", "/robot2/**, /robot3/odom"]), ["/robot2/odom", "/robot3/odom"], "of each");
    assert!(listed(&["/robot*/camera/**"]).is_empty());
}

#[test]
fn an_incident_by_pattern_holds_topics_that_come_later() {
    let (_home, ledger) = open();
    let of = |topic| vec![record(1, topic, 1), record(1, topic, 2)];
    let about = span(0, None, &["/never/**", "/robot1*/odom"]);
    ledger.incidents.open(OWNER, &name("fall"), &about, None).expect("opened");
    append_in(&ledger, Verified, [of(1), of(2), of(12)].concat());
    let kept = ledger.incidents.find(OWNER, &name("fall")).expect("read").expect("there");
    assert_eq!(kept.span, about);
    let coverage = ledger.incidents.span_coverage(OWNER, &about).expect("counted");
    let told: Vec<_> = coverage.iter().map(|one| (one.topic.as_str(), one.records)).collect();
    assert_eq!(told, [("/never/**", 0), ("/robot1/odom", 2), ("/robot12/odom", 2)]);
    for topic in ledger.retention.topics(OWNER).expect("read") {
        give_up(&ledger, &topic, 2);
    }
    let deleted = ledger.retention.to_delete(OWNER, 9).expect("read");
    assert_eq!(deleted.len(), 2, "only those of /robot2/odom");
    ledger.incidents.remove(OWNER, &name("fall")).expect("removed");
    assert_eq!(ledger.retention.to_delete(OWNER, 9).expect("read").len(), 6);
}
