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
    },
    /// Names the account that continues for a lost one.
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
