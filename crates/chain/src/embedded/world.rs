//! The world state: tries whose nodes are read on demand.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::rc::Rc;
use std::sync::Arc;

use ethers::types::U256;
use ethers::utils::keccak256;
use ethers::utils::rlp::{Rlp, RlpStream};
use revm::DatabaseRef;
use revm::database_interface::DBErrorMarker;
use revm::primitives::{Address as EvmAddress, B256, Bytes, KECCAK_EMPTY, U256 as Word};
use revm::state::{Account, AccountInfo, Bytecode, EvmState};
use rusqlite::{Connection, OptionalExtension, Transaction, params};

use super::file::{ChainFile, integer};
use super::trie::{EMPTY_ROOT, Nodes, Trie, below, prove};
use crate::ChainError;
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

// The nodes of the state in the chain's file: each under its hash, with the number of places where it occurs in the
// newest state or in one that is still kept. A block's nodes are written and old ones removed in the block's own
// SQLite transaction.

/// The number of newest blocks whose state is kept.
pub const KEPT: u64 = 128;
/// The most nodes of deleted storage tries removed with one block.
const FELLED_AT_ONCE: u32 = 512;
/// Half of the memory for read and written nodes, bytes. Every block makes some KiB of new ones, so a running site
/// grows by them until both halves are full: much more than the nodes that blocks need again would only look like a
/// leak.
const HALF: usize = 4 * 1024 * 1024;
const HASH: usize = 32;

/// The nodes used last, in two halves: when the newer is full it becomes the older one, and the older one is dropped.
#[derive(Default)]
pub struct Cache {
    halves: RefCell<Halves>,
}

#[derive(Default)]
struct Halves {
    newer: HashMap<Hash, Arc<[u8]>>,
    older: HashMap<Hash, Arc<[u8]>>,
    bytes: usize,
}

impl Cache {
    fn get(&self, hash: Hash) -> Option<Arc<[u8]>> {
        let mut halves = self.halves.borrow_mut();
        if let Some(found) = halves.newer.get(&hash) {
            return Some(Arc::clone(found));
        }
        let found = halves.older.remove(&hash)?;
        halves.keep(hash, Arc::clone(&found));
        Some(found)
    }

    fn put(&self, hash: Hash, node: Arc<[u8]>) {
        self.halves.borrow_mut().keep(hash, node);
    }
}

impl Halves {
    fn keep(&mut self, hash: Hash, node: Arc<[u8]>) {
        let length = HASH + node.len();
        if self.newer.insert(hash, node).is_some() {
            return;
        }
        self.bytes += length;
        if self.bytes > HALF {
            self.bytes = 0;
            self.older = std::mem::take(&mut self.newer);
        }
    }
}

impl Nodes for ChainFile {
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError> {
        if let Some(node) = self.cache.get(hash) {
            return Ok(node);
        }
        let Some(body) = self.read_node(hash)? else {
            return Err(self.wrong(hash, "is gone"));
        };
        let node: Arc<[u8]> = body.into();
        self.cache.put(hash, Arc::clone(&node));
        Ok(node)
    }

    fn malformed(&self, hash: Hash) -> ChainError {
        self.wrong(hash, "is no node")
    }
}

impl Ground for ChainFile {
    fn block_hash(&self, number: u64) -> Result<Hash, ChainError> {
        Ok(self.block(number)?.map_or(Hash([0; HASH]), |(hash, _)| hash))
    }
}

impl ChainFile {
    fn wrong(&self, hash: Hash, what: &str) -> ChainError {
        self.tampered(self.newest_number().unwrap_or(0), &format!("the state's node {hash} {what}"))
    }

    fn read_node(&self, hash: Hash) -> Result<Option<Vec<u8>>, ChainError> {
        let query = "SELECT body FROM node WHERE hash = ?1";
        let found: Option<Vec<u8>> = self.one(query, params![hash.0], |row| row.get(0))?;
        if found.as_ref().is_some_and(|body| keccak256(body) != hash.0) {
            return Err(self.wrong(hash, "is not what it was"));
        }
        Ok(found)
    }

    /// Looks at a node as stored in the file, ignoring the cache.
    ///
    /// # Errors
    /// [`ChainError::Tampered`] if it was altered, or is missing and must not be.
    pub fn look_at(&self, hash: Hash, may_be_gone: bool) -> Result<(), ChainError> {
        match self.read_node(hash)? {
            None if !may_be_gone => Err(self.wrong(hash, "is gone")),
            _ => Ok(()),
        }
    }

    /// Caches the nodes of a block that is on disk, because they are likely to be read next.
    pub fn remember(&self, made: Vec<(Hash, Vec<u8>)>) {
        made.into_iter().for_each(|(hash, node)| self.cache.put(hash, node.into()));
    }

    /// Every node of the state that the file holds.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn all_nodes(&self) -> Result<Vec<Vec<u8>>, ChainError> {
        self.all("SELECT body FROM node ORDER BY hash", [], |row| row.get(0))
    }
}

/// Writes the state changes of block `number`, and removes what no kept state holds any more.
pub fn write(transaction: &Transaction<'_>, number: u64, written: &Written) -> rusqlite::Result<()> {
    add(transaction, &written.made)?;
    let joined = |hashes: &[Hash]| hashes.iter().flat_map(|hash| hash.0).collect::<Vec<u8>>();
    if !(written.left.is_empty() && written.felled.is_empty()) {
        let values = params![integer(number), joined(&written.left), joined(&written.felled)];
        transaction.prepare_cached("INSERT INTO retired VALUES (?1, ?2, ?3)")?.execute(values)?;
    }
    if let Some(due) = number.checked_sub(KEPT) {
        retire(transaction, due)?;
    }
    clear_felled(transaction)
}

/// Adds nodes, counting each place.
pub fn add(transaction: &Connection, made: &[(Hash, Vec<u8>)]) -> rusqlite::Result<()> {
    let mut insert = transaction
        .prepare_cached("INSERT INTO node VALUES (?1, ?2, 1) ON CONFLICT (hash) DO UPDATE SET places = places + 1")?;
    made.iter().try_for_each(|(hash, body)| insert.execute(params![hash.0, body]).map(drop))
}

/// Removes what the blocks up to `due` left behind.
fn retire(transaction: &Transaction<'_>, due: u64) -> rusqlite::Result<()> {
    let mut select = transaction.prepare_cached("SELECT block, nodes, felled FROM retired WHERE block <= ?1")?;
    let rows = select.query_map([integer(due)], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
    let rows: Vec<(i64, Vec<u8>, Vec<u8>)> = rows.collect::<rusqlite::Result<_>>()?;
    for (block, nodes, felled) in rows {
        nodes.chunks(HASH).try_for_each(|hash| take_out(transaction, hash))?;
        felled.chunks(HASH).try_for_each(|hash| doom(transaction, hash))?;
        transaction.prepare_cached("DELETE FROM retired WHERE block = ?1")?.execute([block])?;
    }
    Ok(())
}

fn doom(transaction: &Transaction<'_>, hash: &[u8]) -> rusqlite::Result<()> {
    transaction.prepare_cached("INSERT INTO doomed (hash) VALUES (?1)")?.execute([hash]).map(drop)
}

fn take_out(transaction: &Transaction<'_>, hash: &[u8]) -> rusqlite::Result<()> {
    transaction.prepare_cached("UPDATE node SET places = places - 1 WHERE hash = ?1")?.execute([hash])?;
    transaction.prepare_cached("DELETE FROM node WHERE hash = ?1 AND places <= 0")?.execute([hash]).map(drop)
}

/// Removes some of the nodes of deleted storage tries, from their roots down.
fn clear_felled(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    let mut select = transaction.prepare_cached("SELECT id, hash FROM doomed ORDER BY id LIMIT ?1")?;
    let rows = select.query_map([FELLED_AT_ONCE], |row| Ok((row.get(0)?, row.get(1)?)))?;
    let rows: Vec<(i64, Vec<u8>)> = rows.collect::<rusqlite::Result<_>>()?;
    for (id, hash) in rows {
        let mut read = transaction.prepare_cached("SELECT body FROM node WHERE hash = ?1")?;
        let body: Option<Vec<u8>> = read.query_row([&hash], |row| row.get(0)).optional()?;
        let children = body.and_then(|body| below(&body)).unwrap_or_default();
        children.iter().try_for_each(|child| doom(transaction, &child.0))?;
        take_out(transaction, &hash)?;
        transaction.prepare_cached("DELETE FROM doomed WHERE id = ?1")?.execute([id])?;
    }
    Ok(())
}
