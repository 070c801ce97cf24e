//! The world state: tries whose nodes are read on demand.

use std::collections::BTreeMap;
use std::rc::Rc;

use ethers::types::U256;
use ethers::utils::keccak256;
use ethers::utils::rlp::{Rlp, RlpStream};
use revm::DatabaseRef;
use revm::database_interface::DBErrorMarker;
use revm::primitives::{Address as EvmAddress, B256, Bytes, KECCAK_EMPTY, U256 as Word};
use revm::state::{Account, AccountInfo, Bytecode, EvmState};

use super::trie::{EMPTY_ROOT, Nodes, Trie, prove};
use crate::chain::ChainError;
use crate::model::{Address, Hash};

/// The store of the tries' nodes, the contracts' code and the block hashes.
pub trait Ground: Nodes {
    /// The hash of a block, for the BLOCKHASH instruction.
    ///
    /// # Errors
    /// [`ChainError`] if it cannot be read.
    fn block_hash(&self, number: u64) -> Result<Hash, ChainError>;
}

/// What could not be read; revm needs its own error type.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Unread(pub ChainError);

impl DBErrorMarker for Unread {}

/// The state under one root.
#[derive(Clone)]
pub struct Tries {
    /// The store of its nodes.
    pub ground: Rc<dyn Ground>,
    /// Its root.
    pub root: Hash,
}

/// An account as stored in the trie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Record {
    /// Its next nonce.
    pub nonce: u64,
    /// Wei.
    pub balance: U256,
    /// Root of its storage.
    pub storage: Hash,
    /// Keccak-256 of its code.
    pub code: Hash,
}

/// The nodes a block created in the tries and left behind.
#[derive(Debug, Default)]
pub struct Written {
    /// New nodes and code; one at several places is listed several times.
    pub made: Vec<(Hash, Vec<u8>)>,
    /// Nodes with one place fewer.
    pub left: Vec<Hash>,
    /// Roots of storage tries that were deleted as a whole.
    pub felled: Vec<Hash>,
}

/// A slot, its value, and the nodes on the way to it.
pub type SlotProof = (U256, U256, Vec<std::sync::Arc<[u8]>>);

/// The proof of an account (EIP-1186).
pub struct Proof {
    /// The account, if it exists.
    pub record: Option<Record>,
    /// The nodes on the way to it.
    pub way: Vec<std::sync::Arc<[u8]>>,
    /// Each requested slot: its value and the nodes on the way to it.
    pub slots: Vec<SlotProof>,
}

/// What remains of an account after a block.
#[derive(Default)]
struct Change {
    /// Its former storage is deleted.
    wiped: bool,
    info: AccountInfo,
    slots: BTreeMap<Word, Word>,
}

impl Record {
    fn encode(&self) -> Vec<u8> {
        let mut list = RlpStream::new_list(4);
        list.append(&self.nonce).append(&self.balance).append(&&self.storage.0[..]).append(&&self.code.0[..]);
        list.out().to_vec()
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        let list = Rlp::new(bytes);
        let hash = |at: usize| list.at(at).ok()?.data().ok().and_then(Hash::from_slice);
        Some(Self { nonce: list.val_at(0).ok()?, balance: list.val_at(1).ok()?, storage: hash(2)?, code: hash(3)? })
    }
}

impl Tries {
    /// An account.
    ///
    /// # Errors
    /// [`ChainError`] if a node was altered.
    pub fn record(&self, address: [u8; 20]) -> Result<Option<Record>, ChainError> {
        let found = Trie::new(&*self.ground, self.root).get(&keccak256(address))?;
        found.map(|bytes| self.read(&bytes)).transpose()
    }

    fn read(&self, bytes: &[u8]) -> Result<Record, ChainError> {
        Record::decode(bytes).ok_or_else(|| self.ground.malformed(self.root))
    }

    /// A storage slot of an account.
    ///
    /// # Errors
    /// [`ChainError`] if a node was altered.
    pub fn slot(&self, address: [u8; 20], slot: [u8; 32]) -> Result<U256, ChainError> {
        let Some(record) = self.record(address)? else { return Ok(U256::zero()) };
        let found = Trie::new(&*self.ground, record.storage).get(&keccak256(slot))?;
        found.map_or(Ok(U256::zero()), |bytes| self.number(record.storage, &bytes))
    }

    fn number(&self, root: Hash, bytes: &[u8]) -> Result<U256, ChainError> {
        Rlp::new(bytes).as_val().map_err(|_| self.ground.malformed(root))
    }

    /// The proof of an account and some of its slots.
    ///
    /// # Errors
    /// [`ChainError`] if a node was altered.
    pub fn proof(&self, address: Address, slots: &[U256]) -> Result<Proof, ChainError> {
        let (found, way) = prove(&*self.ground, self.root, &keccak256(address.0))?;
        let record = found.map(|bytes| self.read(&bytes)).transpose()?;
        let storage = record.map_or(EMPTY_ROOT, |record| record.storage);
        let mut proven = Vec::with_capacity(slots.len());
        for slot in slots {
            let mut key = [0; 32];
            slot.to_big_endian(&mut key);
            let (value, way) = prove(&*self.ground, storage, &keccak256(key))?;
            let value = value.map_or(Ok(U256::zero()), |bytes| self.number(storage, &bytes))?;
            proven.push((*slot, value, way));
        }
        Ok(Proof { record, way, slots: proven })
    }

    /// The root after a block's changes, and their effect on the nodes. Nothing is written.
    ///
    /// # Errors
    /// [`ChainError`] if a node was altered.
    pub fn after<'c>(&self, changes: impl IntoIterator<Item = &'c EvmState>) -> Result<(Hash, Written), ChainError> {
        let mut folded: BTreeMap<[u8; 32], Change> = BTreeMap::new();
        let mut written = Written::default();
        for (address, account) in changes.into_iter().flatten().filter(|(_, account)| account.is_touched()) {
            let change = folded.entry(keccak256(address)).or_default();
            fold(change, account, &mut written.made);
        }
        let mut accounts = Trie::new(&*self.ground, self.root);
        for (key, change) in folded {
            self.change(&mut accounts, &key, change, &mut written)?;
        }
        let (root, turnover) = accounts.finish();
        written.made.extend(turnover.made);
        written.left.extend(turnover.left);
        Ok((root, written))
    }

    fn change(
        &self,
        accounts: &mut Trie<'_, dyn Ground>,
        key: &[u8; 32],
        change: Change,
        written: &mut Written,
    ) -> Result<(), ChainError> {
        let before = accounts.get(key)?.map(|bytes| self.read(&bytes)).transpose()?;
        let mut storage = before.map_or(EMPTY_ROOT, |record| record.storage);
        let gone = change.info.is_empty();
        if (change.wiped || gone) && storage != EMPTY_ROOT {
            written.felled.push(storage);
            storage = EMPTY_ROOT;
        }
        if gone {
            return accounts.set(key, None);
        }
        let mut slots = Trie::new(&*self.ground, storage);
        for (slot, value) in change.slots {
            let value = U256::from_big_endian(&value.to_be_bytes::<32>());
            let value = (!value.is_zero()).then(|| ethers::utils::rlp::encode(&value).to_vec());
            slots.set(&keccak256(slot.to_be_bytes::<32>()), value)?;
        }
        let (storage, turnover) = slots.finish();
        written.made.extend(turnover.made);
        written.left.extend(turnover.left);
        let AccountInfo { nonce, balance, code_hash, .. } = change.info;
        let balance = U256::from_big_endian(&balance.to_be_bytes::<32>());
        accounts.set(key, Some(Record { nonce, balance, storage, code: Hash(code_hash.0) }.encode()))
    }
}

/// Adds one transaction's changes to an account.
fn fold(change: &mut Change, account: &Account, made: &mut Vec<(Hash, Vec<u8>)>) {
    if account.is_selfdestructed() {
        *change = Change { wiped: true, ..Change::default() };
        return;
    }
    if account.is_created() {
        *change = Change { wiped: true, ..Change::default() };
        if let Some(code) = account.info.code.as_ref().filter(|code| !code.is_empty()) {
            made.push((Hash(account.info.code_hash.0), code.original_byte_slice().to_vec()));
        }
    }
    change.info = account.info.clone();
    change.slots.extend(account.changed_storage_slots().map(|(slot, value)| (*slot, value.present_value())));
}

impl DatabaseRef for Tries {
    type Error = Unread;

    fn basic_ref(&self, address: EvmAddress) -> Result<Option<AccountInfo>, Unread> {
        let record = self.record(address.into_array()).map_err(Unread)?;
        Ok(record.map(|record| AccountInfo {
            balance: Word::from_limbs(record.balance.0),
            nonce: record.nonce,
            code_hash: B256::from(record.code.0),
            code: None,
            ..AccountInfo::default()
        }))
    }

    fn code_by_hash_ref(&self, hash: B256) -> Result<Bytecode, Unread> {
        if hash == KECCAK_EMPTY || hash.is_zero() {
            return Ok(Bytecode::default());
        }
        let code = self.ground.node(Hash(hash.0)).map_err(Unread)?;
        Ok(Bytecode::new_legacy(Bytes::copy_from_slice(&code)))
    }

    fn storage_ref(&self, address: EvmAddress, slot: Word) -> Result<Word, Unread> {
        let value = self.slot(address.into_array(), slot.to_be_bytes()).map_err(Unread)?;
        Ok(Word::from_limbs(value.0))
    }

    fn block_hash_ref(&self, number: u64) -> Result<B256, Unread> {
        Ok(B256::from(self.ground.block_hash(number).map_err(Unread)?.0))
    }
}
