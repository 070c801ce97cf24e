//! Follows the chain: which records are in a block, which blocks are deep enough, who was
//! registered, granted and revoked. A function of the ledger's cursor; a restart runs it again.

use std::time::Duration;

use tokio::task::block_in_place;

use crate::chain::{BlockRef, Event, EventAt};
use crate::store::{RootSighting, Sighting};

use super::{Network, PipelineError, Plant};

/// Name of the scan position in the ledger.
const CURSOR: &str = "watcher";
/// Name of the written-down directory in the ledger.
const DIRECTORY: &str = "directory";
/// Blocks scanned at a time.
const CHUNK: u64 = 2_000;

/// Reads the directory back as it was written down; a directory of another network, or none,
/// is scanned anew from the contract's first block.
///
/// # Errors
/// Of the ledger.
pub fn restore(plant: &Plant, network: &Network) -> Result<(), PipelineError> {
    let text = plant.ledger.setting(DIRECTORY)?;
    if !text.is_some_and(|text| network.directory.read_back(&text)) {
        let first = network.chain.pin().map_or(0, |pin| pin.deployed_at);
        plant.ledger.set_cursor(CURSOR, first.saturating_sub(1), network.chain.genesis())?;
    }
    Ok(())
}

/// Scans all blocks behind the cursor; returns the head it reached.
///
/// # Errors
/// Of chain and ledger; the cursor stands where the last chunk was written.
pub async fn watch_round(plant: &Plant, network: &Network) -> Result<BlockRef, PipelineError> {
    let head = network.chain.head().await?;
    let mut from = first_block(plant, network).await?;
    while from <= head.number {
        let to = head.number.min(from + CHUNK - 1);
        let events = network.chain.events(from, to).await?;
        let hash = if to == head.number {
            head.hash
        } else {
            network.chain.block(to).await?.map_or(head.hash, |block| block.hash)
        };
        block_in_place(|| write(plant, network, &events, to, hash))?;
        from = to + 1;
    }
    let deep = (head.number + 1).saturating_sub(network.confirmations);
    let confirmed = block_in_place(|| plant.ledger.confirm(deep))?;
    if confirmed > 0 {
        plant.observer.records_changed();
    }
    Ok(head)
}

async fn first_block(plant: &Plant, network: &Network) -> Result<u64, PipelineError> {
    let deployed_at = network.chain.pin().map_or(0, |pin| pin.deployed_at);
    let Some((number, hash)) = block_in_place(|| plant.ledger.cursor(CURSOR))? else { return Ok(deployed_at) };
    if number < deployed_at {
        return Ok(deployed_at);
    }
    if network.chain.block(number).await?.is_some_and(|block| block.hash == hash) {
        return Ok(number + 1);
    }
    reorganised(plant, network, deployed_at)?;
    Ok(deployed_at)
}

fn reorganised(plant: &Plant, network: &Network, deployed_at: u64) -> Result<(), PipelineError> {
    plant.observer.alert(true, "the chain was reorganised; records of replaced blocks are anchored again".to_owned());
    block_in_place(|| {
        plant.ledger.unmine(deployed_at)?;
        network.directory.clear();
        plant.ledger.set_cursor(CURSOR, deployed_at.saturating_sub(1), network.chain.genesis())
    })?;
    Ok(())
}

fn write(
    plant: &Plant,
    network: &Network,
    events: &[EventAt],
    to: u64,
    hash: crate::model::Hash,
) -> Result<(), PipelineError> {
    let sightings: Vec<Sighting> = events.iter().filter_map(sighting).collect();
    let roots: Vec<RootSighting> = events.iter().filter_map(root_sighting).collect();
    let mut changed = !sightings.is_empty() && plant.ledger.mined(&sightings)? > 0;
    changed |= !roots.is_empty() && plant.ledger.anchored(&roots)? > 0;
    let applied = events.iter().filter(|event| network.directory.apply(event)).count();
    if applied > 0 {
        plant.ledger.put_setting(DIRECTORY, &network.directory.write_down())?;
        plant.observer.directory_changed();
    }
    plant.ledger.set_cursor(CURSOR, to, hash)?;
    if changed {
        plant.observer.records_changed();
    }
    Ok(())
}

fn sighting(at: &EventAt) -> Option<Sighting> {
    let Event::DataUploaded { owner, digest, .. } = &at.event else { return None };
    Some(Sighting {
        owner: *owner,
        digest: *digest,
        transaction: at.transaction,
        block: at.block,
        block_hash: at.block_hash,
    })
}

fn root_sighting(at: &EventAt) -> Option<RootSighting> {
    let Event::Anchored { account, root, count, .. } = &at.event else { return None };
    Some(RootSighting {
        account: *account,
        root: *root,
        count: *count,
        transaction: at.transaction,
        block: at.block,
        block_hash: at.block_hash,
    })
}

/// How long to wait for a next block before looking again.
pub const PATIENCE: Duration = Duration::from_secs(2);
