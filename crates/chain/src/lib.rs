//! The Ethereum chain: one [`Chain`] for the embedded EVM and for real nodes over http, ws (both also with TLS) and ipc.
//!
//! All use of ethers and revm is in this crate; the interface uses the types of `model`. Here are the contract's calls
//! and events, signing and sending, reads and news. Which record is in which transaction, when to resend and what to do
//! after a reorg is up to the pipeline.

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
mod state_proof;
#[cfg(test)]
mod tests;
mod transaction;
mod transport;

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

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
pub use crate::genesis::{Allocation, GUIDE, Genesis, GenesisKind};
pub use crate::model::Consensus;
pub use crate::reader::Nonces;
pub use crate::relay::{Relay, RelayError, RelayLine};
pub use crate::sealing::{MEASURED, SealedBy, SealerKind, Sealing};

use crate::model::{Address, Digest, Domain, Hash, Identity, Timestamp, Token};

/// The location of the chain.
#[derive(Clone, PartialEq, Eq)]
pub enum Endpoint {
    /// In this process, kept in a folder. Only one process at a time.
    Embedded {
        /// Holds `chain.db`; created if missing.
        directory: PathBuf,
        /// Its consensus; `None` = as it was founded, and [`Consensus::POA`] for a new one. A chain founded otherwise
        /// is refused.
        consensus: Option<Consensus>,
    },
    Node {
        /// `http://…`, `https://…`, `ws://…`, `wss://…`, `ipc:/path` or `/path.ipc`.
        url: String,
        /// The PEM file of the authorities to trust behind TLS; `None` = those that this machine trusts.
        roots: Option<PathBuf>,
    },
    /// A relay that passes requests on, and whose word must be taken for the answers.
    Relay(RelayLine),
}

/// Without what is secret in a node's URL.
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
    /// The contract to use, if known.
    pub contract: Option<Address>,
    /// What the chain must match.
    pub pinned: Option<Pin>,
    /// How many blocks on top make a block final.
    pub confirmations: u64,
}

/// Identifies one chain and contract.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pin {
    pub chain_id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    /// Address of the contract.
    pub contract: Address,
    /// Keccak-256 of the contract's code.
    pub code_hash: Hash,
    /// The first block to read events from: the deployment's, or 0 if unknown.
    pub deployed_at: u64,
}

impl Pin {
    /// What binds records to this chain and contract.
    pub fn domain(&self) -> Domain {
        crypto::domain(self.chain_id, &self.genesis, &self.contract)
    }
}

/// A connection to the chain. Clones share it.
#[derive(Debug, Clone)]
pub struct Chain {
    inner: Arc<connect::Inner>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct BlockRef {
    pub number: u64,
    pub hash: Hash,
    /// Seconds since 1970, as the sealer of the block stated it.
    pub timestamp: u64,
}

/// A chain and an account on it, for `authros chain status`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainStatus {
    /// `embedded`, `node` or `relay`.
    pub kind: String,
    /// `poa`, `pow`, `pos` or `dev`, as far as a block shows it.
    pub consensus: String,
    pub chain_id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    pub block: u64,
    /// The contract in use.
    pub contract: Option<Address>,
    /// Wei, decimal; `None` without an account.
    pub balance: Option<String>,
    /// The account's next nonce, mined transactions only.
    pub nonce: Option<u64>,
    /// How many of the account's transactions are pending.
    pub pending: Option<u64>,
    /// The node's name and version, as it reports them.
    pub client: String,
}

/// A transaction, ready to be stored and sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedTransaction {
    pub hash: Hash,
    pub nonce: u64,
    /// The bytes for [`Chain::broadcast`].
    pub raw: Vec<u8>,
    /// The most gas it may use.
    pub gas_limit: u64,
    pub gas_price: u128,
}

/// The result of a transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    pub block: u64,
    /// Its block's hash: if it changes later, there was a reorg.
    pub block_hash: Hash,
    /// Whether it took effect.
    pub success: bool,
    pub gas_used: u64,
    /// Why it failed, in plain words, if that can be determined.
    pub reason: Option<String>,
    /// The contract's events in it.
    pub events: Vec<EventAt>,
}

/// An event and its position.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EventAt {
    pub block: u64,
    pub block_hash: Hash,
    /// Block time, seconds, if the node includes it with the event.
    pub timestamp: Option<u64>,
    pub transaction: Hash,
    /// Its index among the block's events.
    pub log_index: u64,
    pub event: Event,
}

/// The state of a registered account.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AccountState {
    /// The registered keys. The contract cannot verify the proof in it; the reader must.
    pub identity: Identity,
    /// The current epoch, from 1.
    pub epoch: u64,
    /// The current epoch's token (the one in `identity` dates from the registration or key rotation).
    pub token: Token,
    /// Whether the administrator suspended its changes.
    pub suspended: bool,
    /// Version of the SM2 keys, from 1.
    pub keys: u64,
    /// How many digests it uploaded individually.
    pub count: u64,
    /// The last of them.
    pub last: Option<Digest>,
}

/// An owner's grant to an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GrantState {
    /// Whether it is not revoked; it may have expired.
    pub active: bool,
    /// The epoch it begins with.
    pub epoch: u64,
    /// When it ends; `None` = never.
    pub expiry: Option<Timestamp>,
}

/// The contract's answer to a dataQuery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueryAnswer {
    /// Whether the caller may read records of the token's epoch.
    pub authorised: bool,
    /// The token's epoch; 0 if the owner never registered it.
    pub epoch: u64,
    /// How many digests the owner uploaded; 0 if not authorised.
    pub count: u64,
    /// The last of them; zero if not authorised.
    pub last: Digest,
}
