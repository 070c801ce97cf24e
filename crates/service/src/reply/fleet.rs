//! Answers about the fleet.

use serde::{Deserialize, Serialize};

use super::RefusedView;
use crate::model::{Address, SignerId, Timestamp};

/// A gateway of the same fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FellowView {
    /// HOST:PORT.
    pub address: String,
    /// SM3 of its identity key.
    pub key: SignerId,
    /// The account that registered that key; `None` = none that is known here.
    pub account: Option<Address>,
    /// When it was named here.
    pub added_at: Timestamp,
    /// When it last told what it holds, since this site runs.
    pub heard: Option<Timestamp>,
    /// Whether everything that it told of owners who may use the gateway of this home is here, as of then.
    pub reconciled: bool,
    /// Records of such owners that it told of and that were not here, as of then: not taken yet, not handed over, or refused.
    pub lacking: u64,
    /// Records taken over from it since this site runs.
    pub taken: u64,
    /// Records erased here since this site runs, because it told that their owners had them erased, and that holds.
    #[serde(default)]
    pub erased: u64,
    /// Owners of records it told of that would be kept here, who may not use the gateway of this home: they are not taken.
    pub passed_over: u64,
    /// Records that this gateway and another one anchored, both.
    pub anchored_twice: u64,
    /// Of what it sent, what was refused, by reason.
    pub refused: Vec<RefusedView>,
    /// Why nothing comes from it now.
    pub problem: Option<String>,
    /// Whether it was silent for `fleet.away_after`, so that others keep what fell to it; never where all keep everything.
    #[serde(default)]
    pub away: bool,
}

/// The fleet of the gateway of this home.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FleetView {
    /// The gateway running here: its address; `None` = none runs.
    pub address: Option<String>,
    /// SM3 of its identity key: what the other keepers name.
    pub key: Option<SignerId>,
    /// The gateways that were named.
    pub fellows: Vec<FellowView>,
    /// Records that their owner had erased elsewhere, and that stay here because an incident of that owner holds them.
    #[serde(default)]
    pub held: u64,
    /// How many gateways are to keep each record (`fleet.copies`); `None` = all of them.
    #[serde(default)]
    pub copies: Option<u16>,
}
