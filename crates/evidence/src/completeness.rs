//! Level (f): which numbers of a topic are there, and which are not. Nothing is claimed before the first or after the last,
//! and only records count whose signer is shown: anybody can seal a record in another's name.

use std::collections::{BTreeMap, BTreeSet};

use authros_model::{Address, RecorderId, TopicId};

use crate::report::{RecordReport, Standing, Stretch};

/// The most gaps that are named.
const MOST_GAPS: usize = 100;

/// One topic of one recorder.
type Topic = (Address, RecorderId, TopicId);
/// Its records by their numbers.
type Numbered<'a> = BTreeMap<u64, Vec<&'a RecordReport>>;

/// The stretches of all records whose bytes hold.
pub(crate) fn stretches(records: &[RecordReport]) -> Vec<Stretch> {
    let mut topics: BTreeMap<Topic, Numbered<'_>> = BTreeMap::new();
    for record in records.iter().filter(|record| record.bytes.standing == Standing::Proven) {
        let (Some(owner), Some(recorder), Some(topic), Some(seq)) =
            (record.owner, record.recorder, record.topic_id, record.seq)
        else {
            continue;
        };
        topics.entry((owner, recorder, topic)).or_default().entry(seq).or_default().push(record);
    }
    topics.into_iter().map(|(of, numbered)| stretch(of, &numbered)).collect()
}

/// Whether these records of one number are two histories of one signer: both are believed, or both have the key that is
/// shown to be the owner's for one of them.
fn is_twice(records: &[&RecordReport]) -> bool {
    let mut believed = records.iter().filter(|record| record.is_believed());
    let Some(one) = believed.next() else { return false };
    let same = |record: &&&RecordReport| record.digest != one.digest && record.signer == one.signer;
    believed.next().is_some() || records.iter().any(|record| same(&record))
}

fn stretch((owner, recorder, topic_id): Topic, numbered: &Numbered<'_>) -> Stretch {
    let all = || numbered.values().flatten();
    let uncounted = all().filter(|record| !record.is_believed()).count() as u64;
    let own = all().any(|record| record.key.standing == Standing::OwnChain);
    let believed = |records: &[&RecordReport]| records.iter().any(|record| record.is_believed());
    let numbers: BTreeSet<u64> =
        numbered.iter().filter(|(_, records)| believed(records)).map(|(number, _)| *number).collect();
    let twice: Vec<u64> = numbered.iter().filter(|(_, records)| is_twice(records)).map(|(number, _)| *number).collect();
    let standing = match (twice.is_empty(), numbers.is_empty(), own) {
        (false, ..) => Standing::Refused,
        (true, true, _) => Standing::Unproven,
        (true, false, true) => Standing::OwnChain,
        (true, false, false) => Standing::Proven,
    };
    let between = numbers.iter().zip(numbers.iter().skip(1)).filter(|(one, next)| **next - **one > 1);
    let gaps: Vec<(u64, u64)> = between.map(|(one, next)| (one + 1, next - 1)).collect();
    let missing = gaps.iter().map(|(from, to)| to - from + 1).sum();
    let (first, last) = (numbers.first().copied(), numbers.last().copied());
    let text = told(first.zip(last), &gaps, missing, twice.first().copied(), uncounted);
    let gaps = gaps.into_iter().take(MOST_GAPS).collect();
    Stretch { owner, recorder, topic_id, standing, first, last, gaps, missing, uncounted, twice, text }
}

fn told(ends: Option<(u64, u64)>, gaps: &[(u64, u64)], missing: u64, twice: Option<u64>, uncounted: u64) -> String {
    let Some((first, last)) = ends else {
        return format!("nothing is claimed: the signers of its {uncounted} records are not proven");
    };
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
    if uncounted > 0 {
        text.push_str(&format!("; and {uncounted} records whose signer is not proven, not counted"));
    }
    match twice {
        Some(number) => format!("TWO different records are number {number}: their signer told two histories; {text}"),
        None => text,
    }
}

fn range(from: u64, to: u64) -> String {
    if from == to { from.to_string() } else { format!("{from}-{to}") }
}
