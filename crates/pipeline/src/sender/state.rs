//! The state of a nonce lane, for display.

use serde::{Deserialize, Serialize};

use crate::chain::{Shortfall, passed_by};
use crate::model::{Address, Timestamp, Wei};

const GWEI: u128 = 1_000_000_000;

/// Why a lane accepts no further transactions for now. Those it holds are kept and sent again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum PauseReason {
    /// The account cannot pay for the gas of its next transaction.
    NoEther(Shortfall),
    /// The node says that it cannot pay, and is behind a block that it had before.
    CatchingUp {
        /// Its newest block.
        block: u64,
        /// The newest block that it had.
        highest: u64,
    },
    /// The network requires more than the operator's cap.
    FeeCap {
        /// Gwei per gas required, rounded up.
        needed: u64,
        /// Gwei per gas allowed by `chain.max_fee`.
        cap: u64,
    },
    /// Blocks are made, and pass by the account's next transaction. Its price is raised meanwhile.
    PassedBy {
        /// How many.
        blocks: u64,
        /// The price per gas that it offers.
        price: Wei,
    },
    /// No block was made for a while although transactions are waiting.
    Stalled,
    /// The node refuses the next transaction for another reason.
    Refused {
        /// In its words, cleaned.
        why: String,
    },
}

impl PauseReason {
    /// The cap forbids a price, given in wei per gas.
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

    /// What happened and what to do, for the lane's account.
    pub fn text(&self, account: Address) -> String {
        format!("anchoring for {account} is paused, nothing is lost: {}", self.cause(account))
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
                "the network requires {needed} gwei per gas, more than chain.max_fee = {cap} allows; wait or raise it"
            ),
            Self::Stalled => "the network produces no blocks; check its signers or miners".to_owned(),
            Self::Refused { why } => format!("the node refuses transactions of {account}: {why}"),
        }
    }
}

/// A nonce lane at a glance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LaneState {
    /// Its account.
    pub account: Address,
    /// Signed transactions in no block yet.
    pub open: u64,
    /// When the oldest of them was first signed.
    pub oldest: Option<Timestamp>,
    /// Why it is paused, if it is.
    pub paused: Option<PauseReason>,
}

impl LaneState {
    /// A lane with nothing in it.
    pub fn idle(account: Address) -> Self {
        Self { account, open: 0, oldest: None, paused: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_name_the_account_and_round_up() {
        let account = Address([7; 20]);
        let capped = PauseReason::capped(1_000_000_001, 1_000_000_000);
        let text = capped.text(account);
        assert!(text.contains("2 gwei") && text.contains("chain.max_fee = 1"), "{text}");
        let poor = PauseReason::NoEther(Shortfall { account, held: Wei(1), needed: Wei(2_000_000) });
        assert!(poor.cause(account).contains("it has 1 wei and needs 0.002 gwei"), "{}", poor.cause(account));
        let passed = PauseReason::PassedBy { blocks: 7, price: Wei(1_900_000_000) };
        assert!(passed.cause(account).starts_with("not taken into 7 blocks at 1.9 gwei per gas"), "{passed:?}");
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
