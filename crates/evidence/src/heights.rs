//! `heights.json`: the place of a topic's highest number in a recorder's head, which is a disclosed record.

use authros_crypto::merkle::{LONGEST_PATH, height_hash, root_of};
use authros_model::{Address, Birth, Digest, Hash, Heads, RecorderId, SignerId, TopicId};
use serde::{Deserialize, Serialize};

use crate::BundleError;
use crate::report::RecordReport;
use crate::verify::Messages;

/// The member's name.
pub(crate) const HEIGHTS: &str = "heights.json";
/// The most entries.
pub const MOST_HEIGHTS: usize = crate::MOST_RECORDS;
/// The format name of the member.
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
    let listed: Listed = crate::form::from_json(text).map_err(|error| wrong(&error))?;
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
    serde_json::to_vec_pretty(&listed).map_err(|error| BundleError::of(HEIGHTS, &error.to_string()))
}

/// A recorder's trusted statement: its signer is proven, and the message opens.
fn statement<'a>(record: &'a RecordReport, messages: &'a Messages, type_name: &str) -> Option<&'a [u8]> {
    let message = messages.get(&record.digest).filter(|_| record.is_believed())?;
    (message.head.topic == TOPIC && message.head.type_name == type_name).then_some(&message.body[..])
}

/// A trusted head that names a topic.
pub(crate) struct Claim<'a> {
    /// Its record.
    pub record: &'a RecordReport,
    /// The number; `None` if the path does not lead to the head's root.
    pub number: Option<u64>,
}

/// What trusted heads of this recorder say about a topic, in their own order.
pub(crate) fn claims<'a>(
    heights: &[Height],
    records: &'a [RecordReport],
    messages: &'a Messages,
    (owner, signer, recorder, topic): (Address, SignerId, RecorderId, TopicId),
) -> Vec<Claim<'a>> {
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

/// Whether this key signed a record for this owner in this recorder.
fn is_of(record: &RecordReport, (owner, signer, recorder): (Address, SignerId, RecorderId)) -> bool {
    (record.owner, record.signer, record.recorder) == (Some(owner), Some(signer), Some(recorder))
}

/// The trusted birth of a recorder, the first one.
pub(crate) fn birth<'a>(
    records: &'a [RecordReport],
    messages: &'a Messages,
    of: (Address, SignerId, RecorderId),
) -> Option<(&'a RecordReport, Birth)> {
    let own = records.iter().filter(|record| is_of(record, of));
    let births = own.filter_map(|record| Some((record, Birth::parse(statement(record, messages, Birth::TYPE)?).ok()?)));
    births.min_by_key(|(record, _)| record.seq)
}
