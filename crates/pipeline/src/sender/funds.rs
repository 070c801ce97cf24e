//! What an account can pay, and what the network's gas has cost although its node quoted less.

use std::sync::PoisonError;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::{Call, Chain, Policy, Priced, Shortfall};
use crate::model::{Address, Wei};
use crate::pipeline::PipelineError;
use crate::pipeline::watcher::CURSOR;

use super::Sender;
use super::state::PauseReason;

/// How long a price that was needed once is offered from the start.
const REMEMBERED: Duration = Duration::from_secs(3_600);
/// How long a node may take to have the blocks again that it had; after that the chain is taken to be shorter.
const CATCHING_UP: Duration = Duration::from_secs(120);

/// A price that a transaction had to offer before it was mined.
#[derive(Debug, Clone, Copy)]
pub(super) struct Needed {
    price: u128,
    at: Instant,
}

/// The newest block of the node so far.
#[derive(Debug, Default)]
pub(super) struct Heads {
    /// Its number; 0 before the first look.
    highest: u64,
    /// Since when the node has been below it.
    behind: Option<Instant>,
}

impl Heads {
    /// Notes the node's newest block; returns the one that it had before, if it is behind that.
    fn see(&mut self, number: u64, patience: Duration) -> Option<u64> {
        let highest = self.highest;
        let since = *self.behind.get_or_insert_with(Instant::now);
        if number >= highest || since.elapsed() > patience {
            (self.highest, self.behind) = (number, None);
            return None;
        }
        Some(highest)
    }
}

impl Sender {
    /// The operator's limits; the floor is at least what was needed within the last hour.
    pub fn policy(&self) -> Policy {
        let needed = self.needed.lock().unwrap_or_else(PoisonError::into_inner);
        let needed = needed.filter(|needed| needed.at.elapsed() < REMEMBERED);
        needed.map_or(self.policy, |needed| self.policy.with_floor(needed.price))
    }

    /// The operator's limits, as they are set.
    pub fn limits(&self) -> Policy {
        self.policy
    }

    /// Notes the price of a transaction that was mined only when it offered more than quoted.
    pub fn note_needed(&self, price: u128) {
        *self.needed.lock().unwrap_or_else(PoisonError::into_inner) = Some(Needed { price, at: Instant::now() });
    }

    /// Notes the node's newest block; returns the one that it had before, if it is behind that.
    pub(super) fn see_head(&self, number: u64) -> Option<u64> {
        self.heads.lock().unwrap_or_else(PoisonError::into_inner).see(number, CATCHING_UP)
    }

    /// Why the account cannot pay so much. A node that is behind its own earlier head does not know what it holds.
    pub(super) async fn shortage(
        &self,
        chain: &Chain,
        account: Address,
        needed: u128,
    ) -> Result<PauseReason, PipelineError> {
        // Before the head is asked for; where the chain became shorter, the watcher goes back itself.
        let read = block_in_place(|| self.ledger.cursor(CURSOR))?.map(|(block, _)| block);
        let block = chain.head().await?.number;
        let seen = self.see_head(block).max(read.filter(|read| *read > block));
        if let Some(highest) = seen {
            return Ok(PauseReason::CatchingUp { block, highest });
        }
        let held = Wei(chain.wealth(account).await?);
        Ok(PauseReason::NoEther(Shortfall { account, held, needed: Wei(needed) }))
    }

    /// Fails before anything is signed if the account cannot pay for the call.
    pub(super) async fn expect_means(&self, chain: &Chain, account: Address, call: &Call) -> Result<(), PipelineError> {
        let Priced::At(price) = self.policy().fresh(&chain.market().await?) else { return Ok(()) };
        let lacking = chain.shortfall(account, call, price).await?;
        if lacking.held >= lacking.needed {
            return Ok(());
        }
        match self.shortage(chain, account, lacking.needed.0).await? {
            PauseReason::NoEther(lacking) => Err(PipelineError::NoEther(lacking)),
            reason => Err(PipelineError::Refused(reason.cause(account))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_below_its_own_head_is_catching_up_for_a_while() {
        let mut heads = Heads::default();
        let long = Duration::from_secs(60);
        assert_eq!((heads.see(7, long), heads.see(9, long), heads.see(9, long)), (None, None, None));
        assert_eq!((heads.see(3, long), heads.see(8, long)), (Some(9), Some(9)));
        assert_eq!((heads.see(9, long), heads.see(10, long)), (None, None));
        assert_eq!(heads.see(2, long), Some(10));
        std::thread::sleep(Duration::from_millis(2));
        assert_eq!((heads.see(2, Duration::ZERO), heads.see(1, long)), (None, Some(2)), "a shorter chain is believed");
    }
}
