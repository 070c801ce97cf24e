//! What an operator asks of a site besides its data: to lock it, to save keys, to look at its gateway.

use serde::{Deserialize, Serialize};

use super::{Ask, Command, SecretBytes};
use crate::model::Party;
use crate::service::reply::{AdmittedView, AlertTestView, AlertsView, GatewayStatusView, IdentityView, WatchView};

requests! {
    /// One of these.
    #[serde(rename_all = "snake_case", tag = "operation")]
    enum Operation by Command::Operate;
    /// Wipe the keys that decrypt, grant and revoke from memory, while capture and anchoring go on. `Unlock` brings
    /// them back.
    Lock => IdentityView;
    /// Hold the capture of all watched topics, or let it go on; what is watched stays watched.
    HoldCapture {
        /// Whether it is held.
        hold: bool,
    } => ();
    /// The profile's keyring as it lies on disk, under its passphrase.
    BackUpKeys => SecretBytes;
    /// Topics that the profile watches, whether anybody publishes them or not.
    ListWatches => Vec<WatchView>;
    /// Alerts that stand.
    ListAlerts => AlertsView;
    /// Send one that says that it is none, and tell what came back.
    TestAlert => AlertTestView;
    /// Who is connected to the gateway of this site, its system keys, and what it refused.
    GatewayStatus => GatewayStatusView;
    /// Let an owner use the gateway of this home.
    Admit {
        /// Who.
        owner: Party,
    } => Vec<AdmittedView>;
    /// Let an owner use it no more.
    Dismiss {
        /// Who.
        owner: Party,
    } => Vec<AdmittedView>;
    /// Who may use it.
    ListAdmitted => Vec<AdmittedView>;
}
