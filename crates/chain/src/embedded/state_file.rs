//! The nodes of the state in the chain's file: each under its hash, with the number of places where it occurs in the
//! newest state or in one that is still kept. A block's nodes are written and old ones removed in the block's own
//! SQLite transaction.

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;

use ethers::utils::keccak256;
use rusqlite::{Connection, OptionalExtension, Transaction, params};

use super::file::{ChainFile, integer};
use super::trie::{Nodes, below};
use super::world::{Ground, Written};
use crate::chain::ChainError;
use crate::model::Hash;

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
