//! Reads through the node: the contract, nonces and receipts, and the news of blocks.

use std::time::{Duration, Instant};

use authros_evidence::{BlockHeader, Slot};
use ethers::abi::Token as AbiToken;
use ethers::types::{Bytes, H160, H256, U64, U256};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::call::{Values, address, artefact, word};
use crate::model::bytes::{hex, unhex};
use crate::model::{Address, Digest, Hash, Token};
use crate::{BlockRef, Call, Chain, ChainError, ChainStatus, Event, EventAt, QueryAnswer};
use crate::{connect::POLL, error::decode_revert_hex, event::AT_ONCE, transaction::List};

/// No account has sent that many transactions.
const NO_NONCE: u64 = 1 << 32;
/// Pending transactions of one account: far above any node's pool.
const MOST_PENDING: u64 = 100_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nonces {
    /// After mined transactions.
    pub mined: u64,
    /// After everything that the node holds.
    pub pending: u64,
}

impl Chain {
    pub async fn status(&self, account: Option<Address>) -> Result<ChainStatus, ChainError> {
        let (kind, consensus) = (self.transport().kind().to_owned(), self.inner.consensus.to_owned());
        let (chain_id, genesis, client) = (self.chain_id(), self.genesis(), self.inner.client.clone());
        let (block, contract) = (self.head().await?.number, self.pin().map(|pin| pin.contract));
        let (mut balance, mut nonce, mut pending) = (None, None, None);
        if let Some(account) = account {
            let mined = self.nonce(account, false).await?;
            balance = Some(self.balance(account).await?.to_string());
            nonce = Some(mined);
            pending = Some(self.nonce(account, true).await?.saturating_sub(mined));
        }
        Ok(ChainStatus { kind, consensus, chain_id, genesis, block, contract, balance, nonce, pending, client })
    }

    /// Wei.
    pub(super) async fn balance(&self, account: Address) -> Result<U256, ChainError> {
        self.rpc("eth_getBalance", json!([account.to_string(), "latest"])).await
    }

    /// A node without a pending state gives the mined nonce.
    pub async fn nonce(&self, account: Address, pending: bool) -> Result<u64, ChainError> {
        let ask = |tag: &'static str| self.rpc::<U64>("eth_getTransactionCount", json!([account.to_string(), tag]));
        let answer = match ask(if pending { "pending" } else { "latest" }).await {
            Err(ChainError::Rejected { .. }) if pending => ask("latest").await?,
            answered => answered?,
        };
        let nonce = Some(answer.as_u64()).filter(|nonce| *nonce < NO_NONCE);
        nonce.ok_or_else(|| self.misunderstood("eth_getTransactionCount", &answer.to_string()))
    }

    /// The two check each other: a transaction signed for a nonce far ahead would never be mined.
    pub async fn nonces(&self, account: Address) -> Result<Nonces, ChainError> {
        let (mined, pending) = (self.nonce(account, false).await?, self.nonce(account, true).await?);
        if (mined..=mined.saturating_add(MOST_PENDING)).contains(&pending) {
            return Ok(Nonces { mined, pending });
        }
        let reason = format!("{mined} as the mined nonce and {pending} as the pending one contradict each other");
        Err(self.misunderstood("eth_getTransactionCount", &reason))
    }

    pub async fn simulate(&self, from: Address, call: &Call) -> Result<(), ChainError> {
        self.call(from, self.contract()?, &call.encode()?, "latest").await.map(|_| ())
    }

    pub(super) async fn call(&self, from: Address, to: Address, data: &[u8], at: &str) -> Result<Vec<u8>, ChainError> {
        let message = json!({ "from": from.to_string(), "to": to.to_string(), "data": format!("0x{}", hex(data)) });
        let output: String = self.rpc("eth_call", json!([message, at])).await?;
        // Old geth returns a revert as a result.
        match decode_revert_hex(&output) {
            Some(code) if output.len() % 64 == 10 => Err(ChainError::Reverted { code }),
            _ => unhex(&output).ok_or_else(|| self.misunderstood("eth_call", "it is not hex")),
        }
    }

    async fn view<T>(
        &self,
        from: Address,
        name: &str,
        arguments: &[AbiToken],
        read: impl FnOnce(&mut Values) -> Option<T>,
    ) -> Result<T, ChainError> {
        let artefact = artefact()?;
        let data = artefact.encode(name, arguments)?;
        let output = self.call(from, self.contract()?, &data, "latest").await?;
        let values = artefact.function(name)?.decode_output(&output);
        let values = values.map_err(|error| self.misunderstood(name, &error.to_string()))?;
        read(&mut Values::new(values)).ok_or_else(|| self.misunderstood(name, "a value has the wrong type"))
    }

    /// The paper's dataQuery. A node does not authenticate `from`.
    pub async fn data_query(&self, from: Address, token: Token, owner: Address) -> Result<QueryAnswer, ChainError> {
        let arguments = [AbiToken::Bytes(token.0.to_vec()), address(owner)];
        let read = |values: &mut Values| {
            let (authorised, epoch) = (values.flag()?, values.number()?);
            Some(QueryAnswer { authorised, epoch, count: values.number()?, last: values.digest()? })
        };
        self.view(from, "dataQuery", &arguments, read).await
    }

    /// Individually, not in a batch.
    pub async fn uploaded_at(&self, owner: Address, digest: Digest) -> Result<Option<u64>, ChainError> {
        let block = self.view(owner, "uploadedAt", &[address(owner), word(digest.0)], Values::number).await?;
        Ok((block != 0).then_some(block))
    }

    /// The block of its first anchor, and the number of its leaves.
    pub async fn root_anchored(&self, account: Address, root: Hash) -> Result<Option<(u64, u64)>, ChainError> {
        let read = |values: &mut Values| Some((values.number()?, values.number()?));
        let found = self.view(account, "anchorOf", &[address(account), word(root.0)], read).await?;
        Ok((found.0 != 0).then_some(found))
    }

    /// Zero before the first anchor.
    pub async fn anchor_head(&self, account: Address) -> Result<Hash, ChainError> {
        self.view(account, "headOf", &[address(account)], Values::hash).await
    }

    /// Ends an embedded chain and waits until its file is closed.
    pub async fn end(&self) {
        if let Some(chain) = self.transport().embedded() {
            chain.end().await;
        }
    }

    /// `false` for other chains.
    pub async fn copy_to(&self, path: std::path::PathBuf) -> Result<bool, ChainError> {
        let Some(embedded) = self.transport().embedded() else { return Ok(false) };
        embedded.copy_to(path).await.map(|()| true)
    }

    /// Runs every block of the embedded chain again; returns how many, `None` for other chains.
    pub async fn run_again(&self) -> Result<Option<u64>, ChainError> {
        let Some(embedded) = self.transport().embedded() else { return Ok(None) };
        embedded.audit().await.map(Some)
    }

    /// For the test that the chain holds no secret.
    pub async fn dump(&self) -> Result<Vec<Vec<u8>>, ChainError> {
        match self.transport().embedded() {
            Some(embedded) => embedded.dump().await,
            None => Err(ChainError::Input("only the embedded chain can be dumped; use it for this".into())),
        }
    }
}

/// From the receipt (ours and Besu), otherwise by running it again on the block before.
pub(super) async fn reason(chain: &Chain, receipt: &Value, block: u64) -> Option<String> {
    if let Some(code) = receipt.get("revertReason").and_then(Value::as_str).and_then(decode_revert_hex) {
        return Some(code);
    }
    let hash = receipt.get("transactionHash")?;
    let sent: Value = chain.rpc("eth_getTransactionByHash", json!([hash])).await.ok()?;
    let field = |name: &str| sent.get(name)?.as_str().map(str::to_lowercase);
    let from = field("from")?.parse().ok()?;
    let to = field("to")?.parse().ok()?;
    let before = format!("{:#x}", block.saturating_sub(1));
    match chain.call(from, to, &unhex(&field("input")?)?, &before).await {
        Err(ChainError::Reverted { code }) => Some(code),
        _ => None,
    }
}

/// Blocks requested together; fewer if a node finds that too many.
const CHUNK: u64 = 2000;

/// Events that change nobody's rights; rights are rebuilt from all others.
const ANCHORS: [&str; 2] = ["DataUploaded", "Anchored"];

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
    /// Transactions and gas of the blocks.
    pub async fn work(&self, from: u64, to: u64) -> Result<(u64, u64), ChainError> {
        let (mut transactions, mut gas) = (0, 0);
        for number in from..=to {
            let Some(block) = self.raw_block(number).await? else { break };
            transactions += block.transactions.len() as u64;
            gas += block.gas_used.map_or(0, |gas| gas.low_u64());
        }
        Ok((transactions, gas))
    }

    /// In order, at most to the head.
    pub async fn events(&self, from: u64, to: u64) -> Result<Vec<EventAt>, ChainError> {
        self.collect(from, to, &Value::Null).await
    }

    /// The events from which rights are rebuilt.
    pub async fn changes(&self, from: u64, to: u64) -> Result<Vec<EventAt>, ChainError> {
        let changes = artefact()?.abi.events().filter(|event| !ANCHORS.contains(&event.name.as_str()));
        let wanted: Vec<String> = changes.map(|event| Hash(event.signature().0).to_string()).collect();
        let mut found = self.collect(from, to, &json!([wanted])).await?;
        found.retain(|at| !matches!(at.event, Event::DataUploaded { .. } | Event::Anchored { .. }));
        Ok(found)
    }

    /// By any account, in the chain's order.
    pub async fn anchors_of(&self, root: Hash, from: u64, to: u64) -> Result<Vec<EventAt>, ChainError> {
        let name = artefact()?.event_signature("Anchored")?.to_string();
        let mut found = self.collect(from, to, &json!([name, null, root.to_string()])).await?;
        found.retain(|at| matches!(at.event, Event::Anchored { root: anchored, .. } if anchored == root));
        Ok(found)
    }

    /// Filters old blocks in chunks, and reads the newest ones whole.
    async fn collect(&self, from: u64, to: u64, topics: &Value) -> Result<Vec<EventAt>, ChainError> {
        let contract = self.contract()?;
        let head = self.head().await?.number;
        let (to, near) = (to.min(head), self.first_near(head));
        let mut found = Vec::new();
        let (mut next, mut chunk) = (from, CHUNK);
        while next <= to && next < near {
            let last = to.min(near - 1).min(next + chunk - 1);
            let Some(logs) = self.portion(contract, (next, last), topics, &mut chunk).await? else { continue };
            found.extend(logs.iter().map(|log| self.decode(log)).collect::<Result<Vec<_>, _>>()?);
            (next, chunk) = (last + 1, CHUNK.min(chunk * 2));
        }
        while next <= to {
            let last = to.min(next + AT_ONCE - 1);
            for (number, block) in (next..=last).zip(self.each_block(next, last).await?) {
                let gone =
                    || self.misunderstood("eth_getLogs", &format!("it does not return block {number} of {head}"));
                found.extend(block.ok_or_else(gone)?.events);
            }
            next = last + 1;
        }
        Ok(found)
    }

    /// Asks for all blocks together, then for as many as the node accepts.
    pub(super) async fn first_with(&self, contract: Address, event: Hash) -> Result<Option<u64>, ChainError> {
        let (topics, head) = (json!([event.to_string()]), self.head().await?.number);
        let (mut next, mut chunk) = (0, head + 1);
        while next <= head {
            let last = head.min(next + chunk - 1);
            match self.portion(contract, (next, last), &topics, &mut chunk).await? {
                Some(logs) if logs.is_empty() => next = last + 1,
                Some(logs) => return Ok(logs.first().map(|log| log.block_number.as_u64())),
                None => {}
            }
        }
        Ok(None)
    }

    /// `None` if the blocks were too many, and halves `chunk`. Nodes say so in words, with a web page, or with silence;
    /// one that is away does not answer a small question either.
    async fn portion(
        &self,
        contract: Address,
        (from, to): (u64, u64),
        topics: &Value,
        chunk: &mut u64,
    ) -> Result<Option<Vec<RawLog>>, ChainError> {
        match self.filtered(&wide(contract, from, to, topics)).await {
            Ok(logs) => Ok(Some(logs)),
            Err(_) if to > from => {
                self.head().await?;
                *chunk = (to - from).div_ceil(2);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    pub(super) async fn filtered(&self, filter: &Value) -> Result<Vec<RawLog>, ChainError> {
        let mut logs: Vec<RawLog> = self.rpc("eth_getLogs", json!([filter])).await?;
        let place: Option<Address> = filter.get("address").and_then(Value::as_str).and_then(|text| text.parse().ok());
        logs.retain(|log| !log.removed && place.is_some_and(|place| log.address.0 == place.0));
        Ok(logs)
    }

    pub(super) fn decode(&self, log: &RawLog) -> Result<EventAt, ChainError> {
        let topics: Vec<Hash> = log.topics.iter().map(|topic| Hash(topic.0)).collect();
        let event = Event::decode(&topics, &log.data).map_err(|reason| self.misunderstood("eth_getLogs", &reason))?;
        let (block, block_hash) = (log.block_number.as_u64(), Hash(log.block_hash.0));
        let (timestamp, transaction) = (log.block_timestamp.map(|time| time.as_u64()), Hash(log.transaction_hash.0));
        Ok(EventAt { block, block_hash, timestamp, transaction, log_index: log.log_index.as_u64(), event })
    }

    /// Returns once the head is above `after`, or when `patience` is over.
    pub async fn next_block(&self, after: u64, patience: Duration) -> Result<BlockRef, ChainError> {
        if let Some(embedded) = self.transport().embedded() {
            let mut news = embedded.line.head.clone();
            // The guard must not be held across the next wait.
            let found = tokio::time::timeout(patience, news.wait_for(|head| head.number > after)).await;
            let Some(head) = found.ok().and_then(Result::ok).map(|head| *head) else { return self.head().await };
            return Ok(head);
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

// What an evidence bundle needs from a chain: block headers as they were hashed, and proofs of the contract's storage.

/// Slots per request; nodes limit it.
const MOST_SLOTS: usize = 32;
/// Bytes, generous: a branch of sixteen hashes, or a leaf.
const LONGEST_NODE: usize = 1024;

/// Header fields in order, numbers after `#`. Those of later forks come last; if one is missing, so are all after it.
const FIELDS: &str = "parentHash sha3Uncles miner stateRoot transactionsRoot receiptsRoot logsBloom #difficulty #number \
    #gasLimit #gasUsed #timestamp extraData mixHash nonce #baseFeePerGas withdrawalsRoot #blobGasUsed #excessBlobGas \
    parentBeaconBlockRoot requestsHash";

impl Chain {
    /// RLP, exactly as hashed.
    pub async fn header_rlp(&self, number: u64) -> Result<Option<Vec<u8>>, ChainError> {
        let block: Value = self.rpc("eth_getBlockByNumber", json!([format!("{number:#x}"), false])).await?;
        if block.is_null() {
            return Ok(None);
        }
        let wrong = || self.misunderstood("eth_getBlockByNumber", "its fields do not match its hash");
        header_of(&block).map(Some).ok_or_else(wrong)
    }

    /// Proof nodes of storage slots after a block (EIP-1186), unchecked.
    pub async fn storage_nodes(&self, number: u64, slots: &[Slot]) -> Result<Vec<Vec<u8>>, ChainError> {
        let contract = self.contract()?.to_string();
        let mut nodes = Vec::new();
        for some in slots.chunks(MOST_SLOTS) {
            let keys: Vec<String> = some.iter().map(|slot| Hash(slot.0).to_string()).collect();
            let answer: Value = self.rpc("eth_getProof", json!([contract, keys, format!("{number:#x}")])).await?;
            let wrong = || self.misunderstood("eth_getProof", "it is not a proof");
            let storage = answer.get("storageProof").and_then(Value::as_array).ok_or_else(wrong)?;
            let ways = std::iter::once(answer.get("accountProof")).chain(storage.iter().map(|one| one.get("proof")));
            for way in ways {
                for node in way.and_then(Value::as_array).ok_or_else(wrong)? {
                    let bytes = node.as_str().and_then(unhex).filter(|bytes| bytes.len() <= LONGEST_NODE);
                    nodes.push(bytes.ok_or_else(wrong)?);
                }
            }
        }
        Ok(nodes)
    }
}

/// `None` if the fields do not give the hash.
fn header_of(block: &Value) -> Option<Vec<u8>> {
    let named: Hash = block.get("hash")?.as_str()?.parse().ok()?;
    let of_hash = |header: &Vec<u8>| BlockHeader::parse(header).is_some_and(|parsed| parsed.hash == named);
    encode(block).filter(of_hash).or_else(|| encode(&without_miner(block)?).filter(of_hash))
}

/// geth 1.10.6 to 1.10.8 shows a Clique block's signer as its miner; the hashed header has no account there.
fn without_miner(block: &Value) -> Option<Value> {
    let mut block = block.clone();
    *block.get_mut("miner")? = json!(Address([0; 20]).to_string());
    Some(block)
}

fn encode(block: &Value) -> Option<Vec<u8>> {
    let (mut list, mut there) = (List::default(), 0);
    for field in FIELDS.split(' ') {
        let name = field.trim_start_matches('#');
        let Some(text) = block.get(name).and_then(Value::as_str) else { break };
        list = list.add(&if name == field { unhex(text)? } else { number(text)? }[..]);
        there += 1;
    }
    (there >= 15).then(|| list.end())
}

fn number(text: &str) -> Option<Vec<u8>> {
    let digits = text.strip_prefix("0x")?;
    let even = if digits.len() % 2 == 0 { digits.to_owned() } else { format!("0{digits}") };
    let bytes = unhex(&even)?;
    Some(bytes.into_iter().skip_while(|byte| *byte == 0).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Such a block, as one version of geth shows it and as another one does.
    #[test]
    fn a_clique_block_shown_with_its_signer_as_miner_gives_its_hash() {
        let blocks: Value = serde_json::from_str(include_str!("../../evidence/src/tests/besu.json")).expect("JSON");
        let mut block = blocks["qbft"].clone();
        block["mixHash"] = json!(Hash([0; 32]).to_string());
        block["extraData"] = json!(format!("0x{}", "07".repeat(97)));
        block["miner"] = json!(format!("0x{}", "00".repeat(20)));
        let header = encode(&block).expect("a header");
        block["hash"] = json!(BlockHeader::parse(&header).expect("parses").hash.to_string());
        assert_eq!(header_of(&block).as_ref(), Some(&header));
        block["miner"] = json!(format!("0x{}", "5a".repeat(20)));
        assert_eq!(header_of(&block).as_ref(), Some(&header), "its signer is shown");
        block["gasUsed"] = json!("0x7");
        assert_eq!(header_of(&block), None, "nothing else may differ");
    }

    /// Their hash covers neither seals nor round: it is not that of their bytes.
    #[test]
    fn blocks_of_real_networks_of_besu_give_their_hash() {
        let blocks: Value = serde_json::from_str(include_str!("../../evidence/src/tests/besu.json")).expect("JSON");
        for name in ["qbft", "ibft2"] {
            let header = header_of(&blocks[name]).expect("its hash");
            let committed = BlockHeader::parse(&header).expect("a header");
            assert!(committed.committed().is_some(), "{name}");
            for field in ["stateRoot", "gasUsed", "timestamp", "parentHash"] {
                let mut other = blocks[name].clone();
                let text = other[field].as_str().expect("text").to_owned();
                let last = if text.ends_with('7') { "8" } else { "7" };
                other[field] = format!("{}{last}", &text[..text.len() - 1]).into();
                assert_eq!(header_of(&other), None, "{name}, {field}");
            }
        }
    }
}
