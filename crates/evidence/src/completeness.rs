//! Level (f): which numbers of a topic are there, and which are not. Nothing is claimed before the first or after the last.

use std::collections::{BTreeMap, BTreeSet};

use authros_model::{Address, RecorderId, TopicId};

use crate::report::{RecordReport, Standing, Stretch};

/// The most gaps that are named.
const MOST_GAPS: usize = 100;

/// One topic of one recorder.
type Topic = (Address, RecorderId, TopicId);
/// Numbers that are there, and those that two records have.
type Numbers = (BTreeSet<u64>, BTreeSet<u64>);

/// The stretches of all records whose bytes hold.
pub(crate) fn stretches(records: &[RecordReport]) -> Vec<Stretch> {
    let mut topics: BTreeMap<Topic, Numbers> = BTreeMap::new();
    for record in records.iter().filter(|record| record.bytes.standing == Standing::Proven) {
        let (Some(owner), Some(recorder), Some(topic), Some(seq)) =
            (record.owner, record.recorder, record.topic_id, record.seq)
        else {
            continue;
        };
        let (numbers, twice) = topics.entry((owner, recorder, topic)).or_default();
        if !numbers.insert(seq) {
            twice.insert(seq);
        }
    }
    topics.into_iter().filter_map(|(of, (numbers, twice))| stretch(of, &numbers, twice)).collect()
}

fn stretch((owner, recorder, topic_id): Topic, numbers: &BTreeSet<u64>, twice: BTreeSet<u64>) -> Option<Stretch> {
    let (first, last) = (*numbers.first()?, *numbers.last()?);
    let between = numbers.iter().zip(numbers.iter().skip(1)).filter(|(one, next)| **next - **one > 1);
    let gaps: Vec<(u64, u64)> = between.map(|(one, next)| (one + 1, next - 1)).collect();
    let missing = gaps.iter().map(|(from, to)| to - from + 1).sum();
    let named: Vec<String> = gaps.iter().take(10).map(|(from, to)| range(*from, *to)).collect();
    let mut text = match gaps.len() {
        0 => format!("every number from {first} to {last}"),
        gaps => format!(
            "{first} to {last} without {}{} ({missing} missing)",
            named.join(", "),
            if gaps > named.len() { " and more" } else { "" }
        ),
    };
    text.push_str("; nothing is claimed before or after");
    if let Some(number) = twice.first() {
        text = format!("TWO different records are number {number}: their signer told two histories; {text}");
    }
    let gaps = gaps.into_iter().take(MOST_GAPS).collect();
    Some(Stretch { owner, recorder, topic_id, first, last, gaps, missing, twice: twice.into_iter().collect(), text })
}

fn range(from: u64, to: u64) -> String {
    if from == to { from.to_string() } else { format!("{from}-{to}") }
}
