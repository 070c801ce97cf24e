//! Whether the chain confirms a record: its own digest, or its batch's root with the path to it.

use tokio::task::block_in_place;

use crate::chain::{AnchorProof, Chain, ChainError, Event};
use crate::crypto::fault;
use crate::model::{Address, Hash};
use crate::store::{BatchPlace, PlacedRecord, RecordRow};

use super::{Network, PipelineError, Plant};

/// The record's place on the chain; `None` before it is in a block.
pub fn anchor_proof(placed: PlacedRecord) -> Option<AnchorProof> {
    let PlacedRecord { row, place } = placed;
    let (transaction, block, block_hash) = (row.transaction?, row.block?, row.block_hash?);
    match place {
        Some(place) => {
            let account = place.account?;
            Some(AnchorProof { account, transaction, block, block_hash, inclusion: Some(place.inclusion) })
        }
        None => Some(AnchorProof { account: row.owner, transaction, block, block_hash, inclusion: None }),
    }
}

/// Whether the stored path leads from the record's leaf to the batch's root.
pub fn is_included(place: &BatchPlace, row: &RecordRow) -> bool {
    place.inclusion.proves(&row.leaf()) || fault::is_off("proof")
}

/// Asks the chain whether the record's block has the root of its batch over the number of leaves its path was made for,
/// and otherwise whether the owner uploaded the digest itself there.
///
/// # Errors
/// Errors of chain and ledger.
pub async fn is_anchored(plant: &Plant, network: &Network, row: &RecordRow) -> Result<bool, PipelineError> {
    if fault::is_off("anchor") {
        return Ok(true);
    }
    let chain = &network.chain;
    let placed = block_in_place(|| plant.ledger.placed(row.digest))?;
    // Its row may have moved since it was read: its block is the one of the place's own moment.
    let (anchored, place) = placed.map_or((row.block, None), |placed| (placed.row.block, placed.place));
    if let Some(place) = place
        && let (Some(account), Some(block)) = (place.account, place.block)
        && anchored.is_none_or(|anchored| anchored == block)
    {
        let (root, count) = (place.inclusion.root, place.inclusion.count);
        return Ok(is_root_in(chain, account, root, count, block).await? && is_included(&place, row));
    }
    let uploaded = chain.uploaded_at(row.owner, row.digest).await?;
    Ok(uploaded.is_some_and(|uploaded| anchored.is_none_or(|block| block == uploaded)))
}

/// Whether an account anchored a root over this many leaves in this very block: for the first time, according to the
/// contract's state, or again, according to the block's events.
///
/// # Errors
/// Errors of the chain.
pub async fn is_root_in(
    chain: &Chain,
    account: Address,
    root: Hash,
    count: u64,
    block: u64,
) -> Result<bool, ChainError> {
    match chain.root_anchored(account, root).await? {
        None => return Ok(false),
        Some((first, counted)) if first == block => return Ok(counted == count),
        Some(_) => {}
    }
    let found = chain.anchors_of(root, block, block).await?;
    let same = |event: &Event| matches!(event, Event::Anchored { account: by, count: over, .. } if (*by, *over) == (account, count));
    Ok(found.iter().any(|at| at.block == block && same(&at.event)))
}

/// What the ledger itself knows: the watcher saw the record's anchor, and if that is a root the path leads to it.
///
/// # Errors
/// Errors of the ledger.
pub fn was_sighted(plant: &Plant, row: &RecordRow) -> Result<bool, PipelineError> {
    Ok(were_sighted(plant, &[row])?.contains(&true))
}

/// Like [`was_sighted`], for many records in their order; the ledger is asked once.
///
/// # Errors
/// Errors of the ledger.
pub fn were_sighted(plant: &Plant, rows: &[&RecordRow]) -> Result<Vec<bool>, PipelineError> {
    let digests: Vec<_> = rows.iter().map(|row| row.digest).collect();
    let sighted = |(row, placed): (&&RecordRow, Option<PlacedRecord>)| {
        let anchored = placed.and_then(|placed| placed.place).filter(|place| place.block.is_some());
        row.block.is_some() && anchored.is_none_or(|place| is_included(&place, row))
    };
    Ok(rows.iter().zip(plant.ledger.placed_all(&digests)?).map(sighted).collect())
}
