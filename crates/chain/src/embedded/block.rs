//! Headers and receipts of the embedded chain: RLP as in Ethereum before London, seals, and their shapes in JSON.

use std::sync::Arc;

use alloy_primitives::{B256, Bloom, Bytes, Log, Signature, U256, keccak256, logs_bloom};
use alloy_trie::TrieAccount;
use k256::ecdsa::SigningKey;
use serde_json::{Value, json};

use super::{pool::BLOCK_GAS, trie::EMPTY_ROOT, world::Proof};
use crate::model::bytes::{hex, unhex};
use crate::model::{Address, Hash};
use crate::transaction::{Items, List, Transaction, created_address, optional, signer};

/// Clique's vanity, bytes: the extra data before the seal.
const VANITY: usize = 32;
/// The vanity of every block after the first, under proof of authority.
pub const MARK: [u8; VANITY] = *b"AuthROS chain file version 1\0\0\0\0";
/// Length of the seal, bytes: r, s, parity.
pub const SEAL: usize = 65;
/// Keccak-256 of an empty RLP list.
const NO_UNCLES: [u8; 32] = [
    0x1d, 0xcc, 0x4d, 0xe8, 0xde, 0xc7, 0x5d, 0x7a, 0xab, 0x85, 0xb5, 0x67, 0xb6, 0xcc, 0xd4, 0x1a, 0xd3, 0x12, 0x45,
    0x1b, 0x94, 0x8a, 0x74, 0x13, 0xf0, 0xa1, 0x42, 0xfd, 0x40, 0xd4, 0x93, 0x47,
];

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    pub parent: Hash,
    /// After the block.
    pub state_root: Hash,
    pub transactions_root: Hash,
    pub receipts_root: Hash,
    pub bloom: Bloom,
    /// Recipient of the fees under proof of work; zero under proof of authority.
    pub beneficiary: Address,
    /// Proof of authority: 2 in turn, 1 for the genesis block. Otherwise the work.
    pub difficulty: u64,
    pub number: u64,
    pub gas_limit: u64,
    pub gas_used: u64,
    /// Seconds since 1970, never less than the parent's.
    pub timestamp: u64,
    /// Vanity; under proof of authority also the signers (in the genesis block) and the seal.
    pub extra: Vec<u8>,
    /// 0 under proof of authority.
    pub nonce: u64,
}

impl Header {
    /// Unsealed. `unique` makes the chain unlike any other; without `signers` it is for proof of work.
    pub fn genesis(signers: &[Address], beneficiary: Address, difficulty: u64, unique: Hash, timestamp: u64) -> Self {
        let mut extra = unique.0.to_vec();
        if !signers.is_empty() {
            signers.iter().for_each(|signer| extra.extend(signer.as_bytes()));
            extra.extend([0; SEAL]);
        }
        Self {
            parent: Hash([0; 32]),
            state_root: EMPTY_ROOT,
            transactions_root: EMPTY_ROOT,
            receipts_root: EMPTY_ROOT,
            bloom: Bloom::ZERO,
            beneficiary,
            difficulty,
            number: 0,
            gas_limit: BLOCK_GAS,
            gas_used: 0,
            timestamp,
            extra,
            nonce: 0,
        }
    }

    /// Fields before mix hash and nonce.
    fn fields(&self, extra: &[u8]) -> List {
        let list = List::default().add(&self.parent.0).add(&NO_UNCLES).add(&self.beneficiary.0);
        let list = list.add(&self.state_root.0).add(&self.transactions_root.0).add(&self.receipts_root.0);
        let list = list.add(&self.bloom).add(&self.difficulty).add(&self.number).add(&self.gas_limit);
        list.add(&self.gas_used).add(&self.timestamp).add(extra)
    }

    fn encode_with(&self, extra: &[u8]) -> Vec<u8> {
        self.fields(extra).add(&[0; 32]).add(&self.nonce.to_be_bytes()).end()
    }

    pub fn encode(&self) -> Vec<u8> {
        self.encode_with(&self.extra)
    }

    pub fn decode(bytes: &[u8]) -> alloy_rlp::Result<Self> {
        let mut items = Items::of(bytes)?;
        let parent = Hash(items.next()?);
        let _uncles: [u8; 32] = items.next()?;
        let header = Self {
            parent,
            beneficiary: Address(items.next()?),
            state_root: Hash(items.next()?),
            transactions_root: Hash(items.next()?),
            receipts_root: Hash(items.next()?),
            bloom: items.next()?,
            difficulty: items.next()?,
            number: items.next()?,
            gas_limit: items.next()?,
            gas_used: items.next()?,
            timestamp: items.next()?,
            extra: items.next::<Bytes>()?.to_vec(),
            nonce: items.next::<[u8; 32]>().and_then(|_| items.next()).map(u64::from_be_bytes)?,
        };
        if header.extra.len() < VANITY || header.encode() != bytes {
            return Err(alloy_rlp::Error::Custom("not a canonical header"));
        }
        Ok(header)
    }

    pub fn hash(&self) -> Hash {
        Hash(keccak256(self.encode()).0)
    }

    /// Keccak-256 of all but mix hash and nonce, like ethash's seal hash.
    pub fn work_hash(&self) -> Hash {
        Hash(keccak256(self.fields(&self.extra).end()).0)
    }

    /// Keccak-256 of all but the seal, like Clique's.
    fn seal_hash(&self) -> Option<B256> {
        let unsealed = self.extra.len().checked_sub(SEAL)?;
        Some(keccak256(self.encode_with(&self.extra[..unsealed])))
    }

    pub fn seal(&mut self, signer: &SigningKey) -> Option<()> {
        let (signature, parity) = signer.sign_prehash_recoverable(&self.seal_hash()?[..]).ok()?;
        let at = self.extra.len() - SEAL;
        self.extra[at..at + 64].copy_from_slice(&signature.to_bytes());
        self.extra[at + 64] = parity.to_byte();
        Some(())
    }

    pub fn sealer(&self) -> Option<Address> {
        let hash = self.seal_hash()?;
        let (scalars, parity) = self.extra[self.extra.len() - SEAL..].split_at(64);
        let signature = Signature::from_bytes_and_parity(scalars, parity == [1]);
        signer(&signature, hash).filter(|_| parity[0] < 2)
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    pub success: bool,
    pub gas_used: u64,
    /// Gas of its block up to and including it.
    pub cumulative_gas: u64,
    pub contract: Option<Address>,
    /// Revert data; empty on success.
    pub output: Vec<u8>,
    pub logs: Vec<Log>,
}

impl Receipt {
    /// The form in the chain's file.
    pub fn encode(&self) -> Vec<u8> {
        let list = List::default().add(&self.success).add(&self.gas_used).add(&self.cumulative_gas);
        list.add(optional(self.contract.as_ref())).add(&self.output[..]).add(&self.logs).end()
    }

    pub fn decode(bytes: &[u8]) -> alloy_rlp::Result<Self> {
        let mut items = Items::of(bytes)?;
        let (success, gas_used, cumulative_gas) = (items.next()?, items.next()?, items.next()?);
        let (contract, output, logs) = (items.address()?, items.next::<Bytes>()?.to_vec(), items.next()?);
        items.end().map(|()| Self { success, gas_used, cumulative_gas, contract, output, logs })
    }

    /// The form that Ethereum commits to since Byzantium (EIP-658).
    pub fn committed(&self) -> Vec<u8> {
        let list = List::default().add(&self.success).add(&self.cumulative_gas);
        list.add(&logs_bloom(&self.logs)).add(&self.logs).end()
    }
}

// The shapes in JSON, and the parsing of parameters.

#[derive(Clone, Copy)]
pub struct Mining {
    pub block: u64,
    pub hash: Hash,
    /// Seconds.
    pub timestamp: u64,
    pub position: u64,
}

impl Mining {
    pub fn at(header: &Header, place: usize) -> Self {
        let position = u64::try_from(place).unwrap_or(u64::MAX);
        Self { block: header.number, hash: header.hash(), timestamp: header.timestamp, position }
    }
}

/// `0x` and hex digits without leading zeros.
pub fn quantity(value: impl std::fmt::LowerHex) -> Value {
    Value::String(format!("{value:#x}"))
}

pub fn data(bytes: &[u8]) -> Value {
    Value::String(format!("0x{}", hex(bytes)))
}

pub fn read_quantity(value: &Value) -> Option<U256> {
    let digits = value.as_str()?.strip_prefix("0x")?;
    U256::from_str_radix(digits, 16).ok()
}

pub fn read_data(value: &Value) -> Option<Vec<u8>> {
    value.as_str()?.strip_prefix("0x").and_then(unhex)
}

/// In upper or lower case.
pub fn read_address(value: &Value) -> Option<Address> {
    value.as_str()?.to_lowercase().parse().ok()
}

pub fn read_hash(value: &Value) -> Option<Hash> {
    read_data(value).and_then(|bytes| Hash::from_slice(&bytes))
}

/// `transactions` are hashes or objects.
pub fn block(header: &Header, hash: Hash, size: usize, total_difficulty: u128, transactions: Vec<Value>) -> Value {
    json!({
        "number": quantity(header.number), "hash": data(&hash.0), "parentHash": data(&header.parent.0),
        "stateRoot": data(&header.state_root.0), "transactionsRoot": data(&header.transactions_root.0),
        "receiptsRoot": data(&header.receipts_root.0), "logsBloom": data(header.bloom.as_slice()),
        "difficulty": quantity(header.difficulty), "totalDifficulty": quantity(total_difficulty),
        "gasLimit": quantity(header.gas_limit), "gasUsed": quantity(header.gas_used),
        "timestamp": quantity(header.timestamp), "extraData": data(&header.extra),
        "miner": data(&header.beneficiary.0), "mixHash": data(&[0; 32]), "nonce": data(&header.nonce.to_be_bytes()),
        "sha3Uncles": data(&NO_UNCLES), "uncles": [], "size": quantity(size), "transactions": transactions,
    })
}

/// EIP-1186.
pub fn proof(address: Address, proof: &Proof) -> Value {
    let nodes = |way: &[Arc<[u8]>]| way.iter().map(|node| data(node)).collect::<Vec<_>>();
    let TrieAccount { nonce, balance, storage_root, code_hash } = proof.account;
    let slots = proof.slots.iter();
    let slots =
        slots.map(|(slot, value, way)| json!({ "key": quantity(slot), "value": quantity(value), "proof": nodes(way) }));
    json!({
        "address": data(&address.0), "balance": quantity(balance), "nonce": quantity(nonce),
        "codeHash": data(&code_hash.0), "storageHash": data(&storage_root.0),
        "accountProof": nodes(&proof.way), "storageProof": slots.collect::<Vec<_>>(),
    })
}

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

/// `first_log` is the index of its first log in the block.
pub fn receipt(one: &Transaction, receipt: &Receipt, mining: Mining, first_log: usize) -> Value {
    let contract = receipt.contract.or_else(|| one.to.is_none().then(|| created_address(one.sender, one.nonce)));
    let logs = receipt.logs.iter().enumerate();
    let mut value = json!({
        "transactionHash": data(&one.hash.0), "transactionIndex": quantity(mining.position),
        "blockHash": data(&mining.hash.0), "blockNumber": quantity(mining.block),
        "from": data(&one.sender.0), "to": one.to.map(|to| data(&to.0)),
        "contractAddress": contract.map(|contract| data(&contract.0)),
        "gasUsed": quantity(receipt.gas_used), "cumulativeGasUsed": quantity(receipt.cumulative_gas),
        "effectiveGasPrice": quantity(one.gas_price), "status": quantity(u8::from(receipt.success)), "type": "0x0",
        "logsBloom": data(logs_bloom(&receipt.logs).as_slice()),
        "logs": logs.map(|(index, one_log)| log(one_log, one.hash, mining, first_log + index)).collect::<Vec<_>>(),
    });
    if !receipt.output.is_empty() {
        value["revertReason"] = data(&receipt.output);
    }
    value
}

pub fn log(log: &Log, transaction: Hash, mining: Mining, index: usize) -> Value {
    json!({
        "address": data(log.address.as_slice()), "data": data(&log.data.data), "removed": false,
        "topics": log.topics().iter().map(|topic| data(&topic.0)).collect::<Vec<_>>(),
        "transactionHash": data(&transaction.0), "transactionIndex": quantity(mining.position),
        "blockHash": data(&mining.hash.0), "blockNumber": quantity(mining.block),
        "blockTimestamp": quantity(mining.timestamp), "logIndex": quantity(index),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key() -> SigningKey {
        SigningKey::from_slice(&[9; 32]).expect("key")
    }

    #[test]
    fn a_sealed_header_round_trips_and_names_its_sealer() {
        let signer = {
            let point = key().verifying_key().to_encoded_point(false);
            Address::from_public_key(point.as_bytes()[1..].try_into().expect("64 bytes"))
        };
        let mut header = Header::genesis(&[signer], Address([0; 20]), 1, Hash([3; 32]), 5);
        header.seal(&key()).expect("seals");
        assert_eq!(header.sealer(), Some(signer));
        let bytes = header.encode();
        assert_eq!(Header::decode(&bytes), Ok(header.clone()));
        header.timestamp += 1;
        assert_ne!(header.sealer(), Some(signer));
        let worked = Header { nonce: 7, ..Header::genesis(&[], signer, 9, Hash([3; 32]), 5) };
        assert_eq!(Header::decode(&worked.encode()), Ok(worked.clone()));
        assert_eq!(worked.sealer(), None);
        let other = Header { nonce: 8, ..worked.clone() };
        assert!(other.work_hash() == worked.work_hash() && other.hash() != worked.hash());
    }

    proptest! {
        #[test]
        fn receipts_round_trip(success: bool, gas: u64, output: Vec<u8>, data: Vec<u8>, topics in 0usize..5, created: bool) {
            let log = Log::new_unchecked([1; 20].into(), vec![[2; 32].into(); topics], data.into());
            let contract = created.then_some(Address([4; 20]));
            let receipt = Receipt { success, gas_used: gas, cumulative_gas: gas, contract, output, logs: vec![log; 2] };
            prop_assert_eq!(Receipt::decode(&receipt.encode()), Ok(receipt));
        }

        #[test]
        fn noise_never_panics(noise: Vec<u8>) {
            let _ = Receipt::decode(&noise);
            let _ = Header::decode(&noise);
        }
    }
}
