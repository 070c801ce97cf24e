//! Block headers, receipts and logs of the embedded chain, their encoding and seal.
//!
//! The header has the fields and the RLP of Ethereum's before London, and its hash is the Keccak-256 of that. Its three
//! roots are those of Merkle-Patricia tries, like Ethereum's.

use ethers::abi::ethereum_types::BloomInput;
use ethers::types::{Bloom, U256};
use ethers::utils::keccak256;
use ethers::utils::rlp::{Decodable, DecoderError, Encodable, Rlp, RlpStream};
use k256::ecdsa::{RecoveryId, Signature, SigningKey};

use super::admission::BLOCK_GAS;
use super::transaction::recover;
use super::trie::EMPTY_ROOT;
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
