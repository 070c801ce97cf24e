//! All events of the contract against the ledger, both ways: none that the watcher read over is missing, and none is there
//! that the chain does not have.

use std::collections::{BTreeMap, BTreeSet};

use super::report::{FindingKind, Tally};
use super::{Network, Plant};
use crate::chain::{ChainError, Event, EventAt};
use crate::pipeline::directory::Told;
use crate::pipeline::watcher::{CURSOR, unread};
use crate::store::{Ledger, StoreError};

/// The most differing blocks of a page that are named one by one.
const MOST_BLOCKS: usize = 100;
/// What follows from a difference, and what to do.
const ADVICE: &str = "what is verified and who may read is judged here by the ledger. The chain is read again from this \
                      block on while the site runs (`authros serve`); then audit again, and check the node behind \
                      chain.url";

/// An event's name in the contract.
fn name(event: &Event) -> String {
    let text = format!("{event:?}");
    text.split([' ', '{']).next().unwrap_or("event").to_owned()
}

/// Compares the contract's events in blocks `from` to `to`, as the chain has them, with the ledger. A block that differs
/// is read once more: the watcher may just have been at it.
pub(super) async fn compare(
    plant: &Plant,
    network: &Network,
    (from, to): (u64, u64),
    events: &[EventAt],
    tally: &mut Tally,
) -> Result<Result<(), ChainError>, StoreError> {
    let differing = differing_blocks(&plant.ledger, (from, to), events)?;
    let mut first = None;
    for block in differing.iter().copied().take(MOST_BLOCKS) {
        let again = match network.chain.events(block, block).await {
            Ok(events) => events,
            Err(error) => return Ok(Err(error)),
        };
        let found = differences(&plant.ledger, (block, block), &again)?;
        for (kind, text) in &found {
            tally.find(*kind, &format!("block {block}"), &format!("{text}; {ADVICE}"));
        }
        first = first.or((!found.is_empty()).then_some(block));
    }
    if differing.len() > MOST_BLOCKS {
        let text = format!("events of {} blocks from {from} to {to} differ from the ledger; {ADVICE}", differing.len());
        tally.find(FindingKind::Missing, "chain", &text);
    }
    if let Some(block) = first {
        unread::note(&plant.ledger, block)?;
    }
    Ok(Ok(()))
}

fn differing_blocks(ledger: &Ledger, (from, to): (u64, u64), events: &[EventAt]) -> Result<BTreeSet<u64>, StoreError> {
    let Some(compared) = Compared::new(ledger, (from, to), events)? else { return Ok(BTreeSet::new()) };
    let missing = compared.missing.iter().map(|event| event.block);
    Ok(missing.chain(compared.surplus.iter().map(|told| told.block)).chain(compared.other.iter().copied()).collect())
}

fn differences(
    ledger: &Ledger,
    blocks: (u64, u64),
    events: &[EventAt],
) -> Result<Vec<(FindingKind, String)>, StoreError> {
    let Some(compared) = Compared::new(ledger, blocks, events)? else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    for at in &compared.missing {
        let text = format!("{} (event {}) is on the chain, and the ledger missed it", name(&at.event), at.log_index);
        found.push((FindingKind::Missing, text));
    }
    for told in &compared.surplus {
        let text = format!("{} (event {}) is in the ledger, and not on the chain", name(&told.event), told.place);
        found.push((FindingKind::Tampered, text));
    }
    if !compared.other.is_empty() {
        found.push((FindingKind::Tampered, "the ledger has an event of it otherwise than the chain".to_owned()));
    }
    Ok(found)
}

/// Chain and ledger side by side.
struct Compared<'a> {
    /// On the chain alone.
    missing: Vec<&'a EventAt>,
    /// In the ledger alone.
    surplus: Vec<Told>,
    /// Blocks with an event that both have, but not the same.
    other: Vec<u64>,
}

impl<'a> Compared<'a> {
    /// As far as the watcher has read; `None` if that is before these blocks.
    fn new(ledger: &Ledger, (from, to): (u64, u64), events: &'a [EventAt]) -> Result<Option<Self>, StoreError> {
        // Asked before the ledger is: what is read up to here is in it.
        let Some((read, _)) = ledger.cursor(CURSOR)?.filter(|(read, _)| *read >= from) else { return Ok(None) };
        let to = to.min(read);
        let missing: Vec<&EventAt> =
            unread::of(ledger, events)?.into_iter().filter(|event| event.block <= to).collect();
        let on_chain: BTreeMap<(u64, u64), &EventAt> =
            events.iter().map(|event| ((event.block, event.log_index), event)).collect();
        let (mut surplus, mut other) = (Vec::new(), Vec::new());
        for row in ledger.rights_in(from, to)? {
            let Some(told) = Told::from_row(&row) else {
                other.push(row.block);
                continue;
            };
            match on_chain.get(&(row.block, row.place)) {
                None => surplus.push(told),
                Some(at) if !told.is_of(at) => other.push(row.block),
                Some(_) => {}
            }
        }
        Ok(Some(Self { missing, surplus, other }))
    }
}
