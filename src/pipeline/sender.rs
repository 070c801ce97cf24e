//! Nonce lanes: one per EOA. A signed transaction is stored before it is sent, and sent again
//! as the same bytes until the chain has decided about its nonce.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::{Call, Chain, ChainError, Receipt};
use crate::crypto::EoaSecret;
use crate::model::{Address, Hash, Timestamp, clean};
use crate::store::{Anchors, Ledger, NewTransaction, TransactionOutcome};

use super::PipelineError;
use super::error::of_payer;

/// A transaction signed less long ago than this is not sent again, nanoseconds.
const QUIET: u64 = 4_000_000_000;
/// How long a single transaction may take until its sender is told that it waits.
const PATIENCE: Duration = Duration::from_secs(120);

/// A call to be signed and sent.
#[derive(Debug, Clone)]
pub struct Outgoing {
    /// What the contract is to do.
    pub call: Call,
    /// What it is for, in a word.
    pub purpose: String,
    /// The records that it anchors.
    pub anchors: Anchors,
}

#[derive(Default)]
struct Lane {
    next: Option<u64>,
}

/// Sends transactions of all accounts of the site.
pub struct Sender {
    ledger: Ledger,
    lanes: Mutex<HashMap<Address, Arc<tokio::sync::Mutex<Lane>>>>,
}

impl Sender {
    /// A sender that keeps its transactions in `ledger`.
    pub fn new(ledger: Ledger) -> Self {
        Self { ledger, lanes: Mutex::default() }
    }

    fn lane(&self, account: Address) -> Arc<tokio::sync::Mutex<Lane>> {
        Arc::clone(self.lanes.lock().unwrap_or_else(PoisonError::into_inner).entry(account).or_default())
    }

    async fn next_nonce(&self, chain: &Chain, account: Address, lane: &Lane) -> Result<u64, PipelineError> {
        if let Some(next) = lane.next {
            return Ok(next);
        }
        let mined = chain.nonce(account, false).await?;
        let open = block_in_place(|| self.ledger.open_transactions(account))?;
        Ok(open.iter().map(|row| row.nonce + 1).fold(mined, u64::max))
    }

    /// Signs, stores and sends `calls` in order.
    ///
    /// # Errors
    /// Of the chain while signing, of the ledger while storing. A transaction that is stored but
    /// could not be handed to the node is no error: it is sent again.
    pub async fn submit(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        calls: Vec<Outgoing>,
    ) -> Result<Vec<Hash>, PipelineError> {
        let account = eoa.address();
        let lane = self.lane(account);
        let mut lane = lane.lock().await;
        let mut nonce = self.next_nonce(chain, account, &lane).await?;
        let mut rows = Vec::with_capacity(calls.len());
        for Outgoing { call, purpose, anchors } in calls {
            let signed = chain.sign(eoa, nonce, &call).await.map_err(|error| of_payer(error, account))?;
            rows.push(NewTransaction { hash: signed.hash, account, nonce, raw: signed.raw, purpose, anchors });
            nonce += 1;
        }
        let sent: Vec<(Hash, Vec<u8>)> = rows.iter().map(|row| (row.hash, row.raw.clone())).collect();
        block_in_place(|| self.ledger.submit_many(rows))?;
        lane.next = Some(nonce);
        for (_, raw) in &sent {
            if let Err(error) = chain.broadcast(raw).await {
                // The bytes are stored; resend() repeats them. The nonce is asked again then.
                if !matches!(error, ChainError::AlreadyKnown) {
                    lane.next = None;
                    break;
                }
            }
        }
        Ok(sent.into_iter().map(|(hash, _)| hash).collect())
    }

    /// Sends one call and waits until it is mined.
    ///
    /// # Errors
    /// `Reverted` with the contract's reason, before anything is sent where the node can tell;
    /// `NotMined` after two minutes; errors of chain and ledger.
    pub async fn send(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        call: Call,
        purpose: &str,
    ) -> Result<(Hash, Receipt), PipelineError> {
        chain.simulate(eoa.address(), &call).await.map_err(|error| of_payer(error, eoa.address()))?;
        let hashes = self
            .submit(chain, eoa, vec![Outgoing { call, purpose: purpose.to_owned(), anchors: Anchors::Nothing }])
            .await?;
        let hash = hashes.first().copied().ok_or_else(|| PipelineError::NotMined(purpose.to_owned()))?;
        self.wait_mined(chain, eoa.address(), hash, purpose).await
    }

    async fn wait_mined(
        &self,
        chain: &Chain,
        account: Address,
        hash: Hash,
        purpose: &str,
    ) -> Result<(Hash, Receipt), PipelineError> {
        let deadline = Instant::now() + PATIENCE;
        let mut head = chain.head().await?.number;
        loop {
            if let Some(receipt) = chain.receipt(hash).await? {
                self.close(hash, &receipt)?;
                return match receipt.success {
                    true => Ok((hash, receipt)),
                    false => Err(PipelineError::Reverted {
                        purpose: purpose.to_owned(),
                        reason: clean(receipt.reason.as_deref().unwrap_or("no reason given"), 200),
                    }),
                };
            }
            if Instant::now() > deadline {
                return Err(PipelineError::NotMined(purpose.to_owned()));
            }
            let seen = chain.next_block(head, Duration::from_secs(2)).await?.number;
            if seen == head {
                self.resend(chain, account).await?;
            }
            head = seen;
        }
    }

    fn close(&self, hash: Hash, receipt: &Receipt) -> Result<(), PipelineError> {
        let outcome = if receipt.success {
            TransactionOutcome::Mined {
                block: receipt.block,
                block_hash: receipt.block_hash,
                gas_used: Some(receipt.gas_used),
            }
        } else {
            TransactionOutcome::Reverted { reason: clean(receipt.reason.as_deref().unwrap_or(""), 200) }
        };
        Ok(block_in_place(|| self.ledger.close_transaction(hash, outcome))?)
    }

    /// Looks at every open transaction of the account: closes what the chain has decided and
    /// sends the rest again, byte for byte. Returns how many are still open, and refused reasons.
    ///
    /// # Errors
    /// Of chain and ledger.
    pub async fn resend(&self, chain: &Chain, account: Address) -> Result<(usize, Vec<String>), PipelineError> {
        let open = block_in_place(|| self.ledger.open_transactions(account))?;
        if open.is_empty() {
            return Ok((0, Vec::new()));
        }
        let (now, mined) = (Timestamp::now(), chain.nonce(account, false).await?);
        let (mut waiting, mut refused) = (0, Vec::new());
        for row in open {
            if row.nonce < mined {
                match chain.receipt(row.hash).await? {
                    Some(receipt) => {
                        if !receipt.success {
                            refused.push(format!(
                                "{}: {}",
                                row.purpose,
                                clean(receipt.reason.as_deref().unwrap_or("reverted"), 200)
                            ));
                        }
                        self.close(row.hash, &receipt)?;
                    }
                    None => block_in_place(|| self.ledger.close_transaction(row.hash, TransactionOutcome::Replaced))?,
                }
                continue;
            }
            waiting += 1;
            if now.0.saturating_sub(row.signed_at.0) < QUIET {
                continue;
            }
            match chain.broadcast(&row.raw).await {
                Ok(_) | Err(ChainError::AlreadyKnown | ChainError::NonceTooLow) => {}
                Err(error) => return Err(of_payer(error, account)),
            }
        }
        Ok((waiting, refused))
    }
}
