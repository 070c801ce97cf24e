//! Nonce lanes: one per EOA. A signed transaction is stored before it is sent, and the same bytes are sent again until
//! the chain has decided about its nonce. After every block a lane is tended ([`Sender::tend`]).

mod lane;
mod tend;

pub use self::lane::{Lane, LaneState, Outgoing, PauseReason};

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use self::lane::Cell;
use crate::chain::{Call, Chain, Policy, Priced, Receipt, Shortfall, offered};
use crate::model::{Address, Hash, Wei, clean};
use crate::store::{Ledger, TransactionRow, TransactionState};
use crate::{Observer, PipelineError, Result, crypto::EoaSecret};

/// Transactions of one account that may wait for a block.
pub const MOST_OPEN: u64 = 1024;
/// How long a caller waits for a single transaction.
const PATIENCE: Duration = Duration::from_secs(120);
/// How long a price that was needed once is offered from the start.
const REMEMBERED: Duration = Duration::from_secs(3_600);
/// How long a node may take to have the blocks again that it had; after that the chain is taken to be shorter.
const CATCHING_UP: Duration = Duration::from_secs(120);
/// The purpose of the transaction that takes a cancelled one's nonce.
const PURPOSE: &str = "cancel";

/// A price that a transaction had to offer before it was mined.
#[derive(Debug, Clone, Copy)]
struct Needed {
    price: u128,
    at: Instant,
}

#[derive(Debug, Default)]
struct Heads {
    /// 0 before the first look.
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

/// A transaction that was cancelled, unless the chain still takes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cancelled {
    pub nonce: u64,
    pub purpose: String,
    /// Whether it anchored records, which are anchored again.
    pub anchors: bool,
    pub hash: Hash,
    pub price: Wei,
}

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
    pub fn new(ledger: Ledger, observer: Arc<dyn Observer>, policy: Policy) -> Self {
        Self { ledger, observer, policy, needed: Mutex::default(), heads: Mutex::default(), lanes: Mutex::default() }
    }

    /// Another process sends from now on: what is known here of the lanes will be false.
    pub fn forget(&self) {
        self.lanes.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    fn cell(&self, account: Address) -> Arc<Cell> {
        let mut lanes = self.lanes.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(lanes.entry(account).or_default())
    }

    /// Until the lane is released nobody else in this process signs for the account.
    pub async fn lane<'a>(&'a self, chain: &'a Chain, eoa: &'a EoaSecret) -> Lane<'a> {
        let account = eoa.address();
        let held = Arc::clone(&self.cell(account).nonces).lock_owned().await;
        Lane { sender: self, chain, eoa, account, held }
    }

    pub fn state_of(&self, account: Address) -> Result<LaneState> {
        let count = self.ledger.lanes.lane_count(account)?;
        let paused = self.cell(account).memory().paused.clone();
        Ok(LaneState { account, open: count.open, oldest: count.oldest, paused })
    }

    /// How many more transactions an account's lane accepts now; 0 while it is paused.
    pub fn room(&self, account: Address) -> Result<usize> {
        let state = self.state_of(account)?;
        let room = if state.paused.is_some() { 0 } else { MOST_OPEN.saturating_sub(state.open) };
        Ok(usize::try_from(room).unwrap_or(0))
    }

    /// Sends one call and waits until it is mined. `Reverted` and `NoEther` come before anything is sent if the node
    /// can tell; `NotMined` comes after two minutes at one price.
    pub async fn send(&self, chain: &Chain, eoa: &EoaSecret, call: Call, purpose: &str) -> Result<(Hash, Receipt)> {
        self.expect_means(chain, eoa.address(), &call).await?;
        chain.simulate(eoa.address(), &call).await?;
        let hashes = self.lane(chain, eoa).await.submit(vec![Outgoing::plain(call, purpose)]).await?;
        let hash = hashes.first().copied().ok_or_else(|| self.not_mined(eoa.address(), purpose))?;
        self.wait_mined(chain, eoa, hash, purpose).await
    }

    pub async fn transfer(&self, chain: &Chain, eoa: &EoaSecret, to: Address, wei: u128, purpose: &str) -> Result<()> {
        let hash = self.lane(chain, eoa).await.transfer(to, wei, purpose).await?;
        self.wait_mined(chain, eoa, hash, purpose).await.map(|_| ())
    }

    /// Waits until a transaction signed here is mined, even if it was signed again with another nonce or price.
    pub async fn wait_mined(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        mut hash: Hash,
        purpose: &str,
    ) -> Result<(Hash, Receipt)> {
        let (first, mut deadline) = (hash, Instant::now() + PATIENCE);
        let mut head = chain.head().await?.number;
        loop {
            // From the first one on: one that was replaced may be mined after all.
            let row = self.newest(first)?;
            if let Some(row) = row.as_ref().filter(|row| row.hash != hash) {
                (hash, deadline) = (row.hash, Instant::now() + PATIENCE);
            }
            if let Some(receipt) = chain.receipt(hash).await? {
                if purpose != PURPOSE && row.is_some_and(|row| row.purpose == PURPOSE) {
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

    fn newest(&self, mut hash: Hash) -> Result<Option<TransactionRow>> {
        for _ in 0..1000 {
            let row = self.ledger.lanes.transaction(hash)?;
            let is_replaced = |row: &&TransactionRow| row.state == TransactionState::Replaced;
            match row.as_ref().filter(is_replaced).and_then(|row| row.replaced_by) {
                Some(next) => hash = next,
                None => return Ok(row),
            }
        }
        Ok(None)
    }

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

    /// The operator's limits; the floor is at least what was needed within the last hour.
    pub fn policy(&self) -> Policy {
        let needed = self.needed.lock().unwrap_or_else(PoisonError::into_inner);
        let needed = needed.filter(|needed| needed.at.elapsed() < REMEMBERED);
        needed.map_or(self.policy, |needed| self.policy.with_floor(needed.price))
    }

    pub fn limits(&self) -> Policy {
        self.policy
    }

    /// Notes the price of a transaction that was mined only when it offered more than quoted.
    pub fn note_needed(&self, price: u128) {
        *self.needed.lock().unwrap_or_else(PoisonError::into_inner) = Some(Needed { price, at: Instant::now() });
    }

    fn see_head(&self, number: u64) -> Option<u64> {
        self.heads.lock().unwrap_or_else(PoisonError::into_inner).see(number, CATCHING_UP)
    }

    /// Why the account cannot pay so much. A node that is behind its own earlier head does not know what it holds.
    async fn shortage(&self, chain: &Chain, account: Address, needed: u128) -> Result<PauseReason> {
        // Before the head is asked for; where the chain became shorter, the watcher goes back itself.
        let read = self.ledger.trail.cursor()?.map(|(block, _)| block);
        let block = chain.head().await?.number;
        let seen = self.see_head(block).max(read.filter(|read| *read > block));
        if let Some(highest) = seen {
            return Ok(PauseReason::CatchingUp { block, highest });
        }
        let held = Wei(chain.wealth(account).await?);
        Ok(PauseReason::NoEther(Shortfall { account, held, needed: Wei(needed) }))
    }

    async fn expect_means(&self, chain: &Chain, account: Address, call: &Call) -> Result<()> {
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

    /// Replaces the open transaction with this nonce by an empty one at a higher price. Records that it anchors are
    /// anchored again; other effects do not happen, and its callers get an error. If the chain takes the old one after
    /// all, that counts.
    pub async fn cancel(&self, chain: &Chain, eoa: &EoaSecret, nonce: u64) -> Result<Cancelled> {
        let account = eoa.address();
        let cell = self.cell(account);
        let _alone = cell.tending.lock().await;
        let open = self.ledger.lanes.open_lane(account)?;
        let Some(row) = open.into_iter().find(|row| row.nonce == nonce) else {
            return Err(PipelineError::Refused(format!(
                "{account} has no transaction with nonce {nonce} waiting here; `authros chain status` lists those that wait"
            )));
        };
        if self.nonces(chain, account).await?.mined > nonce {
            let text = format!("the transaction with nonce {nonce} ({}) is in a block already", row.purpose);
            return Err(PipelineError::Refused(format!("{text}; nothing was cancelled")));
        }
        let raw = self.ledger.lanes.raw_transaction(row.hash)?.unwrap_or_default();
        let price = match self.policy().replacement(offered(&raw)?.price, &chain.market().await?) {
            Priced::At(price) => price,
            Priced::Capped { needed, cap } => {
                return Err(PipelineError::Refused(PauseReason::capped(needed, cap).cause(account)));
            }
        };
        let signed = chain.sign_transfer(eoa, nonce, account, 0, price)?;
        let cost = price.saturating_mul(u128::from(signed.gas_limit));
        if chain.wealth(account).await? < cost {
            return Err(match self.shortage(chain, account, cost).await? {
                PauseReason::NoEther(lacking) => PipelineError::NoEther(lacking),
                reason => PipelineError::Refused(reason.cause(account)),
            });
        }
        self.ledger.lanes.replace_transaction(row.hash, lane::row_of(&signed, account, PURPOSE))?;
        self.hand_in(chain, account, signed.hash, &signed.raw).await;
        Ok(Cancelled { nonce, purpose: row.purpose, anchors: row.anchors, hash: signed.hash, price: Wei(price) })
    }

    /// Returns the block of the transaction in place of a cancelled one, or `None` if the cancelled one was mined after
    /// all.
    pub async fn wait_cancelled(&self, chain: &Chain, eoa: &EoaSecret, cancelled: &Cancelled) -> Result<Option<u64>> {
        let (account, deadline) = (eoa.address(), Instant::now() + PATIENCE);
        let mut head = chain.head().await?.number;
        while self.nonces(chain, account).await?.mined <= cancelled.nonce {
            if Instant::now() > deadline {
                return Err(self.not_mined(account, PURPOSE));
            }
            let seen = chain.next_block(head, Duration::from_secs(2)).await?.number;
            if seen == head {
                self.tend(chain, eoa).await?;
            }
            head = seen;
        }
        for (hash, _) in self.ledger.lanes.of_nonce(account, cancelled.nonce)? {
            let row = self.ledger.lanes.transaction(hash)?;
            if row.is_some_and(|row| row.purpose == PURPOSE)
                && let Some(receipt) = chain.receipt(hash).await?
            {
                return Ok(Some(receipt.block));
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod node_tests;

#[cfg(test)]
mod tests;

#[cfg(test)]
mod funds_tests {
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
