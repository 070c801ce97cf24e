//! Level (f): which numbers of a topic are present. A recorder's head says how high they were at a time; nothing is
//! claimed after that. Only records whose signer is proven count: anybody can seal a record in another's name.

use std::collections::{BTreeMap, BTreeSet};

use authros_crypto::merkle::{LONGEST_PATH, height_hash, root_of};
use authros_model::{Address, Birth, Digest, Hash, Heads, RecorderId, SignerId, TopicId, counted};
use serde::{Deserialize, Serialize};

use crate::report::{HeadsClaim, Reason, RecordReport, Standing, Stretch};
use crate::{BundleError, verify::Messages};

const MOST_GAPS: usize = 100;

type Recorder = (Address, SignerId, RecorderId);
type Topic = (Address, SignerId, RecorderId, TopicId);
type Numbered<'a> = BTreeMap<u64, Vec<&'a RecordReport>>;

pub(crate) fn stretches(heights: &[Height], records: &[RecordReport], messages: &Messages) -> Vec<Stretch> {
    let mut topics: BTreeMap<Topic, Numbered<'_>> = BTreeMap::new();
    for record in records.iter().filter(|record| record.bytes.standing == Standing::Proven) {
        let (Some(owner), Some(signer), Some(recorder), Some(topic), Some(seq)) =
            (record.owner, record.signer, record.recorder, record.topic_id, record.seq)
        else {
            continue;
        };
        topics.entry((owner, signer, recorder, topic)).or_default().entry(seq).or_default().push(record);
    }
    let stretch = |(of, numbered): (Topic, Numbered<'_>)| {
        let mut stretch = stretch(of, &numbered, &claims(heights, records, messages, of));
        if let Some((record, birth)) = birth(records, messages, (of.0, of.1, of.2)) {
            (stretch.born_at, stretch.predecessor) = (record.anchored_at, birth.predecessor);
        }
        let own = are_statements(&numbered);
        stretch.own_statements = own;
        if own {
            // They were included for the sake of other topics: nobody claims that these are all.
            (stretch.gaps, stretch.missing, stretch.heads) = (Vec::new(), 0, None);
        }
        stretch.text = if of.2.is_ring() { told_of_ring(&stretch) } else { told(&stretch, own) };
        if of.2.is_ring() {
            // What is not there fell out of the ring, or was not asked for: no number of it is missing.
            (stretch.gaps, stretch.missing, stretch.heads) = (Vec::new(), 0, None);
        }
        stretch
    };
    topics.into_iter().map(stretch).collect()
}

/// Whether there are counted records, all of them the recorder's own statements.
fn are_statements(numbered: &Numbered<'_>) -> bool {
    let mut believed = numbered.values().flatten().filter(|record| record.is_believed()).peekable();
    believed.peek().is_some() && believed.all(|record| record.is_statement())
}

/// Whether these records of one number are two histories, the key being proven the owner's for one of them.
fn is_twice(records: &[&RecordReport]) -> bool {
    records.len() > 1 && records.iter().any(|record| record.is_believed())
}

/// Whether heads contradict themselves or each other: a path that does not lead to the root, a number that decreased.
fn contradict(claims: &[Claim<'_>]) -> bool {
    let numbers = || claims.iter().map(|claim| claim.number);
    numbers().any(|number| number.is_none()) || numbers().zip(numbers().skip(1)).any(|(one, next)| next < one)
}

fn stretch((owner, signer, recorder, topic_id): Topic, numbered: &Numbered<'_>, claims: &[Claim<'_>]) -> Stretch {
    let all = || numbered.values().flatten();
    let uncounted = all().filter(|record| !record.is_believed()).count() as u64;
    let heads = claims.last().and_then(|claim| {
        Some(HeadsClaim { record: claim.record.digest, number: claim.number?, at: claim.record.anchored_at })
    });
    let of_heads = claims.last().map(|claim| claim.record);
    let own = all().copied().chain(of_heads).any(|record| record.key.standing == Standing::OwnChain);
    let believed = |records: &[&RecordReport]| records.iter().any(|record| record.is_believed());
    let numbers: BTreeSet<u64> =
        numbered.iter().filter(|(_, records)| believed(records)).map(|(number, _)| *number).collect();
    let twice: Vec<u64> = numbered.iter().filter(|(_, records)| is_twice(records)).map(|(number, _)| *number).collect();
    let standing = match (twice.is_empty() && !contradict(claims), numbers.is_empty(), own) {
        (false, ..) => Standing::Refused,
        (true, true, _) => Standing::Unproven,
        (true, false, true) => Standing::OwnChain,
        (true, false, false) => Standing::Proven,
    };
    let reason = match (twice.is_empty(), standing) {
        (false, _) => Some(Reason::TwoHistories),
        (true, Standing::Refused) => Some(Reason::FalseHeads),
        (true, _) => None,
    };
    let (first, last) = (numbers.first().copied(), numbers.last().copied());
    let between = numbers.iter().zip(numbers.iter().skip(1)).filter(|(one, next)| **next - **one > 1);
    let mut gaps: Vec<(u64, u64)> = between.map(|(one, next)| (one + 1, next - 1)).collect();
    // Named by the head and missing in the file: the end was left out.
    let tail = last.zip(heads).filter(|(last, heads)| heads.number > *last);
    gaps.extend(tail.map(|(last, heads)| (last + 1, heads.number)));
    let missing = gaps.iter().map(|(from, to)| (to - from).saturating_add(1)).fold(0, u64::saturating_add);
    gaps.truncate(MOST_GAPS);
    Stretch {
        owner,
        signer,
        recorder,
        topic_id,
        standing,
        reason,
        own_statements: false,
        first,
        last,
        gaps,
        missing,
        uncounted,
        twice,
        heads,
        born_at: None,
        predecessor: None,
        text: String::new(),
    }
}

fn told(stretch: &Stretch, own_statements: bool) -> String {
    let Some((first, last)) = stretch.first.zip(stretch.last) else {
        return format!(
            "nothing can be claimed: the signers of its {} are not proven",
            counted(stretch.uncounted, "record")
        );
    };
    let named: Vec<String> = stretch.gaps.iter().take(10).map(|(from, to)| range(*from, *to)).collect();
    let mut text = match stretch.gaps.len() {
        _ if own_statements => "the recorder's own statements".to_owned(),
        0 => format!("every number from {first} to {last}"),
        gaps => format!(
            "{first} to {last} without {}{} ({} missing)",
            named.join(", "),
            if gaps > named.len() { " and more" } else { "" },
            stretch.missing
        ),
    };
    if !own_statements {
        text.push_str(&until(stretch, first, last));
    }
    if let Some(predecessor) = stretch.predecessor {
        text.push_str(&format!(
            "; its recorder follows {predecessor}, after a restore, on a copy, or with another key"
        ));
    }
    text.push_str(&uncounted(stretch));
    match (stretch.twice.first(), stretch.standing) {
        (Some(number), _) => {
            format!("TWO different records carry number {number}: their signer told two histories; {text}")
        }
        (None, Standing::Refused) => {
            format!("the heads of its recorder contradict each other, or lack the numbers named; {text}")
        }
        _ => text,
    }
}

fn told_of_ring(stretch: &Stretch) -> String {
    let Some((first, last)) = stretch.first.zip(stretch.last).filter(|_| stretch.standing != Standing::Refused) else {
        return told(stretch, true);
    };
    let mut parts = Vec::new();
    let mut from = first;
    for (gap, behind) in &stretch.gaps {
        parts.push(range(from, gap.saturating_sub(1)));
        from = behind.saturating_add(1);
    }
    parts.push(range(from, last));
    let more = if parts.len() > 10 { " and more" } else { "" };
    parts.truncate(10);
    let text = format!(
        "of a robot's ring every number of {}{more}; other numbers of a ring expired or were not requested: nothing is \
         claimed about them",
        parts.join(", ")
    );
    text + &uncounted(stretch)
}

fn uncounted(stretch: &Stretch) -> String {
    match stretch.uncounted {
        0 => String::new(),
        count => format!("; and {} whose signer is not proven, not counted", counted(count, "record")),
    }
}

fn until(stretch: &Stretch, first: u64, last: u64) -> String {
    let before = if first == 1 { String::new() } else { format!(" before {first} or") };
    let Some(HeadsClaim { number, at, .. }) = stretch.heads else {
        return format!("; there is no heads record: nothing is claimed{before} after {last}");
    };
    let at = at.map_or_else(|| "of unknown time".to_owned(), |at| format!("at {at}"));
    if number < first {
        return format!(
            "; the heads record {at} names number {number}, which is before the first one here, so it says nothing \
             about these; nothing is claimed{before} after {last}"
        );
    }
    let claim = match stretch.gaps.iter().any(|(from, _)| *from <= number) {
        false => format!("; complete to number {number} as of the heads record {at}"),
        true => format!("; NOT complete to number {number}, which the heads record {at} names"),
    };
    format!("{claim}; nothing is claimed{before} after that")
}

fn range(from: u64, to: u64) -> String {
    if from == to { from.to_string() } else { format!("{from}-{to}") }
}

pub(crate) const HEIGHTS: &str = "heights.json";
/// The most entries.
pub const MOST_HEIGHTS: usize = crate::MOST_RECORDS;
const FORMAT: &str = "authros-heights/1";
/// The name under which recorders' own statements are filed.
pub(crate) const TOPIC: &str = "authros/recorder";

/// The statement that a head has this highest number of a topic, with the path to its root.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Height {
    /// The record of the head.
    pub heads: Digest,
    /// The topic.
    pub topic: TopicId,
    /// Its highest number.
    pub number: u64,
    /// The leaf's place, from 0.
    pub index: u64,
    /// Hashes from the leaf up.
    pub path: Vec<Hash>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Listed {
    format: String,
    heights: Vec<Height>,
}

pub(crate) fn parse(text: &[u8]) -> Result<Vec<Height>, BundleError> {
    let wrong = |why: &str| BundleError::of(HEIGHTS, why);
    let listed: Listed = crate::manifest::from_json(text).map_err(|error| wrong(&error))?;
    if listed.format != FORMAT {
        return Err(wrong(&format!("its format is not {FORMAT}")));
    }
    if listed.heights.len() > MOST_HEIGHTS {
        return Err(wrong(&format!("it has more than {MOST_HEIGHTS} entries")));
    }
    if listed.heights.iter().any(|height| height.path.len() > LONGEST_PATH) {
        return Err(wrong("a path is longer than in any head"));
    }
    Ok(listed.heights)
}

pub(crate) fn to_text(heights: Vec<Height>) -> Result<Vec<u8>, BundleError> {
    let listed = Listed { format: FORMAT.to_owned(), heights };
    crate::manifest::to_json(HEIGHTS, &listed)
}

/// A recorder's trusted statement: its signer is proven, and the message opens.
fn statement<'a>(record: &'a RecordReport, messages: &'a Messages, type_name: &str) -> Option<&'a [u8]> {
    let message = messages.get(&record.digest).filter(|_| record.is_believed())?;
    (message.head.topic == TOPIC && message.head.type_name == type_name).then_some(&message.body[..])
}

struct Claim<'a> {
    pub record: &'a RecordReport,
    /// The number; `None` if the path does not lead to the head's root.
    pub number: Option<u64>,
}

fn claims<'a>(heights: &[Height], records: &'a [RecordReport], messages: &'a Messages, of: Topic) -> Vec<Claim<'a>> {
    let (owner, signer, recorder, topic) = of;
    let claim = |height: &Height| {
        let at = records.binary_search_by(|record| record.digest.cmp(&height.heads)).ok()?;
        let record = records.get(at).filter(|record| is_of(record, (owner, signer, recorder)))?;
        let heads = Heads::parse(statement(record, messages, Heads::TYPE)?).ok()?;
        let leaf = height_hash(&topic, height.number);
        let leads = root_of(leaf, height.index, u64::from(heads.count), &height.path) == Some(heads.root);
        Some(Claim { record, number: leads.then_some(height.number) })
    };
    let mut claims: Vec<Claim<'_>> = heights.iter().filter(|height| height.topic == topic).filter_map(claim).collect();
    claims.sort_by_key(|claim| claim.record.seq);
    claims
}

fn is_of(record: &RecordReport, (owner, signer, recorder): Recorder) -> bool {
    (record.owner, record.signer, record.recorder) == (Some(owner), Some(signer), Some(recorder))
}

fn birth<'a>(records: &'a [RecordReport], messages: &'a Messages, of: Recorder) -> Option<(&'a RecordReport, Birth)> {
    let own = records.iter().filter(|record| is_of(record, of));
    let births = own.filter_map(|record| Some((record, Birth::parse(statement(record, messages, Birth::TYPE)?).ok()?)));
    births.min_by_key(|(record, _)| record.seq)
}
