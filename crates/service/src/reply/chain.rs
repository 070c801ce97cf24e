//! Answers about the chain.

use serde::{Deserialize, Serialize};

use super::AdministrationView;
use crate::chain::{Pin, Sealing, Shortfall};
use crate::model::{Address, Domain, Hash, SignerId, Wei};
use crate::pipeline::sender::LaneState;

/// The chain from this profile's point of view.
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
    /// Whose word has to be trusted for all this, if it does not come from the site's own node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub through: Option<String>,
    /// The first of them, of all lanes.
    pub waiting: Vec<WaitingView>,
    /// What the account lacks to pay for its next anchor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lacks: Option<Shortfall>,
    /// The limits of the gas price, by the names of their settings.
    pub prices: PricesView,
    /// The cost of its newest anchoring transactions.
    pub gas: GasView,
    /// The state of this profile's lanes: first its own account's, then the extra ones'.
    pub lanes: Vec<LaneState>,
    /// The contract administrator's decisions.
    pub administration: AdministrationView,
    /// Who seals the blocks, and how often.
    #[serde(flatten)]
    pub sealing: Sealing,
}

/// A transaction that waits for a block.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WaitingView {
    /// The account.
    pub account: Address,
    /// Its nonce, for `chain cancel`.
    pub nonce: u64,
    /// Its purpose, in a word.
    pub purpose: String,
    /// The price per gas that it offers.
    pub price: Wei,
}

/// The limits of the gas price, per gas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PricesView {
    /// `chain.min_price`.
    #[serde(rename = "chain.min_price")]
    pub min_price: Wei,
    /// `chain.max_fee`; `None` = no cap.
    #[serde(rename = "chain.max_fee")]
    pub max_fee: Option<Wei>,
}

/// The cost of anchoring, over the newest transactions of one profile's lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct GasView {
    /// Transactions counted, at most 100.
    pub transactions: u64,
    /// Their gas.
    pub gas: u64,
    /// The records that they anchored.
    pub records: u64,
}

/// A contract that was deployed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeployedView {
    /// Chain, contract, code and block.
    #[serde(flatten)]
    pub pin: Pin,
    /// Its administrator: the account that deployed it.
    pub administrator: Address,
}

/// A chain served to other tools.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServedView {
    /// The address.
    pub url: String,
    /// EIP-155 chain id.
    pub chain_id: u64,
    /// The contract, if there is one.
    pub contract: Option<Address>,
}

/// A running gateway.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GatewayView {
    /// The address it listens on.
    pub address: String,
    /// SM3 of its identity key: the pin used by robots and operators.
    pub gateway: SignerId,
    /// The same, for comparison by eye.
    pub fingerprint: String,
    /// The account that anchors.
    pub account: Address,
    /// Its network.
    pub domain: Domain,
}
