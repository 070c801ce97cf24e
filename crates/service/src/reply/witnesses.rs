//! Answers about witnesses.

use serde::{Deserialize, Serialize};

use crate::model::{Address, SignerId, Timestamp};

/// A party that countersigns for a profile, or is served by this home, or both.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WitnessView {
    /// Its name here. Cleaned.
    pub name: String,
    /// Its account.
    pub account: Address,
    /// SM3 of its key.
    pub key: SignerId,
    /// Its gateway; `None` = it is never asked.
    pub gateway: Option<String>,
    /// Whether it is served here.
    pub serves: bool,
    /// When it was added.
    pub added_at: Timestamp,
    /// Countersignatures it gave.
    pub given: u64,
    /// When it gave the newest, by its own clock.
    pub newest: Option<Timestamp>,
    /// Statements of its own that were countersigned here.
    pub served: u64,
    /// How many chains these are about.
    pub chains: u64,
    /// Attempts without a countersignature since the site started.
    pub failures: u64,
    /// Why the last attempt gave none.
    pub problem: Option<String>,
}

/// Two statements of one party that cannot both be true.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContradictionView {
    /// The party's name, if it is still known here.
    pub name: Option<String>,
    /// SM3 of its key.
    pub key: SignerId,
    /// The account that both statements name.
    pub account: Address,
    /// The chain they are about.
    pub chain_id: u64,
    /// What they contradict each other in.
    pub what: String,
    /// When the first was countersigned here.
    pub kept_at: Timestamp,
    /// When the second arrived.
    pub at: Timestamp,
    /// The countersignature over the first, hex (docs/format.md, section 12).
    pub kept: String,
    /// The second with its owner's signature, hex.
    pub later: String,
}

/// Witnesses with all that an operator wants to know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WitnessesView {
    /// The account that another party adds as its witness, or serves.
    pub account: Address,
    /// The key that it compares; `None` while the keyring was not opened.
    pub key: Option<SignerId>,
    /// The parties.
    pub witnesses: Vec<WitnessView>,
    /// Statements of parties that contradict each other, of all profiles.
    pub contradictions: Vec<ContradictionView>,
}

/// What one witness gave.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GivenView {
    /// Its name here.
    pub witness: String,
    /// When, by its clock.
    pub at: Timestamp,
    /// Batches under its countersignature.
    pub batches: u64,
    /// The block that was stated.
    pub block: u64,
}

/// The result of asking witnesses.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WitnessAnswers {
    /// Countersignatures obtained.
    pub given: Vec<GivenView>,
    /// The first failure.
    pub problem: Option<String>,
}
