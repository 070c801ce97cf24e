//! The time stamps that a bundle carries: those over the roots of its records' batches.

use std::collections::{BTreeMap, BTreeSet};

use authros_evidence::time::StampTree;

use super::evidence::Gathered;
use super::{PipelineError, Plant};
use crate::model::Hash;

/// Adds the stamps over these roots; if batches are stamped here at all, it reports how many of these are not yet.
///
/// # Errors
/// Errors of the ledger.
pub(super) fn add(plant: &Plant, roots: &BTreeSet<Hash>, gathered: &mut Gathered) -> Result<(), PipelineError> {
    if plant.ledger.stamp_counts()?.newest.is_none() {
        return Ok(());
    }
    let (mut stamps, mut bare): (BTreeMap<u64, Vec<Hash>>, u64) = (BTreeMap::new(), 0);
    for root in roots {
        match plant.ledger.stamp_of(*root)? {
            Some(key) => stamps.entry(key).or_default().push(*root),
            None => bare += 1,
        }
    }
    for (key, wanted) in stamps {
        let stamp = plant.ledger.stamp(key)?.filter(|stamp| !stamp.tokens.is_empty());
        match stamp.and_then(|stamp| StampTree::new(stamp.roots).zip(Some(stamp.tokens))) {
            Some((tree, tokens)) => {
                gathered
                    .packing
                    .stamps(&tree, &wanted, &tokens)
                    .map_err(|error| PipelineError::Refused(error.to_string()))?;
            }
            None => bare += wanted.len() as u64,
        }
    }
    if bare > 0 {
        let text = format!(
            "{bare} batches have no time stamp yet, so level (d) is absent; `authros evidence stamp` requests one"
        );
        gathered.notes.push(text);
    }
    Ok(())
}
