//! The chain's decisions about a lane's nonces.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::{
    Chain, ChainError, Market, Nonces, Offered, Priced, Receipt, SignedTransaction, Wait, is_outbid, is_same_call,
    offered,
};
use crate::model::{Address, Hash, Wei, clean};
use crate::sender::lane::{BROKEN, Cell, PauseReason, row_of};
use crate::sender::{PURPOSE, Sender};
use crate::store::{OpenTransaction, Reissue, TransactionOutcome};
use crate::{Result, crypto::EoaSecret, watcher};

/// A nonce counts as taken by a foreign transaction when no receipt of ours was found for this long.
const SURE: Duration = Duration::from_secs(1);

/// Memory of a lane; all of it may be lost at any time.
#[derive(Default)]
pub(super) struct Memory {
    pub paused: Option<PauseReason>,
    /// The word of the alarm that was raised and not taken back.
    pub alarm: Option<&'static str>,
    sent: HashMap<Hash, Instant>,
    /// Since when a transaction's nonce has been used although it has no receipt.
    missing: HashMap<Hash, Instant>,
    pub prices: HashMap<Hash, Offered>,
    pub cheap: HashSet<Hash>,
    /// The lowest nonce that nobody holds, and since when.
    pub hole: Option<(u64, Instant)>,
    /// The newest block, and since when.
    head: Option<(u64, Instant)>,
    /// The nonce of the first waiting transaction, and how long it has been the first.
    front: Option<(u64, Wait)>,
}

impl Memory {
    pub fn sent(&mut self, hash: Hash) {
        self.sent.insert(hash, Instant::now());
    }

    pub fn is_quiet(&self, hash: Hash, length: Duration) -> bool {
        self.sent.get(&hash).is_none_or(|at| at.elapsed() >= length)
    }

    /// Notes the newest block; returns for how long it has been the newest.
    pub fn see_head(&mut self, number: u64) -> Duration {
        let known = self.head.filter(|(head, _)| *head == number);
        self.head.insert(known.unwrap_or_else(|| (number, Instant::now()))).1.elapsed()
    }

    pub fn see_front(&mut self, nonce: u64, block: u64) -> Wait {
        match self.front {
            Some((front, wait)) if front == nonce => wait,
            _ => {
                let wait = Wait::from(block, STARVING);
                self.front = Some((nonce, wait));
                wait
            }
        }
    }

    pub fn raise_front(&mut self, block: u64) {
        if let Some((_, wait)) = &mut self.front {
            wait.raise(block);
        }
    }

    /// Whether blocks passed the transaction by, so that it was offered at a higher price.
    fn was_raised(&self, nonce: u64) -> bool {
        self.front.is_some_and(|(front, wait)| front == nonce && wait.is_raised())
    }

    fn is_surely_missing(&mut self, hash: Hash) -> bool {
        self.missing.entry(hash).or_insert_with(Instant::now).elapsed() >= SURE
    }

    fn forget_all_but(&mut self, open: &[OpenTransaction]) {
        let open: HashSet<Hash> = open.iter().map(|row| row.hash).collect();
        self.sent.retain(|hash, _| open.contains(hash));
        self.missing.retain(|hash, _| open.contains(hash));
        self.prices.retain(|hash, _| open.contains(hash));
        self.cheap.retain(|hash| open.contains(hash));
    }
}

enum Decided {
    Own(Receipt),
    /// Another one signed here with this nonce is in a block.
    Kin(Hash, Vec<u8>, Receipt),
    /// None signed here is in a block.
    Taken,
}

impl Sender {
    /// Called after every block of the watcher, and while none comes. Returns the reasons of refused transactions.
    pub async fn tend(&self, chain: &Chain, eoa: &EoaSecret) -> Result<Vec<String>> {
        let account = eoa.address();
        let cell = self.cell(account);
        let Ok(_alone) = cell.tending.try_lock() else { return Ok(Vec::new()) };
        let open = self.ledger.lanes.open_lane(account)?;
        cell.memory().forget_all_but(&open);
        if open.is_empty() {
            let capped = matches!(cell.memory().paused, Some(PauseReason::FeeCap { .. }));
            if !capped || matches!(self.policy().fresh(&chain.market().await?), Priced::At(_)) {
                self.settle(account, None);
            }
            return Ok(Vec::new());
        }
        let nonces = self.nonces(chain, account).await?;
        let (used, waiting): (Vec<_>, Vec<_>) = open.into_iter().partition(|row| row.nonce < nonces.mined);
        let round = Round { sender: self, chain, eoa, account, cell: &cell, nonces, rows: &waiting };
        for row in &used {
            round.learn_price(row)?;
        }
        cell.memory().missing.retain(|hash, _| used.iter().any(|row| row.hash == *hash));
        let refused = round.decide(used).await?;
        let paused = round.run().await?;
        self.settle(account, paused);
        Ok(refused)
    }
}

impl Round<'_> {
    /// Closes what the chain has decided, as far as the watcher has seen the same chain.
    async fn decide(&self, used: Vec<OpenTransaction>) -> Result<Vec<String>> {
        let Some((seen, hash)) = self.sender.ledger.trail.cursor()? else { return Ok(Vec::new()) };
        let mut found = Vec::with_capacity(used.len());
        for row in used {
            let decided = self.look_up(&row).await?;
            if !matches!(decided, Decided::Taken) {
                self.cell.memory().missing.remove(&row.hash);
            }
            found.push((row, decided));
        }
        // A receipt counts only on the watcher's chain: nobody would reopen what was closed for a block that is gone.
        if self.chain.block(seen).await?.is_none_or(|block| block.hash != hash) {
            return Ok(Vec::new());
        }
        let (mut closings, mut refused, mut others) = (Vec::new(), Vec::new(), Vec::new());
        for (row, decided) in found {
            match decided {
                Decided::Own(receipt) | Decided::Kin(_, _, receipt) if receipt.block > seen => {}
                Decided::Own(receipt) => {
                    block_in_place(|| self.hold_against_what_was_read(&receipt))?;
                    refused.extend(refusal(&row, &receipt));
                    closings.push((row.hash, outcome(&receipt)));
                }
                other => others.push((row, other)),
            }
        }
        // Before the chain is queried again: these receipts are of the chain just examined.
        if !closings.is_empty() {
            self.sender.ledger.lanes.close_transactions(closings)?;
        }
        for (row, decided) in others {
            match decided {
                Decided::Kin(kin, raw, receipt) => {
                    block_in_place(|| self.hold_against_what_was_read(&receipt))?;
                    refused.extend(refusal(&row, &receipt));
                    self.give_to_kin(&row, (kin, &raw), &receipt).await?;
                }
                Decided::Taken if self.cell.memory().is_surely_missing(row.hash) => {
                    self.give_way(&row).await?;
                }
                Decided::Own(_) | Decided::Taken => {}
            }
        }
        Ok(refused)
    }

    /// A transaction that had to be offered at a higher price than quoted shows what the next ones need.
    fn learn_price(&self, row: &OpenTransaction) -> Result<()> {
        if !self.cell.memory().was_raised(row.nonce) {
            return Ok(());
        }
        let raw = self.sender.ledger.lanes.raw_transaction(row.hash)?;
        if let Some(offer) = raw.and_then(|raw| offered(&raw).ok()) {
            self.sender.note_needed(offer.price);
        }
        Ok(())
    }

    /// The watcher has read the receipt's block: what the receipt says happened there must be known by now.
    fn hold_against_what_was_read(&self, receipt: &Receipt) -> Result<()> {
        if !watcher::of(&self.sender.ledger, &receipt.events)?.is_empty() {
            watcher::note(&self.sender.ledger.notes, receipt.block)?;
        }
        Ok(())
    }

    async fn look_up(&self, row: &OpenTransaction) -> Result<Decided> {
        if let Some(receipt) = self.chain.receipt(row.hash).await? {
            return Ok(Decided::Own(receipt));
        }
        for (kin, raw) in self.sender.ledger.lanes.of_nonce(self.account, row.nonce)? {
            if kin == row.hash {
                continue;
            }
            if let Some(receipt) = self.chain.receipt(kin).await? {
                return Ok(Decided::Kin(kin, raw, receipt));
            }
        }
        Ok(Decided::Taken)
    }

    /// An earlier transaction of ours with the same nonce was mined after all.
    async fn give_to_kin(&self, row: &OpenTransaction, (kin, raw): (Hash, &[u8]), receipt: &Receipt) -> Result<()> {
        let own = self.sender.ledger.lanes.raw_transaction(row.hash)?.unwrap_or_default();
        if is_same_call(&own, raw) {
            return Ok(self.sender.ledger.lanes.decide_nonce(row.hash, kin, outcome(receipt))?);
        }
        self.sender.ledger.lanes.close_transactions(vec![(kin, outcome(receipt))])?;
        self.give_way(row).await
    }

    /// Records of an anchoring transaction are anchored again; any other call is signed again with the next nonce.
    async fn give_way(&self, row: &OpenTransaction) -> Result<()> {
        if row.anchors || [HOLE, PURPOSE].contains(&row.purpose.as_str()) {
            let closing = vec![(row.hash, TransactionOutcome::Replaced)];
            return Ok(self.sender.ledger.lanes.close_transactions(closing)?);
        }
        let lane = self.sender.lane(self.chain, self.eoa).await;
        let raw = self.sender.ledger.lanes.raw_transaction(row.hash)?.unwrap_or_default();
        let signed = self.chain.resign(self.eoa, &raw, lane.next_nonce().await?, lane.price().await?).await?;
        let reissue = Reissue { hash: signed.hash, nonce: signed.nonce, raw: signed.raw.clone() };
        self.sender.ledger.lanes.reissue(row.hash, reissue)?;
        drop(lane);
        self.sender.hand_in(self.chain, self.account, signed.hash, &signed.raw).await;
        Ok(())
    }
}

fn outcome(receipt: &Receipt) -> TransactionOutcome {
    let Receipt { block, block_hash, gas_used, .. } = *receipt;
    match receipt.success {
        true => TransactionOutcome::Mined { block, block_hash, gas_used: Some(gas_used) },
        false => TransactionOutcome::Reverted { reason: reason(receipt) },
    }
}

fn refusal(row: &OpenTransaction, receipt: &Receipt) -> Option<String> {
    (!receipt.success).then(|| format!("{}: {}", row.purpose, reason(receipt)))
}

fn reason(receipt: &Receipt) -> String {
    clean(receipt.reason.as_deref().unwrap_or("reverted"), 200)
}

// Transactions waiting for a block: resend, raise the price, fill nonce gaps.

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
