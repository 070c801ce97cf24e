//! Follows the chain: blocks and confirmations of records, registrations, grants. A function of the ledger's cursor.
//! Several nodes may answer at one URL, some of them behind: the newest blocks are read one by one, what is not sure is
//! read again, and a node that is behind is no reorg ([`reorg`]).

pub mod foreign;
mod reorg;

use std::collections::{BTreeMap, HashSet};
use std::{ops::RangeInclusive, sync::Arc, time::Duration};

use tokio::task::block_in_place;

use crate::chain::{AT_ONCE, BlockEvents, BlockRef, ChainError, Completeness, Event, EventAt};
use crate::directory::{Told, kept};
use crate::store::notes::{DoubtedBlock, MissedFrom};
use crate::store::{Ledger, Notes, RootSighting, Sighting, StoreError};
use crate::{Directory, Network, PipelineError, Plant, Result, crypto::fault, model::Hash, stages::Milestone};

/// Blocks scanned at a time.
const CHUNK: u64 = 2_000;
/// How often a part of the chain is read again because it changed meanwhile.
const ATTEMPTS: usize = 5;
/// Pause before the next question to a node that is behind.
const PAUSE: Duration = Duration::from_millis(200);

enum Reached {
    Head,
    /// The chain changed while it was read.
    Changed,
    /// The chain has another block here than the one that was read.
    Differs(u64),
    /// The node that answered does not have this block, or not all of it.
    Before(u64),
}

/// Binds the ledger to the contract and reads the directory back; without a readable one, scans from the first block.
pub fn restore(plant: &Plant, network: &Network) -> Result<()> {
    let pin = network.chain.pin().ok_or(ChainError::NoContract)?;
    plant.ledger.rights.bind_contract(network.domain, &serde_json::to_string(&pin).unwrap_or_default())?;
    read_back(plant, network, &network.directory)
}

/// If nothing readable is stored, the scan begins anew.
fn read_back(plant: &Plant, network: &Network, directory: &Directory) -> Result<()> {
    if let Some((number, _)) = plant.ledger.trail.cursor()? {
        // What was stored of blocks after the cursor is read again: they may have been replaced meanwhile.
        plant.ledger.rights.take_back_rights(number + 1)?;
        match kept::read_back(&plant.ledger.rights, directory) {
            Ok(true) => return Ok(()),
            Ok(false) | Err(StoreError::Corrupt { .. }) => {}
            Err(error) => return Err(error.into()),
        }
    }
    plant.ledger.rights.forget_rights()?;
    // The trail stays: it shows whether blocks were replaced meanwhile.
    let (number, hash) = beginning(network);
    plant.ledger.trail.set_cursor(number, hash)?;
    Ok(())
}

/// The last block before the contract's first, as a cursor: its hash is never compared.
fn beginning(network: &Network) -> (u64, Hash) {
    (first_block(network).saturating_sub(1), network.chain.genesis())
}

fn first_block(network: &Network) -> u64 {
    network.chain.pin().map_or(0, |pin| pin.deployed_at)
}

/// Scans all blocks after the cursor; returns the head it reached. On an error the cursor stays at the last written
/// chunk. `Swapped`: another chain answers now, or this one without its history. `NodeBehind`: it lacks what it had
/// before.
pub async fn watch_round(plant: &Plant, network: &Network) -> Result<BlockRef> {
    let (mut obstacle, mut differing) = (PipelineError::Unsteady, None);
    for _ in 0..ATTEMPTS {
        let head = network.chain.head().await?;
        let lacking = match reorg::follow(plant, network, head, differing.take()).await? {
            Some(read) => read,
            None => {
                network.directory.saw_head_of(head.timestamp);
                reorg::look(plant, network, head.number).await?;
                match read_on(plant, network, head).await? {
                    Reached::Head => {
                        confirm(plant, network, head.number)?;
                        return Ok(head);
                    }
                    Reached::Changed => continue,
                    Reached::Differs(block) => {
                        differing = Some(block);
                        continue;
                    }
                    Reached::Before(block) => block,
                }
            }
        };
        obstacle = PipelineError::NodeBehind { block: lacking, head: head.number };
        tokio::time::sleep(PAUSE).await;
    }
    Err(obstacle)
}

fn confirm(plant: &Plant, network: &Network, head: u64) -> Result<()> {
    let deep = (head + 1).saturating_sub(network.confirmations);
    let confirmed = plant.ledger.batches.confirm(deep)?;
    if !confirmed.is_empty() {
        if let Some(stages) = plant.observer.stages() {
            stages.reached(Milestone::Confirmed, confirmed);
        }
        fault::point("confirmed");
        plant.observer.records_changed();
    }
    Ok(())
}

/// Scans up to `head`. If the cursor went back, the directory is built anew beside the one in use, which stays until the
/// new one is complete: a right that ended in between must not come back for a moment.
async fn read_on(plant: &Plant, network: &Network, head: BlockRef) -> Result<Reached> {
    let Some(directory) = block_in_place(|| as_of_the_cursor(plant, network))? else {
        return Walk { plant, network, head: head.number, shown: None }.scan().await;
    };
    let beside = Network { directory: Arc::new(directory), ..network.clone() };
    let reached = Walk { plant, network: &beside, head: head.number, shown: Some(&network.directory) }.scan().await;
    let read = || Ok::<_, PipelineError>(plant.ledger.trail.cursor()?.map_or(0, |(number, _)| number));
    if matches!(reached, Ok(Reached::Head)) || block_in_place(read)? >= network.directory.newest() {
        network.directory.become_like(&beside.directory);
        plant.observer.directory_changed();
    }
    reached
}

/// The directory as of the cursor; `None` if the one in use is that. Scanned again if it cannot be read back.
fn as_of_the_cursor(plant: &Plant, network: &Network) -> Result<Option<Directory>> {
    let Some((number, _)) = plant.ledger.trail.cursor()? else { return Ok(None) };
    if network.directory.newest() <= number {
        return Ok(None);
    }
    let fresh = network.directory.blank();
    read_back(plant, network, &fresh)?;
    Ok(Some(fresh))
}

/// Reads the chain from the cursor to `head`.
struct Walk<'a> {
    plant: &'a Plant,
    network: &'a Network,
    head: u64,
    shown: Option<&'a Directory>,
}

impl Walk<'_> {
    /// Old blocks many at a time, the newest one by one. The directory in use, `shown`, becomes that of `network` with the
    /// last of them, before anybody can see that they were read.
    async fn scan(&self) -> Result<Reached> {
        let first = first_block(self.network);
        let cursor = self.plant.ledger.trail.cursor()?;
        let mut from = cursor.map_or(first, |(number, _)| (number + 1).max(first));
        let mut below = cursor.filter(|(number, _)| *number >= first);
        let noted: BTreeMap<u64, Hash> = block_in_place(|| self.plant.ledger.trail.blocks(from))?.into_iter().collect();
        let near = self.network.chain.first_near(self.head);
        while from < near {
            let to = (near - 1).min(from + CHUNK - 1);
            let Some(last) = self.network.chain.block(to).await? else { return Ok(Reached::Changed) };
            if !stands(self.network, below).await? {
                return Ok(Reached::Changed);
            }
            let events = self.network.chain.events(from, to).await?;
            // The same block at the top means that nothing below changed while it was read.
            if !stands(self.network, Some((to, last.hash))).await? {
                return Ok(Reached::Changed);
            }
            let mut met: Vec<(u64, Hash)> = events.iter().map(|event| (event.block, event.block_hash)).collect();
            met.push((to, last.hash));
            met.dedup();
            if let Some(block) = self.differing(&noted, &met, from..=to).await? {
                return Ok(Reached::Differs(block));
            }
            block_in_place(|| self.write(&events, (to, last.hash), met))?;
            below = Some((to, last.hash));
            from = to + 1;
        }
        self.read(from, below, &noted).await
    }

    /// A block of this stretch that was replaced since it was noted: to overwrite it would leave what rests on it.
    async fn differing(
        &self,
        noted: &BTreeMap<u64, Hash>,
        met: &[(u64, Hash)],
        stretch: RangeInclusive<u64>,
    ) -> Result<Option<u64>> {
        let is_replaced = |(number, hash): &&(u64, Hash)| noted.get(number).is_some_and(|noted| noted != hash);
        if let Some((number, _)) = met.iter().find(is_replaced) {
            return Ok(Some(*number));
        }
        // One without events was not met; if the newest of them stands, so do those below.
        let newest = noted.range(stretch).next_back().map(|(number, hash)| (*number, *hash));
        let is_there = stands(self.network, newest).await?;
        Ok(newest.filter(|_| !is_there).map(|(number, _)| number))
    }

    /// `met` are blocks on the way.
    fn write(&self, events: &[EventAt], to: (u64, Hash), met: Vec<(u64, Hash)>) -> Result<()> {
        let (plant, network) = (self.plant, self.network);
        let sightings: Vec<Sighting> = events.iter().filter_map(sighting).collect();
        let roots: Vec<RootSighting> = events.iter().filter_map(root_sighting).collect();
        if !sightings.is_empty() || !roots.is_empty() {
            fault::point("events-read");
        }
        let mut changed = !sightings.is_empty() && plant.ledger.batches.mined(&sightings)? > 0;
        changed |= !roots.is_empty() && plant.ledger.batches.anchored(&roots)? > 0;
        if changed {
            fault::point("mined");
        }
        events.iter().for_each(|event| network.times.note(event));
        let told: Vec<Told> = events.iter().filter_map(|event| network.directory.judge(event)).collect();
        if !told.is_empty() {
            // Envelopes are stored before anyone looks for them.
            let kept = kept::keep(&plant.ledger.rights, &told);
            // A right that ended has ended, even if the disk is full; what could not be stored is read again.
            if told.iter().filter(|told| network.directory.take(told)).count() > 0 {
                plant.observer.directory_changed();
            }
            kept?;
            fault::point("directory-kept");
        }
        if let Some(shown) = self.shown.filter(|_| to.0 == self.head) {
            shown.become_like(&network.directory);
        }
        plant.ledger.trail.walk_to(to, met)?;
        if changed {
            fault::point("walked");
            plant.observer.records_changed();
        }
        foreign::look(plant, events, self.head)
    }

    /// Reads blocks on top of `below`, as far as they are there and none of the `noted` ones is replaced, and writes them.
    async fn read(&self, from: u64, below: Option<(u64, Hash)>, noted: &BTreeMap<u64, Hash>) -> Result<Reached> {
        let (mut read, mut top, mut next) = (Vec::new(), below, from);
        let reached = 'all: {
            while next <= self.head {
                let last = self.head.min(next + AT_ONCE - 1);
                for (number, found) in (next..=last).zip(self.network.chain.each_block(next, last).await?) {
                    let Some(found) = found else { break 'all Reached::Before(number) };
                    if top.is_some_and(|(below, hash)| below + 1 == number && hash != found.parent) {
                        break 'all Reached::Changed;
                    }
                    if noted.get(&number).is_some_and(|hash| *hash != found.block.hash) {
                        break 'all Reached::Differs(number);
                    }
                    if !block_in_place(|| is_to_be_taken(self.plant, &found))? {
                        break 'all Reached::Before(number);
                    }
                    top = Some((number, found.block.hash));
                    read.push(found);
                }
                next = last + 1;
            }
            Reached::Head
        };
        if let Some(BlockRef { number, hash, .. }) = read.last().map(|last: &BlockEvents| last.block) {
            block_in_place(|| {
                // Before the cursor passes them, so that a restart knows them too.
                reorg::note(self.plant, &read)?;
                let met = read.iter().map(|read| (read.block.number, read.block.hash)).collect();
                let events: Vec<EventAt> = read.into_iter().flat_map(|block| block.events).collect();
                self.write(&events, (number, hash), met)
            })?;
        }
        Ok(reached)
    }
}

async fn stands(network: &Network, block: Option<(u64, Hash)>) -> Result<bool> {
    let Some((number, hash)) = block else { return Ok(true) };
    Ok(network.chain.block(number).await?.is_some_and(|block| block.hash == hash))
}

fn sighting(at: &EventAt) -> Option<Sighting> {
    let Event::DataUploaded { owner, digest, .. } = at.event else { return None };
    let EventAt { transaction, block, block_hash, .. } = *at;
    Some(Sighting { owner, digest, transaction, block, block_hash })
}

fn root_sighting(at: &EventAt) -> Option<RootSighting> {
    let Event::Anchored { account, root, count, .. } = at.event else { return None };
    let EventAt { transaction, block, block_hash, .. } = *at;
    Some(RootSighting { account, root, count, transaction, block, block_hash })
}

/// How long to wait for a next block before checking again.
pub const PATIENCE: Duration = Duration::from_secs(2);

/// Those of these events that the ledger has not taken in, although it knows what they are about.
pub(crate) fn of<'a>(ledger: &Ledger, events: &'a [EventAt]) -> Result<Vec<&'a EventAt>, StoreError> {
    let sightings: Vec<Sighting> = events.iter().filter_map(sighting).collect();
    let roots: Vec<RootSighting> = events.iter().filter_map(root_sighting).collect();
    let is_anchor = |event: &EventAt| sighting(event).is_some() || root_sighting(event).is_some();
    let rights: Vec<(u64, u64)> =
        events.iter().filter(|event| !is_anchor(event)).map(|event| (event.block, event.log_index)).collect();
    let digests: HashSet<_> = ledger.batches.waiting_digests(&sightings)?.into_iter().collect();
    let waiting: HashSet<_> = ledger.batches.waiting_roots(&roots)?.into_iter().collect();
    let unknown: HashSet<_> = ledger.rights.unknown_rights(&rights)?.into_iter().collect();
    let is_unread = |event: &&EventAt| match (sighting(event), root_sighting(event)) {
        (Some(sighting), _) => digests.contains(&sighting.digest),
        (None, Some(sighting)) => waiting.contains(&sighting.root),
        (None, None) => unknown.contains(&(event.block, event.log_index)),
    };
    Ok(events.iter().filter(is_unread).collect())
}

/// Asks the watcher to read the chain again from this block on.
pub(crate) fn note(notes: &Notes, block: u64) -> Result<(), StoreError> {
    if notes.read(&MissedFrom {})?.is_some_and(|known| known <= block) {
        return Ok(());
    }
    notes.write(&MissedFrom {}, &block)
}

/// Wait for events that a block's header names and nobody gives.
const NEAR_PATIENCE: Duration = Duration::from_secs(5);

/// A block whose header names more than anybody gives has to wait, but not forever: a bloom may name what is not there.
fn is_to_be_taken(plant: &Plant, found: &BlockEvents) -> Result<bool> {
    if found.completeness != Completeness::Doubtful {
        return Ok(true);
    }
    let BlockRef { number, hash, .. } = found.block;
    if reorg::waited(&plant.ledger.notes, &DoubtedBlock {}, (number, hash))? < NEAR_PATIENCE {
        return Ok(false);
    }
    let text = format!(
        "the header of block {number} names events that the node does not return; it is read again later. If this \
         happens often, check the node, and run `authros audit`"
    );
    plant.observer.alert(false, text);
    Ok(true)
}

// The chain as the holder of the store's lease reads it, for a process beside it: the directory comes from the store,
// and a head counts once the holder has read it.

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

#[cfg(test)]
mod lagging_tests;

#[cfg(test)]
mod tests;
