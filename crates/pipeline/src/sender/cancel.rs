//! Cancelling a transaction that is in no block: an empty one to oneself takes its nonce.

use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::{Chain, Priced, offered};
use crate::crypto::EoaSecret;
use crate::model::{Hash, Wei};
use crate::pipeline::PipelineError;
use crate::store::{Anchors, NewTransaction};

use super::state::PauseReason;
use super::{PATIENCE, Sender};

/// The purpose of the transaction that takes a cancelled one's nonce.
pub(super) const PURPOSE: &str = "cancel";

/// A transaction that was cancelled, unless the chain takes it all the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cancelled {
    /// Its nonce.
    pub nonce: u64,
    /// Its purpose.
    pub purpose: String,
    /// Whether it anchored records; they wait to be anchored again.
    pub anchors: bool,
    /// The transaction in its place.
    pub hash: Hash,
    /// The price per gas that this one offers.
    pub price: Wei,
}

impl Sender {
    /// Replaces the account's open transaction with this nonce by an empty one to the account itself, at a higher
    /// price. The records that it anchors wait to be anchored again; whatever else it was for does not happen, and
    /// whoever waits for it is told. If the chain takes the old one after all, that is recognised as for any other.
    ///
    /// # Errors
    /// `Refused` if there is no such transaction, it is in a block already, or the cap forbids a higher price;
    /// `NoEther`; errors of chain and ledger.
    pub async fn cancel(&self, chain: &Chain, eoa: &EoaSecret, nonce: u64) -> Result<Cancelled, PipelineError> {
        let account = eoa.address();
        let cell = self.cell(account);
        let _alone = cell.tending.lock().await;
        let open = block_in_place(|| self.ledger.open_lane(account))?;
        let Some(row) = open.into_iter().find(|row| row.nonce == nonce) else {
            return Err(PipelineError::Refused(format!(
                "{account} has no transaction with nonce {nonce} waiting here; `authros chain status` lists those that wait"
            )));
        };
        if self.nonces(chain, account).await?.mined > nonce {
            let text = format!("the transaction with nonce {nonce} ({}) is in a block already", row.purpose);
            return Err(PipelineError::Refused(format!("{text}; nothing was cancelled")));
        }
        let raw = block_in_place(|| self.ledger.raw_transaction(row.hash))?.unwrap_or_default();
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
        let (hash, raw, purpose) = (signed.hash, signed.raw, PURPOSE.to_owned());
        let new = NewTransaction { hash, account, nonce, raw: raw.clone(), purpose, anchors: Anchors::Nothing };
        block_in_place(|| self.ledger.replace_transaction(row.hash, new))?;
        self.hand_in(chain, account, hash, &raw).await;
        Ok(Cancelled { nonce, purpose: row.purpose, anchors: row.anchors, hash, price: Wei(price) })
    }

    /// Waits until the chain has used a cancelled transaction's nonce; returns the block of the one in its place, or
    /// `None` if the cancelled one was mined after all.
    ///
    /// # Errors
    /// `NotMined` after two minutes; errors of chain and ledger.
    pub async fn wait_cancelled(
        &self,
        chain: &Chain,
        eoa: &EoaSecret,
        cancelled: &Cancelled,
    ) -> Result<Option<u64>, PipelineError> {
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
        for (hash, _) in block_in_place(|| self.ledger.of_nonce(account, cancelled.nonce))? {
            let row = block_in_place(|| self.ledger.transaction(hash))?;
            if row.is_some_and(|row| row.purpose == PURPOSE)
                && let Some(receipt) = chain.receipt(hash).await?
            {
                return Ok(Some(receipt.block));
            }
        }
        Ok(None)
    }
}
