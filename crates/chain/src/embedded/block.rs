//! Block headers, receipts and logs of the embedded chain, their encoding and seal.
//!
//! The header has the fields and the RLP of Ethereum's before London, and its hash is the Keccak-256 of that. Its three
//! roots are those of Merkle-Patricia tries, like Ethereum's.

use ethers::abi::ethereum_types::BloomInput;
use ethers::types::{Bloom, U256};
use ethers::utils::keccak256;
use ethers::utils::rlp::{Decodable, DecoderError, Encodable, Rlp, RlpStream};
use k256::ecdsa::{RecoveryId, Signature, SigningKey, VerifyingKey};
use serde_json::{Value, json};

use super::pool::BLOCK_GAS;
use super::trie::EMPTY_ROOT;
use super::world::{Proof, Record};
use crate::model::bytes::{hex, unhex};
use crate::model::party::AddressError;
use crate::model::{Address, Hash};

/// Length of what precedes the seal in the extra data (Clique's vanity), bytes.
const VANITY: usize = 32;
/// The vanity of every block after the first, under proof of authority.
const MARK: [u8; VANITY] = *b"AuthROS chain file version 1\0\0\0\0";
/// Length of the seal, bytes: r, s, parity.
const SEAL: usize = 65;
/// Keccak-256 of the RLP of an empty list: there are no uncles.
const NO_UNCLES: [u8; 32] = [
    0x1d, 0xcc, 0x4d, 0xe8, 0xde, 0xc7, 0x5d, 0x7a, 0xab, 0x85, 0xb5, 0x67, 0xb6, 0xcc, 0xd4, 0x1a, 0xd3, 0x12, 0x45,
    0x1b, 0x94, 0x8a, 0x74, 0x13, 0xf0, 0xa1, 0x42, 0xfd, 0x40, 0xd4, 0x93, 0x47,
];

/// A block header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Hash of the parent.
    pub parent: Hash,
    /// Root of the state after the block.
    pub state_root: Hash,
    /// Root of the transactions.
    pub transactions_root: Hash,
    /// Root of the receipts.
    pub receipts_root: Hash,
    /// Bloom filter of the addresses and topics of the logs.
    pub bloom: Bloom,
    /// The recipient of the fees under proof of work; zero under proof of authority, as in Clique.
    pub beneficiary: Address,
    /// Proof of authority: 1 for the genesis block, 2 for one sealed in turn, 1 out of turn. Otherwise the work.
    pub difficulty: u64,
    /// Block number.
    pub number: u64,
    /// The most gas of its transactions.
    pub gas_limit: u64,
    /// Gas used by all transactions.
    pub gas_used: u64,
    /// Seconds since 1970, never less than the parent's.
    pub timestamp: u64,
    /// Vanity; under proof of authority also the signers (in the genesis block) and the seal.
    pub extra: Vec<u8>,
    /// The nonce found by the work; 0 under proof of authority.
    pub nonce: u64,
}

impl Header {
    /// The first header of a chain, before its seal: `unique` makes it unlike any other. Without `signers` it is for
    /// proof of work with this `beneficiary`.
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
            bloom: Bloom::zero(),
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

    /// The RLP encoding, with the given extra data, with or without mix hash and nonce.
    fn encode_with(&self, extra: &[u8], with_nonce: bool) -> Vec<u8> {
        let mut list = RlpStream::new_list(if with_nonce { 15 } else { 13 });
        list.append(&&self.parent.0[..]).append(&&NO_UNCLES[..]).append(&&self.beneficiary.0[..]);
        list.append(&&self.state_root.0[..]).append(&&self.transactions_root.0[..]);
        list.append(&&self.receipts_root.0[..]).append(&self.bloom).append(&self.difficulty);
        list.append(&self.number).append(&self.gas_limit).append(&self.gas_used).append(&self.timestamp);
        list.append(&extra);
        if with_nonce {
            list.append(&&[0u8; 32][..]).append(&&self.nonce.to_be_bytes()[..]);
        }
        list.out().to_vec()
    }

    /// The RLP encoding, seal included.
    pub fn encode(&self) -> Vec<u8> {
        self.encode_with(&self.extra, true)
    }

    /// From the RLP encoding.
    ///
    /// # Errors
    /// [`DecoderError`] if it is not exactly one header of this chain's kind.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecoderError> {
        let list = Rlp::new(bytes);
        let header = Self {
            parent: hash_at(&list, 0)?,
            state_root: hash_at(&list, 3)?,
            transactions_root: hash_at(&list, 4)?,
            receipts_root: hash_at(&list, 5)?,
            beneficiary: address_at(&list, 2)?.ok_or(DecoderError::RlpInvalidLength)?,
            bloom: list.val_at(6)?,
            difficulty: list.val_at(7)?,
            number: list.val_at(8)?,
            gas_limit: list.val_at(9)?,
            gas_used: list.val_at(10)?,
            timestamp: list.val_at(11)?,
            extra: list.val_at(12)?,
            nonce: u64::from_be_bytes(list.at(14)?.data()?.try_into().map_err(|_| DecoderError::RlpInvalidLength)?),
        };
        if header.extra.len() < VANITY || header.encode() != bytes {
            return Err(DecoderError::Custom("not a canonical header"));
        }
        Ok(header)
    }

    /// The block hash.
    pub fn hash(&self) -> Hash {
        Hash(keccak256(self.encode()))
    }

    /// The hash the work is done over: the Keccak-256 of everything but mix hash and nonce, as ethash's seal hash.
    pub fn work_hash(&self) -> Hash {
        Hash(keccak256(self.encode_with(&self.extra, false)))
    }

    /// The hash a signer signs: the Keccak-256 of everything but the seal, as Clique's seal hash.
    fn seal_hash(&self) -> Option<[u8; 32]> {
        let unsealed = self.extra.len().checked_sub(SEAL)?;
        Some(keccak256(self.encode_with(&self.extra[..unsealed], true)))
    }

    /// Puts the signer's seal into the extra data.
    pub fn seal(&mut self, signer: &SigningKey) -> Option<()> {
        let (signature, parity) = signer.sign_prehash_recoverable(&self.seal_hash()?).ok()?;
        let at = self.extra.len() - SEAL;
        self.extra[at..at + 64].copy_from_slice(&signature.to_bytes());
        self.extra[at + 64] = parity.to_byte();
        Some(())
    }

    /// The signer that sealed the block, under proof of authority.
    pub fn sealer(&self) -> Option<Address> {
        let seal_hash = self.seal_hash()?;
        let (scalars, parity) = self.extra[self.extra.len() - SEAL..].split_at(64);
        recover(&seal_hash, &Signature::from_slice(scalars).ok()?, RecoveryId::from_byte(parity[0])?)
    }
}

/// Extra data of a proof-of-authority block before it is sealed.
pub fn unsealed_extra() -> Vec<u8> {
    [&MARK[..], &[0; SEAL]].concat()
}

/// One log of a transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Log {
    /// The contract that wrote it.
    pub address: Address,
    /// Indexed words.
    pub topics: Vec<Hash>,
    /// The rest, ABI-encoded.
    pub data: Vec<u8>,
}

/// The result of a transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    /// Whether it took effect.
    pub success: bool,
    /// Gas it used.
    pub gas_used: u64,
    /// Gas used by it and all before it in its block.
    pub cumulative_gas: u64,
    /// The contract it created.
    pub contract: Option<Address>,
    /// Revert data if it failed, otherwise empty.
    pub output: Vec<u8>,
    /// Its logs.
    pub logs: Vec<Log>,
}

impl Receipt {
    /// Adds addresses and topics of the logs to `bloom`.
    pub fn accrue(&self, bloom: &mut Bloom) {
        for log in &self.logs {
            bloom.accrue(BloomInput::Raw(log.address.as_bytes()));
            for topic in &log.topics {
                bloom.accrue(BloomInput::Raw(&topic.0));
            }
        }
    }
}

impl Encodable for Log {
    fn rlp_append(&self, stream: &mut RlpStream) {
        stream.begin_list(3).append(&&self.address.0[..]);
        stream.begin_list(self.topics.len());
        for topic in &self.topics {
            stream.append(&&topic.0[..]);
        }
        stream.append(&self.data);
    }
}

impl Decodable for Log {
    fn decode(rlp: &Rlp<'_>) -> Result<Self, DecoderError> {
        let topics = rlp.at(1)?;
        Ok(Self {
            address: address_at(rlp, 0)?.ok_or(DecoderError::RlpInvalidLength)?,
            topics: (0..topics.item_count()?).map(|index| hash_at(&topics, index)).collect::<Result<_, _>>()?,
            data: rlp.val_at(2)?,
        })
    }
}

impl Encodable for Receipt {
    fn rlp_append(&self, stream: &mut RlpStream) {
        stream.begin_list(6).append(&self.success).append(&self.gas_used).append(&self.cumulative_gas);
        stream.append(&self.contract.as_ref().map_or(&[][..], Address::as_bytes));
        stream.append(&self.output).append_list(&self.logs);
    }
}

impl Decodable for Receipt {
    fn decode(rlp: &Rlp<'_>) -> Result<Self, DecoderError> {
        Ok(Self {
            success: rlp.val_at(0)?,
            gas_used: rlp.val_at(1)?,
            cumulative_gas: rlp.val_at(2)?,
            contract: address_at(rlp, 3)?,
            output: rlp.val_at(4)?,
            logs: rlp.list_at(5)?,
        })
    }
}

fn hash_at(list: &Rlp<'_>, index: usize) -> Result<Hash, DecoderError> {
    Hash::from_slice(list.at(index)?.data()?).ok_or(DecoderError::RlpInvalidLength)
}

fn address_at(list: &Rlp<'_>, index: usize) -> Result<Option<Address>, DecoderError> {
    match list.at(index)?.data()? {
        [] => Ok(None),
        bytes => Address::from_slice(bytes).map(Some).ok_or(DecoderError::RlpInvalidLength),
    }
}

/// The address of the contract that `sender` creates with `nonce`.
pub fn created_address(sender: Address, nonce: u64) -> Address {
    let mut list = RlpStream::new_list(2);
    list.append(&&sender.0[..]).append(&U256::from(nonce));
    let hash = keccak256(list.out());
    let mut address = [0; 20];
    address.copy_from_slice(&hash[12..]);
    Address(address)
}

// A legacy (EIP-155) transaction: decoded from its raw bytes, with its sender recovered.
//
// Refusals are worded as in geth, so that one table of messages fits every node.

/// The largest raw transaction accepted, bytes, as in geth.
pub const LARGEST: usize = 128 * 1024;

/// One signed transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transaction {
    /// Keccak-256 of the raw bytes.
    pub hash: Hash,
    /// Who signed it.
    pub sender: Address,
    /// Its nonce.
    pub nonce: u64,
    /// Wei per gas.
    pub gas_price: u128,
    /// The most gas it may use.
    pub gas_limit: u64,
    /// The account it calls; `None` creates a contract.
    pub to: Option<Address>,
    /// Wei to send.
    pub value: U256,
    /// Call data or creation code.
    pub input: Vec<u8>,
    /// Recovery value with the chain id (EIP-155).
    pub v: u64,
    /// First half of the signature.
    pub r: U256,
    /// Second half of the signature.
    pub s: U256,
    /// Its raw bytes.
    pub raw: Vec<u8>,
}

impl Transaction {
    /// Decodes `raw` and recovers its sender.
    ///
    /// # Errors
    /// What is wrong, in geth's words.
    pub fn decode(raw: &[u8], chain_id: u64) -> Result<Self, String> {
        if raw.len() > LARGEST {
            return Err(format!("oversized data: transaction size {}, limit {LARGEST}", raw.len()));
        }
        if raw.first().is_some_and(|first| *first < 0xc0) {
            return Err("transaction type not supported".into());
        }
        let mut transaction = Self::fields(raw).map_err(|error| format!("rlp: {error}"))?;
        transaction.check_chain(chain_id)?;
        transaction.sender =
            transaction.recover(chain_id).ok_or("invalid sender: invalid transaction v, r, s values")?;
        Ok(transaction)
    }

    fn fields(raw: &[u8]) -> Result<Self, DecoderError> {
        let list = Rlp::new(raw);
        if list.payload_info()?.total() != raw.len() || list.item_count()? != 9 {
            return Err(DecoderError::RlpIncorrectListLen);
        }
        let to: Vec<u8> = list.val_at(3)?;
        let price: U256 = list.val_at(1)?;
        Ok(Self {
            hash: Hash(keccak256(raw)),
            sender: Address([0; 20]),
            nonce: list.val_at(0)?,
            gas_price: u128::try_from(price).map_err(|_| DecoderError::RlpIsTooBig)?,
            gas_limit: list.val_at(2)?,
            to: if to.is_empty() {
                None
            } else {
                Some(Address::from_slice(&to).ok_or(DecoderError::RlpInvalidLength)?)
            },
            value: list.val_at(4)?,
            input: list.val_at(5)?,
            v: list.val_at(6)?,
            r: list.val_at(7)?,
            s: list.val_at(8)?,
            raw: raw.to_vec(),
        })
    }

    fn check_chain(&self, chain_id: u64) -> Result<(), String> {
        if self.v < 35 {
            return Err("only replay-protected (EIP-155) transactions allowed over RPC".into());
        }
        let have = (self.v - 35) / 2;
        if have == chain_id {
            Ok(())
        } else {
            Err(format!("invalid sender: invalid chain id for signer: have {have} want {chain_id}"))
        }
    }

    fn recover(&self, chain_id: u64) -> Option<Address> {
        let parity = u8::try_from((self.v - 35) % 2).ok()?;
        let mut scalars = [0; 64];
        self.r.to_big_endian(&mut scalars[..32]);
        self.s.to_big_endian(&mut scalars[32..]);
        let signature = Signature::from_slice(&scalars).ok()?;
        if signature.normalize_s().is_some() {
            return None;
        }
        recover(&self.signing_hash(chain_id), &signature, RecoveryId::from_byte(parity)?)
    }

    fn signing_hash(&self, chain_id: u64) -> [u8; 32] {
        let mut list = RlpStream::new_list(9);
        list.append(&self.nonce).append(&self.gas_price).append(&self.gas_limit);
        list.append(&self.to.as_ref().map_or(&[][..], Address::as_bytes));
        list.append(&self.value).append(&self.input).append(&chain_id).append(&0u8).append(&0u8);
        keccak256(list.out())
    }

    /// Gas charged before the first instruction (Istanbul, EIP-2028).
    pub fn intrinsic_gas(&self) -> u64 {
        let data: u64 = self.input.iter().map(|byte| if *byte == 0 { 4 } else { 16 }).sum();
        data + if self.to.is_some() { 21_000 } else { 53_000 }
    }

    /// The most that it can cost its sender, wei.
    pub fn cost(&self) -> U256 {
        U256::from(self.gas_price).saturating_mul(self.gas_limit.into()).saturating_add(self.value)
    }
}

/// The address whose key signed `hash`.
pub fn recover(hash: &[u8; 32], signature: &Signature, parity: RecoveryId) -> Option<Address> {
    let key = VerifyingKey::recover_from_prehash(hash, signature, parity).ok()?;
    let point = key.to_encoded_point(false);
    point.as_bytes().get(1..)?.try_into().ok().map(Address::from_public_key)
}

// The JSON shapes of blocks, transactions, receipts and logs, and the parsing of parameters.

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

#[cfg(test)]
mod tests {
    use super::*;
    use ethers::utils::rlp;
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

    #[test]
    fn contract_addresses_are_ethereums() {
        let sender: Address = "0x6ac7ea33f8831ea9dcc53393aaa88b25a785dbf0".parse().expect("address");
        let created = created_address(sender, 0).to_string().to_lowercase();
        assert_eq!(created, "0xcd234a471b72ba2f1ccf0a70fcaba648a5eecd8d");
    }

    proptest! {
        #[test]
        fn receipts_round_trip(success: bool, gas: u64, output: Vec<u8>, data: Vec<u8>, topics in 0usize..5, created: bool) {
            let log = Log { address: Address([1; 20]), topics: vec![Hash([2; 32]); topics], data };
            let contract = created.then_some(Address([4; 20]));
            let receipt = Receipt { success, gas_used: gas, cumulative_gas: gas, contract, output, logs: vec![log; 2] };
            prop_assert_eq!(rlp::decode::<Receipt>(&rlp::encode(&receipt)), Ok(receipt));
        }

        #[test]
        fn noise_never_panics(noise: Vec<u8>) {
            let _ = rlp::decode::<Receipt>(&noise);
            let _ = Header::decode(&noise);
        }
    }
}

#[cfg(test)]
mod transaction_tests {
    use super::*;
    use ethers::types::{TransactionRequest, transaction::eip2718::TypedTransaction};
    use ethers_signers::{LocalWallet, Signer};
    use proptest::prelude::*;

    fn signed(chain_id: u64) -> (Vec<u8>, Address) {
        let wallet = LocalWallet::from_bytes(&[7; 32]).expect("key");
        let request = TransactionRequest::new().to(ethers::types::H160([1; 20])).nonce(3).gas(50_000).gas_price(0);
        let request: TypedTransaction = request.data(vec![1, 0, 2]).chain_id(chain_id).into();
        let signature = wallet.sign_transaction_sync(&request).expect("signs");
        (request.rlp_signed(&signature).to_vec(), Address(wallet.address().0))
    }

    #[test]
    fn decodes_what_ethers_signs() {
        let (raw, sender) = signed(77);
        let transaction = Transaction::decode(&raw, 77).expect("decodes");
        assert_eq!((transaction.sender, transaction.nonce, transaction.gas_limit), (sender, 3, 50_000));
        assert_eq!(transaction.to, Some(Address([1; 20])));
        assert_eq!(transaction.intrinsic_gas(), 21_000 + 36);
        assert!(Transaction::decode(&raw, 78).expect_err("chain").contains("chain id"));
        assert!(Transaction::decode(&vec![0xf9; LARGEST + 1], 77).expect_err("size").contains("oversized"));
        assert!(Transaction::decode(&[2, 0xc0], 77).expect_err("type").contains("not supported"));
        assert!(Transaction::decode(&[raw, vec![0]].concat(), 77).is_err());
    }

    proptest! {
        #[test]
        fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = Transaction::decode(&noise, 77);
        }

        #[test]
        fn a_flipped_bit_never_keeps_sender_and_hash(at in 0usize..112, bit in 0u8..8) {
            let (mut raw, sender) = signed(77);
            let hash = Transaction::decode(&raw, 77).expect("decodes").hash;
            let at = at % raw.len();
            raw[at] ^= 1 << bit;
            if let Ok(changed) = Transaction::decode(&raw, 77) {
                prop_assert!(changed.sender != sender && changed.hash != hash);
            }
        }
    }
}
