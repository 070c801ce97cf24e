//! Commands about witnesses: parties that countersign what this home states about its chain, or are served by it.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::model::{Address, SignerId};
use crate::service::reply::{WitnessAnswers, WitnessView, WitnessesView};

requests! {
    /// One of these.
    #[serde(rename_all = "snake_case", tag = "witness")]
    enum WitnessCommand by Command::OfWitness;
    /// Add a party, or change what was written about it.
    AddWitness {
        /// Its name here.
        name: String,
        /// Its account, on its own chain.
        account: Address,
        /// SM3 of its key, as a person passed it on.
        key: SignerId,
        /// Its gateway, HOST:PORT, which is asked to countersign; `None` = it is never asked.
        #[serde(default)]
        gateway: Option<String>,
        /// Whether its statements are countersigned by the gateway of this home.
        serves: bool,
    } => Vec<WitnessView>;
    /// Remove a party: it is neither asked nor served any more, and what it stated here is forgotten.
    RemoveWitness {
        /// Its name here.
        name: String,
    } => Vec<WitnessView>;
    /// The parties of the profile.
    ListWitnesses => Vec<WitnessView>;
    /// The same with contradictions, and what to tell the other side.
    WitnessStatus => WitnessesView;
    /// Ask the profile's witnesses now, not once an hour; needs the keyring opened.
    AskWitnesses => WitnessAnswers;
}
