//! What an operator asks of a site besides its data: to lock it, to save keys, to look at its gateway.

use serde::{Deserialize, Serialize};

/// One of these.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "operation")]
pub enum Operation {
    /// Wipe the keys that decrypt, grant and revoke from memory, while capture and anchoring go on. `Unlock` brings
    /// them back.
    Lock,
    /// The profile's keyring as it lies on disk, under its passphrase.
    BackUpKeys,
    /// Who is connected to the gateway of this site, its system keys, and what it refused.
    GatewayStatus,
}
