//! Requests about the site itself: lock it, save keys, inspect its gateway.

use serde::{Deserialize, Serialize};

use super::{Ask, Command, SecretBytes};
use crate::model::Party;
use crate::service::reply::{AdmittedView, AlertTestView, AlertsView, GatewayStatusView, IdentityView};

requests! {
    /// One of these.
    #[serde(rename_all = "snake_case", tag = "operation")]
    enum Operation by Command::Operate;
    /// Wipe the keys for reading, granting and revoking from memory, while capture and anchoring go on. `Unlock` brings
    /// them back.
    Lock => IdentityView;
    /// Pause the capture of all watched topics, or resume it; watched topics stay watched.
    HoldCapture {
        /// Whether it is paused.
        hold: bool,
    } => ();
    /// The profile's keyring as stored on disk, under its passphrase.
    BackUpKeys => SecretBytes;
    /// Active alerts.
    ListAlerts => AlertsView;
    /// Send a test alert, marked as such, and return the reply.
    TestAlert => AlertTestView;
    /// Who is connected to the gateway of this site, its system keys, and its refusals.
    GatewayStatus => GatewayStatusView;
    /// Let an owner use the gateway of this home.
    Admit {
        /// The owner.
        owner: Party,
    } => Vec<AdmittedView>;
    /// No longer let an owner use it.
    Dismiss {
        /// The owner.
        owner: Party,
    } => Vec<AdmittedView>;
    /// The admitted owners.
    ListAdmitted => Vec<AdmittedView>;
}
