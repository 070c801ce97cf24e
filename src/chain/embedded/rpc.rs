//! Ethereum's JSON-RPC methods over the embedded chain. State is kept for the newest block only.

use ethers::types::U256;
use ethers::utils::rlp;
use serde_json::{Value, json};

use super::block::{GAS_LIMIT, Header, Receipt};
use super::file::Mined;
use super::json::{self, Mining, data, quantity, read_address, read_data, read_hash, read_quantity};
use super::machine::{Answer, CALL_GAS_LIMIT, Message};
use super::node::Node;
use super::sealing::Sealing;
use super::transaction::Transaction;
use crate::chain::ChainError;
use crate::model::{Address, Hash};

/// A refused request: JSON-RPC code, message, revert data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// JSON-RPC or Ethereum error code.
    pub code: i64,
    /// What is wrong, in geth's words.
    pub message: String,
    /// Revert data as hex.
    pub data: Option<Value>,
}

impl Fault {
    fn new(code: i64, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), data: None }
    }
}

impl From<ChainError> for Fault {
    fn from(error: ChainError) -> Self {
        Self::new(-32603, error.to_string())
    }
}

type Reply = Result<Value, Fault>;

/// Positional parameters of a request.
struct Parameters(Vec<Value>);

impl Parameters {
    fn at<T>(&self, index: usize, read: impl FnOnce(&Value) -> Option<T>) -> Result<T, Fault> {
        let missing = || Fault::new(-32602, format!("missing or invalid value for argument {index}"));
        self.0.get(index).and_then(read).ok_or_else(missing)
    }
}

/// Answers one request.
///
/// # Errors
/// [`Fault`] for an unknown method, bad parameters, a refusal or a revert.
pub fn answer(node: &mut Node, method: &str, parameters: Value) -> Reply {
    let parameters = Parameters(match parameters {
        Value::Array(all) => all,
        Value::Null => Vec::new(),
        one => vec![one],
    });
    match method {
        "eth_chainId" => Ok(quantity(node.chain_id)),
        "net_version" => Ok(Value::String(node.chain_id.to_string())),
        "net_listening" => Ok(Value::Bool(true)),
        "net_peerCount" | "eth_gasPrice" | "eth_maxPriorityFeePerGas" => Ok(quantity(0)),
        "web3_clientVersion" => Ok(Value::String(client_version(node))),
        "eth_syncing" => Ok(Value::Bool(false)),
        "eth_mining" => Ok(Value::Bool(node.is_mining())),
        "eth_accounts" => Ok(json!([])),
        "eth_blockNumber" => Ok(quantity(node.head.number)),
        "eth_feeHistory" => fee_history(node, &parameters),
        "eth_sendRawTransaction" => send(node, &parameters),
        "eth_call" | "eth_estimateGas" => message_call(node, method == "eth_call", &parameters),
        _ => read(node, method, &parameters),
    }
}

fn read(node: &Node, method: &str, parameters: &Parameters) -> Reply {
    match method {
        "eth_getBalance" => state(node, parameters, 1, |node, who| quantity(node.machine.balance(who))),
        "eth_getCode" => state(node, parameters, 1, |node, who| data(&node.machine.code(who))),
        "eth_getStorageAt" => {
            let slot = parameters.at(1, read_quantity)?;
            state(node, parameters, 2, |node, who| data(&node.machine.slot(who, slot).0))
        }
        "eth_getTransactionCount" => nonce(node, parameters),
        "eth_getBlockByNumber" => {
            let number = parameters.at(0, |tag| block_number(node, tag))?;
            block(node, number, whole(parameters))
        }
        "eth_getBlockByHash" => match node.file.number_of(parameters.at(0, read_hash)?)? {
            Some(number) => block(node, number, whole(parameters)),
            None => Ok(Value::Null),
        },
        "eth_getBlockTransactionCountByNumber" | "eth_getBlockTransactionCountByHash" => {
            let number = parameters.at(0, |which| block_named(node, which))?;
            number.map_or(Ok(Value::Null), |number| count(node, number))
        }
        "eth_getTransactionByBlockNumberAndIndex" | "eth_getTransactionByBlockHashAndIndex" => {
            let number = parameters.at(0, |which| block_named(node, which))?;
            let index = parameters.at(1, read_quantity)?;
            number.map_or(Ok(Value::Null), |number| transaction_at(node, number, index))
        }
        "eth_getTransactionByHash" => transaction(node, parameters.at(0, read_hash)?),
        "eth_getTransactionReceipt" => receipt(node, parameters.at(0, read_hash)?),
        "eth_getLogs" => logs(node, parameters),
        "clique_getSigners" if matches!(node.sealing, Sealing::Authority(_)) => {
            Ok(node.sealing.addresses().iter().map(|signer| data(&signer.0)).collect())
        }
        _ => Err(Fault::new(-32601, format!("the method {method} does not exist/is not available"))),
    }
}

fn client_version(node: &Node) -> String {
    let sealing = match node.sealing {
        Sealing::Authority(_) => "proof of authority",
        Sealing::Work { .. } => "proof of work by Keccak-256, not ethash",
    };
    format!("AuthROS/v{}/embedded ({sealing})", env!("CARGO_PKG_VERSION"))
}

fn whole(parameters: &Parameters) -> bool {
    parameters.0.get(1) == Some(&Value::Bool(true))
}

/// The number that a block tag means; `None` where the tag is malformed.
fn block_number(node: &Node, tag: &Value) -> Option<u64> {
    match tag.as_str()? {
        "latest" | "pending" | "safe" | "finalized" => Some(node.head.number),
        "earliest" => Some(0),
        _ => read_quantity(tag).and_then(|number| u64::try_from(number).ok()),
    }
}

/// The block that a tag, a number or a hash means; `None` inside where there is none.
#[allow(clippy::option_option, reason = "outside: is it a name of a block; inside: is there one")]
fn block_named(node: &Node, which: &Value) -> Option<Option<u64>> {
    match read_hash(which) {
        Some(hash) => node.file.number_of(hash).ok(),
        None => Some(block_number(node, which).filter(|number| *number <= node.head.number)),
    }
}

fn count(node: &Node, number: u64) -> Reply {
    Ok(quantity(node.file.block_transactions(number)?.len()))
}

fn transaction_at(node: &Node, number: u64, index: U256) -> Reply {
    let all = node.file.block_transactions(number)?;
    let Some(mined) = all.iter().find(|one| U256::from(one.position) == index) else { return Ok(Value::Null) };
    let place = mining(node, number, mined.position)?;
    Ok(json::transaction(&decode(node, mined)?, node.chain_id, Some(place)))
}

fn require_newest(node: &Node, tag: Option<&Value>) -> Result<(), Fault> {
    let newest = tag.is_none_or(|tag| tag.is_null() || block_number(node, tag) == Some(node.head.number));
    if newest { Ok(()) } else { Err(Fault::new(-32000, "this chain keeps the state of its newest block only")) }
}

fn state(node: &Node, parameters: &Parameters, tag: usize, read: impl FnOnce(&Node, Address) -> Value) -> Reply {
    let account = parameters.at(0, read_address)?;
    require_newest(node, parameters.0.get(tag))?;
    Ok(read(node, account))
}

fn nonce(node: &Node, parameters: &Parameters) -> Reply {
    let account = parameters.at(0, read_address)?;
    let tag = parameters.0.get(1);
    require_newest(node, tag)?;
    let mined = node.machine.nonce(account);
    let pending = tag.and_then(Value::as_str) == Some("pending");
    Ok(quantity(if pending { node.pool.next_nonce(account, mined) } else { mined }))
}

fn fee_history(node: &Node, parameters: &Parameters) -> Reply {
    let asked = parameters.at(0, |count| count.as_u64().or_else(|| Some(read_quantity(count)?.low_u64())))?;
    let count = asked.min(1024).min(node.head.number + 1);
    let zeros = |count: u64| (0..count).map(|_| quantity(0)).collect::<Vec<_>>();
    let ratios = vec![0.0; usize::try_from(count).unwrap_or(0)];
    Ok(json!({
        "oldestBlock": quantity(node.head.number + 1 - count), "baseFeePerGas": zeros(count + 1),
        "gasUsedRatio": ratios, "reward": [],
    }))
}

fn send(node: &mut Node, parameters: &Parameters) -> Reply {
    let raw = parameters.at(0, read_data)?;
    node.submit(&raw).map(|hash| data(&hash.0)).map_err(|why| Fault::new(-32000, why))
}

fn message_call(node: &Node, call: bool, parameters: &Parameters) -> Reply {
    let message = parameters.at(0, read_message)?;
    require_newest(node, parameters.0.get(1))?;
    let place = node.next_place();
    let answer = if call {
        node.machine.call(&place, &message)
    } else {
        match node.machine.estimate(&place, &message) {
            Ok(gas) => return Ok(quantity(gas)),
            Err(answer) => answer,
        }
    };
    match answer {
        Answer::Returned(output, _) => Ok(data(&output)),
        Answer::Reverted(output) => {
            Err(Fault { code: 3, message: "execution reverted".into(), data: Some(data(&output)) })
        }
        Answer::Failed(why) => Err(Fault::new(-32000, why)),
    }
}

fn read_message(value: &Value) -> Option<Message> {
    let field = |name: &str| value.get(name).filter(|value| !value.is_null());
    let address = |name: &str| field(name).map_or(Some(None), |value| read_address(value).map(Some));
    let number = |name: &str| field(name).map_or(Some(None), |value| read_quantity(value).map(Some));
    Some(Message {
        from: address("from")?.unwrap_or(Address([0; 20])),
        to: address("to")?,
        value: number("value")?.unwrap_or_default(),
        input: field("data").or_else(|| field("input")).map_or(Some(Vec::new()), read_data)?,
        gas: number("gas")?.map_or(CALL_GAS_LIMIT, |gas| gas.min(U256::from(GAS_LIMIT)).low_u64()),
    })
}

fn header(node: &Node, number: u64) -> Result<Option<(Hash, Header, usize)>, Fault> {
    let Some((hash, bytes)) = node.file.block(number)? else { return Ok(None) };
    let size = bytes.len();
    let header = Header::decode(&bytes).map_err(|error| Fault::new(-32603, error.to_string()))?;
    Ok(Some((hash, header, size)))
}

fn block(node: &Node, number: u64, whole: bool) -> Reply {
    let Some((hash, header, size)) = header(node, number)? else { return Ok(Value::Null) };
    let mined = node.file.block_transactions(number)?;
    let size = mined.iter().map(|one| one.raw.len()).sum::<usize>() + size;
    let mut shown = Vec::with_capacity(mined.len());
    for one in &mined {
        let decoded = decode(node, one)?;
        let place = Mining { block: number, hash, timestamp: header.timestamp, position: one.position };
        let full = || json::transaction(&decoded, node.chain_id, Some(place));
        shown.push(if whole { full() } else { data(&decoded.hash.0) });
    }
    Ok(json::block(&header, hash, size, node.sealing.total_difficulty(number), shown))
}

fn decode(node: &Node, mined: &Mined) -> Result<Transaction, Fault> {
    Transaction::decode(&mined.raw, node.chain_id, Some(mined.sender)).map_err(|error| Fault::new(-32603, error))
}

fn decode_receipt(mined: &Mined) -> Result<Receipt, Fault> {
    rlp::decode(&mined.receipt).map_err(|error| Fault::new(-32603, error.to_string()))
}

fn mining(node: &Node, block: u64, position: u64) -> Result<Mining, Fault> {
    let (hash, header, _) = header(node, block)?.ok_or_else(|| Fault::new(-32603, "a block is missing"))?;
    Ok(Mining { block, hash, timestamp: header.timestamp, position })
}

fn transaction(node: &Node, hash: Hash) -> Reply {
    if let Some(waiting) = node.pool.get(hash) {
        return Ok(json::transaction(waiting, node.chain_id, None));
    }
    let Some(mined) = node.file.mined(hash)? else { return Ok(Value::Null) };
    let place = mining(node, mined.block, mined.position)?;
    Ok(json::transaction(&decode(node, &mined)?, node.chain_id, Some(place)))
}

fn receipt(node: &Node, hash: Hash) -> Reply {
    let Some(mined) = node.file.mined(hash)? else { return Ok(Value::Null) };
    let first_log = node.file.logs_before(mined.block, mined.position)?;
    let place = mining(node, mined.block, mined.position)?;
    Ok(json::receipt(&decode(node, &mined)?, &decode_receipt(&mined)?, place, first_log))
}

/// What eth_getLogs is asked for.
struct Filter {
    from: u64,
    to: u64,
    addresses: Vec<Address>,
    topics: Vec<Vec<Hash>>,
}

fn read_filter(node: &Node, value: &Value) -> Option<Filter> {
    let alternatives = |value: &Value| -> Vec<Value> {
        match value {
            Value::Null => Vec::new(),
            Value::Array(all) => all.clone(),
            one => vec![one.clone()],
        }
    };
    let bound = |name: &str| value.get(name).map_or(Some(node.head.number), |tag| block_number(node, tag));
    let topics = value.get("topics").map(alternatives).unwrap_or_default();
    let addresses = value.get("address").map(alternatives).unwrap_or_default();
    let hashes = |position: &Value| alternatives(position).iter().map(read_hash).collect::<Option<Vec<_>>>();
    let mut filter = Filter {
        from: bound("fromBlock")?,
        to: bound("toBlock")?,
        addresses: addresses.iter().map(read_address).collect::<Option<_>>()?,
        topics: topics.iter().map(hashes).collect::<Option<_>>()?,
    };
    if let Some(hash) = value.get("blockHash").and_then(read_hash) {
        filter.from = node.file.number_of(hash).ok().flatten()?;
        filter.to = filter.from;
    }
    Some(filter)
}

impl Filter {
    fn matches(&self, log: &super::block::Log) -> bool {
        let place = self.addresses.is_empty() || self.addresses.contains(&log.address);
        let wanted = |(index, any): (usize, &Vec<Hash>)| {
            any.is_empty() || log.topics.get(index).is_some_and(|topic| any.contains(topic))
        };
        place && self.topics.len() <= log.topics.len() && self.topics.iter().enumerate().all(wanted)
    }
}

fn logs(node: &Node, parameters: &Parameters) -> Reply {
    let filter = parameters.at(0, |value| read_filter(node, value))?;
    let mut found = Vec::new();
    let (mut place, mut index): (Option<Mining>, usize) = (None, 0);
    for mined in node.file.with_logs(filter.from, filter.to.min(node.head.number))? {
        let here = match place.filter(|place| place.block == mined.block) {
            Some(same) => Mining { position: mined.position, ..same },
            None => {
                index = 0;
                mining(node, mined.block, mined.position)?
            }
        };
        place = Some(here);
        let hash = Hash(ethers::utils::keccak256(&mined.raw));
        for log in decode_receipt(&mined)?.logs {
            if filter.matches(&log) {
                found.push(json::log(&log, hash, here, index));
            }
            index += 1;
        }
    }
    Ok(Value::Array(found))
}
