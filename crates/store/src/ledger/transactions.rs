//! The sender's transactions: signed bytes are stored before they are sent, with the records they anchor.

use rusqlite::{Connection, OptionalExtension as _, Row, params};
use serde::{Deserialize, Serialize};

use super::edges::{By, may};
use super::rows::{out_of_range, unsigned};
use super::{Anchors, Ledger, batches, database::whole, rows};
use crate::model::{Address, Digest, Hash, RecordState, Timestamp, clean};
use crate::store::StoreError;

/// A signed transaction, before it is sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewTransaction {
    /// Its hash.
    pub hash: Hash,
    /// The signing account.
    pub account: Address,
    /// Its nonce.
    pub nonce: u64,
    /// The signed bytes, as sent.
    pub raw: Vec<u8>,
    /// Its purpose, in a word: `anchor`, `grant`, ….
    pub purpose: String,
    /// The records that it anchors.
    pub anchors: Anchors,
}

/// The state of a transaction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TransactionState {
    /// Signed, perhaps sent; not seen in a block.
    Open,
    /// In a block, successful.
    Mined,
    /// In a block, failed.
    Reverted,
    /// Another one took its nonce.
    Replaced,
}

impl TransactionState {
    const ALL: [Self; 4] = [Self::Open, Self::Mined, Self::Reverted, Self::Replaced];

    fn code(self) -> u8 {
        self as u8
    }
}

/// How a transaction ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TransactionOutcome {
    /// In a block, successful. Its records wait for the watcher, which will find their anchors there.
    Mined {
        /// The block's number.
        block: u64,
        /// The block's hash.
        block_hash: Hash,
        /// Gas used.
        gas_used: Option<u64>,
    },
    /// In a block, failed; its records are stored again.
    Reverted {
        /// The contract's reason.
        reason: String,
    },
    /// Another one took its nonce; its records are stored again.
    Replaced,
}

/// A transaction as the ledger knows it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransactionRow {
    /// Its hash.
    pub hash: Hash,
    /// The signing account.
    pub account: Address,
    /// Its nonce.
    pub nonce: u64,
    /// The signed bytes.
    pub raw: Vec<u8>,
    /// Its purpose.
    pub purpose: String,
    /// The records that it anchors.
    pub anchors: Anchors,
    /// When it was stored here.
    pub signed_at: Timestamp,
    /// Its state.
    pub state: TransactionState,
    /// The block it was mined in.
    pub block: Option<u64>,
    /// Gas used.
    pub gas_used: Option<u64>,
    /// Why it failed.
    pub reason: Option<String>,
    /// The transaction that took its nonce, if it was signed here.
    pub replaced_by: Option<Hash>,
}

const COLUMNS: &str =
    "hash, account, nonce, raw, purpose, digests, signed_at, state, block, gas_used, reason, replaced_by, batch";

impl Ledger {
    /// Stores a signed transaction and moves its records (stored ones, or those of its batch) to submitted, in one
    /// commit. Storing the same open transaction again changes nothing.
    ///
    /// # Errors
    /// [`StoreError::NotReady`] if a record is not stored or batched, [`StoreError::Transaction`] if another open
    /// transaction has this nonce or this one is closed; then nothing is written.
    pub fn submit(&self, transaction: NewTransaction) -> Result<(), StoreError> {
        self.submit_many(vec![transaction])
    }

    /// [`Ledger::submit`] for several, all or none.
    ///
    /// # Errors
    /// See [`Ledger::submit`].
    pub fn submit_many(&self, transactions: Vec<NewTransaction>) -> Result<(), StoreError> {
        self.write_many(transactions.len(), move |session| {
            transactions.iter().try_for_each(|new| keep(session.connection, new))
        })
    }

    /// The transactions of an account in no block yet, by nonce.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn open_transactions(&self, account: Address) -> Result<Vec<TransactionRow>, StoreError> {
        self.read(|connection| {
            let sql = format!("SELECT {COLUMNS} FROM transactions WHERE state = 0 AND account = ?1 ORDER BY nonce");
            let mut statement = connection.prepare_cached(&sql)?;
            let rows = statement.query_map([account.0], transaction_row)?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// The transaction with this hash.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn transaction(&self, hash: Hash) -> Result<Option<TransactionRow>, StoreError> {
        self.read(|connection| {
            let sql = format!("SELECT {COLUMNS} FROM transactions WHERE hash = ?1");
            Ok(connection.prepare_cached(&sql)?.query_row([hash.0], transaction_row).optional()?)
        })
    }

    /// Records how a transaction ended. If it failed or was replaced, its submitted records are stored (or batched)
    /// again; if it was mined they wait for the watcher ([`Ledger::mined`]).
    ///
    /// # Errors
    /// [`StoreError::Transaction`] if the ledger does not hold it.
    pub fn close_transaction(&self, hash: Hash, outcome: TransactionOutcome) -> Result<(), StoreError> {
        self.write(move |session| close(session.connection, hash, outcome))
    }

    /// Replaces an open transaction with another of the same account and nonce, in one commit: records that the new one
    /// also anchors stay submitted (under it), the others are stored again.
    ///
    /// # Errors
    /// [`StoreError::Transaction`] if the old one is not open or the nonce differs, [`StoreError::NotReady`] as in
    /// [`Ledger::submit`].
    pub fn replace_transaction(&self, old: Hash, new: NewTransaction) -> Result<(), StoreError> {
        self.write(move |session| {
            let connection = session.connection;
            let lane = lane(connection, old)?;
            if lane != Some((new.account, new.nonce)) {
                return Err(transaction_error(old, "is not open with the account and nonce of its replacement"));
            }
            close(connection, old, TransactionOutcome::Replaced)?;
            connection
                .prepare_cached("UPDATE transactions SET replaced_by = ?2 WHERE hash = ?1")?
                .execute(params![old.0, new.hash.0])?;
            keep(connection, &new)
        })
    }
}

pub(super) fn transaction_error(hash: Hash, detail: &str) -> StoreError {
    StoreError::Transaction { hash: hash.to_hex(), detail: detail.to_owned() }
}

/// Account and nonce of an open transaction.
fn lane(connection: &Connection, hash: Hash) -> Result<Option<(Address, u64)>, StoreError> {
    let found = connection
        .prepare_cached("SELECT account, nonce FROM transactions WHERE hash = ?1 AND state = 0")?
        .query_row([hash.0], |row| Ok((Address(row.get(0)?), unsigned(row, 1)?)))
        .optional()?;
    Ok(found)
}

fn keep(connection: &Connection, new: &NewTransaction) -> Result<(), StoreError> {
    let known: Option<u8> = connection
        .prepare_cached("SELECT state FROM transactions WHERE hash = ?1")?
        .query_row([new.hash.0], |row| row.get(0))
        .optional()?;
    match known {
        Some(0) => return Ok(()),
        Some(_) => return Err(transaction_error(new.hash, "is already closed")),
        None => {}
    }
    let nonce = whole("nonce", new.nonce)?;
    let taken = connection
        .prepare_cached("SELECT 1 FROM transactions WHERE state = 0 AND account = ?1 AND nonce = ?2")?
        .exists(params![new.account.0, nonce])?;
    if taken {
        return Err(transaction_error(new.hash, "uses the nonce of another open transaction"));
    }
    let (digests, batch): (&[Digest], _) = match &new.anchors {
        Anchors::Nothing => (&[], None),
        Anchors::Digests(digests) => (digests, None),
        Anchors::Batch(root) => (&[], Some(root.0)),
    };
    let bytes: Vec<u8> = digests.iter().flat_map(|digest| digest.0).collect();
    connection
        .prepare_cached(
            "INSERT INTO transactions (hash, account, nonce, raw, purpose, digests, signed_at, state, batch)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, 0, ?8)",
        )?
        .execute(params![
            new.hash.0,
            new.account.0,
            nonce,
            new.raw,
            new.purpose,
            bytes,
            whole("time", Timestamp::now().0)?,
            batch,
        ])?;
    match new.anchors {
        Anchors::Batch(root) => batches::submit(connection, root, new.hash, new.account),
        _ => digests.iter().try_for_each(|digest| mark(connection, *digest, new.hash)),
    }
}

fn mark(connection: &Connection, digest: Digest, hash: Hash) -> Result<(), StoreError> {
    let found = connection
        .prepare_cached("SELECT state FROM records WHERE digest = ?1")?
        .query_row([digest.0], |row| rows::state(row, 0))
        .optional()?;
    // A batched record is anchored with its batch, never individually.
    let ready = |state| state != RecordState::Batched && may(By::Submit, state, RecordState::Submitted);
    if !found.is_some_and(ready) {
        return Err(StoreError::NotReady { digest, found: found.map_or("unknown", RecordState::word) });
    }
    connection.prepare_cached("UPDATE records SET state = ?2, tx = ?3 WHERE digest = ?1")?.execute(params![
        digest.0,
        RecordState::Submitted.code(),
        hash.0
    ])?;
    Ok(())
}

pub(super) fn close(connection: &Connection, hash: Hash, outcome: TransactionOutcome) -> Result<(), StoreError> {
    let (state, place, gas, reason) = match outcome {
        TransactionOutcome::Mined { block, block_hash, gas_used } => {
            let gas = gas_used.map(|gas| whole("gas", gas)).transpose()?;
            (TransactionState::Mined, Some((whole("block", block)?, block_hash.0)), gas, None)
        }
        TransactionOutcome::Reverted { reason } => (TransactionState::Reverted, None, None, Some(clean(&reason, 200))),
        TransactionOutcome::Replaced => (TransactionState::Replaced, None, None, None),
    };
    let changed = connection
        .prepare_cached(
            "UPDATE transactions SET state = ?2, block = ?3, block_hash = ?4, gas_used = ?5, reason = ?6
             WHERE hash = ?1",
        )?
        .execute(params![hash.0, state.code(), place.map(|p| p.0), place.map(|p| p.1), gas, reason])?;
    if changed == 0 {
        return Err(transaction_error(hash, "is not in the ledger"));
    }
    if state == TransactionState::Mined { Ok(()) } else { release(connection, hash) }
}

/// Records of a transaction that will never be mined are stored (or batched) again.
fn release(connection: &Connection, hash: Hash) -> Result<(), StoreError> {
    let (digests, batch): (Vec<u8>, Option<[u8; 32]>) = connection
        .prepare_cached("SELECT digests, batch FROM transactions WHERE hash = ?1")?
        .query_row([hash.0], |row| Ok((row.get(0)?, row.get(1)?)))?;
    if let Some(root) = batch {
        return batches::release(connection, Hash(root), hash);
    }
    let mut statement = connection.prepare_cached(
        "UPDATE records SET tx = NULL, state = CASE WHEN state <> ?3 THEN state
             WHEN EXISTS (SELECT 1 FROM leaves WHERE record = n) THEN ?6 ELSE ?4 END
         WHERE digest = ?1 AND tx = ?2 AND block IS NULL AND state IN (?3, ?5)",
    )?;
    let [submitted, stored, tampered, batched] =
        [RecordState::Submitted, RecordState::Stored, RecordState::Tampered, RecordState::Batched]
            .map(RecordState::code);
    for digest in digests.chunks_exact(Digest::LENGTH) {
        statement.execute(params![digest, hash.0, submitted, stored, tampered, batched])?;
    }
    Ok(())
}

fn transaction_row(row: &Row<'_>) -> rusqlite::Result<TransactionRow> {
    let state: usize = row.get::<_, u8>(7)?.into();
    let digests: Vec<u8> = row.get(5)?;
    Ok(TransactionRow {
        hash: Hash(row.get(0)?),
        account: Address(row.get(1)?),
        nonce: unsigned(row, 2)?,
        raw: row.get(3)?,
        purpose: row.get(4)?,
        anchors: match row.get::<_, Option<_>>(12)?.map(Hash) {
            Some(root) => Anchors::Batch(root),
            None if digests.is_empty() => Anchors::Nothing,
            None => Anchors::Digests(digests.chunks_exact(Digest::LENGTH).filter_map(Digest::from_slice).collect()),
        },
        signed_at: Timestamp(unsigned(row, 6)?),
        state: TransactionState::ALL.get(state).copied().ok_or_else(|| out_of_range(7))?,
        block: row.get::<_, Option<i64>>(8)?.map(i64::cast_unsigned),
        gas_used: row.get::<_, Option<i64>>(9)?.map(i64::cast_unsigned),
        reason: row.get(10)?,
        replaced_by: row.get::<_, Option<_>>(11)?.map(Hash),
    })
}
