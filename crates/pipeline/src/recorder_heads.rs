//! The highest numbers of a recorder, anchored while they change: a verifier of evidence then knows which number a
//! topic had reached by that time. A restored ledger and a new key have a new recorder, which names its predecessor.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::crypto::merkle::{Tree, height_hash};
use crate::model::{Address, Birth, Digest, Hash, Heads, Heights, RecordKind, Timestamp};
use crate::store::{Ledger, StoreError};

use super::epoch::EpochKeys;
use super::statement::{self, Statement};
use super::{PipelineError, Plant, audit_head};

/// The name that the records are filed under.
pub const TOPIC: &str = "authros/recorder";

/// The last statement, and when it was made.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Noted {
    looked: Timestamp,
    root: Hash,
    heads: Option<Digest>,
}

/// One note for each chain, owner and recorder: on another chain everything is stated again.
fn place(plant: &Plant, owner: Address, keys: &EpochKeys) -> String {
    format!("recorder-heads:{}:{owner}:{}", plant.ledger.recorder().of_signer(&keys.signer), keys.domain)
}

fn noted(ledger: &Ledger, place: &str) -> Result<Option<Noted>, StoreError> {
    let Some(text) = ledger.setting(place)? else { return Ok(None) };
    let detail = "its note about the numbers that were anchored cannot be read".to_owned();
    serde_json::from_str(&text).map(Some).map_err(|_| StoreError::Corrupt { file: ledger.path().to_owned(), detail })
}

/// The tree over topics with their numbers; `None` for none, and for more than a tree holds.
pub fn tree(heights: &Heights) -> Option<Tree> {
    Tree::new(heights.topics.iter().map(|(topic, number)| height_hash(topic, *number)).collect())
}

/// States the numbers of this ledger's recorder for `owner` if they have changed and were not stated or checked
/// (`seen`, kept by the caller) for `every`; the first time also its birth. Returns the record of the head. One caller
/// at a time.
///
/// # Errors
/// Errors of the store.
pub fn state(
    plant: &Plant,
    owner: Address,
    keys: &EpochKeys,
    every: Duration,
    seen: &mut Option<Instant>,
) -> Result<Option<Digest>, PipelineError> {
    if keys.topic(TOPIC).is_none() || seen.is_some_and(|seen| seen.elapsed() < every) {
        return Ok(None);
    }
    let (place, looked) = (place(plant, owner, keys), Timestamp::now());
    let before = noted(&plant.ledger, &place)?;
    let every = u64::try_from(every.as_nanos()).unwrap_or(u64::MAX);
    // A note from the future comes from a clock that was ahead: it is due.
    let since = before.and_then(|before| looked.0.checked_sub(before.looked.0));
    if since.is_some_and(|since| since < every) {
        return Ok(None);
    }
    *seen = Some(Instant::now());
    let heights = Heights { topics: plant.ledger.heights(owner, keys.signer, [TOPIC, audit_head::TOPIC])? };
    let Some(root) = tree(&heights).map(|tree| tree.root()) else { return Ok(None) };
    let note = |root, heads| {
        let text = serde_json::to_string(&Noted { looked, root, heads }).unwrap_or_default();
        plant.ledger.put_setting(&place, &text)
    };
    let Some(before) = before else {
        note(Hash([0; 32]), None)?;
        return Ok(None);
    };
    if before.root == root {
        return Ok(None);
    }
    let Some(heads) = stated(plant, owner, keys, &heights, (root, before.heads))? else { return Ok(None) };
    // If interrupted here, the next head names the same predecessor, and a birth is stated twice; neither is a
    // contradiction.
    note(root, Some(heads))?;
    plant.observer.records_changed();
    Ok(Some(heads))
}

/// `None` if the keys do not cover the name.
fn stated(
    plant: &Plant,
    owner: Address,
    keys: &EpochKeys,
    heights: &Heights,
    (root, before): (Hash, Option<Digest>),
) -> Result<Option<Digest>, PipelineError> {
    let put = |type_name, body: Vec<u8>| {
        let statement = Statement { kind: RecordKind::Audit, topic: TOPIC, type_name, body: &body };
        statement::state(plant, owner, keys, statement)
    };
    if before.is_none() {
        let birth = Birth { predecessor: plant.ledger.predecessor(owner, keys.signer)? };
        put(Birth::TYPE, birth.encode())?;
    }
    let Some(listed) = put(Heights::TYPE, heights.encode())? else { return Ok(None) };
    let count = u32::try_from(heights.topics.len()).unwrap_or(u32::MAX);
    let previous = before.unwrap_or(Digest([0; Digest::LENGTH]));
    put(Heads::TYPE, Heads { count, root, heights: listed, previous }.encode())
}

#[cfg(test)]
mod tests;
