//! JSON-RPC 2.0 over the embedded chain: single requests and bounded batches, reads and raw transactions.

use std::time::Instant;

use serde_json::{Value, json};

use super::filters::Filters;
use super::heavy::Heavy;
use crate::chain::embedded::{Embedded, Fault};
use crate::model::clean;

/// The most requests in a batch.
const LONGEST_BATCH: usize = 100;
/// The longest answer to one HTTP request, bytes.
const LONGEST_ANSWER: usize = 32 * 1024 * 1024;
/// The most blocks whose logs are returned at once.
pub const MOST_BLOCKS: u64 = 10_000;

/// The methods allowed. Nothing here signs, changes settings or reveals other users of the chain's file.
const METHODS: [&str; 35] = [
    "clique_getSigners",
    "eth_accounts",
    "eth_blockNumber",
    "eth_call",
    "eth_chainId",
    "eth_estimateGas",
    "eth_feeHistory",
    "eth_gasPrice",
    "eth_getBalance",
    "eth_getBlockByHash",
    "eth_getBlockByNumber",
    "eth_getBlockTransactionCountByHash",
    "eth_getBlockTransactionCountByNumber",
    "eth_getCode",
    "eth_getFilterChanges",
    "eth_getFilterLogs",
    "eth_getLogs",
    "eth_getProof",
    "eth_getStorageAt",
    "eth_getTransactionByBlockHashAndIndex",
    "eth_getTransactionByBlockNumberAndIndex",
    "eth_getTransactionByHash",
    "eth_getTransactionCount",
    "eth_getTransactionReceipt",
    "eth_maxPriorityFeePerGas",
    "eth_mining",
    "eth_newBlockFilter",
    "eth_newFilter",
    "eth_sendRawTransaction",
    "eth_syncing",
    "eth_uninstallFilter",
    "net_listening",
    "net_peerCount",
    "net_version",
    "web3_clientVersion",
];

/// The chain and the filters of all connections.
pub struct Service {
    chain: Embedded,
    filters: Filters,
    heavy: Heavy,
}

impl Service {
    /// Over a chain.
    pub fn new(chain: Embedded) -> Self {
        Self { chain, filters: Filters::default(), heavy: Heavy::new(Instant::now()) }
    }

    /// The answer to a body; empty if it needs none.
    pub async fn answer(&self, body: &[u8]) -> Vec<u8> {
        let answer = match serde_json::from_slice::<Value>(body) {
            Err(_) => Some(failure(&Value::Null, &fault(-32700, "the body is not JSON"))),
            Ok(Value::Array(batch)) => return self.batch(batch).await,
            Ok(one) => self.single(one).await,
        };
        answer.map(|answer| written(&answer, &Value::Null)).unwrap_or_default()
    }

    async fn batch(&self, batch: Vec<Value>) -> Vec<u8> {
        if batch.is_empty() || batch.len() > LONGEST_BATCH {
            let what = format!("a batch has 1 to {LONGEST_BATCH} requests, this one {}", batch.len());
            return written(&failure(&Value::Null, &fault(-32600, what)), &Value::Null);
        }
        let mut all: Vec<u8> = Vec::new();
        for request in batch {
            let id = request.get("id").cloned().unwrap_or_default();
            let Some(answer) = self.single(request).await else { continue };
            let mut next = written(&answer, &id);
            if all.len() + next.len() > LONGEST_ANSWER {
                next = written(&failure(&id, &too_long()), &id);
            }
            all.push(if all.is_empty() { b'[' } else { b',' });
            all.append(&mut next);
        }
        if !all.is_empty() {
            all.push(b']');
        }
        all
    }

    /// `None` for a notification, which expects no answer.
    async fn single(&self, request: Value) -> Option<Value> {
        let Value::Object(mut request) = request else {
            return Some(failure(&Value::Null, &fault(-32600, "a request is an object")));
        };
        let id = request.remove("id");
        let known = id.clone().filter(|id| id.is_string() || id.is_number()).unwrap_or_default();
        let result = match (request.get("jsonrpc"), request.get("method"), request.get("params")) {
            (Some(Value::String(version)), Some(Value::String(method)), params) if version == "2.0" => {
                self.call(method, params.cloned()).await
            }
            _ => Err(fault(-32600, "a request has jsonrpc \"2.0\", a method and an id")),
        };
        id?;
        Some(match result {
            Ok(result) => json!({ "jsonrpc": "2.0", "id": known, "result": result }),
            Err(fault) => failure(&known, &fault),
        })
    }

    async fn call(&self, method: &str, parameters: Option<Value>) -> Result<Value, Fault> {
        let parameters = match parameters {
            None | Some(Value::Null) => Vec::new(),
            Some(Value::Array(all)) => all,
            Some(_) => return Err(fault(-32602, "parameters come as an array")),
        };
        if METHODS.binary_search(&method).is_err() {
            let what = format!("the method {} does not exist/is not available", clean(method, 60));
            return Err(fault(-32601, what));
        }
        match method {
            "eth_getLogs" => logs(&self.chain, parameters).await,
            "eth_newFilter" | "eth_newBlockFilter" => self.filters.install(&self.chain, method, parameters).await,
            "eth_getFilterChanges" => self.filters.changes(&self.chain, &parameters).await,
            "eth_getFilterLogs" => self.filters.logs(&self.chain, &parameters).await,
            "eth_sendRawTransaction" => {
                let counted = self.heavy.count(parameters.first(), Instant::now());
                counted.map_err(|pause| too_heavy(pause.as_secs() + 1))?;
                self.chain.request(method, Value::Array(parameters)).await
            }
            "eth_uninstallFilter" => self.filters.uninstall(&parameters).await,
            _ => self.chain.request(method, Value::Array(parameters)).await,
        }
    }
}

/// The logs that match a filter, from at most [`MOST_BLOCKS`] blocks.
///
/// # Errors
/// If the range is longer, or an error of the chain.
pub async fn logs(chain: &Embedded, parameters: Vec<Value>) -> Result<Value, Fault> {
    let head = chain.head().borrow().number;
    if span(parameters.first().unwrap_or(&Value::Null), head) > MOST_BLOCKS {
        return Err(fault(-32005, format!("logs of more than {MOST_BLOCKS} blocks; ask for fewer at once")));
    }
    chain.request("eth_getLogs", Value::Array(parameters)).await
}

/// How many blocks a filter covers.
fn span(filter: &Value, head: u64) -> u64 {
    let bound = |name: &str| match filter.get(name).and_then(Value::as_str) {
        None | Some("latest" | "pending" | "safe" | "finalized") => head,
        Some("earliest") => 0,
        // Anything but a number is refused by the chain.
        Some(number) => u64::from_str_radix(number.trim_start_matches("0x"), 16).unwrap_or(head),
    };
    (bound("toBlock").min(head) + 1).saturating_sub(bound("fromBlock"))
}

/// A refused request.
pub fn fault(code: i64, message: impl Into<String>) -> Fault {
    Fault::new(code, message)
}

fn too_heavy(seconds: u64) -> Fault {
    fault(
        -32005,
        format!("transactions of more than a million gas are taken only now and then; send it again in {seconds} s"),
    )
}

fn too_long() -> Fault {
    fault(-32005, format!("the answer is longer than {LONGEST_ANSWER} bytes; ask for less at once"))
}

fn failure(id: &Value, fault: &Fault) -> Value {
    let mut error = json!({ "code": fault.code, "message": fault.message });
    if let Some(data) = &fault.data {
        error["data"] = data.clone();
    }
    json!({ "jsonrpc": "2.0", "id": id, "error": error })
}

fn written(answer: &Value, id: &Value) -> Vec<u8> {
    let bytes = serde_json::to_vec(answer).unwrap_or_default();
    if bytes.len() <= LONGEST_ANSWER {
        return bytes;
    }
    serde_json::to_vec(&failure(answer.get("id").unwrap_or(id), &too_long())).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_methods_are_sorted_for_the_search() {
        assert!(METHODS.is_sorted());
        for never in ["eth_sendTransaction", "eth_sign", "personal_unlockAccount", "admin_addPeer", "miner_stop"] {
            assert!(METHODS.binary_search(&never).is_err());
        }
    }

    #[test]
    fn spans() {
        for (filter, blocks) in [
            (json!({}), 1),
            (json!({ "fromBlock": "latest", "toBlock": "latest" }), 1),
            (json!({ "fromBlock": "earliest" }), 20_001),
            (json!({ "fromBlock": "0x0", "toBlock": "0x270f" }), MOST_BLOCKS),
            (json!({ "fromBlock": "0x1", "toBlock": "0xffffffffffffffff" }), 20_000),
            (json!({ "fromBlock": "0xffffffffffffffff", "toBlock": "0x1" }), 0),
            (json!({ "fromBlock": "what", "toBlock": 7 }), 1),
            (json!(null), 1),
        ] {
            assert_eq!(span(&filter, 20_000), blocks, "{filter}");
        }
    }
}
