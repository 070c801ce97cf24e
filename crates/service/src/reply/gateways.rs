//! What the gateways that a home joins hold, each compared with the others and with this home.

use serde::{Deserialize, Serialize};

use crate::model::{Address, RecorderId, SignerId, TopicId};

/// The comparison.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewaysView {
    /// Nothing is lacking, and every gateway was asked.
    pub ok: bool,
    /// At so many gateways each record was looked for.
    pub copies: u64,
    /// How many records are at fewer.
    pub short: u64,
    /// How many numbers no gateway lists and this home does not know of.
    pub nowhere: u64,
    /// The gateways, in the order of the settings.
    pub gateways: Vec<GatewayHoldings>,
    /// Those numbers: between others of the same recorder and topic.
    pub holes: Vec<HoleView>,
    /// Ranges left out above, because they are too many.
    pub left_out: u64,
}

/// What one gateway lists, and what it lacks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayHoldings {
    /// HOST:PORT.
    pub address: String,
    /// SM3 of its identity key, once it was met.
    pub key: Option<SignerId>,
    /// Why it was not compared.
    pub problem: Option<String>,
    /// Owners that it tells this profile nothing of.
    pub untold: Vec<UntoldView>,
    /// Records that it lists as held.
    pub records: u64,
    /// Of those, the ones it calls verified.
    pub verified: u64,
    /// Verified records that it does not have.
    pub lacking: u64,
    /// Records that others have, that it does not have, and that are not verified anywhere yet.
    pub waiting: u64,
    /// The lacking ones.
    pub lacks: Vec<LackView>,
}

/// An owner that a gateway tells nothing of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UntoldView {
    /// The owner.
    pub owner: Address,
    /// Its name in the address book.
    pub owner_name: Option<String>,
    /// Why.
    pub problem: String,
}

/// Numbers that one gateway lacks, all of which the same others have.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LackView {
    /// The owner.
    pub owner: Address,
    /// Its name in the address book.
    pub owner_name: Option<String>,
    /// The topic, or its pseudonym; cleaned.
    pub topic: String,
    /// Its pseudonym.
    pub topic_id: TopicId,
    /// Who gave the numbers.
    pub recorder: RecorderId,
    /// How many these are.
    pub records: u64,
    /// First and last of each range.
    pub ranges: Vec<(u64, u64)>,
    /// The gateways that list them.
    pub held_by: Vec<String>,
    /// Whether this home has them.
    pub here: bool,
}

/// Numbers that nobody has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HoleView {
    /// The owner.
    pub owner: Address,
    /// Its name in the address book.
    pub owner_name: Option<String>,
    /// The topic, or its pseudonym; cleaned.
    pub topic: String,
    /// Its pseudonym.
    pub topic_id: TopicId,
    /// Who gave the numbers.
    pub recorder: RecorderId,
    /// How many these are.
    pub numbers: u64,
    /// First and last of each range.
    pub ranges: Vec<(u64, u64)>,
}
