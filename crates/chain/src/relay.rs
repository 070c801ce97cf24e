//! A chain reached through another party's connection: what may pass, how it is passed on, and the transport that sends
//! one's own requests that way.

use std::fmt;
use std::sync::Arc;

use async_trait::async_trait;
use serde_json::Value;

pub mod rules;

pub use rules::{Asker, Ground, Passed, examine};

use super::Chain;
use super::transport::{JsonRpcError, TransportError};
use crate::model::clean;

/// Only what this program's own client needs is passed on: reads and raw transactions. Nothing here signs, keeps state
/// at the node, or reaches its settings and keys. [`rules`] say what passes for whom.
const METHODS: [&str; 24] = [
    "clique_getSigners",
    "eth_blockNumber",
    "eth_call",
    "eth_chainId",
    "eth_estimateGas",
    "eth_feeHistory",
    "eth_gasPrice",
    "eth_getBalance",
    "eth_getBlockByHash",
    "eth_getBlockByNumber",
    "eth_getCode",
    "eth_getLogs",
    "eth_getProof",
    "eth_getStorageAt",
    "eth_getTransactionByHash",
    "eth_getTransactionCount",
    "eth_getTransactionReceipt",
    "eth_maxPriorityFeePerGas",
    "eth_sendRawTransaction",
    "eth_syncing",
    "ibft_getValidatorsByBlockNumber",
    "net_version",
    "qbft_getValidatorsByBlockNumber",
    "web3_clientVersion",
];
/// The longest signed transaction passed on, bytes: the limit of old geth.
pub const LONGEST_RAW: usize = 32 * 1024;
/// The longest error text of a node passed on, characters.
const LONGEST_WORDS: usize = 400;

/// Why a relayed request failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RelayError {
    /// The method is not passed on.
    #[error("this method is not forwarded to the chain; connect to a node for it")]
    NotAllowed,
    /// The node answered with an error.
    #[error("{message}")]
    Answered {
        /// JSON-RPC's code.
        code: i64,
        /// The node's words, cleaned.
        message: String,
        /// Its data: revert data.
        data: Option<Value>,
    },
    /// No answer came, or it was not JSON-RPC.
    #[error("{0}")]
    Silent(String),
}

/// Passes JSON-RPC requests on to a chain.
#[async_trait]
pub trait Relay: Send + Sync {
    /// Passes one request on.
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError>;

    /// Its location, for display.
    fn place(&self) -> String;
}

/// A shared [`Relay`], as an endpoint; two are equal if they are the same object.
#[derive(Clone)]
pub struct RelayLine(pub Arc<dyn Relay>);

impl fmt::Debug for RelayLine {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "RelayLine({})", self.0.place())
    }
}

impl PartialEq for RelayLine {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Eq for RelayLine {}

impl From<RelayError> for TransportError {
    fn from(error: RelayError) -> Self {
        match error {
            RelayError::Answered { code, message, data } => Self::Answered(JsonRpcError { code, message, data }),
            RelayError::NotAllowed => {
                Self::Answered(JsonRpcError { code: -32601, message: RelayError::NotAllowed.to_string(), data: None })
            }
            RelayError::Silent(reason) => Self::Broken(reason),
        }
    }
}

impl From<TransportError> for RelayError {
    fn from(error: TransportError) -> Self {
        match error {
            TransportError::Answered(JsonRpcError { code, message, data }) => {
                Self::Answered { code, message: clean(&message, LONGEST_WORDS), data }
            }
            other => Self::Silent(clean(&other.to_string(), LONGEST_WORDS)),
        }
    }
}

/// What a request costs the chain, compared with a simple look-up.
pub fn weight(method: &str) -> u32 {
    match method {
        "eth_getLogs" | "eth_estimateGas" | "eth_sendRawTransaction" | "eth_getProof" => 10,
        "eth_call" | "eth_feeHistory" => 4,
        _ => 1,
    }
}

/// Whether a request is passed on: its method is known, its parameters are an array, and a transaction is no longer
/// than any of ours.
///
/// # Errors
/// [`RelayError::NotAllowed`].
pub fn check(method: &str, parameters: &Value) -> Result<(), RelayError> {
    let known = METHODS.binary_search(&method).is_ok();
    let length = || parameters.get(0).and_then(Value::as_str).map_or(0, str::len);
    let fits = method != "eth_sendRawTransaction" || length() <= 2 + 2 * LONGEST_RAW;
    if known && parameters.is_array() && fits { Ok(()) } else { Err(RelayError::NotAllowed) }
}

impl Chain {
    /// Passes another party's request on to this chain, over this process's own connection. Whether it may pass is for
    /// [`examine`] to say.
    ///
    /// # Errors
    /// [`RelayError`].
    pub async fn relay(&self, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        check(method, parameters)?;
        Ok(self.transport().request_for_another(method, parameters.clone()).await?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_reading_and_raw_transactions_pass() {
        assert!(METHODS.is_sorted());
        for method in METHODS {
            assert_eq!(check(method, &json!([])), Ok(()), "{method}");
            assert_eq!(check(method, &json!({})), Err(RelayError::NotAllowed), "{method} with an object");
        }
        for never in [
            "",
            "eth_accounts",
            "eth_newFilter",
            "eth_sendTransaction",
            "eth_sign",
            "eth_subscribe",
            "personal_unlockAccount",
            "admin_addPeer",
            "debug_traceTransaction",
            "anvil_setBalance",
            "evm_mine",
            "miner_stop",
            "txpool_content",
            "ETH_CALL",
        ] {
            assert_eq!(check(never, &json!([])), Err(RelayError::NotAllowed), "{never}");
        }
    }

    #[test]
    fn a_raw_transaction_has_a_longest() {
        let raw = |bytes: usize| json!([format!("0x{}", "00".repeat(bytes))]);
        assert_eq!(check("eth_sendRawTransaction", &raw(LONGEST_RAW)), Ok(()));
        assert_eq!(check("eth_sendRawTransaction", &raw(LONGEST_RAW + 1)), Err(RelayError::NotAllowed));
    }
}
