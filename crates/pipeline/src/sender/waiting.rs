//! Transactions waiting for a block: resend, raise the price, fill nonce gaps.

use std::collections::HashSet;
use std::time::{Duration, Instant};

use crate::chain::{Chain, ChainError, Market, Nonces, Offered, Priced, SignedTransaction, Wait, is_outbid, offered};
use crate::crypto::EoaSecret;
use crate::model::{Address, Hash, Wei, clean};
use crate::pipeline::Result;
use crate::store::{OpenTransaction, Reissue};

use super::Sender;
use super::lane::{BROKEN, Cell, PauseReason, row_of};

/// The purpose of an empty transfer to oneself that fills a nonce gap.
pub(super) const HOLE: &str = "nonce";
/// Bytes handed in more recently than this are not handed in again.
const QUIET: Duration = Duration::from_millis(if cfg!(test) { 300 } else { 4_000 });
/// How often bytes that the node holds are handed in again.
const REMINDER: Duration = Duration::from_secs(30);
/// The shortest wait before the first waiting transaction counts as passed by.
pub(super) const STARVING: Duration = if cfg!(test) { Duration::from_millis(500) } else { crate::chain::STARVING };
/// Without a block for this long the network counts as stalled.
const STALLED: Duration = Duration::from_millis(if cfg!(test) { 2_000 } else { 30_000 });
/// The most transactions handed in again, or signed again, in one round.
const ROUND: usize = 128;
/// The most gaps filled in one round.
const HOLES: usize = 32;

pub(super) struct Round<'a> {
    pub sender: &'a Sender,
    pub chain: &'a Chain,
    pub eoa: &'a EoaSecret,
    pub account: Address,
    pub cell: &'a Cell,
    pub nonces: Nonces,
    pub rows: &'a [OpenTransaction],
}

impl Round<'_> {
    /// Returns the obstacle.
    pub async fn run(&self) -> Result<Option<PauseReason>> {
        let Some(first) = self.rows.first() else { return Ok(None) };
        let market = self.chain.market().await?;
        let still = self.cell.memory().see_head(market.head.number);
        self.sender.see_head(market.head.number);
        let wait = self.cell.memory().see_front(first.nonce, market.head.number);
        let hole = self.fill_holes(&market).await?;
        let (replaced, dear) = self.raise(&market, wait).await?;
        let refused = self.repeat(&market, &replaced).await?;
        let stalled = (still >= STALLED).then_some(PauseReason::Stalled);
        let passed_by = wait.passed_by(market.head.number);
        let passed_by = passed_by.map(|blocks| self.passed_by(blocks, first.nonce)).transpose()?;
        Ok(hole.or(dear).or(refused).or(stalled).or(passed_by))
    }

    /// The first waiting transaction at its present price, which may just have been raised.
    fn passed_by(&self, blocks: u64, nonce: u64) -> Result<PauseReason> {
        let newest = self.sender.ledger.lanes.of_nonce(self.account, nonce)?;
        let offer = newest.first().and_then(|(_, raw)| offered(raw).ok());
        Ok(PauseReason::PassedBy { blocks, price: Wei(offer.map_or(0, |offer| offer.price)) })
    }

    /// A nonce below an open one that neither the node nor we hold blocks everything after it: its transaction was
    /// another process's, or was lost with a replaced block.
    async fn fill_holes(&self, market: &Market) -> Result<Option<PauseReason>> {
        let held = self.nonces.pending;
        let own: HashSet<u64> = self.rows.iter().map(|row| row.nonce).collect();
        let last = self.rows.last().map_or(held, |row| row.nonce);
        let holes: Vec<u64> = (held..last).filter(|nonce| !own.contains(nonce)).take(HOLES).collect();
        let Some(lowest) = holes.first().copied() else {
            self.cell.memory().hole = None;
            return Ok(None);
        };
        {
            let mut memory = self.cell.memory();
            let since = memory.hole.filter(|(nonce, _)| *nonce == lowest).map(|(_, since)| since);
            if since.is_none_or(|since| since.elapsed() < QUIET) {
                memory.hole = Some((lowest, since.unwrap_or_else(Instant::now)));
                return Ok(None);
            }
        }
        let price = match self.sender.policy().fresh(market) {
            Priced::At(price) => price,
            Priced::Capped { needed, cap } => return Ok(Some(PauseReason::capped(needed, cap))),
        };
        for nonce in holes {
            let signed = self.chain.sign_transfer(self.eoa, nonce, self.account, 0, price)?;
            self.sender.ledger.lanes.submit(row_of(&signed, self.account, HOLE))?;
            self.sender.hand_in(self.chain, self.account, signed.hash, &signed.raw).await;
        }
        self.cell.memory().hole = None;
        Ok(None)
    }

    /// Replaces transactions that have become too cheap; returns them, and the obstacle.
    async fn raise(&self, market: &Market, wait: Wait) -> Result<(HashSet<Hash>, Option<PauseReason>)> {
        let mut replaced = HashSet::new();
        let policy = self.sender.policy();
        for (index, row) in self.rows.iter().take(ROUND).enumerate() {
            let is_passed_by = index == 0 && wait.is_due(market.head.number) && policy.raises(market);
            let is_cheap = self.cell.memory().cheap.contains(&row.hash);
            if market.base.is_none() && policy.floor == 0 && !is_cheap && !is_passed_by {
                continue;
            }
            let Some((raw, old)) = self.offer_of(row)? else { continue };
            let (is_outbid, is_below) = (is_outbid(old.price, market), old.price < policy.floor);
            let is_late = is_cheap && market.offer() > old.price;
            let is_wanted = (is_outbid || is_below || is_late) && self.cell.memory().is_quiet(row.hash, QUIET);
            if !is_wanted && !is_passed_by {
                continue;
            }
            let price = match policy.replacement(old.price, market) {
                Priced::At(price) => price,
                // What it offers may still be enough, only not soon.
                Priced::Capped { .. } if !is_outbid && !is_late => continue,
                Priced::Capped { needed, cap } => return Ok((replaced, Some(PauseReason::capped(needed, cap)))),
            };
            let cost = old.cost_at(price);
            if self.chain.wealth(self.account).await? < cost {
                return Ok((replaced, Some(self.sender.shortage(self.chain, self.account, cost).await?)));
            }
            self.replace(row, &raw, price).await?;
            if is_passed_by {
                self.cell.memory().raise_front(market.head.number);
            }
            replaced.insert(row.hash);
        }
        Ok((replaced, None))
    }

    fn offer_of(&self, row: &OpenTransaction) -> Result<Option<(Vec<u8>, Offered)>> {
        let Some(raw) = self.sender.ledger.lanes.raw_transaction(row.hash)? else { return Ok(None) };
        let known = self.cell.memory().prices.get(&row.hash).copied();
        let offer = known.map_or_else(|| offered(&raw), Ok)?;
        self.cell.memory().prices.insert(row.hash, offer);
        Ok(Some((raw, offer)))
    }

    async fn replace(&self, row: &OpenTransaction, raw: &[u8], price: u128) -> Result<()> {
        let signed = self.chain.resign(self.eoa, raw, row.nonce, price).await?;
        self.put_in_place(row, signed).await
    }

    async fn put_in_place(&self, row: &OpenTransaction, signed: SignedTransaction) -> Result<()> {
        let reissue = Reissue { hash: signed.hash, nonce: signed.nonce, raw: signed.raw.clone() };
        self.sender.ledger.lanes.reissue(row.hash, reissue)?;
        self.sender.hand_in(self.chain, self.account, signed.hash, &signed.raw).await;
        Ok(())
    }

    /// Hands in again, byte for byte, what the node does not hold.
    async fn repeat(&self, market: &Market, replaced: &HashSet<Hash>) -> Result<Option<PauseReason>> {
        let due = |row: &&OpenTransaction| {
            let length = if row.nonce < self.nonces.pending { REMINDER } else { QUIET };
            !replaced.contains(&row.hash) && self.cell.memory().is_quiet(row.hash, length)
        };
        let begun = Instant::now();
        let (mut answered, mut lost) = (false, None);
        for row in self.rows.iter().filter(due).take(ROUND) {
            if lost.is_some() && begun.elapsed() > BROKEN {
                break;
            }
            let Some((raw, offer)) = self.offer_of(row)? else { continue };
            match self.chain.broadcast(&raw).await {
                Ok(_) | Err(ChainError::AlreadyKnown | ChainError::NonceTooLow | ChainError::Reverted { .. }) => {}
                Err(ChainError::Underpriced) => {
                    self.cell.memory().cheap.insert(row.hash);
                }
                Err(ChainError::InsufficientFunds) => return self.cheapen(market, row, &raw, offer).await,
                Err(error @ (ChainError::Unreachable { .. } | ChainError::Answer { .. })) => {
                    // The node may still have it, and the next answer may arrive.
                    lost = Some(error);
                    continue;
                }
                Err(error) => {
                    self.renew(market, row, &raw).await?;
                    return Ok(Some(PauseReason::Refused { why: clean(&error.to_string(), 200) }));
                }
            }
            answered = true;
            self.cell.memory().sent(row.hash);
        }
        lost.filter(|_| !answered).map_or(Ok(None), |error| Err(error.into()))
    }

    /// Signs a refused call again. The node does not hold the old bytes, so the price need not rise.
    async fn renew(&self, market: &Market, row: &OpenTransaction, raw: &[u8]) -> Result<()> {
        let Priced::At(price) = self.sender.policy().fresh(market) else { return Ok(()) };
        let signed = self.chain.resign(self.eoa, raw, row.nonce, price).await?;
        if signed.hash == row.hash {
            return Ok(());
        }
        self.put_in_place(row, signed).await
    }

    /// The account cannot pay the price offered: if the market is far lower by now, less is offered.
    async fn cheapen(
        &self,
        market: &Market,
        row: &OpenTransaction,
        raw: &[u8],
        old: Offered,
    ) -> Result<Option<PauseReason>> {
        let fresh = match self.sender.policy().fresh(market) {
            Priced::At(price) if price < old.price && price.saturating_mul(2) <= old.price => Some(price),
            Priced::At(_) | Priced::Capped { .. } => None,
        };
        let cost = old.cost_at(fresh.unwrap_or(old.price));
        match fresh {
            Some(price) if self.chain.wealth(self.account).await? >= cost => self.replace(row, raw, price).await?,
            _ => return Ok(Some(self.sender.shortage(self.chain, self.account, cost).await?)),
        }
        Ok(None)
    }
}
