//! The highest numbers of a recorder, anchored while they change: a verifier of evidence then knows which number a
//! topic had reached by that time. A restored ledger and a new key have a new recorder, which names its predecessor.

use std::time::{Duration, Instant};

use crate::crypto::merkle::{Tree, height_hash};
use crate::model::{Address, Birth, Digest, Hash, Heads, Heights, RecordKind, Timestamp};
use crate::statement::{self, Statement};
use crate::store::notes::{StatedNumbers, StatedRoot};
use crate::{Plant, Result, audit_head, epoch::EpochKeys};

/// The name that the records are filed under.
pub const TOPIC: &str = "authros/recorder";

fn noted(plant: &Plant, owner: Address, keys: &EpochKeys) -> StatedNumbers {
    StatedNumbers { recorder: plant.ledger.records.recorder().of_signer(&keys.signer), owner, domain: keys.domain }
}

/// The tree over topics with their numbers; `None` for none, and for more than a tree holds.
pub fn tree(heights: &Heights) -> Option<Tree> {
    Tree::new(heights.topics.iter().map(|(topic, number)| height_hash(topic, *number)).collect())
}

/// States the numbers of this ledger's recorder if they changed and were not looked at (`seen`) for `every`; the first
/// time also its birth. Returns the record of the head. One caller at a time.
pub fn state(
    plant: &Plant,
    owner: Address,
    keys: &EpochKeys,
    every: Duration,
    seen: &mut Option<Instant>,
) -> Result<Option<Digest>> {
    if keys.topic(TOPIC).is_none() || seen.is_some_and(|seen| seen.elapsed() < every) {
        return Ok(None);
    }
    let (noted, looked) = (noted(plant, owner, keys), Timestamp::now());
    let before = plant.ledger.notes.read(&noted)?;
    let every = u64::try_from(every.as_nanos()).unwrap_or(u64::MAX);
    // A note from the future comes from a clock that was ahead: it is due.
    let since = before.and_then(|before| looked.0.checked_sub(before.looked.0));
    if since.is_some_and(|since| since < every) {
        return Ok(None);
    }
    *seen = Some(Instant::now());
    let heights = Heights { topics: plant.ledger.counts.heights(owner, keys.signer, [TOPIC, audit_head::TOPIC])? };
    let Some(root) = tree(&heights).map(|tree| tree.root()) else { return Ok(None) };
    let note = |root, heads| plant.ledger.notes.write(&noted, &StatedRoot { looked, root, heads });
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
) -> Result<Option<Digest>> {
    let put = |type_name, body: Vec<u8>| {
        let statement = Statement { kind: RecordKind::Audit, topic: TOPIC, type_name, body: &body };
        statement::state(plant, owner, keys, statement)
    };
    if before.is_none() {
        let birth = Birth { predecessor: plant.ledger.counts.predecessor(owner, keys.signer)? };
        put(Birth::TYPE, birth.encode())?;
    }
    let Some(listed) = put(Heights::TYPE, heights.encode())? else { return Ok(None) };
    let count = u32::try_from(heights.topics.len()).unwrap_or(u32::MAX);
    let previous = before.unwrap_or(Digest([0; Digest::LENGTH]));
    put(Heads::TYPE, Heads { count, root, heights: listed, previous }.encode())
}

#[cfg(test)]
mod tests;
