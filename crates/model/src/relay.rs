//! What may pass to a chain through another party's connection, and what became of it.

use async_trait::async_trait;
use serde_json::Value;

/// Reads and raw transactions only: nothing that signs, keeps state at the node, or reaches its settings and keys.
const METHODS: &str = "clique_getSigners eth_blockNumber eth_call eth_chainId eth_estimateGas eth_feeHistory eth_gasPrice \
    eth_getBalance eth_getBlockByHash eth_getBlockByNumber eth_getCode eth_getLogs eth_getProof eth_getStorageAt \
    eth_getTransactionByHash eth_getTransactionCount eth_getTransactionReceipt eth_maxPriorityFeePerGas \
    eth_sendRawTransaction eth_syncing ibft_getValidatorsByBlockNumber net_version qbft_getValidatorsByBlockNumber \
    web3_clientVersion";
/// The longest signed transaction passed on, bytes: the limit of old geth.
pub const LONGEST_RAW: usize = 32 * 1024;

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum RelayError {
    #[error("this method is not forwarded to the chain; connect to a node for it")]
    NotAllowed,
    #[error("{message}")]
    Answered { code: i64, message: String, data: Option<Value> },
    /// No answer, or one that is not JSON-RPC.
    #[error("{0}")]
    Silent(String),
}

#[async_trait]
pub trait Relay: Send + Sync {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError>;

    /// Its location, for display.
    fn place(&self) -> String;
}

/// Cost for the chain, relative to a simple look-up.
pub fn weight(method: &str) -> u32 {
    match method {
        "eth_getLogs" | "eth_estimateGas" | "eth_sendRawTransaction" | "eth_getProof" => 10,
        "eth_call" | "eth_feeHistory" => 4,
        _ => 1,
    }
}

/// Refuses unknown methods, parameters that are no array, and transactions longer than any of ours.
pub fn check(method: &str, parameters: &Value) -> Result<(), RelayError> {
    let known = METHODS.split(' ').any(|known| known == method);
    let length = || parameters.get(0).and_then(Value::as_str).map_or(0, str::len);
    let fits = method != "eth_sendRawTransaction" || length() <= 2 + 2 * LONGEST_RAW;
    if known && parameters.is_array() && fits { Ok(()) } else { Err(RelayError::NotAllowed) }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn only_reading_and_raw_transactions_pass() {
        for method in METHODS.split(' ') {
            assert_eq!(check(method, &json!([])), Ok(()), "{method}");
            assert_eq!(check(method, &json!({})), Err(RelayError::NotAllowed), "{method} with an object");
        }
        for never in [
            "",
            " ",
            "eth_call eth_chainId",
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
