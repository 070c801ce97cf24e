//! Nonce lanes as the ledger knows them: open transactions, those that share a nonce, and replacing one signed
//! transaction with another along with everything it carries.

use rusqlite::{Connection, OptionalExtension as _, params};

use super::rows::unsigned;
use super::transactions::{close, transaction_error};
use super::{Ledger, database::whole};
use crate::model::{Address, Hash, Timestamp};
use crate::store::{StoreError, TransactionOutcome};

/// The open part of a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LaneCount {
    /// Transactions in no block yet.
    pub open: u64,
    /// The highest nonce among them.
    pub highest: Option<u64>,
    /// When the oldest of them was first signed.
    pub oldest: Option<Timestamp>,
}

/// An open transaction without its bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenTransaction {
    /// Its hash.
    pub hash: Hash,
    /// Its nonce.
    pub nonce: u64,
    /// Its purpose.
    pub purpose: String,
    /// Whether its records go back if it fails; otherwise it is a call of its own, to be signed again.
    pub anchors: bool,
}

/// An open transaction's call, signed again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reissue {
    /// The new hash.
    pub hash: Hash,
    /// The new nonce, or the same at another price.
    pub nonce: u64,
    /// The new bytes.
    pub raw: Vec<u8>,
}

impl Ledger {
    /// How many transactions of an account are open, read from an index.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn lane_count(&self, account: Address) -> Result<LaneCount, StoreError> {
        self.read(|connection| {
            let sql = "SELECT count(*), max(nonce), min(signed_at) FROM transactions WHERE state = 0 AND account = ?1";
            let count = connection.prepare_cached(sql)?.query_row([account.0], |row| {
                let optional = |column| row.get::<_, Option<i64>>(column).map(|value| value.map(i64::cast_unsigned));
                Ok(LaneCount { open: unsigned(row, 0)?, highest: optional(1)?, oldest: optional(2)?.map(Timestamp) })
            })?;
            Ok(count)
        })
    }

    /// The highest nonce of an account's transactions signed here, whatever became of them.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn highest_nonce(&self, account: Address) -> Result<Option<u64>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached("SELECT max(nonce) FROM transactions WHERE account = ?1")?;
            let highest: Option<i64> = statement.query_row([account.0], |row| row.get(0))?;
            Ok(highest.map(i64::cast_unsigned))
        })
    }

    /// The cost of an account's newest `most` anchoring transactions in blocks: their number, their gas, and the
    /// records they anchored. Read from an index, whatever the number of transactions.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn anchoring_gas(&self, account: Address, most: u64) -> Result<(u64, u64, u64), StoreError> {
        let most = whole("transactions", most)?;
        self.read(|connection| {
            let sql = "SELECT count(*), coalesce(sum(gas_used), 0), coalesce(sum(records), 0) FROM (
                SELECT gas_used, CASE WHEN batch IS NULL THEN length(digests) / 32
                    ELSE (SELECT count FROM batches WHERE root = batch) END AS records
                FROM transactions WHERE account = ?1 AND state = 1 AND gas_used IS NOT NULL
                    AND (batch IS NOT NULL OR length(digests) > 0)
                ORDER BY nonce DESC LIMIT ?2)";
            let figures = connection.prepare_cached(sql)?.query_row(params![account.0, most], |row| {
                Ok((unsigned(row, 0)?, unsigned(row, 1)?, unsigned(row, 2)?))
            })?;
            Ok(figures)
        })
    }

    /// The open transactions of an account by nonce, without their bytes.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn open_lane(&self, account: Address) -> Result<Vec<OpenTransaction>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT hash, nonce, purpose, length(digests) > 0 OR batch IS NOT NULL FROM transactions
                 WHERE state = 0 AND account = ?1 ORDER BY nonce",
            )?;
            let rows = statement.query_map([account.0], |row| {
                Ok(OpenTransaction {
                    hash: Hash(row.get(0)?),
                    nonce: unsigned(row, 1)?,
                    purpose: row.get(2)?,
                    anchors: row.get(3)?,
                })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// The signed bytes of a transaction; `None` if the ledger does not hold it.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn raw_transaction(&self, hash: Hash) -> Result<Option<Vec<u8>>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached("SELECT raw FROM transactions WHERE hash = ?1")?;
            Ok(statement.query_row([hash.0], |row| row.get(0)).optional()?)
        })
    }

    /// Hash and bytes of every transaction ever signed here with this nonce, whatever its outcome, newest first.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn of_nonce(&self, account: Address, nonce: u64) -> Result<Vec<(Hash, Vec<u8>)>, StoreError> {
        let nonce = whole("nonce", nonce)?;
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT hash, raw FROM transactions WHERE account = ?1 AND nonce = ?2 ORDER BY key DESC",
            )?;
            let rows = statement.query_map(params![account.0, nonce], |row| Ok((Hash(row.get(0)?), row.get(1)?)))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// [`Ledger::close_transaction`] for several, in one commit.
    ///
    /// # Errors
    /// See [`Ledger::close_transaction`]; then none is closed.
    pub fn close_transactions(&self, closings: Vec<(Hash, TransactionOutcome)>) -> Result<(), StoreError> {
        self.write_many(closings.len(), move |session| {
            closings.into_iter().try_for_each(|(hash, outcome)| close(session.connection, hash, outcome))
        })
    }

    /// Replaces an open transaction with the same call, signed again, in one commit: purpose, age and everything it
    /// anchors pass to the new one. The new one may be one that was replaced before.
    ///
    /// # Errors
    /// [`StoreError::Transaction`] if the old one is not open, or the new one is the old one or was closed by the
    /// chain.
    pub fn reissue(&self, old: Hash, new: Reissue) -> Result<(), StoreError> {
        let nonce = whole("nonce", new.nonce)?;
        self.write(move |session| {
            let connection = session.connection;
            let kept = connection
                .prepare_cached(
                    "INSERT INTO transactions (hash, account, nonce, raw, purpose, digests, signed_at, state, batch)
                     SELECT ?2, account, ?3, ?4, purpose, digests, signed_at, 0, batch FROM transactions
                     WHERE hash = ?1 AND state = 0
                     ON CONFLICT (hash) DO UPDATE SET state = 0, replaced_by = NULL
                     WHERE transactions.state = 3 AND transactions.hash <> ?1",
                )?
                .execute(params![old.0, new.hash.0, nonce, new.raw])?;
            if kept == 0 {
                return Err(transaction_error(old, "is not open, or nothing about it would change"));
            }
            hand_over(connection, old, new.hash)?;
            supersede(connection, old, new.hash)
        })
    }

    /// The chain chose `winner`, which makes the same call with the same nonce as the open `loser`: what the loser
    /// carries passes to the winner, which then ends with `outcome`.
    ///
    /// # Errors
    /// [`StoreError::Transaction`] if the ledger does not hold the winner.
    pub fn decide_nonce(&self, loser: Hash, winner: Hash, outcome: TransactionOutcome) -> Result<(), StoreError> {
        self.write(move |session| {
            let connection = session.connection;
            hand_over(connection, loser, winner)?;
            supersede(connection, loser, winner)?;
            connection
                .prepare_cached("UPDATE transactions SET replaced_by = NULL WHERE hash = ?1")?
                .execute([winner.0])?;
            close(connection, winner, outcome)
        })
    }
}

/// Moves records and a batch from one transaction to another.
fn hand_over(connection: &Connection, from: Hash, to: Hash) -> Result<(), StoreError> {
    let (digests, batch): (Vec<u8>, Option<[u8; 32]>) = connection
        .prepare_cached("SELECT digests, batch FROM transactions WHERE hash = ?1")?
        .query_row([from.0], |row| Ok((row.get(0)?, row.get(1)?)))?;
    if let Some(root) = batch {
        connection
            .prepare_cached("UPDATE batches SET tx = ?3 WHERE root = ?1 AND tx = ?2 AND block IS NULL")?
            .execute([root, from.0, to.0])?;
        connection
            .prepare_cached(
                "UPDATE records SET tx = ?3 WHERE tx = ?2 AND block IS NULL AND n IN
                 (SELECT record FROM leaves JOIN batches ON key = batch WHERE root = ?1)",
            )?
            .execute([root, from.0, to.0])?;
    }
    let mut statement =
        connection.prepare_cached("UPDATE records SET tx = ?3 WHERE digest = ?1 AND tx = ?2 AND block IS NULL")?;
    for digest in digests.chunks_exact(crate::model::Digest::LENGTH) {
        statement.execute(params![digest, from.0, to.0])?;
    }
    Ok(())
}

/// Marks a transaction as replaced by another one, without returning its records.
fn supersede(connection: &Connection, old: Hash, new: Hash) -> Result<(), StoreError> {
    connection
        .prepare_cached("UPDATE transactions SET state = 3, replaced_by = ?2 WHERE hash = ?1")?
        .execute([old.0, new.0])?;
    Ok(())
}
