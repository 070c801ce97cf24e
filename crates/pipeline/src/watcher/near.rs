//! The newest blocks, one by one: each by its hash, each on top of the one before, each held against its own header.

use std::time::Duration;

use tokio::task::block_in_place;

use crate::chain::{AT_ONCE, BlockEvents, BlockRef, Completeness, EventAt};
use crate::model::Hash;
use crate::pipeline::{Directory, Network, PipelineError, Plant};

use super::{Reached, again, foreign, write};

/// The setting that says since when which block is doubted.
const DOUBTED: &str = "watcher:doubted";
/// How long a block is waited for whose header names events that nobody gives.
const PATIENCE: Duration = Duration::from_secs(5);

/// Reads blocks `from` to `to` on top of `below`, as far as they are there, and writes them.
pub(super) async fn read(
    plant: &Plant,
    network: &Network,
    (from, to): (u64, u64),
    below: Option<(u64, Hash)>,
    shown: Option<&Directory>,
) -> Result<Reached, PipelineError> {
    let (mut read, mut top, mut next) = (Vec::new(), below, from);
    let mut reached = Reached::Head;
    'all: while next <= to {
        let last = to.min(next + AT_ONCE - 1);
        for (number, found) in (next..=last).zip(network.chain.each_block(next, last).await?) {
            let Some(found) = found else {
                reached = Reached::Before(number);
                break 'all;
            };
            if top.is_some_and(|(below, hash)| below + 1 == number && hash != found.parent) {
                reached = Reached::Changed;
                break 'all;
            }
            if !block_in_place(|| is_to_be_taken(plant, &found))? {
                reached = Reached::Before(number);
                break 'all;
            }
            top = Some((number, found.block.hash));
            read.push(found);
        }
        next = last + 1;
    }
    if !read.is_empty() {
        block_in_place(|| take(plant, network, &read, to, shown))?;
    }
    Ok(reached)
}

/// A block whose header names more than anybody gives is waited for, but not for ever: a bloom may name what is not there.
fn is_to_be_taken(plant: &Plant, found: &BlockEvents) -> Result<bool, PipelineError> {
    if found.completeness != Completeness::Doubtful {
        return Ok(true);
    }
    let BlockRef { number, hash, .. } = found.block;
    if again::waited(plant, DOUBTED, (number, hash))? < PATIENCE {
        return Ok(false);
    }
    plant.observer.alert(
        false,
        format!(
            "the header of block {number} names events that the node does not give; it is read again later. If this comes \
             often, check the node, and run `authros audit`"
        ),
    );
    Ok(true)
}

fn take(
    plant: &Plant,
    network: &Network,
    read: &[BlockEvents],
    head: u64,
    shown: Option<&Directory>,
) -> Result<(), PipelineError> {
    let Some(last) = read.last() else { return Ok(()) };
    // Before the cursor passes them, so that a restart knows them too.
    again::note(plant, read)?;
    let events: Vec<EventAt> = read.iter().flat_map(|block| block.events.iter().cloned()).collect();
    let met = read.iter().map(|read| (read.block.number, read.block.hash)).collect();
    let shown = shown.filter(|_| last.block.number == head);
    write(plant, network, &events, (last.block.number, last.block.hash), met, shown)?;
    foreign::look(plant, &events, head)
}
