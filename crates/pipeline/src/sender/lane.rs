//! A held nonce lane, and the state of one.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tokio::sync::OwnedMutexGuard;

use super::{Sender, tend::Memory};
use crate::chain::{Call, Chain, ChainError, Nonces, Priced, Shortfall, SignedTransaction, offered, passed_by};
use crate::crypto::{EoaSecret, fault};
use crate::model::{Address, Hash, Timestamp, Wei};
use crate::store::{Anchors, NewTransaction};
use crate::{PipelineError, Result};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outgoing {
    pub call: Call,
    /// A word: `anchor`, `grant`, ….
    pub purpose: String,
    pub anchors: Anchors,
}

impl Outgoing {
    pub fn plain(call: Call, purpose: &str) -> Self {
        Self { call, purpose: purpose.to_owned(), anchors: Anchors::Nothing }
    }
}

#[derive(Default)]
pub(super) struct Cell {
    /// Held while nonces are assigned.
    pub nonces: std::sync::Arc<tokio::sync::Mutex<()>>,
    /// Held while the lane is tended.
    pub tending: tokio::sync::Mutex<()>,
    memory: Mutex<Memory>,
}

impl Cell {
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
    /// The next nonce, after everything mined, pending at the node (signed here or elsewhere), or open here.
    pub async fn next_nonce(&self) -> Result<u64> {
        let pending = self.sender.nonces(self.chain, self.account).await?.pending;
        let open = self.sender.ledger.lanes.lane_count(self.account)?;
        Ok(open.highest.map_or(0, |nonce| nonce + 1).max(pending))
    }

    /// Wei per gas.
    pub(super) async fn price(&self) -> Result<u128> {
        match self.sender.policy().fresh(&self.chain.market().await?) {
            Priced::At(price) => Ok(price),
            Priced::Capped { needed, cap } => Err(self.sender.pause(self.account, PauseReason::capped(needed, cap))),
        }
    }

    /// Signs and stores in order, releases the lane, then sends. On an error nothing is stored; a stored transaction
    /// that the node did not take is no error: it is sent again.
    pub async fn submit(self, outgoing: Vec<Outgoing>) -> Result<Vec<Hash>> {
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
        self.sender.ledger.lanes.submit_many(rows)?;
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

    pub async fn transfer(self, to: Address, wei: u128, purpose: &str) -> Result<Hash> {
        let (price, nonce) = (self.price().await?, self.next_nonce().await?);
        let signed = self.chain.sign_transfer(self.eoa, nonce, to, wei, price)?;
        let cost = wei.saturating_add(price.saturating_mul(u128::from(signed.gas_limit)));
        let held = self.chain.wealth(self.account).await?;
        if held < cost {
            let (account, held, needed) = (self.account, Wei(held), Wei(cost));
            return Err(PipelineError::NoEther(Shortfall { account, held, needed }));
        }
        let (sender, chain, account) = (self.sender, self.chain, self.account);
        sender.ledger.lanes.submit(row_of(&signed, account, purpose))?;
        drop(self.held);
        sender.hand_in(chain, account, signed.hash, &signed.raw).await;
        Ok(signed.hash)
    }
}

/// The row of a transaction that anchors no records.
pub(super) fn row_of(signed: &SignedTransaction, account: Address, purpose: &str) -> NewTransaction {
    let (hash, nonce, raw, purpose) = (signed.hash, signed.nonce, signed.raw.clone(), purpose.to_owned());
    NewTransaction { hash, account, nonce, raw, purpose, anchors: Anchors::Nothing }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HandedIn {
    /// The node has them, or will be asked about their nonce.
    Held,
    /// No answer came: the node may or may not have them.
    Lost,
    /// The node does not accept them now.
    Refused,
}

/// Transactions that others may have sent from the account without a second question.
const JUMP: u64 = 32;
const PAUSE: Duration = Duration::from_millis(500);
/// While answers fail, the longest that bytes are handed in one after the other.
pub(super) const BROKEN: Duration = Duration::from_secs(8);

impl Sender {
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

    /// Where the nonces are far beyond what was signed here, the node is asked twice: a site that shares the account
    /// may have sent that many. [`ChainError::Answer`] if the second answer contradicts the first.
    pub(super) async fn nonces(&self, chain: &Chain, account: Address) -> Result<Nonces> {
        let known = self.ledger.lanes.highest_nonce(account)?.map_or(0, |nonce| nonce + 1);
        let first = chain.nonces(account).await?;
        if first.pending <= known.saturating_add(JUMP) {
            return Ok(first);
        }
        tokio::time::sleep(PAUSE).await;
        let second = chain.nonces(account).await?;
        let likely = first.mined..=first.mined.saturating_add(JUMP);
        if likely.contains(&second.mined) && second.pending <= first.pending.saturating_add(JUMP) {
            return Ok(second);
        }
        let reason = format!("{} and then {} as the mined nonce contradict each other", first.mined, second.mined);
        Err(ChainError::Answer { url: chain.url(), method: "eth_getTransactionCount".to_owned(), reason }.into())
    }
}

const GWEI: u128 = 1_000_000_000;

/// Why a lane accepts no further transactions for now. Those it holds are kept and sent again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum PauseReason {
    NoEther(Shortfall),
    /// The node says that it cannot pay, and is behind a block that it had before.
    CatchingUp {
        block: u64,
        /// Newest block that it had.
        highest: u64,
    },
    /// Gwei per gas: the network requires `needed`, rounded up, and `chain.max_fee` is `cap`.
    FeeCap {
        needed: u64,
        cap: u64,
    },
    /// Blocks are made, and pass by the account's next transaction. Its price is raised meanwhile.
    PassedBy {
        blocks: u64,
        price: Wei,
    },
    /// No block was made for a while although transactions are waiting.
    Stalled,
    Refused {
        /// In the node's words, cleaned.
        why: String,
    },
}

impl PauseReason {
    /// Prices in wei per gas.
    pub(super) fn capped(needed: u128, cap: u128) -> Self {
        let gwei = |wei: u128| u64::try_from(wei.div_ceil(GWEI)).unwrap_or(u64::MAX);
        Self::FeeCap { needed: gwei(needed), cap: gwei(cap) }
    }

    /// One word, for JSON and for detecting changes.
    pub fn word(&self) -> &'static str {
        match self {
            Self::NoEther(_) => "no ether",
            Self::CatchingUp { .. } => "catching up",
            Self::PassedBy { .. } => "passed by",
            Self::FeeCap { .. } => "fee cap",
            Self::Stalled => "stalled",
            Self::Refused { .. } => "refused",
        }
    }

    /// Whether somebody has to do something about it.
    pub fn is_alarm(&self) -> bool {
        !matches!(self, Self::CatchingUp { .. })
    }

    pub fn text(&self, account: Address) -> String {
        format!("anchoring for {account} is paused, records are safe: {}", self.cause(account))
    }

    /// The obstacle, and what to do about it.
    pub fn cause(&self, account: Address) -> String {
        match self {
            Self::NoEther(shortfall) => shortfall.to_string(),
            Self::CatchingUp { block, highest } => {
                format!("the node is catching up: it had block {highest} and is at {block}; wait until it has it again")
            }
            Self::PassedBy { blocks, price } => passed_by(*blocks, *price),
            Self::FeeCap { needed, cap } => format!(
                "the network requires {needed} gwei per gas, more than chain.max_fee = {cap} gwei allows; wait or raise it"
            ),
            Self::Stalled => "the network produces no blocks; check its signers or miners".to_owned(),
            Self::Refused { why } => format!("the node refuses transactions of {account}: {why}"),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LaneState {
    pub account: Address,
    /// Signed transactions in no block yet.
    pub open: u64,
    /// When the oldest of them was first signed.
    pub oldest: Option<Timestamp>,
    pub paused: Option<PauseReason>,
}

impl LaneState {
    pub fn idle(account: Address) -> Self {
        Self { account, open: 0, oldest: None, paused: None }
    }
}

#[cfg(test)]
mod state_tests {
    use super::*;

    #[test]
    fn texts_name_the_account_and_round_up() {
        let account = Address([7; 20]);
        let capped = PauseReason::capped(1_000_000_001, 1_000_000_000);
        let text = capped.text(account);
        assert!(text.contains("2 gwei") && text.contains("chain.max_fee = 1 gwei"), "{text}");
        let poor = PauseReason::NoEther(Shortfall { account, held: Wei(1), needed: Wei(2_000_000) });
        assert!(poor.cause(account).contains("it has 1 wei and needs 0.002 gwei"), "{}", poor.cause(account));
        let passed = PauseReason::PassedBy { blocks: 7, price: Wei(1_900_000_000) };
        assert!(passed.cause(account).starts_with("not included in 7 blocks at 1.9 gwei per gas"), "{passed:?}");
        let behind = PauseReason::CatchingUp { block: 3, highest: 9 };
        for reason in [poor, passed, behind, PauseReason::Stalled, PauseReason::Refused { why: "full".into() }] {
            assert!(reason.text(account).contains(&account.to_string()), "{reason:?}");
            assert_eq!(reason.is_alarm(), reason.word() != "catching up");
            let json = serde_json::to_string(&reason).expect("json");
            assert_eq!(serde_json::from_str::<PauseReason>(&json).ok(), Some(reason), "{json}");
        }
        let state = LaneState { paused: Some(capped), ..LaneState::idle(account) };
        let json = serde_json::to_string(&state).expect("json");
        assert!(json.contains(r#""reason":"fee_cap""#), "{json}");
        assert_eq!(serde_json::from_str::<LaneState>(&json).ok(), Some(state));
    }
}
