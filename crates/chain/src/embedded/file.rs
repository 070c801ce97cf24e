//! The file of the embedded chain: blocks, raw transactions, receipts and the state's nodes in one SQLite database.
//!
//! A block is one SQLite transaction, on disk (WAL, synchronous=FULL) before it is announced. While the chain is open
//! no other process can open the file.

use std::fs::{DirBuilder, OpenOptions};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use ethers::utils::rlp;
use k256::ecdsa::SigningKey;
use rusqlite::config::DbConfig;
use rusqlite::{Connection, ErrorCode, OptionalExtension, Row, params};
use zeroize::Zeroizing;

use super::block::{Header, Receipt};
use super::state_file::{self, Cache};
use super::transaction::Transaction;
use super::trie::EMPTY_ROOT;
use super::version::{self, CHOSEN, PLAIN, TRIES};
use super::world::Written;
use crate::chain::{ChainError, Consensus};
use crate::model::{Address, Hash};

const SCHEMA: &str = "
    CREATE TABLE IF NOT EXISTS chain (
        id INTEGER PRIMARY KEY CHECK (id = 1), version INTEGER NOT NULL, chain_id INTEGER NOT NULL, signer BLOB NOT NULL
    );
    CREATE TABLE IF NOT EXISTS block (number INTEGER PRIMARY KEY, hash BLOB NOT NULL UNIQUE, header BLOB NOT NULL);
    CREATE TABLE IF NOT EXISTS sent (
        block INTEGER NOT NULL, position INTEGER NOT NULL, hash BLOB NOT NULL UNIQUE, sender BLOB NOT NULL,
        raw BLOB NOT NULL, receipt BLOB NOT NULL, logs INTEGER NOT NULL, PRIMARY KEY (block, position)
    );";
const KEY_LENGTH: usize = 32;

/// Drawn when a chain is founded.
pub struct Founding {
    /// Its chain id.
    pub chain_id: u64,
    /// How its blocks are sealed.
    pub consensus: Consensus,
    /// The keys that seal its blocks; under proof of work, the key of the account that gets the fees.
    pub keys: Vec<SigningKey>,
    /// Since when its state is stored as tries; `None` in a file before version 3.
    pub era: Option<Era>,
}

/// The point from which a chain is of version 3.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Era {
    /// The first block by the new rules; 0 if the chain was founded under them.
    pub first: u64,
    /// Root of the state before that block.
    pub root: Hash,
}

/// A block to be written to the file.
pub struct Sealed<'a> {
    /// Its header.
    pub header: &'a Header,
    /// Its transactions.
    pub sent: &'a [Transaction],
    /// Their receipts.
    pub receipts: &'a [Receipt],
    /// Its changes to the state's nodes.
    pub written: &'a Written,
    /// Whether it was sealed out of turn.
    pub out_of_turn: bool,
}

/// A mined transaction as stored in the file.
pub struct Mined {
    /// Its sender.
    pub sender: Address,
    /// Its raw bytes.
    pub raw: Vec<u8>,
    /// Its receipt, RLP.
    pub receipt: Vec<u8>,
    /// How many logs it wrote.
    pub logs: u64,
}

/// The open file.
pub struct ChainFile {
    path: PathBuf,
    connection: Connection,
    pub(super) cache: Cache,
}

impl ChainFile {
    /// Opens or creates `chain.db` in `directory` (0700, files 0600).
    ///
    /// # Errors
    /// [`ChainError::File`] if it cannot be written or another process has it open, [`ChainError::Tampered`] if it is
    /// not a chain.
    pub fn open(directory: &Path) -> Result<Self, ChainError> {
        let path = super::file_in(directory);
        let blame = |error: std::io::Error| ChainError::File { path: path.clone(), reason: error.to_string() };
        DirBuilder::new().recursive(true).mode(0o700).create(directory).map_err(blame)?;
        OpenOptions::new().create(true).append(true).mode(0o600).open(&path).map_err(blame)?;
        let blame = |error: rusqlite::Error| blamed(&path, &error);
        let connection = connect(&path).map_err(blame)?;
        version::check(&connection, &path)?;
        prepare(&connection).map_err(blame)?;
        Ok(Self { path, connection, cache: Cache::default() })
    }

    /// Refuses a chain written by a later version of this program, and leaves the file as it is. Other problems are
    /// reported when it is opened.
    ///
    /// # Errors
    /// [`ChainError::File`].
    pub fn check(directory: &Path) -> Result<(), ChainError> {
        let path = super::file_in(directory);
        if !path.exists() {
            return Ok(());
        }
        let Ok(connection) = connect(&path) else { return Ok(()) };
        let checked = version::check(&connection, &path);
        version::leave_log(&connection, &path);
        checked
    }

    fn blame(&self, error: &rusqlite::Error) -> ChainError {
        blamed(&self.path, error)
    }

    /// The founding data; `None` in a new file.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read or was changed.
    pub fn founding(&self) -> Result<Option<Founding>, ChainError> {
        let columns = |row: &Row<'_>| Ok((row.get(0)?, natural(row, 1)?, Zeroizing::new(row.get(2)?)));
        let row: Option<(i64, u64, Zeroizing<Vec<u8>>)> = self
            .connection
            .query_row("SELECT version, chain_id, signer FROM chain", [], columns)
            .optional()
            .map_err(|error| self.blame(&error))?;
        let Some((version, chain_id, signer)) = row else { return Ok(None) };
        let (consensus, era) = match version {
            PLAIN => (Consensus::POA, None),
            CHOSEN => (self.chosen()?, None),
            TRIES => (self.chosen()?, Some(self.era()?)),
            found => return Err(ChainError::Newer { path: self.path.clone(), found, known: TRIES }),
        };
        let keys: Result<Vec<_>, _> = signer.chunks(KEY_LENGTH).map(SigningKey::from_slice).collect();
        let keys = keys.ok().filter(|keys| keys.len() == keys_of(&consensus));
        let keys = keys.ok_or_else(|| self.tampered(0, "the signers' keys were changed"))?;
        Ok(Some(Founding { chain_id, consensus, keys, era }))
    }

    fn chosen(&self) -> Result<Consensus, ChainError> {
        let words: Option<String> = self.one("SELECT words FROM consensus", [], |row| row.get(0))?;
        let consensus = words.and_then(|words| words.parse().ok());
        consensus.ok_or_else(|| self.tampered(0, "its consensus is unknown to this program"))
    }

    fn era(&self) -> Result<Era, ChainError> {
        let read = |row: &Row<'_>| Ok(Era { first: natural(row, 0)?, root: Hash(row.get(1)?) });
        let era = self.one("SELECT first, root FROM era", [], read)?;
        era.ok_or_else(|| self.tampered(0, "it does not say where its version 3 starts"))
    }

    /// Writes a new chain: founding and genesis block, all or nothing.
    ///
    /// # Errors
    /// [`ChainError::File`] if it cannot be written.
    pub fn found(&self, founding: &Founding, genesis: &Header) -> Result<(), ChainError> {
        let mut keys = Zeroizing::new(Vec::with_capacity(KEY_LENGTH * founding.keys.len()));
        founding.keys.iter().for_each(|key| keys.extend_from_slice(&Zeroizing::new(key.to_bytes())[..]));
        self.write(|transaction| {
            let values = params![TRIES, integer(founding.chain_id), &keys[..]];
            transaction.execute("INSERT INTO chain VALUES (1, ?1, ?2, ?3)", values)?;
            begin_tries(transaction, &founding.consensus, Era { first: 0, root: EMPTY_ROOT })?;
            insert_header(transaction, genesis)
        })
    }

    /// Upgrades an older file to version 3, all or nothing: `made` are the nodes of its newest state.
    ///
    /// # Errors
    /// [`ChainError::File`] if it cannot be written.
    pub fn upgrade(
        &self,
        consensus: &Consensus,
        era: Era,
        made: &[(Hash, Vec<u8>)],
        out_of_turn: &[u64],
    ) -> Result<(), ChainError> {
        self.write(|transaction| {
            transaction.execute("UPDATE chain SET version = ?1", [TRIES])?;
            begin_tries(transaction, consensus, era)?;
            state_file::add(transaction, made)?;
            out_of_turn.iter().try_for_each(|number| insert_out_of_turn(transaction, *number))
        })
    }

    /// Writes a block and its changes to the state; when this returns it is on disk.
    ///
    /// # Errors
    /// [`ChainError::File`] if it cannot be written; then nothing was.
    pub fn append(&self, block: &Sealed<'_>) -> Result<(), ChainError> {
        self.write(|transaction| {
            insert_header(transaction, block.header)?;
            if block.out_of_turn {
                insert_out_of_turn(transaction, block.header.number)?;
            }
            let mut insert = transaction.prepare_cached("INSERT INTO sent VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")?;
            for ((position, one), receipt) in (0i64..).zip(block.sent).zip(block.receipts) {
                let encoded = rlp::encode(receipt);
                let (number, hash, sender) = (integer(block.header.number), &one.hash.0, &one.sender.0);
                let logs = i64::try_from(receipt.logs.len()).unwrap_or(i64::MAX);
                insert.execute(params![number, position, hash, sender, one.raw, &encoded[..], logs])?;
            }
            state_file::write(transaction, block.header.number, block.written)
        })
    }

    /// Runs changes in one transaction: when this returns, either all are on disk or none happened.
    fn write(&self, work: impl FnOnce(&rusqlite::Transaction<'_>) -> rusqlite::Result<()>) -> Result<(), ChainError> {
        let write = || {
            let transaction = self.connection.unchecked_transaction()?;
            work(&transaction)?;
            transaction.commit()
        };
        write().map_err(|error| self.blame(&error))
    }

    /// The number of the newest block.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn newest_number(&self) -> Result<u64, ChainError> {
        let newest = self.one("SELECT coalesce(max(number), 0) FROM block", [], |row| natural(row, 0))?;
        Ok(newest.unwrap_or(0))
    }

    /// The blocks that were sealed out of turn, in order.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn out_of_turn(&self) -> Result<Vec<u64>, ChainError> {
        self.all("SELECT number FROM out_of_turn ORDER BY number", [], |row| natural(row, 0))
    }

    /// Copies the file, as it is, to a new file of mode 0600.
    ///
    /// # Errors
    /// [`ChainError::File`] if it cannot be written.
    pub fn copy_to(&self, path: &Path) -> Result<(), ChainError> {
        let blame = |error: std::io::Error| ChainError::File { path: path.to_owned(), reason: error.to_string() };
        let file = OpenOptions::new().create_new(true).write(true).mode(0o600).open(path).map_err(blame)?;
        let copied = self.connection.backup(rusqlite::MAIN_DB, path, None::<fn(rusqlite::backup::Progress)>);
        copied.map_err(|error| blamed(path, &error))?;
        file.sync_all().map_err(blame)
    }

    /// A block by number: hash and header.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn block(&self, number: u64) -> Result<Option<(Hash, Vec<u8>)>, ChainError> {
        let query = "SELECT number, hash, header FROM block WHERE number = ?1";
        self.one(query, params![integer(number)], header_columns)
            .map(|found| found.map(|(_, hash, header)| (hash, header)))
    }

    /// The number of the block with this hash.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn number_of(&self, hash: Hash) -> Result<Option<u64>, ChainError> {
        self.one("SELECT number FROM block WHERE hash = ?1", params![hash.0], |row| natural(row, 0))
    }

    /// The block and index at which a transaction was mined.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn place_of(&self, hash: Hash) -> Result<Option<(u64, u64)>, ChainError> {
        let query = "SELECT block, position FROM sent WHERE hash = ?1";
        self.one(query, params![hash.0], |row| Ok((natural(row, 0)?, natural(row, 1)?)))
    }

    /// The transactions of a block, in order.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn block_transactions(&self, number: u64) -> Result<Vec<Mined>, ChainError> {
        let query = "SELECT sender, raw, receipt, logs FROM sent WHERE block = ?1 ORDER BY position";
        self.all(query, [integer(number)], mined_columns)
    }

    /// The numbers of the blocks with logs from `from` to `to`, in order.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub fn with_logs(&self, from: u64, to: u64) -> Result<Vec<u64>, ChainError> {
        let query = "SELECT DISTINCT block FROM sent WHERE block BETWEEN ?1 AND ?2 AND logs > 0 ORDER BY block";
        self.all(query, [from, to].map(integer), |row| natural(row, 0))
    }

    /// One row of a query.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
    pub(super) fn one<T>(
        &self,
        query: &str,
        values: impl rusqlite::Params,
        read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Option<T>, ChainError> {
        let mut statement = self.connection.prepare_cached(query).map_err(|error| self.blame(&error))?;
        statement.query_row(values, read).optional().map_err(|error| self.blame(&error))
    }

    /// All rows of a query.
    ///
    /// # Errors
    /// [`ChainError`] if the file cannot be read.
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

    /// Writes without waiting for the disk, for tests that write many blocks.
    #[cfg(test)]
    pub fn in_a_hurry(&self) {
        self.connection.pragma_update(None, "synchronous", "OFF").expect("a pragma");
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The error for a block that was altered.
    pub fn tampered(&self, block: u64, what: &str) -> ChainError {
        ChainError::Tampered { path: self.path.clone(), block, what: what.to_owned() }
    }
}

/// How many keys a chain holds.
pub fn keys_of(consensus: &Consensus) -> usize {
    match consensus {
        Consensus::Poa { signers, .. } => usize::from(*signers),
        Consensus::Pow { .. } => 1,
    }
}

fn connect(path: &Path) -> rusqlite::Result<Connection> {
    let connection = Connection::open(path)?;
    connection.busy_timeout(Duration::from_secs(5))?;
    // A statement is planned once, whatever is bound to it.
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
    connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
    Ok(connection)
}

fn prepare(connection: &Connection) -> rusqlite::Result<()> {
    connection.pragma_update(None, "journal_mode", "WAL")?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    // Nothing of it goes into temporary files outside its folder.
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

/// The changes that make a file version 3.
fn begin_tries(transaction: &rusqlite::Transaction<'_>, consensus: &Consensus, era: Era) -> rusqlite::Result<()> {
    transaction.execute_batch(state_file::SCHEMA)?;
    transaction.execute("INSERT OR IGNORE INTO consensus VALUES (1, ?1)", [consensus.to_string()])?;
    transaction.execute("INSERT INTO era VALUES (1, ?1, ?2)", params![integer(era.first), era.root.0]).map(drop)
}

fn insert_out_of_turn(connection: &Connection, number: u64) -> rusqlite::Result<()> {
    connection.prepare_cached("INSERT INTO out_of_turn VALUES (?1)")?.execute([integer(number)]).map(drop)
}

/// SQLite's integers are signed; no number here gets that large.
pub(super) fn integer(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

fn natural(row: &Row<'_>, column: usize) -> rusqlite::Result<u64> {
    let value: i64 = row.get(column)?;
    u64::try_from(value).map_err(|_| rusqlite::Error::IntegralValueOutOfRange(column, value))
}

fn header_columns(row: &Row<'_>) -> rusqlite::Result<(u64, Hash, Vec<u8>)> {
    Ok((natural(row, 0)?, Hash(row.get(1)?), row.get(2)?))
}

fn mined_columns(row: &Row<'_>) -> rusqlite::Result<Mined> {
    Ok(Mined { sender: Address(row.get(0)?), raw: row.get(1)?, receipt: row.get(2)?, logs: natural(row, 3)? })
}
