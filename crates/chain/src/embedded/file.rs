//! The file of the embedded chain: one SQLite database. A block is one transaction, on disk (WAL, synchronous=FULL)
//! before it is announced; no other process can open the file meanwhile.

use std::fs::{DirBuilder, OpenOptions};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{cell::RefCell, collections::VecDeque, rc::Rc};

use k256::ecdsa::SigningKey;
use rusqlite::{Connection, ErrorCode, OptionalExtension, Row, config::DbConfig, params};
use tokio::sync::oneshot;
use zeroize::Zeroizing;

use super::block::{Header, Receipt};
use super::node::{Again, Node, header, receipts_root};
use super::world::{self, Cache};
use super::{machine::Outcome, sealing, trie::list_root};
use crate::transaction::{Items, Transaction};
use crate::{ChainError, Consensus, model::Hash};

const VERSION: i64 = 1;
const SCHEMA: &str = "
    CREATE TABLE IF NOT EXISTS chain (
        id INTEGER PRIMARY KEY CHECK (id = 1), version INTEGER NOT NULL, chain_id INTEGER NOT NULL,
        consensus TEXT NOT NULL, signer BLOB NOT NULL
    );
    CREATE TABLE IF NOT EXISTS block (number INTEGER PRIMARY KEY, hash BLOB NOT NULL UNIQUE, header BLOB NOT NULL);
    CREATE TABLE IF NOT EXISTS sent (
        block INTEGER NOT NULL, position INTEGER NOT NULL, hash BLOB NOT NULL UNIQUE, raw BLOB NOT NULL,
        receipt BLOB NOT NULL, logs INTEGER NOT NULL, PRIMARY KEY (block, position)
    );
    CREATE TABLE IF NOT EXISTS node (hash BLOB PRIMARY KEY, body BLOB NOT NULL, places INTEGER NOT NULL);
    CREATE TABLE IF NOT EXISTS retired (block INTEGER PRIMARY KEY, nodes BLOB NOT NULL, felled BLOB NOT NULL);
    CREATE TABLE IF NOT EXISTS doomed (id INTEGER PRIMARY KEY, hash BLOB NOT NULL);";
const KEY_LENGTH: usize = 32;

pub struct Founding {
    pub chain_id: u64,
    pub consensus: Consensus,
    /// Under proof of work, the key of the account that gets the fees.
    pub keys: Vec<SigningKey>,
}

pub struct Mined {
    pub raw: Vec<u8>,
    /// RLP.
    pub receipt: Vec<u8>,
    pub logs: u64,
}

pub struct ChainFile {
    path: PathBuf,
    connection: Connection,
    pub(super) cache: Cache,
}

impl ChainFile {
    /// Makes the directory 0700, the file 0600.
    pub fn open(directory: &Path) -> Result<Self, ChainError> {
        let path = super::file_in(directory);
        let blame = |error: std::io::Error| ChainError::File { path: path.clone(), reason: error.to_string() };
        DirBuilder::new().recursive(true).mode(0o700).create(directory).map_err(blame)?;
        OpenOptions::new().create(true).append(true).mode(0o600).open(&path).map_err(blame)?;
        let blame = |error: rusqlite::Error| blamed(&path, &error);
        let connection = connect(&path).map_err(blame)?;
        check_version(&connection, &path)?;
        prepare(&connection).map_err(blame)?;
        Ok(Self { path, connection, cache: Cache::default() })
    }

    /// Refuses another version without touching the file; other problems show when it is opened.
    pub fn check(directory: &Path) -> Result<(), ChainError> {
        let path = super::file_in(directory);
        if !path.exists() {
            return Ok(());
        }
        let Ok(connection) = connect(&path) else { return Ok(()) };
        let checked = check_version(&connection, &path);
        leave_log(&connection, &path);
        checked
    }

    fn blame(&self, error: &rusqlite::Error) -> ChainError {
        blamed(&self.path, error)
    }

    /// `None` in a new file.
    pub fn founding(&self) -> Result<Option<Founding>, ChainError> {
        type Columns = (u64, String, Zeroizing<Vec<u8>>);
        let columns = |row: &Row<'_>| Ok((natural(row, 0)?, row.get(1)?, Zeroizing::new(row.get(2)?)));
        let row: Option<Columns> = self.one("SELECT chain_id, consensus, signer FROM chain", [], columns)?;
        let Some((chain_id, words, signer)) = row else { return Ok(None) };
        let consensus = words.parse().map_err(|_| self.tampered(0, "its consensus is unknown to this program"))?;
        let keys: Result<Vec<_>, _> = signer.chunks(KEY_LENGTH).map(SigningKey::from_slice).collect();
        let keys = keys.ok().filter(|keys| keys.len() == keys_of(&consensus));
        let keys = keys.ok_or_else(|| self.tampered(0, "the signers' keys were changed"))?;
        Ok(Some(Founding { chain_id, consensus, keys }))
    }

    pub fn found(&self, founding: &Founding, genesis: &Header) -> Result<(), ChainError> {
        let mut keys = Zeroizing::new(Vec::with_capacity(KEY_LENGTH * founding.keys.len()));
        founding.keys.iter().for_each(|key| keys.extend_from_slice(&Zeroizing::new(key.to_bytes())[..]));
        self.write(|transaction| {
            let values = params![VERSION, integer(founding.chain_id), founding.consensus.to_string(), &keys[..]];
            transaction.execute("INSERT INTO chain VALUES (1, ?1, ?2, ?3, ?4)", values)?;
            insert_header(transaction, genesis)
        })
    }

    /// On disk when this returns.
    pub fn append(&self, header: &Header, outcome: &Outcome) -> Result<(), ChainError> {
        self.write(|transaction| {
            insert_header(transaction, header)?;
            let mut insert = transaction.prepare_cached("INSERT INTO sent VALUES (?1, ?2, ?3, ?4, ?5, ?6)")?;
            for ((position, one), receipt) in (0i64..).zip(&outcome.included).zip(&outcome.receipts) {
                let (number, logs) = (integer(header.number), integer(receipt.logs.len() as u64));
                insert.execute(params![number, position, one.hash.0, one.raw, receipt.encode(), logs])?;
            }
            world::write(transaction, header.number, &outcome.written)
        })
    }

    /// One transaction: all is on disk, or nothing happened.
    fn write(&self, work: impl FnOnce(&rusqlite::Transaction<'_>) -> rusqlite::Result<()>) -> Result<(), ChainError> {
        let write = || {
            let transaction = self.connection.unchecked_transaction()?;
            work(&transaction)?;
            transaction.commit()
        };
        write().map_err(|error| self.blame(&error))
    }

    pub fn newest_number(&self) -> Result<u64, ChainError> {
        let newest = self.one("SELECT coalesce(max(number), 0) FROM block", [], |row| natural(row, 0))?;
        Ok(newest.unwrap_or(0))
    }

    /// The copy has mode 0600.
    pub fn copy_to(&self, path: &Path) -> Result<(), ChainError> {
        let blame = |error: std::io::Error| ChainError::File { path: path.to_owned(), reason: error.to_string() };
        let file = OpenOptions::new().create_new(true).write(true).mode(0o600).open(path).map_err(blame)?;
        let copied = self.connection.backup(rusqlite::MAIN_DB, path, None::<fn(rusqlite::backup::Progress)>);
        copied.map_err(|error| blamed(path, &error))?;
        file.sync_all().map_err(blame)
    }

    /// Hash and header.
    pub fn block(&self, number: u64) -> Result<Option<(Hash, Vec<u8>)>, ChainError> {
        let query = "SELECT hash, header FROM block WHERE number = ?1";
        self.one(query, params![integer(number)], |row| Ok((Hash(row.get(0)?), row.get(1)?)))
    }

    pub fn number_of(&self, hash: Hash) -> Result<Option<u64>, ChainError> {
        self.one("SELECT number FROM block WHERE hash = ?1", params![hash.0], |row| natural(row, 0))
    }

    /// Block and index.
    pub fn place_of(&self, hash: Hash) -> Result<Option<(u64, u64)>, ChainError> {
        let query = "SELECT block, position FROM sent WHERE hash = ?1";
        self.one(query, params![hash.0], |row| Ok((natural(row, 0)?, natural(row, 1)?)))
    }

    pub fn block_transactions(&self, number: u64) -> Result<Vec<Mined>, ChainError> {
        let query = "SELECT raw, receipt, logs FROM sent WHERE block = ?1 ORDER BY position";
        let mined = |row: &Row<'_>| Ok(Mined { raw: row.get(0)?, receipt: row.get(1)?, logs: natural(row, 2)? });
        self.all(query, [integer(number)], mined)
    }

    pub fn with_logs(&self, from: u64, to: u64) -> Result<Vec<u64>, ChainError> {
        let query = "SELECT DISTINCT block FROM sent WHERE block BETWEEN ?1 AND ?2 AND logs > 0 ORDER BY block";
        self.all(query, [from, to].map(integer), |row| natural(row, 0))
    }

    pub(super) fn one<T>(
        &self,
        query: &str,
        values: impl rusqlite::Params,
        read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Option<T>, ChainError> {
        let mut statement = self.connection.prepare_cached(query).map_err(|error| self.blame(&error))?;
        statement.query_row(values, read).optional().map_err(|error| self.blame(&error))
    }

    pub(super) fn all<T>(
        &self,
        query: &str,
        values: impl rusqlite::Params,
        read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, ChainError> {
        let blame = |error: rusqlite::Error| self.blame(&error);
        let mut statement = self.connection.prepare_cached(query).map_err(blame)?;
        let rows = statement.query_map(values, read).map_err(blame)?;
        rows.collect::<Result<_, _>>().map_err(blame)
    }

    /// Does not wait for the disk.
    #[cfg(test)]
    pub fn in_a_hurry(&self) {
        self.connection.pragma_update(None, "synchronous", "OFF").expect("a pragma");
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn tampered(&self, block: u64, what: &str) -> ChainError {
        ChainError::Tampered { path: self.path.clone(), block, what: what.to_owned() }
    }
}

pub fn keys_of(consensus: &Consensus) -> usize {
    match consensus {
        Consensus::Poa { signers, .. } => usize::from(*signers),
        Consensus::Pow { .. } => 1,
    }
}

fn connect(path: &Path) -> rusqlite::Result<Connection> {
    let connection = Connection::open(path)?;
    connection.busy_timeout(Duration::from_secs(5))?;
    // Plans a statement once, whatever is bound to it.
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
    connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
    Ok(connection)
}

/// Leaves a file of another version as it is. One without a readable version passes: opening it reports why.
fn check_version(connection: &Connection, path: &Path) -> Result<(), ChainError> {
    let found = match connection.query_row("SELECT version FROM chain", [], |row| row.get::<_, i64>(0)) {
        Ok(found) if found != VERSION => found,
        _ => return Ok(()),
    };
    leave_log(connection, path);
    if found > VERSION {
        return Err(ChainError::Newer { path: path.to_owned(), found, known: VERSION });
    }
    let what = format!("its version is {found}, which no authros writes");
    Err(ChainError::Tampered { path: path.to_owned(), block: 0, what })
}

/// Keeps a waiting log beside the file instead of merging it on close.
fn leave_log(connection: &Connection, path: &Path) {
    let waits = std::fs::metadata(path.with_extension("db-wal")).is_ok_and(|log| log.len() > 0);
    // Where this is not supported, the log is merged, which loses nothing.
    drop(connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, waits));
}

fn prepare(connection: &Connection) -> rusqlite::Result<()> {
    connection.pragma_update(None, "journal_mode", "WAL")?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    // No temporary files outside the folder.
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    connection.execute_batch(SCHEMA)
}

fn blamed(path: &Path, error: &rusqlite::Error) -> ChainError {
    match error.sqlite_error_code() {
        Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt) => {
            ChainError::Tampered { path: path.to_owned(), block: 0, what: error.to_string() }
        }
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            ChainError::File { path: path.to_owned(), reason: "it is open in another process".into() }
        }
        _ => ChainError::File { path: path.to_owned(), reason: error.to_string() },
    }
}

fn insert_header(connection: &Connection, header: &Header) -> rusqlite::Result<()> {
    let values = params![integer(header.number), header.hash().0, header.encode()];
    connection.prepare_cached("INSERT INTO block VALUES (?1, ?2, ?3)")?.execute(values).map(|_| ())
}

/// SQLite's integers are signed; no number here gets that large.
pub(super) fn integer(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

fn natural(row: &Row<'_>, column: usize) -> rusqlite::Result<u64> {
    let value: i64 = row.get(column)?;
    u64::try_from(value).map_err(|_| rusqlite::Error::IntegralValueOutOfRange(column, value))
}

// Blocks are checked when read: a header by its hash and the block above it, the rest by the header.

pub struct Done {
    pub transaction: Transaction,
    pub receipt: Receipt,
}

/// Bounds of the cache: blocks, and their bytes with an allowance per transaction.
const MOST_BLOCKS: usize = 32;
const MOST_BYTES: usize = 2 * 1024 * 1024;
const BESIDE: usize = 1024;

/// The blocks used last, so that their senders need not be recovered again.
#[derive(Default)]
pub struct Looked(RefCell<VecDeque<Block>>);

type Block = (u64, Rc<Vec<Done>>);

/// The header, the block's transactions, and the index of one of them.
pub type Place = (Header, Rc<Vec<Done>>, usize);

impl Looked {
    pub fn wrote(&self, number: u64, sent: Vec<Transaction>, receipts: Vec<Receipt>) {
        let done = sent.into_iter().zip(receipts).map(|(transaction, receipt)| Done { transaction, receipt });
        self.remember(number, Rc::new(done.collect()));
    }

    fn find(&self, number: u64) -> Option<Rc<Vec<Done>>> {
        self.0.borrow().iter().find(|(known, _)| *known == number).map(|(_, done)| Rc::clone(done))
    }

    /// Keeps at least one block, however long.
    fn remember(&self, number: u64, done: Rc<Vec<Done>>) {
        let mut blocks = self.0.borrow_mut();
        blocks.retain(|(known, _)| *known != number);
        blocks.push_back((number, done));
        let sum = |blocks: &VecDeque<Block>| {
            let all = blocks.iter().flat_map(|(_, done)| done.iter());
            all.map(|done| done.transaction.raw.len() + BESIDE).sum::<usize>()
        };
        while blocks.len() > MOST_BLOCKS || blocks.len() > 1 && sum(&blocks) > MOST_BYTES {
            blocks.pop_front();
        }
    }
}

impl Node {
    /// `None` above the newest.
    pub fn header(&self, number: u64) -> Result<Option<Header>, ChainError> {
        if number > self.head.number {
            return Ok(None);
        }
        let found = header(&self.file, number)?;
        if number < self.head.number {
            let parent = |bytes: &[u8]| Items::of(bytes).ok()?.next().ok().map(Hash);
            if self.file.block(number + 1)?.and_then(|(_, above)| parent(&above)) != Some(found.hash()) {
                return Err(self.file.tampered(number, "it is not the parent that the next block names"));
            }
        } else if found.hash() != self.head.hash {
            return Err(self.file.tampered(number, "its hash was changed"));
        }
        Ok(Some(found))
    }

    pub fn done(&self, header: &Header) -> Result<Rc<Vec<Done>>, ChainError> {
        let number = header.number;
        if let Some(done) = self.looked.find(number) {
            return Ok(done);
        }
        let mined = self.file.block_transactions(number)?;
        let done = mined.iter().map(|one| self.decoded(header, one)).collect::<Result<Vec<_>, _>>()?;
        let sent: Vec<&[u8]> = done.iter().map(|done| &done.transaction.raw[..]).collect();
        let receipts = receipts_root(done.iter().map(|done| &done.receipt));
        if list_root(&sent) != header.transactions_root || receipts != header.receipts_root {
            return Err(self.file.tampered(number, "its transactions or receipts were changed"));
        }
        let done = Rc::new(done);
        self.looked.remember(number, Rc::clone(&done));
        Ok(done)
    }

    fn decoded(&self, header: &Header, mined: &Mined) -> Result<Done, ChainError> {
        let blame = |what: &str| self.file.tampered(header.number, what);
        let transaction = Transaction::decode(&mined.raw, self.chain_id).map_err(|what| blame(&what))?;
        let receipt = Receipt::decode(&mined.receipt).map_err(|_| blame("a receipt is malformed"))?;
        Ok(Done { transaction, receipt })
    }

    pub fn mined(&self, hash: Hash) -> Result<Option<Place>, ChainError> {
        let Some((number, position)) = self.file.place_of(hash)? else { return Ok(None) };
        let gone = || self.file.tampered(number, "a transaction was moved");
        let header = self.header(number)?.ok_or_else(gone)?;
        let done = self.done(&header)?;
        let place = usize::try_from(position).map_err(|_| gone())?;
        if done.get(place).is_none_or(|done| done.transaction.hash != hash) {
            return Err(gone());
        }
        Ok(Some((header, done, place)))
    }
}

// The audit runs every block again, a little at a time, so that requests and blocks do not wait.

/// Time slice of an audit.
const SHARE: Duration = Duration::from_millis(20);

pub struct Auditing {
    again: Again,
    /// The newest block at the start.
    newest: u64,
    /// Nodes of the state still to read; `None` until all blocks have run.
    nodes: Option<Vec<Hash>>,
    reply: oneshot::Sender<Result<u64, ChainError>>,
}

impl Node {
    pub fn begin_audit(&mut self, reply: oneshot::Sender<Result<u64, ChainError>>) {
        match sealing::open(&self.file, None) {
            Ok(founded) => {
                let again = Again::new(&self.file, founded);
                self.audits.push_back(Auditing { again, newest: self.head.number, nodes: None, reply });
            }
            Err(error) => drop(reply.send(Err(error))),
        }
    }

    pub fn go_on_auditing(&mut self) {
        let Some(mut auditing) = self.audits.pop_front().filter(|auditing| !auditing.reply.is_closed()) else { return };
        match self.share_of(&mut auditing) {
            Ok(false) => self.audits.push_back(auditing),
            Ok(true) => drop(auditing.reply.send(Ok(auditing.newest))),
            Err(error) => drop(auditing.reply.send(Err(error))),
        }
    }

    /// `true` when the audit is finished.
    fn share_of(&self, auditing: &mut Auditing) -> Result<bool, ChainError> {
        let begun = Instant::now();
        while begun.elapsed() < SHARE {
            if auditing.again.last.number < auditing.newest {
                auditing.again.step()?;
                continue;
            }
            let nodes = auditing.nodes.get_or_insert_with(|| auditing.again.state_nodes());
            let Some(hash) = nodes.pop() else { return Ok(true) };
            // Blocks mined meanwhile may have removed nodes.
            self.file.look_at(hash, self.head.number > auditing.newest)?;
        }
        Ok(false)
    }
}

#[cfg(test)]
mod reading_tests {
    use super::*;

    #[test]
    fn the_last_blocks_are_remembered_and_not_more() {
        let looked = Looked::default();
        for number in 1..=100 {
            looked.wrote(number, Vec::new(), Vec::new());
        }
        let remembered: Vec<u64> = (1..=100).filter(|number| looked.find(*number).is_some()).collect();
        assert_eq!(remembered, (100 - MOST_BLOCKS as u64 + 1..=100).collect::<Vec<_>>());
        let first = looked.find(70).expect("remembered");
        looked.remember(70, Rc::clone(&first));
        looked.wrote(101, Vec::new(), Vec::new());
        assert!(looked.find(69).is_none() && looked.find(70).is_some(), "the one that was read last stays");
    }
}
