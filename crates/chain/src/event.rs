//! Events of the contract, decoded.

use std::collections::BTreeMap;

use ethers::abi::ethereum_types::BloomInput;
use ethers::types::{Bloom, H256};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::task::JoinSet;

use crate::call::{Values, artefact};
use crate::model::{Address, Digest, GrantTerms, Hash, Identity, SignerId, Timestamp, Token, bytes::unhex};
use crate::{BlockRef, Chain, ChainError, EventAt, connect::RawBlock, reader::RawLog};

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// At epoch 1.
    Registered { owner: Address, identity: Identity, epoch: u64 },
    /// `keys` is their version, from 1.
    KeysRotated { owner: Address, keys: u64, identity: Identity, envelope: Vec<u8> },
    /// `None` = no end.
    Extended { owner: Address, grantee: Address, expiry: Option<Timestamp> },
    /// From `from` on, `recovery` may stop a succession.
    RecoveryNamed { owner: Address, recovery: Option<Address>, from: Timestamp },
    /// `number` counts the owner's; `timestamp` is the owner's claim, `None` if it is not 8 bytes.
    DataUploaded { owner: Address, digest: Digest, token: Token, epoch: u64, number: u64, timestamp: Option<Timestamp> },
    /// A grant began.
    Granted { terms: GrantTerms, envelope: Vec<u8> },
    /// The envelope of another epoch.
    Wrapped { owner: Address, grantee: Address, epoch: u64, envelope: Vec<u8> },
    /// `epoch` and `token` are the owner's new ones.
    Revoked { owner: Address, grantee: Address, epoch: u64, token: Token },
    /// `epoch` and `token` are the owner's new ones.
    Rotated { owner: Address, epoch: u64, token: Token },
    /// Over `count` digests.
    Anchored { account: Address, root: Hash, count: u64, previous: Hash },
    /// The device may sign for the owner.
    Lent { owner: Address, device: SignerId, until: Option<Timestamp> },
    /// The device may no longer sign.
    Recalled { owner: Address, device: SignerId },
    /// May register.
    Admitted { account: Address },
    /// May no longer register.
    Dismissed { account: Address },
    /// Registration.
    OpenChanged { open: bool },
    /// By the administrator.
    Suspended { account: Address },
    /// The suspension ended.
    Restored { account: Address },
    /// A time in the past means that changes resumed.
    PausedUntil { until: Timestamp },
    /// `recovery` may stop it until `due`.
    SuccessionProposed { lost: Address, successor: Address, recovery: Option<Address>, due: Timestamp },
    /// Stopped or withdrawn.
    SuccessionCancelled { lost: Address, by: Address },
    /// Of successions.
    DelayFixed { seconds: u64 },
    /// The successor continues for the lost account.
    Succeeded { lost: Address, successor: Address },
    /// May take over.
    AdministratorNominated { nominee: Address },
    /// The nominee took over.
    AdministratorChanged { previous: Address, administrator: Address },
}

impl Event {
    pub fn account(&self) -> Option<Address> {
        match self {
            Self::Registered { owner: about, .. }
            | Self::KeysRotated { owner: about, .. }
            | Self::DataUploaded { owner: about, .. }
            | Self::Granted { terms: GrantTerms { owner: about, .. }, .. }
            | Self::Wrapped { owner: about, .. }
            | Self::Revoked { owner: about, .. }
            | Self::Rotated { owner: about, .. }
            | Self::Extended { owner: about, .. }
            | Self::RecoveryNamed { owner: about, .. }
            | Self::Lent { owner: about, .. }
            | Self::Recalled { owner: about, .. }
            | Self::Anchored { account: about, .. }
            | Self::Admitted { account: about }
            | Self::Dismissed { account: about }
            | Self::Suspended { account: about }
            | Self::Restored { account: about }
            | Self::Succeeded { lost: about, .. }
            | Self::SuccessionProposed { lost: about, .. }
            | Self::SuccessionCancelled { lost: about, .. } => Some(*about),
            _ => None,
        }
    }

    pub fn decode(topics: &[Hash], data: &[u8]) -> Result<Self, String> {
        let artefact = artefact().map_err(|error| error.to_string())?;
        let first = topics.first().ok_or("an event without a topic")?;
        let mut events = artefact.abi.events();
        let event = events.find(|event| event.signature().0 == first.0).ok_or("an unknown event")?;
        let topics = topics.iter().map(|topic| H256(topic.0)).collect();
        let log =
            event.parse_log(ethers::abi::RawLog { topics, data: data.to_vec() }).map_err(|error| error.to_string())?;
        let mut values = Values::new(log.params.into_iter().map(|parameter| parameter.value).collect());
        named(&event.name, &mut values).ok_or_else(|| format!("a malformed event {}", event.name))
    }
}

/// An event by its name, and the kinds of its values in the contract's order.
macro_rules! of_values {
    ($name:ident, $values:ident; $($event:ident { $($field:ident: $kind:ident),* })*) => {
        match $name {
            $(stringify!($event) => Event::$event { $($field: $values.$kind()?),* },)*
            _ => return None,
        }
    };
}

fn named(name: &str, values: &mut Values) -> Option<Event> {
    Some(match name {
        "Registered" => {
            let (owner, _) = (values.address()?, values.token()?);
            Event::Registered { owner, identity: values.identity()?, epoch: 1 }
        }
        "Granted" => {
            let (owner, grantee, epoch) = (values.address()?, values.address()?, values.number()?);
            let (expiry, scope) = (values.end()?, values.scope()?);
            Event::Granted { terms: GrantTerms { owner, grantee, epoch, expiry, scope }, envelope: values.bytes()? }
        }
        _ => of_values! { name, values;
            KeysRotated { owner: address, keys: number, identity: identity, envelope: bytes }
            Extended { owner: address, grantee: address, expiry: end }
            RecoveryNamed { owner: address, recovery: somebody, from: moment }
            DataUploaded { owner: address, digest: digest, token: token, epoch: number, number: number, timestamp: claim }
            Wrapped { owner: address, grantee: address, epoch: number, envelope: bytes }
            Revoked { owner: address, grantee: address, epoch: number, token: token }
            Rotated { owner: address, epoch: number, token: token }
            Anchored { account: address, root: hash, count: number, previous: hash }
            Lent { owner: address, device: device, until: end }
            Recalled { owner: address, device: device }
            Admitted { account: address }
            Dismissed { account: address }
            OpenChanged { open: flag }
            Suspended { account: address }
            Restored { account: address }
            PausedUntil { until: moment }
            SuccessionProposed { lost: address, successor: address, recovery: somebody, due: moment }
            SuccessionCancelled { lost: address, by: address }
            DelayFixed { seconds: number }
            Succeeded { lost: address, successor: address }
            AdministratorNominated { nominee: address }
            AdministratorChanged { previous: address, administrator: address }
        },
    })
}

// Events of one block, asked for by its hash and checked against its header. A node without the block must refuse; if
// it answers "none", the header's bloom shows that, and the block's receipts decide.

/// Blocks below the head that are read one by one: no node merely lags that far.
pub const NEAR: u64 = 64;
/// Blocks asked for together.
pub const AT_ONCE: u64 = 8;
/// Receipts of a block that are asked for one by one.
const MOST_RECEIPTS: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Completeness {
    /// According to the header, or to every receipt.
    Whole,
    /// According to one answer only: the node's headers name no logs.
    Unconfirmed,
    /// The header names events that no answer contains.
    Doubtful,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockEvents {
    pub block: BlockRef,
    pub parent: Hash,
    pub events: Vec<EventAt>,
    pub completeness: Completeness,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct RawLogs {
    block_hash: H256,
    logs: Vec<RawLog>,
}

impl RawBlock {
    fn bloom(&self) -> Option<Bloom> {
        let bytes = unhex(self.logs_bloom.as_ref()?.as_str()?)?;
        (bytes.len() == Bloom::len_bytes()).then(|| Bloom::from_slice(&bytes))
    }

    /// Events of `contract` in the bloom, among `known`; `None` if the bloom says nothing.
    fn named(&self, contract: Address, known: &[H256]) -> Option<Vec<H256>> {
        let bloom = self.bloom()?;
        // An empty bloom beside transactions may come from a node that makes none.
        if bloom == Bloom::zero() && !self.transactions.is_empty() {
            return None;
        }
        let has = |bytes: &[u8]| bloom.contains_input(BloomInput::Raw(bytes));
        let has_contract = has(&contract.0);
        Some(known.iter().filter(|topic| has_contract && has(&topic.0)).copied().collect())
    }
}

fn covers(logs: &[RawLog], named: &[H256]) -> bool {
    named.iter().all(|topic| logs.iter().any(|log| log.topics.first() == Some(topic)))
}

impl Chain {
    /// `None` if no node asked has the whole block.
    pub async fn block_events(&self, number: u64) -> Result<Option<BlockEvents>, ChainError> {
        let Some(header) = self.raw_block(number).await? else { return Ok(None) };
        let missing = || self.misunderstood("eth_getBlockByNumber", "it has no parent");
        let parent = header.parent_hash.ok_or_else(missing)?;
        let Some((mut logs, completeness)) = self.logs_under(&header).await? else { return Ok(None) };
        logs.sort_by_key(|log| log.log_index);
        let block = header.reference();
        let mut events = logs.iter().map(|log| self.decode(log)).collect::<Result<Vec<_>, _>>()?;
        events.iter_mut().for_each(|event| event.timestamp = Some(block.timestamp));
        Ok(Some(BlockEvents { block, parent: Hash(parent.0), events, completeness }))
    }

    /// In order, [`AT_ONCE`] blocks at most.
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

    /// First block that is read on its own under this head.
    pub fn first_near(&self, head: u64) -> u64 {
        // One program's answers agree with each other.
        if self.is_exact() { head + 1 } else { (head + 1).saturating_sub(NEAR) }
    }

    /// One program in this process is the whole chain, so no answer is older than another.
    pub fn is_exact(&self) -> bool {
        self.transport().embedded().is_some()
    }

    async fn logs_under(&self, header: &RawBlock) -> Result<Option<(Vec<RawLog>, Completeness)>, ChainError> {
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
            (Ok(one), Ok(other)) if other.len() <= one.len() => Ok(Some((one, Completeness::Doubtful))),
            (Ok(_), Ok(longer)) => Ok(Some((longer, Completeness::Doubtful))),
            (Ok(logs), Err(_)) | (Err(_), Ok(logs)) => Ok(Some((logs, Completeness::Doubtful))),
            // A refusal means that it does not have the block.
            (Err(ChainError::Rejected { .. }), Err(_)) => Ok(None),
            (Err(error), Err(_)) => Err(error),
        }
    }

    async fn named_by(&self, header: &RawBlock) -> Result<Option<Vec<H256>>, ChainError> {
        if !self.makes_blooms().await? {
            return Ok(None);
        }
        let known: Vec<H256> = artefact()?.abi.events().map(|event| H256(event.signature().0)).collect();
        Ok(header.named(self.contract()?, &known))
    }

    /// Whether the deployment's block names the contract: some nodes send empty blooms.
    async fn makes_blooms(&self) -> Result<bool, ChainError> {
        let pin = self.pin().ok_or(ChainError::NoContract)?;
        if let Some(known) = self.inner.makes_blooms.get() {
            return Ok(*known);
        }
        let Some(header) = self.raw_block(pin.deployed_at).await? else { return Ok(false) };
        let names = header.bloom().is_some_and(|bloom| bloom.contains_input(BloomInput::Raw(&pin.contract.0)));
        Ok(*self.inner.makes_blooms.get_or_init(|| names))
    }

    async fn logs_with(&self, mut filter: Value, block: H256) -> Result<Vec<RawLog>, ChainError> {
        filter["address"] = json!(self.contract()?.to_string());
        let mut logs = self.filtered(&filter).await?;
        logs.retain(|log| log.block_hash == block);
        Ok(logs)
    }

    /// `None` if a receipt is missing.
    async fn logs_of_receipts(&self, header: &RawBlock) -> Result<Option<Vec<RawLog>>, ChainError> {
        let contract = self.contract()?;
        let Some(receipts) = self.receipts_of(header).await? else { return Ok(None) };
        let is_whole = receipts.len() == header.transactions.len() && !receipts.is_empty();
        if !is_whole || receipts.iter().any(|receipt| receipt.block_hash != header.hash) {
            return Ok(None);
        }
        let logs = receipts.into_iter().flat_map(|receipt| receipt.logs);
        Ok(Some(logs.filter(|log| log.address.0 == contract.0).collect()))
    }

    async fn receipts_of(&self, header: &RawBlock) -> Result<Option<Vec<RawLogs>>, ChainError> {
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

/// Without a bloom, "none" counts only of a block that was named by its hash.
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

#[cfg(test)]
mod tests {
    use super::*;
    use ethers::abi::Token as AbiToken;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn noise_is_an_error_never_a_panic(which in 0usize..60, words in proptest::collection::vec(any::<[u8; 32]>(), 0..4), data: Vec<u8>) {
            let events: Vec<_> = artefact().expect("artefact").abi.events().collect();
            let mut topics = vec![Hash(events[which % events.len()].signature().0)];
            topics.extend(words.into_iter().map(Hash));
            let _ = Event::decode(&topics, &data);
        }
    }

    #[test]
    fn every_event_of_the_contract_has_a_word_here() {
        for event in artefact().expect("artefact").abi.events() {
            let topics: Vec<Hash> = std::iter::once(Hash(event.signature().0))
                .chain(event.inputs.iter().filter(|input| input.indexed).map(|_| Hash([0; 32])))
                .collect();
            let plain: Vec<AbiToken> =
                event.inputs.iter().filter(|input| !input.indexed).map(|input| zero(&input.kind)).collect();
            let decoded = Event::decode(&topics, &ethers::abi::encode(&plain));
            assert!(decoded.is_ok(), "{}: {decoded:?}", event.name);
        }
        assert!(Event::decode(&[], &[]).is_err());
        assert!(Event::decode(&[Hash([1; 32])], &[]).is_err());
    }

    fn zero(kind: &ethers::abi::ParamType) -> AbiToken {
        use ethers::abi::ParamType;
        match kind {
            ParamType::Bool => AbiToken::Bool(false),
            ParamType::Bytes => AbiToken::Bytes(vec![0; Identity::LENGTH]),
            ParamType::Array(_) => AbiToken::Array(Vec::new()),
            ParamType::FixedBytes(size) => AbiToken::FixedBytes(vec![0; *size]),
            _ => AbiToken::Uint(0.into()),
        }
    }
}
