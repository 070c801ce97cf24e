//! Nonce lanes: one per EOA. A signed transaction is stored before it is sent, and the same bytes are sent again until
//! the chain has decided about its nonce.
//!
//! After every block a lane is *tended* ([`Sender::tend`]): its transactions are closed, yielded to others, replaced at
//! a higher price, gaps filled, or the lane visibly paused; nothing is lost.

mod cancel;
mod funds;
mod lane;
#[cfg(test)]
mod node_tests;
mod nonces;
mod state;
mod tend;
#[cfg(test)]
mod tests;
mod waiting;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::{Call, Chain, Policy, Receipt};
use crate::crypto::EoaSecret;
use crate::model::{Address, Hash, clean};
use crate::store::{Ledger, TransactionRow, TransactionState};

pub use self::cancel::Cancelled;
use self::funds::{Heads, Needed};
use self::lane::Cell;
pub use self::lane::{Lane, Outgoing};
pub use self::state::{LaneState, PauseReason};
use super::{Observer, PipelineError};

/// Transactions of one account that may wait for a block.
pub const MOST_OPEN: u64 = 1024;
/// How long a single transaction may take before its sender is told that it is waiting.
const PATIENCE: Duration = Duration::from_secs(120);

/// Sends transactions of all accounts of the site.
pub struct Sender {
    ledger: Ledger,
    observer: Arc<dyn Observer>,
    policy: Policy,
    /// A price that was needed although the node quoted less, and when.
    needed: Mutex<Option<Needed>>,
    heads: Mutex<Heads>,
    lanes: Mutex<HashMap<Address, Arc<Cell>>>,
}

impl Sender {
    /// A sender that stores its transactions in `ledger` and tells `observer` when a lane is paused.
    pub fn new(ledger: Ledger, observer: Arc<dyn Observer>, policy: Policy) -> Self {
        Self { ledger, observer, policy, needed: Mutex::default(), heads: Mutex::default(), lanes: Mutex::default() }
    }

    fn cell(&self, account: Address) -> Arc<Cell> {
        let mut lanes = self.lanes.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(lanes.entry(account).or_insert_with(|| Arc::new(Cell::new())))
    }

    /// Holds the account's lane: until it is released nobody else signs for it in this process.
    pub async fn lane<'a>(&'a self, chain: &'a Chain, eoa: &'a EoaSecret) -> Lane<'a> {
        let account = eoa.address();
        let held = Arc::clone(&self.cell(account).nonces).lock_owned().await;
        Lane { sender: self, chain, eoa, account, held }
    }

    /// The state of an account's lane.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn state_of(&self, account: Address) -> Result<LaneState, PipelineError> {
        let count = block_in_place(|| self.ledger.lane_count(account))?;
        let paused = self.cell(account).memory().paused.clone();
        Ok(LaneState { account, open: count.open, oldest: count.oldest, paused })
    }

    /// How many more transactions an account's lane accepts now; 0 while it is paused.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn room(&self, account: Address) -> Result<usize, PipelineError> {
        let state = self.state_of(account)?;
        let room = if state.paused.is_some() { 0 } else { MOST_OPEN.saturating_sub(state.open) };
        Ok(usize::try_from(room).unwrap_or(0))
    }

    /// Signs, stores and sends `outgoing` in order.
    ///
    /// # Errors
    /// See [`Lane::submit`].
    pub async fn submit(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        outgoing: Vec<Outgoing>,
    ) -> Result<Vec<Hash>, PipelineError> {
        self.lane(chain, eoa).await.submit(outgoing).await
    }

    /// Sends one call and waits until it is mined.
    ///
    /// # Errors
    /// `Reverted` with the contract's reason, and `NoEther`, before anything is sent if the node can tell; `NotMined`
    /// after two minutes at one price; `Cancelled`; errors of chain and ledger.
    pub async fn send(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        call: Call,
        purpose: &str,
    ) -> Result<(Hash, Receipt), PipelineError> {
        self.expect_means(chain, eoa.address(), &call).await?;
        chain.simulate(eoa.address(), &call).await?;
        let hashes = self.submit(chain, eoa, vec![Outgoing::plain(call, purpose)]).await?;
        let hash = hashes.first().copied().ok_or_else(|| self.not_mined(eoa.address(), purpose))?;
        self.wait_mined(chain, eoa, hash, purpose).await
    }

    /// Sends ether, and waits until it is mined.
    ///
    /// # Errors
    /// See [`Sender::send`]; `NoEther` if the account holds too little.
    pub async fn transfer(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        to: Address,
        wei: u128,
        purpose: &str,
    ) -> Result<(), PipelineError> {
        let hash = self.lane(chain, eoa).await.transfer(to, wei, purpose).await?;
        self.wait_mined(chain, eoa, hash, purpose).await.map(|_| ())
    }

    /// Waits until a transaction signed here is mined, even if it was signed again with another nonce or price.
    ///
    /// # Errors
    /// See [`Sender::send`].
    pub async fn wait_mined(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        mut hash: Hash,
        purpose: &str,
    ) -> Result<(Hash, Receipt), PipelineError> {
        let (first, mut deadline) = (hash, Instant::now() + PATIENCE);
        let mut head = chain.head().await?.number;
        loop {
            // From the first one on: one that was replaced may be mined after all.
            let row = self.newest(first)?;
            if let Some(row) = row.as_ref().filter(|row| row.hash != hash) {
                (hash, deadline) = (row.hash, Instant::now() + PATIENCE);
            }
            if let Some(receipt) = chain.receipt(hash).await? {
                if purpose != cancel::PURPOSE && row.is_some_and(|row| row.purpose == cancel::PURPOSE) {
                    return Err(PipelineError::Cancelled(purpose.to_owned()));
                }
                return match receipt.success {
                    true => Ok((hash, receipt)),
                    false => Err(PipelineError::Reverted {
                        purpose: purpose.to_owned(),
                        reason: clean(receipt.reason.as_deref().unwrap_or("no reason given"), 200),
                    }),
                };
            }
            if Instant::now() > deadline {
                return Err(self.not_mined(eoa.address(), purpose));
            }
            let seen = chain.next_block(head, Duration::from_secs(2)).await?.number;
            if seen == head {
                self.tend(chain, eoa).await?;
            }
            head = seen;
        }
    }

    fn not_mined(&self, account: Address, purpose: &str) -> PipelineError {
        let paused = self.cell(account).memory().paused.as_ref().map(|reason| reason.cause(account));
        let why = paused.unwrap_or_else(|| "check that the network makes blocks".to_owned());
        PipelineError::NotMined { purpose: purpose.to_owned(), why }
    }

    /// Follows a transaction to its last replacement.
    fn newest(&self, mut hash: Hash) -> Result<Option<TransactionRow>, PipelineError> {
        for _ in 0..1000 {
            let row = block_in_place(|| self.ledger.transaction(hash))?;
            let is_replaced = |row: &&TransactionRow| row.state == TransactionState::Replaced;
            match row.as_ref().filter(is_replaced).and_then(|row| row.replaced_by) {
                Some(next) => hash = next,
                None => return Ok(row),
            }
        }
        Ok(None)
    }

    /// Pauses an account's lane, and reports it once.
    fn pause(&self, account: Address, reason: PauseReason) -> PipelineError {
        let text = reason.text(account);
        self.settle(account, Some(reason));
        PipelineError::Refused(text)
    }

    fn settle(&self, account: Address, paused: Option<PauseReason>) {
        let told = {
            let cell = self.cell(account);
            let mut memory = cell.memory();
            memory.paused.clone_from(&paused);
            let alarm = paused.as_ref().filter(|reason| reason.is_alarm()).map(PauseReason::word);
            // While the node is catching up nothing is known anew, so an alarm stands.
            let alarm = if paused.is_some() { alarm.or(memory.alarm) } else { None };
            (std::mem::replace(&mut memory.alarm, alarm), alarm)
        };
        match (told, paused) {
            ((before, now), _) if before == now => {}
            (_, Some(now)) => self.observer.alert(true, now.text(account)),
            (_, None) => self.observer.alert(false, format!("anchoring for {account} resumes")),
        }
    }
}
