//! JSON-RPC 2.0 over the embedded chain: single requests and bounded batches, reads and raw transactions.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use ethers::utils::rlp::Rlp;
use serde_json::{Map, Value, json};

use crate::embedded::{Embedded, Fault};
use crate::model::bytes::unhex;
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

// Filters: what is new since a caller last asked. There are only a few, and they expire when unused.

/// The most filters at a time.
const MOST: usize = 64;
/// How long an unused filter lives.
const LIFE: Duration = Duration::from_secs(300);
/// The most block hashes returned at once; the rest follows with the next request.
const MOST_HASHES: u64 = 1000;

#[derive(Clone)]
enum Kind {
    Blocks,
    Logs(Map<String, Value>),
}

struct Filter {
    kind: Kind,
    next: u64,
    asked: Instant,
}

/// The filters of all connections.
#[derive(Default)]
pub struct Filters {
    open: tokio::sync::Mutex<(u64, HashMap<u64, Filter>)>,
}

fn number(value: u64) -> Value {
    Value::String(format!("{value:#x}"))
}

fn id(parameters: &[Value]) -> Option<u64> {
    u64::from_str_radix(parameters.first()?.as_str()?.strip_prefix("0x")?, 16).ok()
}

fn unknown() -> Fault {
    fault(-32000, "filter not found")
}

impl Filters {
    /// Creates a filter for what comes from now on; returns its id.
    ///
    /// # Errors
    /// For a malformed filter, or if there are too many.
    pub async fn install(&self, chain: &Embedded, method: &str, parameters: Vec<Value>) -> Result<Value, Fault> {
        let next = chain.head().borrow().number + 1;
        let kind = if method == "eth_newFilter" {
            let Some(Value::Object(filter)) = parameters.into_iter().next() else {
                return Err(fault(-32602, "missing or invalid value for argument 0"));
            };
            // The chain reports what is wrong with it, if anything.
            logs(chain, vec![within(&filter, next, next)]).await?;
            Kind::Logs(filter)
        } else {
            Kind::Blocks
        };
        let mut open = self.open.lock().await;
        let now = Instant::now();
        open.1.retain(|_, filter| now.duration_since(filter.asked) < LIFE);
        if open.1.len() >= MOST {
            return Err(fault(-32005, format!("there are {MOST} filters already; uninstall some")));
        }
        open.0 += 1;
        let id = open.0;
        open.1.insert(id, Filter { kind, next, asked: now });
        Ok(number(id))
    }

    /// What is new since the last time.
    ///
    /// # Errors
    /// For an unknown filter.
    pub async fn changes(&self, chain: &Embedded, parameters: &[Value]) -> Result<Value, Fault> {
        let mut open = self.open.lock().await;
        let filter = id(parameters).and_then(|id| open.1.get_mut(&id)).ok_or_else(unknown)?;
        filter.asked = Instant::now();
        let head = chain.head().borrow().number;
        if filter.next > head {
            return Ok(json!([]));
        }
        let most = if matches!(filter.kind, Kind::Blocks) { MOST_HASHES } else { MOST_BLOCKS };
        let last = head.min(filter.next + most - 1);
        let news = match &filter.kind {
            Kind::Logs(wanted) => logs(chain, vec![within(wanted, filter.next, last)]).await?,
            Kind::Blocks => hashes(chain, filter.next, last).await?,
        };
        filter.next = last + 1;
        Ok(news)
    }

    /// All logs that match a filter, including old ones.
    ///
    /// # Errors
    /// For an unknown filter, or one of blocks.
    pub async fn logs(&self, chain: &Embedded, parameters: &[Value]) -> Result<Value, Fault> {
        let wanted = {
            let open = self.open.lock().await;
            id(parameters).and_then(|id| open.1.get(&id)).map(|filter| filter.kind.clone())
        };
        match wanted {
            Some(Kind::Logs(filter)) => logs(chain, vec![Value::Object(filter)]).await,
            _ => Err(unknown()),
        }
    }

    /// Removes a filter; returns whether there was one.
    ///
    /// # Errors
    /// Never; the signature matches the other methods.
    pub async fn uninstall(&self, parameters: &[Value]) -> Result<Value, Fault> {
        let found = match id(parameters) {
            Some(id) => self.open.lock().await.1.remove(&id).is_some(),
            None => false,
        };
        Ok(Value::Bool(found))
    }
}

/// A filter with other bounds.
fn within(filter: &Map<String, Value>, first: u64, last: u64) -> Value {
    let mut filter = filter.clone();
    filter.remove("blockHash");
    filter.insert("fromBlock".into(), number(first));
    filter.insert("toBlock".into(), number(last));
    Value::Object(filter)
}

async fn hashes(chain: &Embedded, first: u64, last: u64) -> Result<Value, Fault> {
    let mut all = Vec::new();
    for block in first..=last {
        let block = chain.request("eth_getBlockByNumber", json!([number(block), false])).await?;
        all.push(block.get("hash").cloned().unwrap_or_default());
    }
    Ok(Value::Array(all))
}

// Transactions that take much of a block. Gas costs nothing on this chain, and every user of the machine may send some: a
// number of them at once, then one now and then. The contract's usual calls are not among them.

/// A transaction that may use more gas is heavy: several times what an anchor, a registration or a grant uses.
const HEAVY: u64 = 1_000_000;
/// How many are taken at once, from all callers together.
const AT_ONCE: u32 = 40;
/// Time until one more is taken.
const PAUSE: Duration = Duration::from_secs(10);

/// How many heavy transactions are still taken.
#[derive(Debug)]
pub struct Heavy {
    /// How many, and as of when.
    left: Mutex<(u32, Instant)>,
}

impl Heavy {
    /// All of them.
    pub fn new(now: Instant) -> Self {
        Self { left: Mutex::new((AT_ONCE, now)) }
    }

    /// Counts a transaction, signed and in hex, if it is heavy.
    ///
    /// # Errors
    /// How long to wait for the next one, if no more are taken now.
    pub fn count(&self, raw: Option<&Value>, now: Instant) -> Result<(), Duration> {
        let raw = raw.and_then(Value::as_str).and_then(unhex).unwrap_or_default();
        // What is no transaction is refused by the chain.
        let gas = Rlp::new(&raw).val_at::<u64>(2).unwrap_or(0);
        if gas <= HEAVY { Ok(()) } else { self.take(now) }
    }

    fn take(&self, now: Instant) -> Result<(), Duration> {
        let mut left = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut number, mut since) = *left;
        while number < AT_ONCE && now.saturating_duration_since(since) >= PAUSE {
            (number, since) = (number + 1, since + PAUSE);
        }
        if number == AT_ONCE {
            since = now;
        }
        let taken = number.checked_sub(1);
        *left = (taken.unwrap_or(0), since);
        taken.map(drop).ok_or_else(|| PAUSE.saturating_sub(now.saturating_duration_since(since)))
    }
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

#[cfg(test)]
mod heavy_tests {
    use super::*;
    use crate::model::bytes::hex;

    /// A transaction that may use this much gas; nobody signed it.
    fn raw(gas: u64) -> Value {
        let mut list = ethers::utils::rlp::RlpStream::new_list(9);
        list.append(&1u64).append(&0u64).append(&gas);
        (0..6).for_each(|_| {
            list.append_empty_data();
        });
        Value::String(format!("0x{}", hex(&list.out())))
    }

    #[test]
    fn heavy_ones_are_few_and_the_usual_ones_are_not_counted() {
        let begun = Instant::now();
        let heavy = Heavy::new(begun);
        let count = |gas: u64, after: Duration| heavy.count(Some(&raw(gas)), begun + after);
        for _ in 0..AT_ONCE {
            assert_eq!(count(HEAVY + 1, Duration::ZERO), Ok(()));
        }
        assert_eq!(count(10_000_000, Duration::from_secs(3)), Err(Duration::from_secs(7)));
        assert_eq!(count(HEAVY, Duration::ZERO), Ok(()), "a usual one");
        assert_eq!(heavy.count(Some(&Value::Null), begun), Ok(()), "the chain refuses it");
        assert_eq!(heavy.count(None, begun), Ok(()));
        assert_eq!(count(HEAVY + 1, PAUSE), Ok(()));
        assert!(count(HEAVY + 1, PAUSE).is_err(), "one in ten seconds");
        let later = PAUSE * (2 * AT_ONCE);
        assert_eq!((0..2 * AT_ONCE).filter(|_| count(HEAVY + 1, later).is_ok()).count(), 40);
    }
}
