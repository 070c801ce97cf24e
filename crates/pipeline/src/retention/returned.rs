//! Bytes of erased records that an earlier version took in again when a robot or a gateway brought them: overwritten, as
//! when they were erased.

use crate::model::Digest;
use crate::pipeline::{PipelineError, Plant};

use super::ROUND;

/// Overwrites them, and says how many there were.
///
/// # Errors
/// Errors of vault and ledger; called again, it does what is left.
pub fn overwrite_returned(plant: &Plant) -> Result<u64, PipelineError> {
    let mut count = 0;
    for erased in plant.ledger.erased_and_gone()?.chunks(ROUND) {
        let digests: Vec<Digest> = erased.iter().map(|(digest, _)| *digest).collect();
        let stored = plant.vault.contains_many(&digests)?;
        let is_here = |((digest, copied), stored): (&(Digest, bool), bool)| (stored || *copied).then_some(*digest);
        let here: Vec<Digest> = erased.iter().zip(stored).filter_map(is_here).collect();
        if here.is_empty() {
            continue;
        }
        // The local copies first: otherwise the vault would be refilled from them.
        plant.ledger.scour_local_copies(&here)?;
        plant.vault.scour(&here)?;
        count += here.len() as u64;
    }
    Ok(count)
}
