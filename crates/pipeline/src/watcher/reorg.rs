//! Replaced blocks: everything read from them is undone, from where the chains diverge.

use tokio::task::block_in_place;

use crate::chain::ChainError;
use crate::model::Hash;
use crate::pipeline::{Network, PipelineError, Plant};

use super::{CURSOR, beginning, first_block, restore, stands};
use crate::pipeline::directory::kept;

/// If a reorg leaves nothing of this many blocks, it is not a reorg.
const DEEPEST: u64 = 1024;

/// Whether the chain still holds the newest block seen; if not, goes back to the last block that both chains have. A
/// chain without that history is another one.
pub(super) async fn follow(plant: &Plant, network: &Network) -> Result<(), PipelineError> {
    let newest =
        block_in_place(|| Ok::<_, PipelineError>(plant.ledger.trail_end()?.max(plant.ledger.cursor(CURSOR)?)))?;
    let Some((number, _)) = newest else { return Ok(()) };
    if number < first_block(network) || stands(network, newest).await? {
        return Ok(());
    }
    network.chain.identify().await?;
    let trail = block_in_place(|| plant.ledger.trail())?;
    let common = last_common(network, &trail).await?;
    if common.is_none() && !trail.is_empty() {
        only_young(network, &trail).await?;
    }
    go_back(plant, network, common.unwrap_or_else(|| beginning(network)), number).await
}

/// No block that was ever seen is there any more. On a short history that is a deep reorg; if blocks far below the head
/// are gone as well, it is another chain that happens to hold our contract at the same address.
async fn only_young(network: &Network, trail: &[(u64, Hash)]) -> Result<(), PipelineError> {
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

/// The highest block of the trail that the chain has too. Chains agree up to one block and differ from there on, so
/// bisection finds it.
async fn last_common(network: &Network, trail: &[(u64, Hash)]) -> Result<Option<(u64, Hash)>, PipelineError> {
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

/// Undoes what was read after `common`. Each step may be interrupted: the cursor moves last, so the next round finds
/// the same reorg.
async fn go_back(plant: &Plant, network: &Network, common: (u64, Hash), was_at: u64) -> Result<(), PipelineError> {
    let from = common.0 + 1;
    network.times.forget_from(from);
    let deep = block_in_place(|| plant.ledger.verified_from(from))?;
    // Confirmed ones first: those the verifier advances meanwhile are then among the verified ones.
    let moved = block_in_place(|| Ok::<_, PipelineError>(plant.ledger.unmine(from)? + plant.ledger.unverify(from)?))?;
    if network.directory.newest() >= from {
        block_in_place(|| undo_rights(plant, network, from))?;
        plant.observer.directory_changed();
    }
    block_in_place(|| plant.ledger.walk_back(CURSOR, common))?;
    let depth = was_at.saturating_sub(common.0);
    let text = format!("the chain replaced its last {depth} blocks; {moved} records are anchored again");
    if deep > 0 {
        let confirmations = network.confirmations;
        plant.observer.alert(
            true,
            format!("{text}, {deep} of them verified before: the reorg is deeper than confirmations = {confirmations}, raise the setting"),
        );
    } else {
        plant.observer.alert(moved > 0, text);
    }
    plant.observer.records_changed();
    Ok(())
}

/// The directory as it was before `from`; readers see the old one until the new one is complete. If it cannot be read
/// back, all of it is scanned again.
fn undo_rights(plant: &Plant, network: &Network, from: u64) -> Result<(), PipelineError> {
    plant.ledger.take_back_rights(from)?;
    let fresh = network.directory.blank();
    if kept::read_back(&plant.ledger, &fresh)? {
        network.directory.become_like(fresh);
        return Ok(());
    }
    network.directory.become_like(network.directory.blank());
    plant.ledger.forget_rights()?;
    restore(plant, network)
}
