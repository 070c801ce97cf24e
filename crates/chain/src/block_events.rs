//! The events of one block, asked for by its hash and held against its header. A node that does not have the block must
//! refuse; one that says "none" all the same is found out by the header's bloom, and then the block's receipts decide.

use std::collections::BTreeMap;

use ethers::abi::ethereum_types::BloomInput;
use ethers::types::{Bloom, H256, U64};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::task::JoinSet;

use super::artefact::artefact;
use super::watcher::RawLog;
use super::{BlockRef, Chain, ChainError, EventAt};
use crate::model::{Address, Hash, bytes::unhex};

/// How many blocks below the head are read one by one: a node so far behind is not just a little late.
pub const NEAR: u64 = 64;
/// Blocks asked for at once.
pub const AT_ONCE: u64 = 8;
/// The most receipts of a block that are asked for one by one.
const MOST_RECEIPTS: usize = 256;

/// How sure it is that a block's events are all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Completeness {
    /// The block's header, or every receipt in it, says so.
    Whole,
    /// Only one answer says so: the node's headers name no logs.
    Unconfirmed,
    /// The header names events of the contract that nobody gave.
    Doubtful,
}

/// The contract's events in one block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockEvents {
    /// The block.
    pub block: BlockRef,
    /// Hash of the block before it.
    pub parent: Hash,
    /// Its events, in order.
    pub events: Vec<EventAt>,
    /// Whether these are all.
    pub completeness: Completeness,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct RawHeader {
    number: U64,
    hash: H256,
    parent_hash: H256,
    timestamp: U64,
    #[serde(default)]
    logs_bloom: Value,
    #[serde(default)]
    transactions: Vec<Value>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct RawLogs {
    block_hash: H256,
    logs: Vec<RawLog>,
}

impl RawHeader {
    fn block(&self) -> BlockRef {
        BlockRef { number: self.number.as_u64(), hash: Hash(self.hash.0), timestamp: self.timestamp.as_u64() }
    }

    fn bloom(&self) -> Option<Bloom> {
        let bytes = unhex(self.logs_bloom.as_str()?)?;
        (bytes.len() == Bloom::len_bytes()).then(|| Bloom::from_slice(&bytes))
    }

    /// The events of `contract` that the bloom names, among `known`; `None` if it says nothing.
    fn named(&self, contract: Address, known: &[H256]) -> Option<Vec<H256>> {
        let bloom = self.bloom()?;
        // Without transactions there is nothing to name; with some, an empty bloom may be that of a node that makes none.
        if bloom == Bloom::zero() && !self.transactions.is_empty() {
            return None;
        }
        let has = |bytes: &[u8]| bloom.contains_input(BloomInput::Raw(bytes));
        let has_contract = has(&contract.0);
        Some(known.iter().filter(|topic| has_contract && has(&topic.0)).copied().collect())
    }
}

/// Whether each of these events is among the logs.
fn covers(logs: &[RawLog], named: &[H256]) -> bool {
    named.iter().all(|topic| logs.iter().any(|log| log.topics.first() == Some(topic)))
}

impl Chain {
    /// The contract's events in block `number`; `None` if those asked do not have the block, or not all of it yet.
    ///
    /// # Errors
    /// [`ChainError::NoContract`], or an error of the node.
    pub async fn block_events(&self, number: u64) -> Result<Option<BlockEvents>, ChainError> {
        let Some(header) = self.header(number).await? else { return Ok(None) };
        let Some((mut logs, completeness)) = self.logs_under(&header).await? else { return Ok(None) };
        logs.sort_by_key(|log| log.log_index);
        let block = header.block();
        let mut events = logs.iter().map(|log| self.decode(log)).collect::<Result<Vec<_>, _>>()?;
        events.iter_mut().for_each(|event| event.timestamp = Some(block.timestamp));
        Ok(Some(BlockEvents { block, parent: Hash(header.parent_hash.0), events, completeness }))
    }

    /// Like [`Chain::block_events`] for blocks `from` to `to`, in order; for [`AT_ONCE`] of them at most.
    ///
    /// # Errors
    /// See [`Chain::block_events`].
    pub async fn each_block(&self, from: u64, to: u64) -> Result<Vec<Option<BlockEvents>>, ChainError> {
        let mut asked = JoinSet::new();
        for number in from..=to.min(from + AT_ONCE - 1) {
            let chain = self.clone();
            asked.spawn(async move { (number, chain.block_events(number).await) });
        }
        let mut found = BTreeMap::new();
        while let Some(answer) = asked.join_next().await {
            let (number, block) = answer.map_err(|error| ChainError::Internal(format!("reading a block: {error}")))?;
            found.insert(number, block?);
        }
        Ok(found.into_values().collect())
    }

    /// The first block that is to be read by itself under this head.
    pub fn first_near(&self, head: u64) -> u64 {
        // One program's answers agree with each other.
        if self.is_exact() { head + 1 } else { (head + 1).saturating_sub(NEAR) }
    }

    /// Whether one program in this process is the whole chain: then no answer is older than another.
    pub fn is_exact(&self) -> bool {
        self.transport().embedded().is_some()
    }

    async fn header(&self, number: u64) -> Result<Option<RawHeader>, ChainError> {
        self.rpc("eth_getBlockByNumber", json!([format!("{number:#x}"), false])).await
    }

    async fn logs_under(&self, header: &RawHeader) -> Result<Option<(Vec<RawLog>, Completeness)>, ChainError> {
        let named = self.named_by(header).await?;
        if named.as_ref().is_some_and(Vec::is_empty) {
            return Ok(Some((Vec::new(), Completeness::Whole)));
        }
        let by_hash = self.logs_with(json!({ "blockHash": Hash(header.hash.0).to_string() }), header.hash).await;
        if let Some(found) = settled(&by_hash, named.as_deref(), true) {
            return Ok(Some(found));
        }
        // Another question may reach another node, and an old node may not know the first one.
        let number = format!("{:#x}", header.number);
        let by_number = self.logs_with(json!({ "fromBlock": number, "toBlock": number }), header.hash).await;
        if let Some(found) = settled(&by_number, named.as_deref(), false) {
            return Ok(Some(found));
        }
        if let Ok(Some(logs)) = self.logs_of_receipts(header).await {
            return Ok(Some((logs, Completeness::Whole)));
        }
        match (by_hash, by_number) {
            (Ok(one), Ok(other)) => Ok(Some((longer(one, other), Completeness::Doubtful))),
            (Ok(logs), Err(_)) | (Err(_), Ok(logs)) => Ok(Some((logs, Completeness::Doubtful))),
            // It refuses: it does not have the block.
            (Err(ChainError::Rejected { .. }), Err(_)) => Ok(None),
            (Err(error), Err(_)) => Err(error),
        }
    }

    /// The events that a header's bloom names; `None` if this node's blooms say nothing.
    async fn named_by(&self, header: &RawHeader) -> Result<Option<Vec<H256>>, ChainError> {
        if !self.makes_blooms().await? {
            return Ok(None);
        }
        let known: Vec<H256> = artefact()?.abi.events().map(|event| H256(event.signature().0)).collect();
        Ok(header.named(self.contract()?, &known))
    }

    /// Whether the block of the contract's own deployment names the contract: some nodes send empty blooms.
    async fn makes_blooms(&self) -> Result<bool, ChainError> {
        let pin = self.pin().ok_or(ChainError::NoContract)?;
        if let Some(known) = self.inner.makes_blooms.get() {
            return Ok(*known);
        }
        let Some(header) = self.header(pin.deployed_at).await? else { return Ok(false) };
        let names = header.bloom().is_some_and(|bloom| bloom.contains_input(BloomInput::Raw(&pin.contract.0)));
        Ok(*self.inner.makes_blooms.get_or_init(|| names))
    }

    /// The contract's logs in one block, by a filter that names it.
    async fn logs_with(&self, mut filter: Value, block: H256) -> Result<Vec<RawLog>, ChainError> {
        filter["address"] = json!(self.contract()?.to_string());
        let mut logs = self.filtered(&filter).await?;
        logs.retain(|log| log.block_hash == block);
        Ok(logs)
    }

    /// The contract's logs as all receipts of a block have them; `None` if one is not there.
    async fn logs_of_receipts(&self, header: &RawHeader) -> Result<Option<Vec<RawLog>>, ChainError> {
        let contract = self.contract()?;
        let Some(receipts) = self.receipts_of(header).await? else { return Ok(None) };
        let is_whole = receipts.len() == header.transactions.len() && !receipts.is_empty();
        if !is_whole || receipts.iter().any(|receipt| receipt.block_hash != header.hash) {
            return Ok(None);
        }
        let logs = receipts.into_iter().flat_map(|receipt| receipt.logs);
        Ok(Some(logs.filter(|log| log.address.0 == contract.0).collect()))
    }

    async fn receipts_of(&self, header: &RawHeader) -> Result<Option<Vec<RawLogs>>, ChainError> {
        let hash = Hash(header.hash.0).to_string();
        if let Ok(Some(all)) = self.rpc::<Option<Vec<RawLogs>>>("eth_getBlockReceipts", json!([hash])).await {
            return Ok(Some(all));
        }
        if header.transactions.len() > MOST_RECEIPTS {
            return Ok(None);
        }
        let mut found = Vec::with_capacity(header.transactions.len());
        for transaction in &header.transactions {
            let receipt: Option<RawLogs> = self.rpc("eth_getTransactionReceipt", json!([transaction])).await?;
            let Some(receipt) = receipt else { return Ok(None) };
            found.push(receipt);
        }
        Ok(Some(found))
    }
}

/// The logs of an answer that needs no further question. Where no bloom says what there is, "none" counts only of a block
/// that was named by its hash.
fn settled(
    answer: &Result<Vec<RawLog>, ChainError>,
    named: Option<&[H256]>,
    is_by_hash: bool,
) -> Option<(Vec<RawLog>, Completeness)> {
    let logs = answer.as_ref().ok()?;
    let completeness = match named {
        Some(named) if covers(logs, named) => Completeness::Whole,
        None if is_by_hash || !logs.is_empty() => Completeness::Unconfirmed,
        _ => return None,
    };
    Some((logs.clone(), completeness))
}

fn longer(one: Vec<RawLog>, other: Vec<RawLog>) -> Vec<RawLog> {
    if other.len() > one.len() { other } else { one }
}
