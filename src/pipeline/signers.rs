//! Who could sign a record: its owner at the anchoring block, or a device lent then.

use crate::model::PublicKey;
use crate::store::RecordRow;

use super::{Network, PipelineError, Plant};

/// The key by which the record's signer could sign for its owner at the anchoring block (now, where there is none
/// yet). The chain has only the ids of devices; their keys are those the ledger has met.
///
/// # Errors
/// Of the ledger. `None` where the signer was neither.
pub fn key_of(plant: &Plant, network: &Network, row: &RecordRow) -> Result<Option<PublicKey>, PipelineError> {
    let own = network.directory.signing_key(row.owner, row.signer, row.block);
    if own.is_some() || !network.directory.is_lent(row.owner, row.signer, row.block, row.acknowledged_at) {
        return Ok(own);
    }
    let key = plant.ledger.signer(row.signer)?;
    Ok(key.filter(|key| crate::crypto::signer_id(key) == row.signer))
}
