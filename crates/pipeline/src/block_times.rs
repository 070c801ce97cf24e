//! Times of blocks: included with the events if the node does so, otherwise requested from the chain, and cached.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use tokio::runtime::Handle;
use tokio::task::block_in_place;

use crate::chain::EventAt;
use crate::model::Timestamp;

use super::{Network, PipelineError, Result};

/// The most times cached.
const MOST: usize = 16_384;

pub struct BlockTimes {
    known: Mutex<BTreeMap<u64, Timestamp>>,
    /// The runtime on which threads outside it can query the chain.
    runtime: Option<Handle>,
}

impl Default for BlockTimes {
    fn default() -> Self {
        Self { known: Mutex::default(), runtime: Handle::try_current().ok() }
    }
}

impl BlockTimes {
    pub(super) fn note(&self, at: &EventAt) {
        if let Some(time) = at.timestamp {
            self.keep(at.block, Timestamp::from_seconds(time));
        }
    }

    fn keep(&self, block: u64, time: Timestamp) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.len() >= MOST && !known.contains_key(&block) {
            known.pop_first();
        }
        known.insert(block, time);
    }

    /// Blocks from this one on were replaced.
    pub(super) fn forget_from(&self, block: u64) {
        drop(self.known.lock().unwrap_or_else(PoisonError::into_inner).split_off(&block));
    }

    fn of(&self, block: u64) -> Option<Timestamp> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).get(&block).copied()
    }
}

impl Network {
    /// As stated by the block's maker. Asks the chain if unknown; `Unsteady` if there is no such block (any more).
    pub fn time_of(&self, block: u64) -> Result<Timestamp> {
        if let Some(time) = self.times.of(block) {
            return Ok(time);
        }
        let runtime = self.times.runtime.as_ref().ok_or(PipelineError::Unsteady)?;
        block_in_place(|| runtime.block_on(self.ask_time(block)))
    }

    /// Same, for tasks.
    pub async fn ask_time(&self, block: u64) -> Result<Timestamp> {
        if let Some(time) = self.times.of(block) {
            return Ok(time);
        }
        let found = self.chain.block(block).await?.ok_or(PipelineError::Unsteady)?;
        let time = Timestamp::from_seconds(found.timestamp);
        self.times.keep(block, time);
        Ok(time)
    }
}
