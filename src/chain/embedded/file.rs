//! The file of the embedded chain: blocks, raw transactions and receipts in one SQLite database.
//!
//! A block is one SQLite transaction, on disk (WAL, synchronous=FULL) before anyone hears of it.
//! While the chain is open no other process can open the file.

use std::fs::{DirBuilder, OpenOptions};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use ethers::utils::rlp;
use k256::ecdsa::SigningKey;
use rusqlite::{Connection, ErrorCode, OptionalExtension, Row, params};
use zeroize::Zeroizing;

use super::block::{Header, Receipt};
use super::transaction::Transaction;
use crate::chain::{ChainError, Consensus};
use crate::model::{Address, Hash};

/// A chain of one signer with the usual period, as every chain was at first.
const PLAIN: i64 = 1;
/// A chain that says its consensus.
const CHOSEN: i64 = 2;
const SCHEMA: &str = "
    CREATE TABLE IF NOT EXISTS chain (
        id INTEGER PRIMARY KEY CHECK (id = 1), version INTEGER NOT NULL, chain_id INTEGER NOT NULL, signer BLOB NOT NULL
    );
    CREATE TABLE IF NOT EXISTS block (number INTEGER PRIMARY KEY, hash BLOB NOT NULL UNIQUE, header BLOB NOT NULL);
    CREATE TABLE IF NOT EXISTS sent (
        block INTEGER NOT NULL, position INTEGER NOT NULL, hash BLOB NOT NULL UNIQUE, sender BLOB NOT NULL,
        raw BLOB NOT NULL, receipt BLOB NOT NULL, logs INTEGER NOT NULL, PRIMARY KEY (block, position)
    );";
/// Of a [`CHOSEN`] chain only; the column `signer` then holds all keys in a row.
const CONSENSUS: &str = "CREATE TABLE consensus (id INTEGER PRIMARY KEY CHECK (id = 1), words TEXT NOT NULL)";
const KEY_LENGTH: usize = 32;

/// What is drawn when a chain is made.
pub struct Founding {
    /// Its chain id.
    pub chain_id: u64,
    /// How its blocks are sealed.
    pub consensus: Consensus,
    /// The keys that seal its blocks; under proof of work the one of the account that gets the fees.
    pub keys: Vec<SigningKey>,
}

/// A mined transaction as it lies in the file.
pub struct Mined {
    /// Its block.
    pub block: u64,
    /// Its place in the block.
    pub position: u64,
    /// Who signed it.
    pub sender: Address,
    /// As it was sent.
    pub raw: Vec<u8>,
    /// What became of it, RLP.
    pub receipt: Vec<u8>,
}

/// The open file.
pub struct ChainFile {
    path: PathBuf,
    connection: Connection,
}

impl ChainFile {
    /// Opens or makes `chain.db` in `directory` (0700, files 0600).
    ///
    /// # Errors
    /// [`ChainError::File`] where it cannot be written or another process has it open,
    /// [`ChainError::Tampered`] where it is no chain.
    pub fn open(directory: &Path) -> Result<Self, ChainError> {
        let path = directory.join("chain.db");
        let blame = |error: std::io::Error| ChainError::File { path: path.clone(), reason: error.to_string() };
        DirBuilder::new().recursive(true).mode(0o700).create(directory).map_err(blame)?;
        OpenOptions::new().create(true).append(true).mode(0o600).open(&path).map_err(blame)?;
        let connection = prepare(&path).map_err(|error| blamed(&path, &error))?;
        Ok(Self { path, connection })
    }

    fn blame(&self, error: &rusqlite::Error) -> ChainError {
        blamed(&self.path, error)
    }

    /// What was drawn when the chain was made; `None` in a new file.
    ///
    /// # Errors
    /// [`ChainError`] where the file cannot be read or was changed.
    pub fn founding(&self) -> Result<Option<Founding>, ChainError> {
        let columns = |row: &Row<'_>| Ok((row.get(0)?, natural(row, 1)?, Zeroizing::new(row.get(2)?)));
        let row: Option<(i64, u64, Zeroizing<Vec<u8>>)> = self
            .connection
            .query_row("SELECT version, chain_id, signer FROM chain", [], columns)
            .optional()
            .map_err(|error| self.blame(&error))?;
        let Some((version, chain_id, signer)) = row else { return Ok(None) };
        let consensus = match version {
            PLAIN => Consensus::POA,
            CHOSEN => self.chosen()?,
            _ => {
                let reason = format!("it has version {version}, and this program reads versions {PLAIN} and {CHOSEN}");
                return Err(ChainError::File { path: self.path.clone(), reason });
            }
        };
        let keys: Result<Vec<_>, _> = signer.chunks(KEY_LENGTH).map(SigningKey::from_slice).collect();
        let keys = keys.ok().filter(|keys| keys.len() == keys_of(&consensus));
        let keys = keys.ok_or_else(|| self.tampered(0, "the signers' keys are not what they were"))?;
        Ok(Some(Founding { chain_id, consensus, keys }))
    }

    fn chosen(&self) -> Result<Consensus, ChainError> {
        let words: Option<String> = self.one("SELECT words FROM consensus", [], |row| row.get(0))?;
        let consensus = words.and_then(|words| words.parse().ok());
        consensus.ok_or_else(|| self.tampered(0, "its consensus is none that this program knows"))
    }

    /// Writes a new chain: founding and genesis block, all or nothing.
    ///
    /// # Errors
    /// [`ChainError::File`] where it cannot be written.
    pub fn found(&mut self, founding: &Founding, genesis: &Header) -> Result<(), ChainError> {
        let path = self.path.clone();
        let mut keys = Zeroizing::new(Vec::with_capacity(KEY_LENGTH * founding.keys.len()));
        founding.keys.iter().for_each(|key| keys.extend_from_slice(&Zeroizing::new(key.to_bytes())[..]));
        let version = if founding.consensus == Consensus::POA { PLAIN } else { CHOSEN };
        let mut write = || {
            let transaction = self.connection.transaction()?;
            let values = params![version, integer(founding.chain_id), &keys[..]];
            transaction.execute("INSERT INTO chain VALUES (1, ?1, ?2, ?3)", values)?;
            if version == CHOSEN {
                transaction.execute(CONSENSUS, [])?;
                let words = founding.consensus.to_string();
                transaction.execute("INSERT INTO consensus VALUES (1, ?1)", [words])?;
            }
            insert_header(&transaction, genesis)?;
            transaction.commit()
        };
        write().map_err(|error| blamed(&path, &error))
    }

    /// Writes a block; when this returns it is on disk.
    ///
    /// # Errors
    /// [`ChainError::File`] where it cannot be written; then nothing was.
    pub fn append(&mut self, header: &Header, sent: &[Transaction], receipts: &[Receipt]) -> Result<(), ChainError> {
        let path = self.path.clone();
        let mut write = || {
            let transaction = self.connection.transaction()?;
            insert_header(&transaction, header)?;
            {
                let mut insert = transaction.prepare_cached("INSERT INTO sent VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")?;
                for ((position, one), receipt) in (0i64..).zip(sent).zip(receipts) {
                    let encoded = rlp::encode(receipt);
                    let (block, hash, sender) = (integer(header.number), &one.hash.0, &one.sender.0);
                    let logs = i64::try_from(receipt.logs.len()).unwrap_or(i64::MAX);
                    insert.execute(params![block, position, hash, sender, one.raw, &encoded[..], logs])?;
                }
            }
            transaction.commit()
        };
        write().map_err(|error| blamed(&path, &error))
    }

    /// Calls `visit` with every block in order: number, hash, header, transactions.
    ///
    /// # Errors
    /// The first of `visit`, or [`ChainError`] where the file cannot be read.
    pub fn replay(
        &self,
        mut visit: impl FnMut(u64, Hash, Vec<u8>, Vec<Mined>) -> Result<(), ChainError>,
    ) -> Result<(), ChainError> {
        let blame = |error: rusqlite::Error| self.blame(&error);
        let mut blocks =
            self.connection.prepare("SELECT number, hash, header FROM block ORDER BY number").map_err(blame)?;
        let mut rows = blocks.query([]).map_err(blame)?;
        while let Some(row) = rows.next().map_err(blame)? {
            let (number, hash, header) = header_columns(row).map_err(blame)?;
            visit(number, hash, header, self.block_transactions(number)?)?;
        }
        Ok(())
    }

    /// Copies the file, as it is, to a new one of mode 0600.
    ///
    /// # Errors
    /// [`ChainError::File`] where it cannot be written.
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
    /// [`ChainError`] where the file cannot be read.
    pub fn block(&self, number: u64) -> Result<Option<(Hash, Vec<u8>)>, ChainError> {
        let query = "SELECT number, hash, header FROM block WHERE number = ?1";
        self.one(query, params![integer(number)], header_columns)
            .map(|found| found.map(|(_, hash, header)| (hash, header)))
    }

    /// The number of the block with this hash.
    ///
    /// # Errors
    /// [`ChainError`] where the file cannot be read.
    pub fn number_of(&self, hash: Hash) -> Result<Option<u64>, ChainError> {
        self.one("SELECT number FROM block WHERE hash = ?1", params![hash.0], |row| natural(row, 0))
    }

    /// A mined transaction.
    ///
    /// # Errors
    /// [`ChainError`] where the file cannot be read.
    pub fn mined(&self, hash: Hash) -> Result<Option<Mined>, ChainError> {
        let query = "SELECT block, position, sender, raw, receipt FROM sent WHERE hash = ?1";
        self.one(query, params![hash.0], mined_columns)
    }

    /// The transactions of a block, in order.
    ///
    /// # Errors
    /// [`ChainError`] where the file cannot be read.
    pub fn block_transactions(&self, number: u64) -> Result<Vec<Mined>, ChainError> {
        self.many("SELECT block, position, sender, raw, receipt FROM sent WHERE block = ?1 ORDER BY position", [number])
    }

    /// The transactions with logs of the blocks `from` to `to`, in order.
    ///
    /// # Errors
    /// [`ChainError`] where the file cannot be read.
    pub fn with_logs(&self, from: u64, to: u64) -> Result<Vec<Mined>, ChainError> {
        let query = "SELECT block, position, sender, raw, receipt FROM sent
                     WHERE block BETWEEN ?1 AND ?2 AND logs > 0 ORDER BY block, position";
        self.many(query, [from, to])
    }

    /// How many logs the transactions before `position` wrote in their block.
    ///
    /// # Errors
    /// [`ChainError`] where the file cannot be read.
    pub fn logs_before(&self, block: u64, position: u64) -> Result<usize, ChainError> {
        let query = "SELECT coalesce(sum(logs), 0) FROM sent WHERE block = ?1 AND position < ?2";
        self.one(query, params![integer(block), integer(position)], |row| natural(row, 0))
            .map(|sum| sum.and_then(|sum| usize::try_from(sum).ok()).unwrap_or(0))
    }

    fn one<T>(
        &self,
        query: &str,
        values: impl rusqlite::Params,
        read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Option<T>, ChainError> {
        let mut statement = self.connection.prepare_cached(query).map_err(|error| self.blame(&error))?;
        statement.query_row(values, read).optional().map_err(|error| self.blame(&error))
    }

    fn many<const N: usize>(&self, query: &str, values: [u64; N]) -> Result<Vec<Mined>, ChainError> {
        let blame = |error: rusqlite::Error| self.blame(&error);
        let mut statement = self.connection.prepare_cached(query).map_err(blame)?;
        let rows =
            statement.query_map(rusqlite::params_from_iter(values.map(integer)), mined_columns).map_err(blame)?;
        rows.collect::<Result<_, _>>().map_err(blame)
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The error that a block is not what it was.
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

fn prepare(path: &Path) -> rusqlite::Result<Connection> {
    let connection = Connection::open(path)?;
    connection.busy_timeout(Duration::from_secs(5))?;
    connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
    connection.pragma_update(None, "journal_mode", "WAL")?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    // Nothing of it in temporary files outside of its folder.
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    connection.execute_batch(SCHEMA)?;
    Ok(connection)
}

fn blamed(path: &Path, error: &rusqlite::Error) -> ChainError {
    match error.sqlite_error_code() {
        Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt) => {
            ChainError::Tampered { path: path.to_owned(), block: 0, what: error.to_string() }
        }
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            ChainError::File { path: path.to_owned(), reason: "another process has it open".into() }
        }
        _ => ChainError::File { path: path.to_owned(), reason: error.to_string() },
    }
}

fn insert_header(connection: &Connection, header: &Header) -> rusqlite::Result<()> {
    let values = params![integer(header.number), header.hash().0, header.encode()];
    connection.prepare_cached("INSERT INTO block VALUES (?1, ?2, ?3)")?.execute(values).map(|_| ())
}

/// SQLite's integers are signed; nothing here reaches that far.
fn integer(value: u64) -> i64 {
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
    Ok(Mined {
        block: natural(row, 0)?,
        position: natural(row, 1)?,
        sender: Address(row.get(2)?),
        raw: row.get(3)?,
        receipt: row.get(4)?,
    })
}
