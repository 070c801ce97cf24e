//! News from the chain: blocks and events.

use std::time::{Duration, Instant};

use ethers::types::{Bytes, H160, H256, U64};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::artefact::artefact;
use super::block_events::AT_ONCE;
use super::connect::POLL;
use super::{BlockRef, Chain, ChainError, Event, EventAt};
use crate::model::{Address, Hash};

/// The most blocks requested at once; fewer if a node finds that too many.
const CHUNK: u64 = 2000;

/// Uploads and anchors, which change nobody's rights: rights are rebuilt from all other events (registrations, grants,
/// loans and the administrator's acts).
const ANCHORS: [&str; 2] = ["DataUploaded", "Anchored"];

/// A log as a node returns it.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct RawLog {
    pub address: H160,
    pub topics: Vec<H256>,
    data: Bytes,
    block_number: U64,
    pub block_hash: H256,
    transaction_hash: H256,
    pub log_index: U64,
    block_timestamp: Option<U64>,
    #[serde(default)]
    removed: bool,
}

/// The filter for a contract's logs in a range of blocks.
fn wide(contract: Address, from: u64, to: u64, topics: &Value) -> Value {
    let mut filter = json!({
        "address": contract.to_string(), "fromBlock": format!("{from:#x}"), "toBlock": format!("{to:#x}"),
    });
    if !topics.is_null() {
        filter["topics"] = topics.clone();
    }
    filter
}

impl Chain {
    /// The contract's events in blocks `from` to `to` (at most the head), in order.
    ///
    /// # Errors
    /// [`ChainError::NoContract`], or an error of the node.
    pub async fn events(&self, from: u64, to: u64) -> Result<Vec<EventAt>, ChainError> {
        self.collect(from, to, &Value::Null).await
    }

    /// Like [`Chain::events`], without uploads and anchors: the events from which rights are rebuilt.
    ///
    /// # Errors
    /// See [`Chain::events`].
    pub async fn changes(&self, from: u64, to: u64) -> Result<Vec<EventAt>, ChainError> {
        let changes = artefact()?.abi.events().filter(|event| !ANCHORS.contains(&event.name.as_str()));
        let wanted: Vec<String> = changes.map(|event| Hash(event.signature().0).to_string()).collect();
        let mut found = self.collect(from, to, &json!([wanted])).await?;
        found.retain(|at| !matches!(at.event, Event::DataUploaded { .. } | Event::Anchored { .. }));
        Ok(found)
    }

    /// Every anchor of one root in blocks `from` to `to`, by any account, in the chain's order.
    ///
    /// # Errors
    /// See [`Chain::events`].
    pub async fn anchors_of(&self, root: Hash, from: u64, to: u64) -> Result<Vec<EventAt>, ChainError> {
        let name = artefact()?.event_signature("Anchored")?.to_string();
        let mut found = self.collect(from, to, &json!([name, null, root.to_string()])).await?;
        found.retain(|at| matches!(at.event, Event::Anchored { root: anchored, .. } if anchored == root));
        Ok(found)
    }

    /// Old blocks many at a time with a filter of topics, the newest ones whole.
    async fn collect(&self, from: u64, to: u64, topics: &Value) -> Result<Vec<EventAt>, ChainError> {
        let contract = self.contract()?;
        let head = self.head().await?.number;
        let (to, near) = (to.min(head), self.first_near(head));
        let mut found = Vec::new();
        let (mut next, mut chunk) = (from, CHUNK);
        while next <= to && next < near {
            let last = to.min(near - 1).min(next + chunk - 1);
            match self.filtered(&wide(contract, next, last, topics)).await {
                Ok(logs) => {
                    for log in logs {
                        found.push(self.decode(&log)?);
                    }
                    next = last + 1;
                    chunk = CHUNK.min(chunk * 2);
                }
                Err(_) if last > next => chunk = self.half(next, last).await?,
                Err(error) => return Err(error),
            }
        }
        while next <= to {
            let last = to.min(next + AT_ONCE - 1);
            for (number, block) in (next..=last).zip(self.each_block(next, last).await?) {
                let missing =
                    || self.misunderstood("eth_getLogs", &format!("it does not give block {number} of {head}"));
                found.extend(block.ok_or_else(missing)?.events);
            }
            next = last + 1;
        }
        Ok(found)
    }

    /// The first block with an event of a contract: asked for all blocks at once, then for as many as the node likes.
    ///
    /// # Errors
    /// An error of the node that it also gives for a single block.
    pub(super) async fn first_with(&self, contract: Address, event: Hash) -> Result<Option<u64>, ChainError> {
        let (topics, head) = (json!([event.to_string()]), self.head().await?.number);
        let (mut next, mut chunk) = (0, head + 1);
        while next <= head {
            let last = head.min(next + chunk - 1);
            match self.filtered(&wide(contract, next, last, &topics)).await {
                Ok(logs) => match logs.first() {
                    Some(log) => return Ok(Some(log.block_number.as_u64())),
                    None => next = last + 1,
                },
                Err(_) if last > next => chunk = self.half(next, last).await?,
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Half of the blocks that were too many: nodes and what stands before them say so in words, with a web page, or with
    /// silence. One that is away does not answer a small question either.
    async fn half(&self, next: u64, last: u64) -> Result<u64, ChainError> {
        self.head().await?;
        Ok((last - next).div_ceil(2))
    }

    /// The logs that match a filter, of the contract that it names.
    pub(super) async fn filtered(&self, filter: &Value) -> Result<Vec<RawLog>, ChainError> {
        let mut logs: Vec<RawLog> = self.rpc("eth_getLogs", json!([filter])).await?;
        let contract: Option<Address> =
            filter.get("address").and_then(Value::as_str).and_then(|text| text.parse().ok());
        logs.retain(|log| !log.removed && contract.is_some_and(|contract| log.address.0 == contract.0));
        Ok(logs)
    }

    pub(super) fn decode(&self, log: &RawLog) -> Result<EventAt, ChainError> {
        let topics: Vec<Hash> = log.topics.iter().map(|topic| Hash(topic.0)).collect();
        let event = Event::decode(&topics, &log.data).map_err(|reason| self.misunderstood("eth_getLogs", &reason))?;
        Ok(EventAt {
            block: log.block_number.as_u64(),
            block_hash: Hash(log.block_hash.0),
            timestamp: log.block_timestamp.as_ref().map(U64::as_u64),
            transaction: Hash(log.transaction_hash.0),
            log_index: log.log_index.as_u64(),
            event,
        })
    }

    /// The head as soon as it is above `after`, or the current one when `patience` is over.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn next_block(&self, after: u64, patience: Duration) -> Result<BlockRef, ChainError> {
        if let Some(embedded) = self.transport().embedded() {
            let mut news = embedded.head();
            // The guard must not be held across the next wait.
            let found = tokio::time::timeout(patience, news.wait_for(|head| head.number > after)).await;
            let found = found.ok().and_then(Result::ok).map(|head| *head);
            return match found {
                Some(head) => Ok(head),
                None => self.head().await,
            };
        }
        let deadline = Instant::now() + patience;
        loop {
            let head = self.head().await?;
            let left = deadline.saturating_duration_since(Instant::now());
            if head.number > after || left.is_zero() {
                return Ok(head);
            }
            tokio::time::sleep(POLL.min(left)).await;
        }
    }
}
