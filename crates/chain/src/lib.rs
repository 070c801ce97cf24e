//! The Ethereum chain: one [`Chain`] for the embedded EVM and for real nodes over http and ipc.
//!
//! ethers and revm stay in this crate. The pipeline decides which record is in which transaction, when to resend, and
//! what to do after a reorg.

mod call;
mod connect;
mod embedded;
mod error;
mod event;
mod fees;
mod genesis;
mod reader;
pub mod relay;
mod sealing;
pub mod serve;
#[cfg(test)]
mod tests;
mod transaction;
mod transport;

use std::{fmt, path::PathBuf, sync::Arc};

use authros_crypto as crypto;
use authros_model as model;
use serde::{Deserialize, Serialize};

pub use crate::call::{Call, LONGEST_ENVELOPE, MOST_WRAPS};
pub use crate::connect::{DEFAULT_DELAY, Deployment, LONGEST_DELAY, LONGEST_PAUSE, SHORTEST_DELAY};
pub use crate::crypto::{AnchorProof, merkle};
pub use crate::embedded::check_embedded_chain;
pub use crate::error::{ChainError, SEAL_ANEW, explain, passed_by};
pub use crate::event::{AT_ONCE, BlockEvents, Completeness, Event, NEAR};
pub use crate::fees::{
    Market, Offered, Policy, Priced, STARVING, Shortfall, Wait, call_data, is_outbid, is_same_call, offered,
};
pub use crate::genesis::{Allocation, Genesis, GenesisKind, network_guide};
pub use crate::model::Consensus;
pub use crate::reader::Nonces;
pub use crate::relay::{Relay, RelayError, RelayLine};
pub use crate::sealing::{MEASURED, SealedBy, SealerKind, Sealing};

use crate::model::{Address, Digest, Domain, Hash};

#[derive(Clone, PartialEq, Eq)]
pub enum Endpoint {
    /// In this process; one process at a time.
    Embedded {
        directory: PathBuf,
        /// `None` = as founded, [`Consensus::POA`] for a new chain.
        consensus: Option<Consensus>,
    },
    Node {
        /// `http://…`, `https://…`, `ipc:/path` or `/path.ipc`.
        url: String,
        /// PEM file of trusted authorities; `None` = the machine's.
        roots: Option<PathBuf>,
    },
    /// The answers are the relay's word.
    Relay(RelayLine),
}

/// Hides secrets in a node's URL.
impl fmt::Debug for Endpoint {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Embedded { directory, .. } => write!(formatter, "Embedded({})", directory.display()),
            Self::Node { url, .. } => write!(formatter, "Node({})", model::address_without_secrets(url)),
            Self::Relay(relay) => relay.fmt(formatter),
        }
    }
}

#[derive(Debug, Clone)]
pub struct ChainOptions {
    pub endpoint: Endpoint,
    pub contract: Option<Address>,
    pub pinned: Option<Pin>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pin {
    pub chain_id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    pub contract: Address,
    /// Keccak-256.
    pub code_hash: Hash,
    /// First block with events; 0 if unknown.
    pub deployed_at: u64,
}

impl Pin {
    pub fn domain(&self) -> Domain {
        crypto::domain(self.chain_id, &self.genesis, &self.contract)
    }
}

#[derive(Debug, Clone)]
pub struct Chain {
    inner: Arc<connect::Inner>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct BlockRef {
    pub number: u64,
    pub hash: Hash,
    /// Seconds since 1970, as stated by its sealer.
    pub timestamp: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainStatus {
    /// `embedded`, `node` or `relay`.
    pub kind: String,
    /// `poa`, `pow`, `pos` or `dev`, as far as a block shows it.
    pub consensus: String,
    pub chain_id: u64,
    pub genesis: Hash,
    pub block: u64,
    pub contract: Option<Address>,
    /// Wei, decimal.
    pub balance: Option<String>,
    /// Next nonce, mined transactions only.
    pub nonce: Option<u64>,
    pub pending: Option<u64>,
    pub client: String,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedTransaction {
    pub hash: Hash,
    pub nonce: u64,
    pub raw: Vec<u8>,
    pub gas_limit: u64,
    pub gas_price: u128,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    pub block: u64,
    /// Changes in a reorg.
    pub block_hash: Hash,
    pub success: bool,
    pub gas_used: u64,
    /// Why it failed, if known.
    pub reason: Option<String>,
    pub events: Vec<EventAt>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EventAt {
    pub block: u64,
    pub block_hash: Hash,
    /// Block time, seconds, if the node includes it.
    pub timestamp: Option<u64>,
    pub transaction: Hash,
    /// Index among the block's events.
    pub log_index: u64,
    pub event: Event,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueryAnswer {
    pub authorised: bool,
    /// 0 if the owner never registered the token.
    pub epoch: u64,
    /// 0 if not authorised.
    pub count: u64,
    /// Zero if not authorised.
    pub last: Digest,
}
