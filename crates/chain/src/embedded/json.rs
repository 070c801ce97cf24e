//! The JSON shapes of blocks, transactions, receipts and logs, and the parsing of parameters.

use ethers::types::U256;
use ethers::utils::keccak256;
use serde_json::{Value, json};

use super::block::{Header, Log, Receipt, created_address};
use super::transaction::Transaction;
use super::trie::EMPTY_ROOT;
use super::world::{Proof, Record};
use crate::model::{
    Address, Hash,
    address::AddressError,
    bytes::{hex, unhex},
};

/// Where a transaction was mined.
#[derive(Clone, Copy)]
pub struct Mining {
    /// Block number.
    pub block: u64,
    /// Block hash.
    pub hash: Hash,
    /// Block time, seconds.
    pub timestamp: u64,
    /// Index in the block.
    pub position: u64,
}

impl Mining {
    /// At an index in a block.
    pub fn at(header: &Header, place: usize) -> Self {
        let position = u64::try_from(place).unwrap_or(u64::MAX);
        Self { block: header.number, hash: header.hash(), timestamp: header.timestamp, position }
    }
}

/// `0x` and hex digits without leading zeros.
pub fn quantity(value: impl Into<U256>) -> Value {
    Value::String(format!("{:#x}", value.into()))
}

/// `0x` and all bytes.
pub fn data(bytes: &[u8]) -> Value {
    Value::String(format!("0x{}", hex(bytes)))
}

/// Parses a quantity.
pub fn read_quantity(value: &Value) -> Option<U256> {
    let digits = value.as_str()?.strip_prefix("0x")?;
    U256::from_str_radix(digits, 16).ok()
}

/// Parses bytes.
pub fn read_data(value: &Value) -> Option<Vec<u8>> {
    value.as_str()?.strip_prefix("0x").and_then(unhex)
}

/// Parses an address, in upper or lower case.
pub fn read_address(value: &Value) -> Option<Address> {
    let parsed: Result<Address, AddressError> = value.as_str()?.to_lowercase().parse();
    parsed.ok()
}

/// Parses a 32-byte hash.
pub fn read_hash(value: &Value) -> Option<Hash> {
    read_data(value).and_then(|bytes| Hash::from_slice(&bytes))
}

/// A block; `transactions` are hashes or whole objects.
pub fn block(header: &Header, hash: Hash, size: usize, total_difficulty: u128, transactions: Vec<Value>) -> Value {
    json!({
        "number": quantity(header.number), "hash": data(&hash.0), "parentHash": data(&header.parent.0),
        "stateRoot": data(&header.state_root.0), "transactionsRoot": data(&header.transactions_root.0),
        "receiptsRoot": data(&header.receipts_root.0), "logsBloom": data(header.bloom.as_bytes()),
        "difficulty": quantity(header.difficulty), "totalDifficulty": quantity(total_difficulty),
        "gasLimit": quantity(header.gas_limit), "gasUsed": quantity(header.gas_used),
        "timestamp": quantity(header.timestamp), "extraData": data(&header.extra),
        "miner": data(&header.beneficiary.0), "mixHash": data(&[0; 32]), "nonce": data(&header.nonce.to_be_bytes()),
        "sha3Uncles": "0x1dcc4de8dec75d7aab85b567b6ccd41ad312451b948a7413f0a142fd40d49347",
        "uncles": [], "size": quantity(size), "transactions": transactions,
    })
}

/// The proof of an account (EIP-1186).
pub fn proof(address: Address, proof: &Proof) -> Value {
    let nodes = |way: &[std::sync::Arc<[u8]>]| way.iter().map(|node| data(node)).collect::<Vec<_>>();
    let nobody = Record { nonce: 0, balance: U256::zero(), storage: EMPTY_ROOT, code: Hash(keccak256([])) };
    let record = proof.record.unwrap_or(nobody);
    let slots = proof
        .slots
        .iter()
        .map(|(slot, value, way)| json!({ "key": quantity(*slot), "value": quantity(*value), "proof": nodes(way) }));
    json!({
        "address": data(&address.0), "balance": quantity(record.balance), "nonce": quantity(record.nonce),
        "codeHash": data(&record.code.0), "storageHash": data(&record.storage.0),
        "accountProof": nodes(&proof.way), "storageProof": slots.collect::<Vec<_>>(),
    })
}

/// A transaction, mined or waiting.
pub fn transaction(one: &Transaction, chain_id: u64, mining: Option<Mining>) -> Value {
    json!({
        "hash": data(&one.hash.0), "from": data(&one.sender.0), "to": one.to.map(|to| data(&to.0)),
        "nonce": quantity(one.nonce), "gas": quantity(one.gas_limit), "gasPrice": quantity(one.gas_price),
        "value": quantity(one.value), "input": data(&one.input), "type": "0x0", "chainId": quantity(chain_id),
        "v": quantity(one.v), "r": quantity(one.r), "s": quantity(one.s),
        "blockNumber": mining.map(|mining| quantity(mining.block)),
        "blockHash": mining.map(|mining| data(&mining.hash.0)),
        "transactionIndex": mining.map(|mining| quantity(mining.position)),
    })
}

/// A receipt; `first_log` is the index of its first log in the block.
pub fn receipt(one: &Transaction, receipt: &Receipt, mining: Mining, first_log: usize) -> Value {
    let mut bloom = ethers::types::Bloom::zero();
    receipt.accrue(&mut bloom);
    let contract = receipt.contract.or_else(|| one.to.is_none().then(|| created_address(one.sender, one.nonce)));
    let logs = receipt.logs.iter().enumerate();
    let mut value = json!({
        "transactionHash": data(&one.hash.0), "transactionIndex": quantity(mining.position),
        "blockHash": data(&mining.hash.0), "blockNumber": quantity(mining.block),
        "from": data(&one.sender.0), "to": one.to.map(|to| data(&to.0)),
        "contractAddress": contract.map(|contract| data(&contract.0)),
        "gasUsed": quantity(receipt.gas_used), "cumulativeGasUsed": quantity(receipt.cumulative_gas),
        "effectiveGasPrice": quantity(one.gas_price), "status": quantity(u8::from(receipt.success)), "type": "0x0",
        "logsBloom": data(bloom.as_bytes()),
        "logs": logs.map(|(index, one_log)| log(one_log, one.hash, mining, first_log + index)).collect::<Vec<_>>(),
    });
    if !receipt.output.is_empty() {
        value["revertReason"] = data(&receipt.output);
    }
    value
}

/// A log.
pub fn log(log: &Log, transaction: Hash, mining: Mining, index: usize) -> Value {
    json!({
        "address": data(&log.address.0), "data": data(&log.data), "removed": false,
        "topics": log.topics.iter().map(|topic| data(&topic.0)).collect::<Vec<_>>(),
        "transactionHash": data(&transaction.0), "transactionIndex": quantity(mining.position),
        "blockHash": data(&mining.hash.0), "blockNumber": quantity(mining.block),
        "blockTimestamp": quantity(mining.timestamp), "logIndex": quantity(index),
    })
}
