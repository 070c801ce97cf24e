//! A bundle's proof of completeness: for each recorder in it, the newest head on the chain, its birth, and the proofs
//! of the topics' highest numbers under the head.

use std::collections::{BTreeMap, BTreeSet};

use authros_evidence::{Height, MOST_RECORDS};
use tokio::task::block_in_place;

use crate::model::{Birth, Digest, Heads, Heights, RecordState, RecorderId, TopicId};
use crate::store::{RecordQuery, RecordRow};

use super::PipelineError;
use super::reader::Reader;
use super::recorder_heads::{TOPIC, tree};

/// The most statements of one type by one recorder that are searched.
const MOST_STATEMENTS: usize = 16;

/// Statements that a bundle discloses for completeness.
#[derive(Debug, Default)]
pub(super) struct Shown {
    /// The records of heads and births.
    pub rows: Vec<RecordRow>,
    /// Highest numbers with their paths.
    pub heights: Vec<Height>,
    /// What is missing, in words.
    pub notes: Vec<String>,
}

/// What there is for these records.
///
/// # Errors
/// Errors of the ledger; a statement that does not open is skipped.
pub(super) async fn shown(reader: &Reader<'_>, rows: &[RecordRow]) -> Result<Shown, PipelineError> {
    let mut topics: BTreeMap<RecorderId, BTreeSet<TopicId>> = BTreeMap::new();
    // The recorder of a ring states nothing: its id says that its numbers may be missing.
    for row in rows.iter().filter(|row| row.topic != TOPIC && !row.recorder.is_ring()) {
        topics.entry(row.recorder).or_default().insert(row.topic_id);
    }
    let mut shown = Shown::default();
    for (recorder, topics) in topics {
        if rows.len() + shown.rows.len() + 2 > MOST_RECORDS {
            let text = format!("statements of recorder {recorder} and later ones do not fit into the bundle");
            shown.notes.push(text);
            break;
        }
        one(reader, (recorder, &topics), &mut shown).await?;
    }
    Ok(shown)
}

/// What there is for one recorder.
async fn one(
    reader: &Reader<'_>,
    (recorder, topics): (RecorderId, &BTreeSet<TopicId>),
    shown: &mut Shown,
) -> Result<(), PipelineError> {
    let before = shown.rows.len();
    for row in statements(reader, recorder, Heads::TYPE)? {
        let Some(heights) = heights(reader, &row).await else { continue };
        shown.heights.extend(of_topics(row.digest, &heights, topics));
        shown.rows.push(row);
        break;
    }
    if shown.rows.len() == before {
        shown
            .notes
            .push(format!("recorder {recorder} has no anchored heads record here: nothing says how far its topics go"));
    }
    let before = shown.rows.len();
    for row in statements(reader, recorder, Birth::TYPE)? {
        if body(reader, &row).await.is_some() {
            shown.rows.push(row);
            break;
        }
    }
    if shown.rows.len() == before {
        shown.notes.push(format!(
            "recorder {recorder} has no anchored birth record here: nothing says which recorder it follows"
        ));
    }
    Ok(())
}

/// Anchored statements of a recorder, in search order: heads from the newest, births from the oldest.
fn statements(reader: &Reader<'_>, recorder: RecorderId, type_name: &str) -> Result<Vec<RecordRow>, PipelineError> {
    let query = RecordQuery {
        owner: Some(reader.reader.address),
        recorder: Some(recorder),
        topic: Some(TOPIC.to_owned()),
        type_name: Some(type_name.to_owned()),
        limit: MOST_STATEMENTS,
        newest_first: type_name == Heads::TYPE,
        ..RecordQuery::default()
    };
    let mut rows = block_in_place(|| reader.plant.ledger.list(&query))?.rows;
    rows.retain(is_confirmed);
    Ok(rows)
}

fn is_confirmed(row: &RecordRow) -> bool {
    matches!(row.state, RecordState::Confirmed | RecordState::Verified)
}

/// The content of a statement.
async fn body(reader: &Reader<'_>, row: &RecordRow) -> Option<Vec<u8>> {
    Some(reader.open(row).await.ok()?.body)
}

/// The list of numbers under a head.
async fn heights(reader: &Reader<'_>, row: &RecordRow) -> Option<Heights> {
    let heads = Heads::parse(&body(reader, row).await?).ok()?;
    let listed = block_in_place(|| reader.plant.ledger.record(heads.heights)).ok()??;
    let heights = Heights::parse(&body(reader, &listed).await?).ok()?;
    (tree(&heights)?.root() == heads.root).then_some(heights)
}

fn of_topics(heads: Digest, heights: &Heights, topics: &BTreeSet<TopicId>) -> Vec<Height> {
    let Some(tree) = tree(heights) else { return Vec::new() };
    let named = heights.topics.iter().enumerate().filter(|(_, (topic, _))| topics.contains(topic));
    let height = |(at, (topic, number)): (usize, &(TopicId, u64))| {
        let (topic, number, path) = (*topic, *number, tree.path(at));
        Height { heads, topic, number, index: at as u64, path }
    };
    named.map(height).collect()
}
