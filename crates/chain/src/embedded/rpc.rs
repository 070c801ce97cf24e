//! Ethereum's JSON-RPC methods over the embedded chain. State is kept for the newest block only.

use alloy_primitives::{B256, Log, U256};
use serde_json::{Value, json};

use super::block::{self, Header, Mining, data, quantity, read_address, read_data, read_hash, read_quantity};
use super::world::{KEPT, Tries};
use super::{machine::Answer, node::Node, pool::TRANSACTION_GAS};
use crate::model::{Address, Hash, clean, counted};
use crate::transaction::Unsigned;
use crate::transport::{JsonRpcError, TransportError, refused};

pub type Reply = Result<Value, TransportError>;

pub struct Parameters(Vec<Value>);

impl Parameters {
    pub fn at<T>(&self, index: usize, read: impl FnOnce(&Value) -> Option<T>) -> Result<T, TransportError> {
        self.0.get(index).and_then(read).ok_or_else(|| Self::missing(index))
    }

    fn missing(index: usize) -> TransportError {
        refused(-32602, format!("missing or invalid value for argument {index}"))
    }
}

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
        "eth_getBalance" => state(node, parameters, 1, |node, who| Ok(quantity(node.machine.balance(who)?))),
        "eth_getCode" => state(node, parameters, 1, |node, who| Ok(data(&node.machine.code(who)?))),
        "eth_getStorageAt" => {
            let slot = parameters.at(1, read_quantity)?;
            state(node, parameters, 2, |node, who| Ok(data(&node.machine.tries.slot(who, slot)?.to_be_bytes::<32>())))
        }
        "eth_getTransactionCount" => nonce(node, parameters),
        "eth_getProof" => proof(node, parameters),
        "eth_getBlockByNumber" => block(node, parameters.at(0, |tag| block_number(node, tag))?, whole(parameters)),
        "eth_getBlockByHash" => match node.file.number_of(parameters.at(0, read_hash)?)? {
            Some(number) => block(node, number, whole(parameters)),
            None => Ok(Value::Null),
        },
        "eth_getBlockTransactionCountByNumber" | "eth_getBlockTransactionCountByHash" => {
            let number = parameters.at(0, |which| block_named(node, which))?;
            number.map_or(Ok(Value::Null), |number| Ok(quantity(node.done(&header(node, number)?)?.len())))
        }
        "eth_getTransactionByBlockNumberAndIndex" | "eth_getTransactionByBlockHashAndIndex" => {
            let number = parameters.at(0, |which| block_named(node, which))?;
            let index = parameters.at(1, read_quantity)?;
            number.map_or(Ok(Value::Null), |number| transaction_at(node, number, index))
        }
        "eth_getTransactionByHash" => transaction(node, parameters.at(0, read_hash)?),
        "eth_getTransactionReceipt" => receipt(node, parameters.at(0, read_hash)?),
        "eth_getLogs" => logs(node, parameters.0.first().unwrap_or(&Value::Null)),
        "clique_getSigners" if node.sealing.work.is_none() => {
            Ok(node.sealing.addresses().iter().map(|signer| data(&signer.0)).collect())
        }
        _ => Err(refused(-32601, format!("the method {} does not exist/is not available", clean(method, 60)))),
    }
}

fn client_version(node: &Node) -> String {
    let work = node.sealing.work.is_some();
    let sealing = if work { "proof of work by Keccak-256, not ethash" } else { "proof of authority" };
    format!("AuthROS/v{}/embedded ({sealing})", env!("CARGO_PKG_VERSION"))
}

fn whole(parameters: &Parameters) -> bool {
    parameters.0.get(1) == Some(&Value::Bool(true))
}

/// `None` if the tag is malformed.
pub fn block_number(node: &Node, tag: &Value) -> Option<u64> {
    match tag.as_str()? {
        "latest" | "pending" | "safe" | "finalized" => Some(node.head.number),
        "earliest" => Some(0),
        _ => read_quantity(tag).and_then(|number| u64::try_from(number).ok()),
    }
}

#[allow(clippy::option_option, reason = "outside: is it a name of a block; inside: is there one")]
fn block_named(node: &Node, which: &Value) -> Option<Option<u64>> {
    match read_hash(which) {
        Some(hash) => node.file.number_of(hash).ok(),
        None => Some(block_number(node, which).filter(|number| *number <= node.head.number)),
    }
}

fn header(node: &Node, number: u64) -> Result<Header, TransportError> {
    node.header(number)?.ok_or_else(|| refused(-32000, format!("block {number} is above the newest")))
}

fn transaction_at(node: &Node, number: u64, index: U256) -> Reply {
    let header = header(node, number)?;
    let done = node.done(&header)?;
    let place: usize = index.saturating_to();
    let Some(one) = done.get(place) else { return Ok(Value::Null) };
    Ok(block::transaction(&one.transaction, node.chain_id, Some(Mining::at(&header, place))))
}

fn require_newest(node: &Node, tag: Option<&Value>) -> Result<(), TransportError> {
    let newest = tag.is_none_or(|tag| tag.is_null() || block_number(node, tag) == Some(node.head.number));
    if newest { Ok(()) } else { Err(refused(-32000, "this chain keeps only the state of its newest block")) }
}

fn state(node: &Node, parameters: &Parameters, tag: usize, read: impl FnOnce(&Node, Address) -> Reply) -> Reply {
    let account = parameters.at(0, read_address)?;
    require_newest(node, parameters.0.get(tag))?;
    read(node, account)
}

fn nonce(node: &Node, parameters: &Parameters) -> Reply {
    let account = parameters.at(0, read_address)?;
    let tag = parameters.0.get(1);
    require_newest(node, tag)?;
    let mined = node.machine.nonce(account)?;
    let pending = tag.and_then(Value::as_str) == Some("pending");
    Ok(quantity(if pending { node.pool.next_nonce(account, mined) } else { mined }))
}

fn fee_history(node: &Node, parameters: &Parameters) -> Reply {
    let asked = parameters.at(0, |count| count.as_u64().or_else(|| Some(read_quantity(count)?.saturating_to())))?;
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
    node.submit(&raw).map(|hash| data(&hash.0)).map_err(|why| refused(-32000, why))
}

fn message_call(node: &Node, call: bool, parameters: &Parameters) -> Reply {
    let (from, message) = parameters.at(0, read_message)?;
    require_newest(node, parameters.0.get(1))?;
    let (machine, place) = (&node.machine, node.next_place());
    let answer = if call { machine.call(&place, from, &message) } else { machine.estimate(&place, from, &message) };
    match answer? {
        Answer::Returned(output, gas) => Ok(if call { data(&output) } else { quantity(gas) }),
        Answer::Reverted(output) => Err(TransportError::Answered(reverted(&output))),
        Answer::Failed(why) => Err(refused(-32000, why)),
    }
}

fn reverted(output: &[u8]) -> JsonRpcError {
    JsonRpcError { code: 3, message: "execution reverted".to_owned(), data: Some(data(output)) }
}

fn read_message(value: &Value) -> Option<(Address, Unsigned)> {
    let field = |name: &str| value.get(name).filter(|value| !value.is_null());
    let address = |name: &str| field(name).map_or(Some(None), |value| read_address(value).map(Some));
    let number = |name: &str| field(name).map_or(Some(None), |value| read_quantity(value).map(Some));
    let message = Unsigned {
        to: address("to")?,
        value: number("value")?.unwrap_or_default(),
        input: field("data").or_else(|| field("input")).map_or(Some(Vec::new()), read_data)?,
        gas_limit: number("gas")?.map_or(TRANSACTION_GAS, |gas| gas.saturating_to::<u64>().min(TRANSACTION_GAS)),
        ..Unsigned::default()
    };
    Some((address("from")?.unwrap_or(Address([0; 20])), message))
}

const MOST_SLOTS: usize = 256;

/// EIP-1186, for blocks whose state is kept.
fn proof(node: &Node, parameters: &Parameters) -> Reply {
    let account = parameters.at(0, read_address)?;
    let slots = |value: &Value| value.as_array()?.iter().map(read_slot).collect::<Option<Vec<U256>>>();
    let slots = parameters.at(1, slots)?;
    if slots.len() > MOST_SLOTS {
        return Err(refused(
            -32005,
            format!("a proof of {}; ask for at most {MOST_SLOTS}", counted(slots.len() as u64, "slot")),
        ));
    }
    let number = match parameters.0.get(2) {
        None | Some(Value::Null) => node.head.number,
        Some(_) => parameters.at(2, |which| block_named(node, which))?.unwrap_or(u64::MAX),
    };
    let newest = node.head.number;
    if number > newest {
        return Err(refused(-32000, "there is no such block"));
    }
    if newest - number >= KEPT {
        let oldest = (newest + 1).saturating_sub(KEPT);
        let what = format!("the state of block {number} is not kept; ask for one of the blocks {oldest} to {newest}");
        return Err(refused(-32000, what));
    }
    let tries = Tries { root: header(node, number)?.state_root, ..node.machine.tries.clone() };
    Ok(block::proof(account, &tries.proof(account, &slots)?))
}

/// As a quantity, or as 32 bytes.
fn read_slot(value: &Value) -> Option<U256> {
    read_hash(value).map(|word| U256::from_be_bytes(word.0)).or_else(|| read_quantity(value))
}

fn block(node: &Node, number: u64, whole: bool) -> Reply {
    let Some(header) = node.header(number)? else { return Ok(Value::Null) };
    let done = node.done(&header)?;
    let size = done.iter().map(|done| done.transaction.raw.len()).sum::<usize>() + header.encode().len();
    let shown = done.iter().enumerate().map(|(place, one)| {
        let full = || block::transaction(&one.transaction, node.chain_id, Some(Mining::at(&header, place)));
        if whole { full() } else { data(&one.transaction.hash.0) }
    });
    Ok(block::block(&header, header.hash(), size, node.sealing.total_difficulty(number), shown.collect()))
}

fn transaction(node: &Node, hash: Hash) -> Reply {
    if let Some(waiting) = node.pool.get(hash) {
        return Ok(block::transaction(waiting, node.chain_id, None));
    }
    let Some((header, done, place)) = node.mined(hash)? else { return Ok(Value::Null) };
    Ok(block::transaction(&done[place].transaction, node.chain_id, Some(Mining::at(&header, place))))
}

fn receipt(node: &Node, hash: Hash) -> Reply {
    let Some((header, done, place)) = node.mined(hash)? else { return Ok(Value::Null) };
    let first_log = done[..place].iter().map(|before| before.receipt.logs.len()).sum();
    Ok(block::receipt(&done[place].transaction, &done[place].receipt, Mining::at(&header, place), first_log))
}

// `eth_getLogs`: bounded in blocks, bytes searched and bytes returned, before any of it is built.

const MOST_BLOCKS: u64 = 10_000;
/// Bytes of transactions and receipts searched for one request.
const MOST_READ: usize = 32 * 1024 * 1024;
/// Bytes of the answer, roughly as JSON.
const MOST_GIVEN: usize = 8 * 1024 * 1024;
/// JSON size of a log without data and topics, bytes.
const FRAME: usize = 500;

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
    fn matches(&self, log: &Log) -> bool {
        let place = self.addresses.is_empty() || self.addresses.contains(&Address(log.address.into_array()));
        let wanted = |(any, topic): (&Vec<Hash>, &B256)| any.is_empty() || any.contains(&Hash(topic.0));
        place && self.topics.len() <= log.topics().len() && self.topics.iter().zip(log.topics()).all(wanted)
    }
}

fn too_many(what: &str) -> TransportError {
    refused(-32005, format!("{what}; request fewer blocks per call"))
}

fn logs(node: &Node, filter: &Value) -> Reply {
    if let Some(hash) = filter.get("blockHash").and_then(read_hash)
        && node.file.number_of(hash)?.is_none()
    {
        return Err(refused(-32000, "unknown block"));
    }
    let filter = read_filter(node, filter).ok_or_else(|| Parameters::missing(0))?;
    let to = filter.to.min(node.head.number);
    if (to + 1).saturating_sub(filter.from) > MOST_BLOCKS {
        return Err(too_many(&format!("logs of more than {MOST_BLOCKS} blocks")));
    }
    let (mut found, mut read, mut given) = (Vec::new(), 0, 0);
    for number in node.file.with_logs(filter.from, to)? {
        let Some(header) = node.header(number)? else { break };
        let mut index = 0;
        for (place, done) in node.done(&header)?.iter().enumerate() {
            read += FRAME
                + done.transaction.raw.len()
                + done.receipt.logs.iter().map(|log| log.data.data.len()).sum::<usize>();
            if read > MOST_READ {
                return Err(too_many("there is too much to search"));
            }
            for log in &done.receipt.logs {
                if filter.matches(log) {
                    given += FRAME + 2 * log.data.data.len() + 70 * log.topics().len();
                    if given > MOST_GIVEN {
                        return Err(too_many("there are too many logs"));
                    }
                    found.push(block::log(log, done.transaction.hash, Mining::at(&header, place), index));
                }
                index += 1;
            }
        }
    }
    Ok(Value::Array(found))
}
