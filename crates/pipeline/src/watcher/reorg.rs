//! Replaced blocks: what was read from them is undone. A block that the node does not have is not replaced: the node is
//! behind, and is waited for.

use std::time::Duration;

use tokio::task::block_in_place;

use super::{beginning, first_block, stands};
use crate::chain::{BlockEvents, BlockRef, ChainError, Completeness, NEAR};
use crate::model::{Hash, Timestamp, counted};
use crate::store::notes::{AwaitedBlock, MissedFrom, NodeBehind, UnsureBlock, UnsureBlocks};
use crate::store::{Note, Notes};
use crate::{Network, PipelineError, Plant, Result};

/// If a reorg leaves nothing of this many blocks, it is not a reorg.
const DEEPEST: u64 = 1024;
/// The chain was taken back if it names the same older head for this long.
const TAKEN_BACK: Duration = Duration::from_secs(300);

/// Goes back to the last common block if one that was read is replaced: the newest, the cursor's, or the `differing` one
/// that the walk met. A chain without that history is another. Returns the newest block that was read, if the node does
/// not have it.
pub(super) async fn follow(
    plant: &Plant,
    network: &Network,
    head: BlockRef,
    differing: Option<u64>,
) -> Result<Option<u64>> {
    let mut suspects = block_in_place(|| suspects(plant, differing))?;
    suspects.retain(|(number, _)| *number >= first_block(network));
    let Some((newest, _)) = suspects.last().copied() else { return Ok(None) };
    if newest <= head.number && all_stand(network, &suspects).await? {
        block_in_place(|| no_longer_behind(&plant.ledger.notes))?;
        return Ok(None);
    }
    let identified = network.chain.identify().await;
    let trail = plant.ledger.trail.blocks(0)?;
    suspects.extend(trail.iter().rfind(|(number, _)| *number <= head.number));
    suspects.sort_unstable();
    let replaced = lowest_replaced(plant, network, head, &suspects).await?;
    // A node that is behind may not have the contract yet.
    let may_lack_it = head.number < first_block(network) + NEAR;
    let lacks_it = matches!(identified, Err(ChainError::Swapped { what: "contract code hash", .. }));
    if replaced.is_some() || !(may_lack_it && lacks_it) {
        identified?;
    }
    let Some(replaced) = replaced else { return Ok(Some(newest)) };
    // Above a false block, a true one may have been read: what stands there says nothing about what is below.
    let up_to = trail.partition_point(|(number, _)| *number <= replaced);
    let common = last_common(network, trail.get(..up_to).unwrap_or_default()).await?;
    if common.is_none() && !stands(network, trail.last().copied()).await? {
        only_young(network, &trail).await?;
    }
    go_back(plant, network, common.unwrap_or_else(|| beginning(network)), newest).await?;
    Ok(None)
}

/// Blocks by which a reorg is noticed, lowest first.
fn suspects(plant: &Plant, differing: Option<u64>) -> Result<Vec<(u64, Hash)>> {
    let trail = &plant.ledger.trail;
    let mut suspects: Vec<(u64, Hash)> = trail.end()?.into_iter().chain(trail.cursor()?).collect();
    if let Some(block) = differing {
        suspects.extend(trail.blocks(block)?.first());
    }
    suspects.sort_unstable();
    suspects.dedup();
    Ok(suspects)
}

async fn all_stand(network: &Network, blocks: &[(u64, Hash)]) -> Result<bool> {
    for block in blocks {
        if !stands(network, Some(*block)).await? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The lowest of these blocks that another one replaces. The last of them, if none is replaced for so long that the chain
/// was taken back.
async fn lowest_replaced(
    plant: &Plant,
    network: &Network,
    head: BlockRef,
    suspects: &[(u64, Hash)],
) -> Result<Option<u64>> {
    for (number, hash) in suspects.iter().filter(|(number, _)| *number <= head.number) {
        if network.chain.block(*number).await?.is_some_and(|there| there.hash != *hash) {
            return Ok(Some(*number));
        }
    }
    let is_taken_back = || {
        let waited = waited(&plant.ledger.notes, &NodeBehind {}, (head.number, head.hash))?;
        Ok::<_, PipelineError>(waited >= TAKEN_BACK)
    };
    let is_over = network.chain.is_exact() || block_in_place(is_taken_back)?;
    Ok(suspects.last().filter(|_| is_over).map(|(number, _)| *number))
}

/// By bisection: chains agree up to one block and differ from there on.
async fn last_common(network: &Network, trail: &[(u64, Hash)]) -> Result<Option<(u64, Hash)>> {
    let (mut agree, mut differ) = (0, trail.len());
    while agree < differ {
        let middle = agree + (differ - agree) / 2;
        if stands(network, trail.get(middle).copied()).await? {
            agree = middle + 1;
        } else {
            differ = middle;
        }
    }
    Ok(agree.checked_sub(1).and_then(|last| trail.get(last).copied()))
}

/// No block that was ever seen is there any more. On a short history that is a deep reorg; if blocks far below the head
/// are gone as well, it is another chain that happens to hold our contract at the same address.
async fn only_young(network: &Network, trail: &[(u64, Hash)]) -> Result<()> {
    let (Some(oldest), Some(newest)) = (trail.first(), trail.last()) else { return Ok(()) };
    let deepest = DEEPEST.max(network.confirmations.saturating_mul(4));
    if newest.0.saturating_sub(oldest.0) <= deepest {
        return Ok(());
    }
    let found = network.chain.block(oldest.0).await?;
    let found = found.map_or_else(|| "not there".to_owned(), |block| block.hash.to_hex());
    let (url, pinned) = (network.chain.url(), oldest.1.to_hex());
    Err(ChainError::Swapped { url, what: "history", pinned, found }.into())
}

/// Undoes what was read after `common`. The cursor moves last: if interrupted, the next round finds the same reorg.
async fn go_back(plant: &Plant, network: &Network, common: (u64, Hash), was_at: u64) -> Result<()> {
    let from = common.0 + 1;
    network.times.forget_from(from);
    let (moved, deep) = plant.ledger.batches.take_back(from)?;
    plant.ledger.trail.walk_back(common)?;
    let depth = was_at.saturating_sub(common.0);
    let (blocks, records) = (counted(depth, "block"), counted(moved, "record"));
    let text = format!("the chain replaced its last {blocks}; {records} will be anchored again");
    if deep > 0 {
        let confirmations = network.confirmations;
        let text = format!(
            "{text}, {deep} of them verified before: the reorg is deeper than confirmations = {confirmations}, raise the setting"
        );
        plant.observer.alert(true, text);
    } else {
        plant.observer.alert(moved > 0, text);
    }
    plant.observer.records_changed();
    Ok(())
}

/// Depths below the head at which an unsure block is read again. A node further behind is not just a little late.
const DEPTHS: [u64; 4] = [2, 6, 16, NEAR];
/// The most unsure blocks; beyond, the oldest are given up.
const MOST: usize = 256;

/// For how long this very block has been waited for.
pub(super) fn waited(notes: &Notes, note: &impl Note<Value = AwaitedBlock>, block: (u64, Hash)) -> Result<Duration> {
    let now = Timestamp::now();
    match notes.read(note)?.filter(|known| known.block == block) {
        Some(known) => Ok(Duration::from_nanos(now.0.saturating_sub(known.since.0))),
        None => Ok(notes.write(note, &AwaitedBlock { block, since: now }).map(|()| Duration::ZERO)?),
    }
}

fn no_longer_behind(notes: &Notes) -> Result<()> {
    match notes.read(&NodeBehind {})? {
        Some(known) => Ok(notes.forget(&NodeBehind {}, &known)?),
        None => Ok(()),
    }
}

pub(super) fn note(plant: &Plant, read: &[BlockEvents]) -> Result<()> {
    let unsure = read.iter().filter(|read| read.completeness != Completeness::Whole).map(|read| UnsureBlock {
        block: read.block.number,
        hash: read.block.hash,
        events: read.events.len(),
        times: 0,
    });
    let fresh: Vec<UnsureBlock> = unsure.collect();
    if fresh.is_empty() {
        return Ok(());
    }
    let mut all = plant.ledger.notes.read(&UnsureBlocks {})?.unwrap_or_default();
    all.retain(|known| fresh.iter().all(|one| one.block != known.block));
    all.extend(fresh);
    all.drain(..all.len().saturating_sub(MOST));
    Ok(plant.ledger.notes.write(&UnsureBlocks {}, &all)?)
}

/// Reads again what is due at this head, and goes back to the first block of which something was missed.
pub(super) async fn look(plant: &Plant, network: &Network, head: u64) -> Result<()> {
    let notes = &plant.ledger.notes;
    if let Some(block) = notes.read(&MissedFrom {})? {
        block_in_place(|| go_back_before(plant, network, block))?;
        // What was noted meanwhile stays.
        notes.forget(&MissedFrom {}, &block)?;
    }
    let known = notes.read(&UnsureBlocks {})?.unwrap_or_default();
    let mut left = Vec::with_capacity(known.len());
    for unsure in &known {
        left.extend(look_at(plant, network, head, unsure.clone()).await?);
    }
    if left != known {
        notes.write(&UnsureBlocks {}, &left)?;
    }
    Ok(())
}

/// Returns what is still unsure.
async fn look_at(plant: &Plant, network: &Network, head: u64, mut unsure: UnsureBlock) -> Result<Option<UnsureBlock>> {
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
fn go_back_before(plant: &Plant, network: &Network, block: u64) -> Result<()> {
    let trail = plant.ledger.trail.blocks(0)?;
    let before = trail.iter().rev().find(|(number, _)| *number < block).copied();
    let before = before.unwrap_or_else(|| beginning(network));
    // The cursor first: what is stored of blocks after it is taken back at any start. The trail stays, because batches rest
    // on its blocks: [`follow`] finds out whether they are replaced before they are read again.
    plant.ledger.trail.walk_back(before)?;
    plant.ledger.rights.take_back_rights(before.0 + 1)?;
    let text = format!(
        "the events read from block {block} differ from those on the chain: a node that is behind returns none; the \
         chain is read again from there, records are safe. Check that all nodes behind the URL are up to date"
    );
    plant.observer.alert(false, text);
    Ok(())
}
