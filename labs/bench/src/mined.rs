//! Tells each of many waiters that its transaction is in a block: one reader of blocks for all of them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::foreign::block;
use authros_chain::{Chain, ChainError, Receipt};
use authros_model::{ErrorKind, Hash, Wei};
use authros_service::Failure;

/// How long nothing may move before waiting ends.
const STALL: Duration = Duration::from_secs(120);
/// How long a node may be silent.
const SILENCE: Duration = Duration::from_secs(20);
/// How often a node is asked for its head; the embedded chain announces it.
const POLL: Duration = Duration::from_millis(20);
/// How long to wait after a node did not answer.
const REST: Duration = Duration::from_millis(200);

/// Blocks seen, and who waits for one.
#[derive(Debug)]
pub struct Mined {
    /// `None` once nobody reads blocks any more.
    waiting: Mutex<Option<HashMap<Hash, oneshot::Sender<()>>>>,
    blocks: Mutex<Vec<Instant>>,
    trouble: Mutex<Option<String>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Default for Mined {
    fn default() -> Self {
        Self { waiting: Mutex::new(Some(HashMap::new())), blocks: Mutex::default(), trouble: Mutex::default() }
    }
}

impl Mined {
    /// To be called before the transaction is sent; resolves when it is in a block.
    pub fn expect(&self, hash: Hash) -> oneshot::Receiver<()> {
        let (tell, told) = oneshot::channel();
        lock(&self.waiting).as_mut().and_then(|waiting| waiting.insert(hash, tell));
        told
    }

    /// Waits for a transaction that was expected, and reads its receipt.
    ///
    /// # Errors
    /// If it is not mined while nothing moves for two minutes, the node is silent, or it failed.
    pub async fn receipt(&self, chain: &Chain, hash: Hash, told: oneshot::Receiver<()>) -> Result<Receipt, Failure> {
        if told.await.is_err() {
            let trouble = lock(&self.trouble).clone();
            let why = trouble.unwrap_or_else(|| {
                ChainError::NotMined { seconds: STALL.as_secs(), blocks: 0, price: Wei::default() }.to_string()
            });
            return Err(Failure::new(ErrorKind::Unreachable, why));
        }
        match chain.receipt(hash).await? {
            Some(receipt) if receipt.success => Ok(receipt),
            Some(receipt) => {
                let why = receipt.reason.unwrap_or_else(|| "it failed on the chain".to_owned());
                Err(Failure::new(ErrorKind::Refused, why))
            }
            None => Err(Failure::new(ErrorKind::Refused, "its block was reorganised away")),
        }
    }

    /// When the blocks with transactions of the run were seen.
    pub fn blocks(&self) -> Vec<Instant> {
        lock(&self.blocks).clone()
    }

    /// Reads blocks after `head` until nothing moves any more; then notifies all who still wait.
    pub async fn watch(self: Arc<Self>, chain: Chain, mut head: u64, embedded: bool) {
        let patience = if embedded { Duration::from_secs(1) } else { POLL };
        let (mut moved, mut answered) = (Instant::now(), Instant::now());
        while moved.elapsed() < STALL && answered.elapsed() < SILENCE {
            match self.look(&chain, head, patience).await {
                Ok(now) => {
                    answered = Instant::now();
                    *lock(&self.trouble) = None;
                    if now > head {
                        (head, moved) = (now, answered);
                    }
                }
                Err(error) => {
                    *lock(&self.trouble) = Some(error.message);
                    tokio::time::sleep(REST).await;
                }
            }
        }
        *lock(&self.waiting) = None;
    }

    async fn look(&self, chain: &Chain, after: u64, patience: Duration) -> Result<u64, Failure> {
        let head = chain.next_block(after, patience).await?.number;
        let seen = Instant::now();
        for number in after + 1..=head {
            let Some(work) = block(chain, number).await? else { return Ok(number - 1) };
            let told: Vec<_> = match lock(&self.waiting).as_mut() {
                Some(waiting) => work.transactions.iter().filter_map(|hash| waiting.remove(hash)).collect(),
                None => Vec::new(),
            };
            if !told.is_empty() {
                lock(&self.blocks).push(seen);
            }
            // One that was ended waits no more.
            told.into_iter().for_each(|tell| _ = tell.send(()));
        }
        Ok(head)
    }
}
