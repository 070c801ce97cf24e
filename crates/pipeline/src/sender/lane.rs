//! A nonce lane while it is held: nobody else signs for the account meanwhile.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::OwnedMutexGuard;
use tokio::task::block_in_place;

use crate::chain::{Call, Chain, ChainError, Priced, Shortfall, offered};
use crate::crypto::{EoaSecret, fault};
use crate::model::{Address, Hash, Wei};
use crate::pipeline::PipelineError;
use crate::store::{Anchors, NewTransaction};

use super::Sender;
use super::state::{LaneState, PauseReason};
use super::tend::Memory;

/// A call to be signed, stored and sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outgoing {
    /// The call.
    pub call: Call,
    /// Its purpose, in a word: `anchor`, `grant`, ….
    pub purpose: String,
    /// The records it anchors.
    pub anchors: Anchors,
}

impl Outgoing {
    /// A call that anchors no records.
    pub fn plain(call: Call, purpose: &str) -> Self {
        Self { call, purpose: purpose.to_owned(), anchors: Anchors::Nothing }
    }
}

/// What is remembered of an account's lane between checks.
pub(super) struct Cell {
    /// Held while nonces are assigned.
    pub nonces: std::sync::Arc<tokio::sync::Mutex<()>>,
    /// Held while the lane is tended.
    pub tending: tokio::sync::Mutex<()>,
    memory: Mutex<Memory>,
}

impl Cell {
    pub fn new() -> Self {
        Self {
            nonces: std::sync::Arc::default(),
            tending: tokio::sync::Mutex::default(),
            memory: Mutex::new(Memory::new()),
        }
    }

    pub fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A lane, held. Keep it only as long as signing takes.
pub struct Lane<'a> {
    pub(super) sender: &'a Sender,
    pub(super) chain: &'a Chain,
    pub(super) eoa: &'a EoaSecret,
    pub(super) account: Address,
    pub(super) held: OwnedMutexGuard<()>,
}

impl Lane<'_> {
    /// The account.
    pub fn account(&self) -> Address {
        self.account
    }

    /// The state of the lane.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn state(&self) -> Result<LaneState, PipelineError> {
        self.sender.state_of(self.account)
    }

    /// How many more transactions it accepts now; 0 while it is paused.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn room(&self) -> Result<usize, PipelineError> {
        self.sender.room(self.account)
    }

    /// The lane's open transactions by nonce, without their bytes.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn open(&self) -> Result<Vec<crate::store::OpenTransaction>, PipelineError> {
        Ok(block_in_place(|| self.sender.ledger.open_lane(self.account))?)
    }

    /// The next nonce, after everything mined, pending at the node (whoever signed it), or open here.
    ///
    /// # Errors
    /// Errors of chain and ledger.
    pub async fn next_nonce(&self) -> Result<u64, PipelineError> {
        let pending = self.sender.nonces(self.chain, self.account).await?.pending;
        let open = block_in_place(|| self.sender.ledger.lane_count(self.account))?;
        Ok(open.highest.map_or(0, |nonce| nonce + 1).max(pending))
    }

    /// The most that gas may cost now, wei.
    pub(super) async fn price(&self) -> Result<u128, PipelineError> {
        match self.sender.policy().fresh(&self.chain.market().await?) {
            Priced::At(price) => Ok(price),
            Priced::Capped { needed, cap } => Err(self.sender.pause(self.account, PauseReason::capped(needed, cap))),
        }
    }

    /// Signs and stores `outgoing` in order, releases the lane, then sends it.
    ///
    /// # Errors
    /// Errors of the chain while signing, of the ledger while storing; then nothing is stored. A transaction that is
    /// stored but could not be handed to the node is not an error: it is sent again.
    pub async fn submit(self, outgoing: Vec<Outgoing>) -> Result<Vec<Hash>, PipelineError> {
        if outgoing.is_empty() {
            return Ok(Vec::new());
        }
        let price = self.price().await?;
        let mut nonce = self.next_nonce().await?;
        let mut rows = Vec::with_capacity(outgoing.len());
        for Outgoing { call, purpose, anchors } in outgoing {
            let signed = match self.chain.sign_at(self.eoa, nonce, &call, price).await {
                Err(ChainError::InsufficientFunds) => {
                    return Err(PipelineError::NoEther(self.chain.shortfall(self.account, &call, price).await?));
                }
                signed => signed?,
            };
            let (hash, account, raw) = (signed.hash, self.account, signed.raw);
            rows.push(NewTransaction { hash, account, nonce, raw, purpose, anchors });
            nonce += 1;
        }
        let sent: Vec<(Hash, Vec<u8>)> = rows.iter().map(|row| (row.hash, row.raw.clone())).collect();
        fault::point("signed");
        block_in_place(|| self.sender.ledger.submit_many(rows))?;
        fault::point("signed-kept");
        let (sender, chain, account) = (self.sender, self.chain, self.account);
        drop(self.held);
        let hashes = sent.iter().map(|(hash, _)| *hash).collect();
        let begun = Instant::now();
        for (hash, raw) in sent {
            // A lost answer says nothing about the next one; a node that is slow for each one does.
            let handed = sender.hand_in(chain, account, hash, &raw).await;
            if handed == HandedIn::Refused || handed == HandedIn::Lost && begun.elapsed() > BROKEN {
                break;
            }
        }
        fault::point("handed-in");
        Ok(hashes)
    }
}

impl Lane<'_> {
    /// Signs and stores a transfer of ether, releases the lane, then sends it.
    ///
    /// # Errors
    /// See [`Lane::submit`]; `NoEther` if the account holds too little.
    pub async fn transfer(self, to: Address, wei: u128, purpose: &str) -> Result<Hash, PipelineError> {
        let (price, nonce) = (self.price().await?, self.next_nonce().await?);
        let signed = self.chain.sign_transfer(self.eoa, nonce, to, wei, price)?;
        let cost = wei.saturating_add(price.saturating_mul(u128::from(signed.gas_limit)));
        let held = self.chain.wealth(self.account).await?;
        if held < cost {
            let (account, held, needed) = (self.account, Wei(held), Wei(cost));
            return Err(PipelineError::NoEther(Shortfall { account, held, needed }));
        }
        let (hash, account, raw) = (signed.hash, self.account, signed.raw);
        let row = NewTransaction {
            hash,
            account,
            nonce,
            raw: raw.clone(),
            purpose: purpose.to_owned(),
            anchors: Anchors::Nothing,
        };
        block_in_place(|| self.sender.ledger.submit(row))?;
        let (sender, chain) = (self.sender, self.chain);
        drop(self.held);
        sender.hand_in(chain, account, hash, &raw).await;
        Ok(hash)
    }
}

/// The outcome of handing bytes to the node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HandedIn {
    /// The node has them, or will be asked about their nonce.
    Held,
    /// No answer came: the node may or may not have them.
    Lost,
    /// The node does not accept them now.
    Refused,
}

/// While answers fail, the longest that bytes are handed in one after the other.
pub(super) const BROKEN: Duration = Duration::from_secs(8);

impl Sender {
    /// Hands stored bytes to the node.
    pub(super) async fn hand_in(&self, chain: &Chain, account: Address, hash: Hash, raw: &[u8]) -> HandedIn {
        let answer = chain.broadcast(raw).await;
        let cell = self.cell(account);
        match answer {
            Ok(_) | Err(ChainError::AlreadyKnown | ChainError::NonceTooLow | ChainError::Reverted { .. }) => {
                cell.memory().sent(hash);
                HandedIn::Held
            }
            Err(ChainError::Underpriced) => {
                let mut memory = cell.memory();
                memory.sent(hash);
                memory.cheap.insert(hash);
                HandedIn::Held
            }
            Err(ChainError::InsufficientFunds) => {
                let needed = offered(raw).map_or(0, |offer| offer.cost_at(offer.price));
                if let Ok(reason) = self.shortage(chain, account, needed).await {
                    self.pause(account, reason);
                }
                HandedIn::Refused
            }
            Err(ChainError::Unreachable { .. } | ChainError::Answer { .. }) => HandedIn::Lost,
            Err(_) => HandedIn::Refused,
        }
    }
}
