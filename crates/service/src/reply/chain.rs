//! What is told of the chain.

use serde::{Deserialize, Serialize};

use super::AdministrationView;
use crate::chain::{Pin, Sealing};
use crate::model::{Address, Domain, Hash, SignerId};
use crate::pipeline::sender::LaneState;

/// The chain as seen from here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainView {
    /// `embedded`, `node` or `relay`.
    pub kind: String,
    /// `poa`, `pow`, `unknown`.
    pub consensus: String,
    /// EIP-155 chain id.
    pub chain_id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    /// Newest block.
    pub block: u64,
    /// The contract, once deployed or configured.
    pub contract: Option<Address>,
    /// The profile's balance in wei, decimal.
    pub balance: String,
    /// The profile's next nonce.
    pub nonce: u64,
    /// Own transactions not yet in a block.
    pub pending: u64,
    /// The node's own name, cleaned.
    pub client: String,
    /// Whose word has to be taken for all this, where it is not the own node's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub through: Option<String>,
    /// What its newest anchoring transactions cost.
    #[serde(default)]
    pub gas: GasView,
    /// How this profile's lanes stand: its own account's first, then its witnesses'.
    #[serde(default)]
    pub lanes: Vec<LaneState>,
    /// What the administrator of the contract decided.
    #[serde(default)]
    pub administration: AdministrationView,
    /// Who seals the blocks, and how often.
    #[serde(flatten)]
    pub sealing: Sealing,
}

/// What anchoring costs, over the newest transactions of one profile's lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct GasView {
    /// Transactions that were counted, at most 100.
    pub transactions: u64,
    /// Their gas.
    pub gas: u64,
    /// The records that they anchored.
    pub records: u64,
}

/// A contract that was put on the chain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeployedView {
    /// Chain, contract, code and block.
    #[serde(flatten)]
    pub pin: Pin,
    /// Who administers it: the account that deployed it.
    pub administrator: Address,
}

/// A chain that other tools can read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServedView {
    /// Where.
    pub url: String,
    /// EIP-155 chain id.
    pub chain_id: u64,
    /// The contract, where there is one.
    pub contract: Option<Address>,
}

/// A gateway at work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayView {
    /// Where it listens.
    pub address: String,
    /// SM3 of its identity key: what robots and operators pin.
    pub gateway: SignerId,
    /// The same, to be compared by eye.
    pub fingerprint: String,
    /// The account that anchors.
    pub account: Address,
    /// Its network.
    pub domain: Domain,
}
