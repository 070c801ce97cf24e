//! What is read once more: blocks that were not surely read whole, and everything from a block on of which an event was
//! missed. Kept in the ledger, so that a restart goes on with it.

use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;

use crate::chain::{BlockEvents, Completeness, NEAR};
use crate::model::{Hash, Timestamp};
use crate::pipeline::{Network, PipelineError, Plant};
use crate::store::Ledger;

use super::{CURSOR, beginning, unread};

/// The setting with the blocks that are read again.
const UNSURE: &str = "watcher:unsure";
/// How far below the head such a block is read again, each time. A node that is further behind is not just a little late.
const DEPTHS: [u64; 4] = [2, 6, 16, NEAR];
/// The most such blocks; beyond, the oldest are given up.
const MOST: usize = 256;

/// A block that may have been read only in part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Unsure {
    block: u64,
    hash: Hash,
    /// How many events were read of it.
    events: usize,
    /// How often it was read again.
    times: usize,
}

/// Something that is waited for.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Waiting {
    block: (u64, Hash),
    since: Timestamp,
}

fn kept<T: DeserializeOwned>(ledger: &Ledger, key: &str) -> Result<Option<T>, PipelineError> {
    Ok(ledger.setting(key)?.and_then(|text| serde_json::from_str(&text).ok()))
}

fn keep<T: Serialize>(ledger: &Ledger, key: &str, value: &T) -> Result<(), PipelineError> {
    Ok(ledger.put_setting(key, &serde_json::to_string(value).unwrap_or_default())?)
}

/// For how long this very block has been waited for.
pub(super) fn waited(plant: &Plant, key: &str, block: (u64, Hash)) -> Result<Duration, PipelineError> {
    let now = Timestamp::now();
    let known: Option<Waiting> = kept(&plant.ledger, key)?;
    match known.filter(|known| known.block == block) {
        Some(known) => Ok(Duration::from_nanos(now.0.saturating_sub(known.since.0))),
        None => keep(&plant.ledger, key, &Waiting { block, since: now }).map(|()| Duration::ZERO),
    }
}

/// Nothing is waited for under this key any more.
pub(super) fn no_longer(plant: &Plant, key: &str) -> Result<(), PipelineError> {
    match plant.ledger.setting(key)? {
        Some(known) => Ok(plant.ledger.drop_setting(key, &known)?),
        None => Ok(()),
    }
}

/// Notes those of these blocks that are to be read again.
pub(super) fn note(plant: &Plant, read: &[BlockEvents]) -> Result<(), PipelineError> {
    let unsure = read.iter().filter(|read| read.completeness != Completeness::Whole).map(|read| Unsure {
        block: read.block.number,
        hash: read.block.hash,
        events: read.events.len(),
        times: 0,
    });
    let fresh: Vec<Unsure> = unsure.collect();
    if fresh.is_empty() {
        return Ok(());
    }
    let mut all: Vec<Unsure> = kept(&plant.ledger, UNSURE)?.unwrap_or_default();
    all.retain(|known| fresh.iter().all(|one| one.block != known.block));
    all.extend(fresh);
    all.drain(..all.len().saturating_sub(MOST));
    keep(&plant.ledger, UNSURE, &all)
}

/// Reads again what is due at this head, and goes back to the first block of which something was missed.
pub(super) async fn look(plant: &Plant, network: &Network, head: u64) -> Result<(), PipelineError> {
    if let Some((block, note)) = block_in_place(|| unread::noted(&plant.ledger))? {
        block_in_place(|| go_back_before(plant, network, block))?;
        block_in_place(|| unread::settled(&plant.ledger, &note))?;
    }
    let known: Vec<Unsure> = block_in_place(|| kept(&plant.ledger, UNSURE))?.unwrap_or_default();
    let mut left = Vec::with_capacity(known.len());
    for unsure in &known {
        left.extend(look_at(plant, network, head, unsure.clone()).await?);
    }
    if left != known {
        block_in_place(|| keep(&plant.ledger, UNSURE, &left))?;
    }
    Ok(())
}

/// Reads a block again if that is due; returns what is still unsure.
async fn look_at(
    plant: &Plant,
    network: &Network,
    head: u64,
    mut unsure: Unsure,
) -> Result<Option<Unsure>, PipelineError> {
    let Some(depth) = DEPTHS.get(unsure.times) else { return Ok(None) };
    if head.saturating_sub(unsure.block) < *depth {
        return Ok(Some(unsure));
    }
    let Some(found) = network.chain.block_events(unsure.block).await? else { return Ok(Some(unsure)) };
    // A block that was replaced is read where the chain is walked again.
    if found.block.hash != unsure.hash {
        return Ok(None);
    }
    if found.events.len() > unsure.events {
        block_in_place(|| go_back_before(plant, network, unsure.block))?;
        return Ok(None);
    }
    unsure.times += 1;
    Ok((found.completeness != Completeness::Whole).then_some(unsure))
}

/// An event of this block was missed, or is not on the chain. Their order counts, so all is read again from there.
fn go_back_before(plant: &Plant, network: &Network, block: u64) -> Result<(), PipelineError> {
    let trail = plant.ledger.trail()?;
    let before = trail.iter().rev().find(|(number, _)| *number < block).copied();
    let before = before.unwrap_or_else(|| beginning(network));
    // The cursor first: what is stored of blocks after it is taken back at any start.
    plant.ledger.walk_back(CURSOR, before)?;
    plant.ledger.take_back_rights(before.0 + 1)?;
    plant.observer.alert(
        false,
        format!(
            "the events of block {block} as they were read differ from those on the chain: a node that is behind gives none; \
             the chain is read again from there, nothing is lost. Check that all nodes behind the URL are up to date"
        ),
    );
    Ok(())
}
