//! Acts of the contract's administrator.

use serde::{Deserialize, Serialize};

use crate::model::Party;

/// What the contract's administrator does.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "act")]
pub enum Administration {
    /// Lets an account register while registration is closed.
    Admit {
        /// The account.
        account: Party,
    },
    /// Withdraws an admission.
    Dismiss {
        /// The account.
        account: Party,
    },
    /// Blocks all changes by an account except those that take rights away.
    Suspend {
        /// The account.
        account: Party,
    },
    /// Frees a suspended account.
    Restore {
        /// The account.
        account: Party,
    },
    /// Opens registration to all, or closes it.
    Open {
        /// Whether anyone may register.
        open: bool,
    },
    /// Blocks all changes except those that take rights away, or allows them again.
    Pause {
        /// Whether they are blocked.
        paused: bool,
        /// For how long, seconds; `None` = a day.
        seconds: Option<u64>,
    },
    /// Proposes the account that continues for a lost one.
    Propose {
        /// The account whose key is lost.
        lost: Party,
        /// The successor.
        successor: Party,
    },
    /// Stops a pending succession; the recovery account may do so, too.
    Cancel {
        /// The lost account.
        lost: Party,
    },
    /// Completes a succession whose delay is over; anybody may.
    Complete {
        /// The lost account.
        lost: Party,
    },
    /// Names the next administrator.
    HandOver {
        /// The account.
        account: Party,
    },
    /// Takes over, as the account that was named.
    Accept,
}
