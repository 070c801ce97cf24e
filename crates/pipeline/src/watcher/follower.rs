//! The chain as the holder of the store's lease reads it, for a process beside it: the directory comes from the store, and a
//! head counts once the holder has read it.

use tokio::task::block_in_place;

use super::restore;
use crate::chain::BlockRef;
use crate::directory::{Told, kept};
use crate::model::Hash;
use crate::{Directory, Network, PipelineError, Plant, Result};

#[derive(Debug, Default)]
pub struct Follower {
    /// The holder's cursor up to which the directory is known to be the store's.
    seen: Option<(u64, Hash)>,
}

impl Follower {
    /// Brings the directory to the store's. Returns the chain's newest block if what it says is known here.
    pub async fn round(&mut self, plant: &Plant, network: &Network) -> Result<Option<BlockRef>> {
        let head = network.chain.head().await?;
        network.directory.saw_head_of(head.timestamp);
        let is_read = block_in_place(|| {
            self.catch_up(plant, network)?;
            Ok::<_, PipelineError>(self.seen.is_some() && is_read(plant, (head.number, head.hash))?)
        });
        Ok(is_read?.then_some(head))
    }

    fn catch_up(&mut self, plant: &Plant, network: &Network) -> Result<()> {
        // First: events are stored before the cursor passes them.
        let cursor = plant.ledger.trail.cursor()?;
        if self.seen == cursor {
            return Ok(());
        }
        let stands = self.seen.map_or(Ok(false), |seen| is_read(plant, seen))?;
        let Some((number, _)) = cursor.filter(|_| stands) else {
            let fresh = network.directory.blank();
            kept::read_back(&plant.ledger.rights, &fresh)?;
            network.times.forget_from(0);
            // Events beyond the cursor may be replaced without a sign here.
            self.seen = cursor.filter(|(number, _)| fresh.newest() <= *number);
            become_like(plant, network, &fresh);
            return Ok(());
        };
        let rows = plant.ledger.rights.rights_in(network.directory.newest(), number)?;
        let mut is_changed = false;
        for row in &rows {
            is_changed |= network.directory.take(&Told::from_row(&plant.ledger.rights, row)?);
        }
        if is_changed {
            plant.observer.directory_changed();
        }
        self.seen = cursor;
        Ok(())
    }
}

/// Whether the holder has read this very block.
fn is_read(plant: &Plant, block: (u64, Hash)) -> Result<bool> {
    Ok(plant.ledger.trail.blocks(block.0)?.first() == Some(&block))
}

fn become_like(plant: &Plant, network: &Network, fresh: &Directory) {
    network.directory.become_like(fresh);
    plant.observer.directory_changed();
}

/// Begins to read for all, where the last holder of the lease ended, perhaps in the middle: what it stored of blocks after the
/// cursor is read again.
pub fn take_over(plant: &Plant, network: &Network) -> Result<()> {
    let beside = Network { directory: network.directory.blank().into(), ..network.clone() };
    restore(plant, &beside)?;
    become_like(plant, network, &beside.directory);
    Ok(())
}
