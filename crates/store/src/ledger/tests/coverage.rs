//! When there are records of a topic: compared with what was put in, part by part.

use super::*;
use crate::ledger::counts::{Coverage, CoverageQuery};

const OWNER: Address = Address([1; 20]);

fn at(seq: u64, captured_at: u64) -> NewRecord {
    NewRecord { captured_at: Timestamp(captured_at), ..record(1, 1, seq) }
}

fn query(since: Option<u64>, until: u64, parts: usize) -> CoverageQuery {
    let topics = vec!["/robot1/odom".to_owned()];
    CoverageQuery { owner: OWNER, topics, signers: None, since: since.map(Timestamp), until: Timestamp(until), parts }
}

fn covered(ledger: &Ledger, query: &CoverageQuery) -> Coverage {
    ledger.counts.coverage(query).expect("read").pop().expect("of the topic")
}

/// A letter for each part: d = data, q = quarantined, t = tampered, l = lost, `.` = nothing.
fn strip(coverage: &Coverage) -> Vec<String> {
    let letters = |part: &crate::ledger::counts::CoveragePart| {
        let all = [(part.data, 'd'), (part.quarantined, 'q'), (part.tampered, 't'), (part.lost > 0, 'l')];
        let text: String = all.iter().filter(|(is, _)| *is).map(|(_, letter)| *letter).collect();
        if text.is_empty() { ".".to_owned() } else { text }
    };
    coverage.parts.iter().map(letters).collect()
}

#[test]
fn each_part_says_what_there_is_of_it() {
    let (_home, ledger) = open();
    let held = NewRecord { state: RecordState::Quarantined, ..at(5, 355) };
    // 100 to 500 in four parts of 100; /robot2 is another topic, the one at 500 is behind the end.
    let mut records = vec![at(1, 100), at(2, 199), at(3, 310), at(4, 500), held];
    records.push(NewRecord { captured_at: Timestamp(250), ..record(1, 2, 1) });
    ledger.records.append(records).expect("acknowledged");
    let lost = Loss {
        topic: "/robot1/odom".to_owned(),
        first_at: Timestamp(299),
        last_at: Timestamp(301),
        ..loss(LossReason::Transport, 7)
    };
    let elsewhere = loss(LossReason::Memory, 2);
    ledger.losses.count(vec![lost, elsewhere]).expect("counted");
    let coverage = covered(&ledger, &query(Some(100), 500, 4));
    assert_eq!(strip(&coverage), ["d", "l", "dql", "."]);
    assert_eq!(
        coverage.parts.iter().map(|part| (part.at.0, part.lost)).collect::<Vec<_>>(),
        [(100, 0), (200, 7), (300, 7), (400, 0)]
    );
    assert_eq!((coverage.first, coverage.last), (Some(Timestamp(100)), Some(Timestamp(500))));
    let whole = covered(&ledger, &query(None, 600, 1));
    assert_eq!((whole.since, strip(&whole)), (Timestamp(100), vec!["dql".to_owned()]));
}

#[test]
fn several_topics_begin_with_the_first_record_of_any() {
    let (_home, ledger) = open();
    let other = NewRecord { captured_at: Timestamp(150), ..record(1, 2, 1) };
    ledger.records.append(vec![at(1, 310), other]).expect("acknowledged");
    let topics = ["/robot1/odom", "/robot2/odom", "/never"].map(str::to_owned).to_vec();
    let found = ledger.counts.coverage(&CoverageQuery { topics, ..query(None, 550, 4) }).expect("read");
    let told: Vec<_> = found.iter().map(|one| (one.since.0, one.first.map(|at| at.0), strip(one).concat())).collect();
    let expected = [(150, Some(310), ".d.."), (150, Some(150), "d..."), (150, None, "....")];
    assert_eq!(told, expected.map(|(since, first, strip)| (since, first, strip.to_owned())));
}

#[test]
fn two_robots_of_one_topic_have_a_timeline_each() {
    let (_home, ledger) = open();
    let [one, other] = [SignerId([7; 32]), SignerId([8; 32])];
    let of = |signer: SignerId, recorder: u8, seq: u64, captured_at: u64| NewRecord {
        digest: Digest([16 * recorder + u8::try_from(seq).expect("few"); 32]),
        signer,
        foreign: Some(Foreign { recorder: RecorderId([recorder; 16]), keeper: Address([9; 20]) }),
        ..at(seq, captured_at)
    };
    // The second one takes turns with its ring, whose recorder is another.
    let records = vec![of(one, 1, 1, 110), of(one, 1, 2, 120), of(other, 2, 1, 310), of(other, 3, 1, 420)];
    ledger.records.append(records).expect("acknowledged");
    let topic = "/robot1/odom".to_owned();
    let lost = Loss { topic, first_at: Timestamp(210), last_at: Timestamp(210), ..loss(LossReason::Transport, 7) };
    ledger.losses.count(vec![lost]).expect("counted");
    let of = |signers: &[SignerId]| {
        let signers = Some(signers.iter().copied().collect());
        covered(&ledger, &CoverageQuery { signers, ..query(Some(100), 500, 4) })
    };
    let all = covered(&ledger, &query(Some(100), 500, 4));
    assert_eq!((strip(&all).concat().as_str(), all.signers.len()), ("dldd", 2));
    let first = of(&[one]);
    assert_eq!(strip(&first).concat(), "d...", "a loss of this site is none of the robot's");
    assert_eq!((first.first, first.last, &first.signers), (Some(Timestamp(110)), Some(Timestamp(120)), &all.signers));
    let second = of(&[other]);
    assert_eq!((strip(&second).concat().as_str(), second.first), ("..dd", Some(Timestamp(310))));
    assert_eq!(strip(&of(&[one, other])).concat(), "d.dd");
    assert_eq!((of(&[]).first, of(&[SignerId([9; 32])]).first), (None, None));
}

#[test]
fn a_topic_without_records_and_a_span_without_length_are_no_errors() {
    let (_home, ledger) = open();
    let nothing = covered(&ledger, &query(None, 600, 60));
    assert_eq!((nothing.first, nothing.since, strip(&nothing)), (None, Timestamp(600), vec![".".to_owned()]));
    let turned = covered(&ledger, &query(Some(900), 600, 0));
    assert_eq!((turned.since, turned.parts.len()), (Timestamp(600), 1));
    assert_eq!(covered(&ledger, &query(Some(0), 10, 60)).parts.len(), 10, "no part is shorter than 1 ns");
}

server::on_a_server! {
    a_topic_without_records_and_a_span_without_length_are_no_errors,
}
