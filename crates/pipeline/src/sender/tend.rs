//! The chain's decisions about a lane's nonces.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::{Chain, Offered, Priced, Receipt, Wait, is_same_call, offered};
use crate::crypto::EoaSecret;
use crate::model::{Hash, clean};
use crate::pipeline::Result;
use crate::store::{OpenTransaction, Reissue, TransactionOutcome};
use crate::watcher;

use super::lane::PauseReason;
use super::waiting::{self, Round};
use super::{PURPOSE, Sender};

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
                let wait = Wait::from(block, waiting::STARVING);
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
        if row.anchors || [waiting::HOLE, PURPOSE].contains(&row.purpose.as_str()) {
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
