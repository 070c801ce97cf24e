//! What an operator asks of a site besides its data: to lock it, to save keys, to look at its gateway.

use serde::{Deserialize, Serialize};

use crate::model::Party;

/// One of these.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "operation")]
pub enum Operation {
    /// Wipe the keys that decrypt, grant and revoke from memory, while capture and anchoring go on. `Unlock` brings
    /// them back.
    Lock,
    /// The profile's keyring as it lies on disk, under its passphrase.
    BackUpKeys,
    /// Who is connected to the gateway of this site, its system keys, and what it refused.
    GatewayStatus,
    /// Let an owner use the gateway of this home.
    Admit {
        /// Who.
        owner: Party,
    },
    /// Let an owner use it no more.
    Dismiss {
        /// Who.
        owner: Party,
    },
    /// Who may use it.
    ListAdmitted,
}
