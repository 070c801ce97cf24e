//! The countersignatures that a bundle carries: those over the roots of its records' batches, with the headers of the
//! blocks that were stated.

use std::collections::{BTreeMap, BTreeSet};

use authros_evidence::PinnedWitness;
use authros_evidence::time::StampTree;
use tokio::task::block_in_place;

use super::PipelineError;
use super::evidence::Gathered;
use super::reader::Reader;
use crate::model::{Address, Hash};

/// The most countersignatures in a bundle.
const MOST: usize = 1000;

/// Adds the countersignatures over these roots, each with the account that anchored it.
///
/// # Errors
/// Errors of ledger and chain.
pub(super) async fn add(
    reader: &Reader<'_>,
    roots: &BTreeSet<(Hash, Address)>,
    gathered: &mut Gathered,
) -> Result<(), PipelineError> {
    let (plant, network) = (reader.plant, reader.network);
    let witnesses = block_in_place(|| plant.ledger.witnesses())?;
    let (mut positions, mut bare): (BTreeMap<u64, BTreeSet<(Hash, Address)>>, u64) = (BTreeMap::new(), 0);
    for (root, account) in roots {
        let keys = block_in_place(|| plant.ledger.positions_of(*root, network.domain))?;
        bare += u64::from(keys.is_empty());
        for key in keys {
            positions.entry(key).or_default().insert((*root, *account));
        }
    }
    if positions.len() > MOST {
        let text = format!("the bundle has {MOST} of {} countersignatures of witnesses", positions.len());
        gathered.notes.push(text);
    }
    for (key, under) in positions.into_iter().take(MOST) {
        let Some(kept) = block_in_place(|| plant.ledger.position(key))? else { continue };
        let (countersignature, position) = (kept.countersignature, kept.countersignature.stated.position);
        // A gateway's keeper anchors for others; whoever else stated a batch has no say about its records.
        let mine = |(root, account): (Hash, Address)| {
            (position.owner == reader.reader.address || position.owner == account).then_some(root)
        };
        let wanted: Vec<Hash> = under.into_iter().filter_map(mine).collect();
        let Some(tree) = StampTree::new(kept.roots).filter(|_| !wanted.is_empty()) else { continue };
        let added = gathered.packing.countersignature(&countersignature, &tree, &wanted, plant.provider);
        added.map_err(|error| PipelineError::Refused(error.to_string()))?;
        // A node that has no such block, or gives headers that are none, spoils no export.
        match network.chain.header_rlp(position.block).await.ok().flatten() {
            Some(header) => gathered.packing.header(position.block, header),
            None => gathered.notes.push(format!(
                "block {}, which was stated to the witness {}, is not on the chain, or its node does not give it",
                position.block, countersignature.witness
            )),
        }
    }
    if bare > 0 && witnesses.iter().any(|row| row.owner == reader.reader.address && row.address.is_some()) {
        let text = format!(
            "{bare} batches are countersigned by no witness yet: level (g) is absent; `authros witness ask` asks for it"
        );
        gathered.notes.push(text);
    }
    Ok(())
}

/// The owner's witnesses as named in a trust file.
///
/// # Errors
/// Errors of the ledger.
pub(super) fn suggested(reader: &Reader<'_>) -> Result<Vec<PinnedWitness>, PipelineError> {
    let rows = reader.plant.ledger.witnesses()?;
    let asked = rows.into_iter().filter(|row| row.owner == reader.reader.address && row.address.is_some());
    let mut seen = BTreeSet::new();
    let pin = |row: crate::store::WitnessRow| {
        seen.insert(row.account).then_some(PinnedWitness { account: row.account, key: row.key, name: row.name })
    };
    Ok(asked.filter_map(pin).take(16).collect())
}
