//! Events of the contract that the ledger should have and does not: found in a transaction's own receipt, or by an audit.
//! The block is noted; the next round of the watcher goes back to it.

use std::collections::HashSet;

use crate::chain::EventAt;
use crate::store::{Ledger, RootSighting, Sighting, StoreError};

use super::{root_sighting, sighting};

/// The setting with the first block of which something was missed.
const MISSED: &str = "watcher:missed";

/// Those of these events that the ledger has not taken in, although it knows what they are about.
pub(crate) fn of<'a>(ledger: &Ledger, events: &'a [EventAt]) -> Result<Vec<&'a EventAt>, StoreError> {
    let sightings: Vec<Sighting> = events.iter().filter_map(sighting).collect();
    let roots: Vec<RootSighting> = events.iter().filter_map(root_sighting).collect();
    let is_anchor = |event: &EventAt| sighting(event).is_some() || root_sighting(event).is_some();
    let rights: Vec<(u64, u64)> =
        events.iter().filter(|event| !is_anchor(event)).map(|event| (event.block, event.log_index)).collect();
    let digests: HashSet<_> = ledger.waiting_digests(&sightings)?.into_iter().collect();
    let waiting: HashSet<_> = ledger.waiting_roots(&roots)?.into_iter().collect();
    let unknown: HashSet<_> = ledger.unknown_rights(&rights)?.into_iter().collect();
    let is_unread = |event: &&EventAt| match (sighting(event), root_sighting(event)) {
        (Some(sighting), _) => digests.contains(&sighting.digest),
        (None, Some(sighting)) => waiting.contains(&sighting.root),
        (None, None) => unknown.contains(&(event.block, event.log_index)),
    };
    Ok(events.iter().filter(is_unread).collect())
}

/// Asks the watcher to read the chain again from this block on.
pub(crate) fn note(ledger: &Ledger, block: u64) -> Result<(), StoreError> {
    if noted(ledger)?.is_some_and(|(known, _)| known <= block) {
        return Ok(());
    }
    ledger.put_setting(MISSED, &block.to_string())
}

/// The block noted, and the note as it stands.
pub(super) fn noted(ledger: &Ledger) -> Result<Option<(u64, String)>, StoreError> {
    let text = ledger.setting(MISSED)?;
    Ok(text.and_then(|text| Some((text.parse().ok()?, text))))
}

/// The watcher went back; what was noted meanwhile stays.
pub(super) fn settled(ledger: &Ledger, note: &str) -> Result<(), StoreError> {
    ledger.drop_setting(MISSED, note)
}
