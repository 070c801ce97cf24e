//! The world state: tries whose nodes are read on demand.

use std::collections::{BTreeMap, HashMap};
use std::{cell::RefCell, rc::Rc, sync::Arc};

use alloy_primitives::{B256, Bytes, KECCAK256_EMPTY, U256, keccak256};
use alloy_rlp::{Decodable, decode_exact};
use alloy_trie::TrieAccount;
use revm::state::{Account, AccountInfo, Bytecode, EvmState};
use revm::{DatabaseRef, database_interface::DBErrorMarker};
use rusqlite::{Connection, OptionalExtension, Transaction, params};

use super::file::{ChainFile, integer};
use super::trie::{EMPTY_ROOT, Nodes, Trie, Turnover, below};
use crate::ChainError;
use crate::model::{Address, Hash};

/// revm needs its own error type.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Unread(pub ChainError);

impl DBErrorMarker for Unread {}

#[derive(Clone)]
pub struct Tries {
    pub ground: Rc<dyn Nodes>,
    pub root: Hash,
}

/// Slot, value, and the nodes on the way.
pub type SlotProof = (U256, U256, Vec<Arc<[u8]>>);

/// EIP-1186.
pub struct Proof {
    /// Empty if it does not exist.
    pub account: TrieAccount,
    pub way: Vec<Arc<[u8]>>,
    pub slots: Vec<SlotProof>,
}

#[derive(Default)]
struct Change {
    wiped: bool,
    info: AccountInfo,
    slots: BTreeMap<U256, U256>,
}

impl Tries {
    fn read<T: Decodable>(&self, root: Hash, bytes: &[u8]) -> Result<T, ChainError> {
        decode_exact(bytes).map_err(|_| self.ground.malformed(root))
    }

    pub fn account(&self, address: Address) -> Result<Option<TrieAccount>, ChainError> {
        let found = Trie::new(&*self.ground, self.root).get(&keccak256(address.0)[..])?;
        found.map(|bytes| self.read(self.root, &bytes)).transpose()
    }

    pub fn slot(&self, address: Address, slot: U256) -> Result<U256, ChainError> {
        let storage = Hash(self.account(address)?.unwrap_or_default().storage_root.0);
        let found = Trie::new(&*self.ground, storage).get(&slot_key(slot)[..])?;
        found.map_or(Ok(U256::ZERO), |bytes| self.read(storage, &bytes))
    }

    pub fn code(&self, hash: B256) -> Result<Arc<[u8]>, ChainError> {
        if hash == KECCAK256_EMPTY || hash.is_zero() { Ok(Arc::default()) } else { self.ground.node(Hash(hash.0)) }
    }

    pub fn proof(&self, address: Address, slots: &[U256]) -> Result<Proof, ChainError> {
        let (found, way) = Trie::new(&*self.ground, self.root).prove(&keccak256(address.0)[..])?;
        let account: TrieAccount = found.map(|bytes| self.read(self.root, &bytes)).transpose()?.unwrap_or_default();
        let root = Hash(account.storage_root.0);
        let storage = Trie::new(&*self.ground, root);
        let prove = |slot: &U256| {
            let (found, way) = storage.prove(&slot_key(*slot)[..])?;
            Ok((*slot, found.map_or(Ok(U256::ZERO), |bytes| self.read(root, &bytes))?, way))
        };
        Ok(Proof { account, way, slots: slots.iter().map(prove).collect::<Result<_, ChainError>>()? })
    }

    /// Root and nodes after a block's changes; nothing is written.
    pub fn after<'c>(&self, changes: impl IntoIterator<Item = &'c EvmState>) -> Result<(Hash, Turnover), ChainError> {
        let mut folded: BTreeMap<B256, Change> = BTreeMap::new();
        let mut all = Turnover::default();
        for (address, account) in changes.into_iter().flatten().filter(|(_, account)| account.is_touched()) {
            fold(folded.entry(keccak256(address)).or_default(), account, &mut all.made);
        }
        let mut accounts = Trie::new(&*self.ground, self.root);
        for (key, change) in folded {
            let value = self.changed(&accounts, &key[..], change, &mut all)?;
            accounts.set(&key[..], value)?;
        }
        let (root, turnover) = accounts.finish();
        all.add(turnover);
        Ok((root, all))
    }

    /// `None` if nothing is left of it.
    fn changed(
        &self,
        accounts: &Trie<'_, dyn Nodes>,
        key: &[u8],
        change: Change,
        all: &mut Turnover,
    ) -> Result<Option<Vec<u8>>, ChainError> {
        let before = accounts.get(key)?.map(|bytes| self.read(self.root, &bytes)).transpose()?;
        let mut storage = before.map_or(EMPTY_ROOT, |account: TrieAccount| Hash(account.storage_root.0));
        let gone = change.info.is_empty();
        if (change.wiped || gone) && storage != EMPTY_ROOT {
            all.felled.push(storage);
            storage = EMPTY_ROOT;
        }
        if gone {
            return Ok(None);
        }
        let mut slots = Trie::new(&*self.ground, storage);
        for (slot, value) in change.slots {
            slots.set(&slot_key(slot)[..], (!value.is_zero()).then(|| alloy_rlp::encode(value)))?;
        }
        let (storage, turnover) = slots.finish();
        all.add(turnover);
        let AccountInfo { nonce, balance, code_hash, .. } = change.info;
        Ok(Some(alloy_rlp::encode(TrieAccount::new(nonce, balance, storage.0.into(), code_hash))))
    }
}

fn slot_key(slot: U256) -> B256 {
    keccak256(slot.to_be_bytes::<32>())
}

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

    fn basic_ref(&self, address: alloy_primitives::Address) -> Result<Option<AccountInfo>, Unread> {
        let found = self.account(Address(address.into_array())).map_err(Unread)?;
        Ok(found.map(|TrieAccount { nonce, balance, code_hash, .. }| AccountInfo {
            balance,
            nonce,
            code_hash,
            code: None,
            ..AccountInfo::default()
        }))
    }

    fn code_by_hash_ref(&self, hash: B256) -> Result<Bytecode, Unread> {
        let code = self.code(hash).map_err(Unread)?;
        Ok(if code.is_empty() { Bytecode::default() } else { Bytecode::new_legacy(Bytes::copy_from_slice(&code)) })
    }

    fn storage_ref(&self, address: alloy_primitives::Address, slot: U256) -> Result<U256, Unread> {
        self.slot(Address(address.into_array()), slot).map_err(Unread)
    }

    fn block_hash_ref(&self, number: u64) -> Result<B256, Unread> {
        self.ground.block_hash(number).map(|hash| hash.0.into()).map_err(Unread)
    }
}

// Nodes in the file: each under its hash, with the number of its places in kept states. A block changes them in its own
// SQLite transaction.

/// Newest blocks whose state is kept.
pub const KEPT: u64 = 128;
/// Nodes of deleted storage tries that one block removes.
const FELLED_AT_ONCE: u32 = 512;
/// Half of the node cache, bytes. A block a second fills both halves within minutes; while they fill, the site grows as
/// if it leaked. What is not in them, SQLite has at hand.
const HALF: usize = 512 * 1024;
/// What a cached node takes besides its bytes: hash, pointer, counts, and free places of the map.
const BESIDE: usize = 112;
const HASH: usize = 32;

/// When the newer half is full, it replaces the older one.
#[derive(Default)]
pub struct Cache(RefCell<Halves>);

#[derive(Default)]
struct Halves {
    newer: HashMap<Hash, Arc<[u8]>>,
    older: HashMap<Hash, Arc<[u8]>>,
    bytes: usize,
}

impl Cache {
    fn get(&self, hash: Hash) -> Option<Arc<[u8]>> {
        let mut halves = self.0.borrow_mut();
        if let Some(found) = halves.newer.get(&hash) {
            return Some(Arc::clone(found));
        }
        let found = halves.older.remove(&hash)?;
        halves.keep(hash, Arc::clone(&found));
        Some(found)
    }

    fn put(&self, hash: Hash, node: Arc<[u8]>) {
        self.0.borrow_mut().keep(hash, node);
    }
}

impl Halves {
    fn keep(&mut self, hash: Hash, node: Arc<[u8]>) {
        let length = BESIDE + node.len();
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
        let node: Arc<[u8]> = self.read_node(hash)?.ok_or_else(|| self.wrong(hash, "is gone"))?.into();
        self.cache.put(hash, Arc::clone(&node));
        Ok(node)
    }

    fn malformed(&self, hash: Hash) -> ChainError {
        self.wrong(hash, "is not a trie node")
    }

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

    /// Ignores the cache.
    pub fn look_at(&self, hash: Hash, may_be_gone: bool) -> Result<(), ChainError> {
        match self.read_node(hash)? {
            None if !may_be_gone => Err(self.wrong(hash, "is gone")),
            _ => Ok(()),
        }
    }

    pub fn remember(&self, made: Vec<(Hash, Vec<u8>)>) {
        made.into_iter().for_each(|(hash, node)| self.cache.put(hash, node.into()));
    }

    pub fn all_nodes(&self) -> Result<Vec<Vec<u8>>, ChainError> {
        self.all("SELECT body FROM node ORDER BY hash", [], |row| row.get(0))
    }
}

pub fn write(transaction: &Transaction<'_>, number: u64, written: &Turnover) -> rusqlite::Result<()> {
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

pub fn add(transaction: &Connection, made: &[(Hash, Vec<u8>)]) -> rusqlite::Result<()> {
    let mut insert = transaction
        .prepare_cached("INSERT INTO node VALUES (?1, ?2, 1) ON CONFLICT (hash) DO UPDATE SET places = places + 1")?;
    made.iter().try_for_each(|(hash, body)| insert.execute(params![hash.0, body]).map(drop))
}

fn retire(transaction: &Transaction<'_>, due: u64) -> rusqlite::Result<()> {
    let mut select = transaction.prepare_cached("SELECT block, nodes, felled FROM retired WHERE block <= ?1")?;
    let rows = select.query_map([integer(due)], |row| row.try_into())?;
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

/// From their roots down.
fn clear_felled(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    let mut select = transaction.prepare_cached("SELECT id, hash FROM doomed ORDER BY id LIMIT ?1")?;
    let rows = select.query_map([FELLED_AT_ONCE], |row| row.try_into())?;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// As many nodes as a block of one anchor makes, and as long as they are on average.
    const NODES: u64 = 10;
    const LENGTH: usize = 200;

    impl Cache {
        fn held(&self) -> usize {
            let halves = self.0.borrow();
            halves.newer.values().chain(halves.older.values()).map(|node| BESIDE + node.len()).sum()
        }

        fn takes_block(&self, number: u64) {
            for node in number * NODES..(number + 1) * NODES {
                self.put(Hash(keccak256(node.to_be_bytes()).0), vec![0_u8; LENGTH].into());
            }
        }
    }

    #[test]
    fn the_node_cache_is_full_within_ten_minutes_of_a_block_a_second() {
        let cache = Cache::default();
        let most = |blocks: std::ops::Range<u64>| {
            blocks.fold(0_usize, |most, number| {
                cache.takes_block(number);
                most.max(cache.held())
            })
        };
        let (first, hour) = (most(0..600), most(600..3_600));
        let block = usize::try_from(NODES).expect("small") * (BESIDE + LENGTH);
        assert!(hour <= first + block, "{first} bytes after ten minutes, {hour} after an hour");
    }

    #[test]
    fn a_node_that_is_read_stays_cached_while_others_pass() {
        let (cache, root) = (Cache::default(), Hash([7; HASH]));
        cache.put(root, vec![1_u8; LENGTH].into());
        for number in 0..600 {
            cache.takes_block(number);
            assert!(cache.get(root).is_some(), "block {number}");
        }
        assert!(cache.get(Hash(keccak256(0_u64.to_be_bytes()).0)).is_none());
    }
}
