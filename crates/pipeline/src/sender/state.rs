//! The state of a nonce lane, for display.

use serde::{Deserialize, Serialize};

use crate::model::{Address, Timestamp};

const GWEI: u128 = 1_000_000_000;

/// Why a lane accepts no further transactions for now. Those it holds are kept and sent again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum PauseReason {
    /// The account cannot pay for the gas of its next transaction.
    NoEther,
    /// The network requires more than the operator's cap.
    FeeCap {
        /// Gwei per gas required, rounded up.
        needed: u64,
        /// Gwei per gas allowed by `chain.max_fee`.
        cap: u64,
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
            Self::NoEther => "no ether",
            Self::FeeCap { .. } => "fee cap",
            Self::Stalled => "stalled",
            Self::Refused { .. } => "refused",
        }
    }

    /// What happened and what to do, for the lane's account.
    pub fn text(&self, account: Address) -> String {
        format!("anchoring for {account} is paused, nothing is lost: {}", self.cause(account))
    }

    /// The obstacle, and what to do about it.
    pub fn cause(&self, account: Address) -> String {
        match self {
            Self::NoEther => format!("{account} has too little ether to pay for gas; send it some on this chain"),
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
        for reason in [PauseReason::NoEther, PauseReason::Stalled, PauseReason::Refused { why: "full".into() }] {
            assert!(reason.text(account).contains(&account.to_string()), "{reason:?}");
        }
        let state = LaneState { paused: Some(capped), ..LaneState::idle(account) };
        let json = serde_json::to_string(&state).expect("json");
        assert!(json.contains(r#""reason":"fee_cap""#), "{json}");
        assert_eq!(serde_json::from_str::<LaneState>(&json).ok(), Some(state));
    }
}
