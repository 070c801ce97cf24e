//! Commands about the fleet: the gateways with which the gateway of this home reconciles what it holds.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::model::SignerId;
use crate::service::reply::{FellowView, FleetView};

requests! {
    /// One of these.
    #[serde(rename_all = "snake_case", tag = "fleet")]
    enum FleetCommand by Command::OfFleet;
    /// Name a gateway of the same fleet, or write down its new address. Nothing is handed over before its keeper has
    /// named the gateway of this home.
    AddFellow {
        /// HOST:PORT.
        address: String,
        /// SM3 of its identity key, as a person passed it on.
        key: SignerId,
    } => Vec<FellowView>;
    /// Name it no more: nothing is asked of it, and nothing handed to it.
    RemoveFellow {
        /// SM3 of its identity key, the beginning of that, or its address.
        gateway: String,
    } => Vec<FellowView>;
    /// The gateways that were named.
    ListFellows => Vec<FellowView>;
    /// The same, with what they are to know of the gateway of this home.
    FleetStatus => FleetView;
}
