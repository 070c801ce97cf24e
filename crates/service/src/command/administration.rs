//! Acts of the contract's administrator.

use serde::{Deserialize, Serialize};

use crate::model::Party;

/// What the contract's administrator does.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "act")]
pub enum Administration {
    /// Lets an account register while registration is closed.
    Admit {
        /// Who.
        account: Party,
    },
    /// Withdraws an admission.
    Dismiss {
        /// Who.
        account: Party,
    },
    /// Stops an account's changes but those that take rights away.
    Suspend {
        /// Who.
        account: Party,
    },
    /// Frees a suspended account.
    Restore {
        /// Who.
        account: Party,
    },
    /// Opens registration to all, or closes it.
    Open {
        /// Whether anyone may register.
        open: bool,
    },
    /// Stops all changes but those that take rights away, or lets them go on.
    Pause {
        /// Whether they are stopped.
        paused: bool,
        /// For how long, seconds; `None` = a day. On a contract of the first revision they are stopped without end.
        #[serde(default)]
        seconds: Option<u64>,
    },
    /// Proposes the account that is to continue for a lost one.
    Propose {
        /// The account whose key is lost.
        lost: Party,
        /// Who is to continue.
        successor: Party,
    },
    /// Stops a succession that waits; the recovery account may, too.
    Cancel {
        /// Whose.
        lost: Party,
    },
    /// Completes a succession whose time has come; anybody may.
    Complete {
        /// Whose.
        lost: Party,
    },
    /// Names the account that continues for a lost one, at once (first revision).
    Succeed {
        /// The account whose key is lost.
        lost: Party,
        /// Who continues.
        successor: Party,
    },
    /// Names the next administrator.
    HandOver {
        /// Who.
        account: Party,
    },
    /// Takes over, as the one that was named.
    Accept,
}
