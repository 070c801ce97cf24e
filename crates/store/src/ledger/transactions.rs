//! The sender's transactions, stored with the records they anchor before they are sent.

use serde::{Deserialize, Serialize};

use super::rows::{self, By, may, of_its_batch, optional, out_of_range, time, unsigned};
use super::{Anchors, Lanes, Session, batches};
use crate::StoreError;
use crate::database::whole;
use crate::model::{Address, Digest, Hash, RecordState, Timestamp, clean};
use crate::sql::{self, Connection, Row, params};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewTransaction {
    pub hash: Hash,
    pub account: Address,
    pub nonce: u64,
    /// As sent.
    pub raw: Vec<u8>,
    /// `anchor`, `grant`, ….
    pub purpose: String,
    pub anchors: Anchors,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TransactionState {
    /// Perhaps sent; in no block.
    Open,
    Mined,
    Reverted,
    Replaced,
}

impl TransactionState {
    const ALL: [Self; 4] = [Self::Open, Self::Mined, Self::Reverted, Self::Replaced];
}

#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(missing_docs, reason = "each variant's line names its fields")]
pub enum TransactionOutcome {
    /// Its records wait for the watcher.
    Mined { block: u64, block_hash: Hash, gas_used: Option<u64> },
    /// Its records are stored again.
    Reverted { reason: String },
    /// Another took its nonce; its records are stored again.
    Replaced,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransactionRow {
    pub hash: Hash,
    pub account: Address,
    pub nonce: u64,
    pub raw: Vec<u8>,
    pub purpose: String,
    pub anchors: Anchors,
    pub signed_at: Timestamp,
    pub state: TransactionState,
    pub block: Option<u64>,
    pub gas_used: Option<u64>,
    pub reason: Option<String>,
    /// If signed here.
    pub replaced_by: Option<Hash>,
}

const COLUMNS: &str =
    "hash, account, nonce, raw, purpose, digests, signed_at, state, block, gas_used, reason, replaced_by, batch";

impl Lanes {
    /// Stores it and moves its records to submitted in one commit. [`StoreError::NotReady`] if a record is not stored
    /// or batched, [`StoreError::Transaction`] if the nonce is in use or the transaction is closed.
    pub fn submit(&self, transaction: NewTransaction) -> Result<(), StoreError> {
        self.submit_many(vec![transaction])
    }

    /// All or none.
    pub fn submit_many(&self, transactions: Vec<NewTransaction>) -> Result<(), StoreError> {
        self.0.write_many(transactions.len(), move |session| {
            transactions.iter().try_for_each(|new| keep(session.connection, new))
        })
    }

    /// In no block, by nonce.
    pub fn open_transactions(&self, account: Address) -> Result<Vec<TransactionRow>, StoreError> {
        let sql = format!("SELECT {COLUMNS} FROM transactions WHERE state = 0 AND account = ?1 ORDER BY nonce");
        self.0.list(&sql, [account.0], transaction_row)
    }

    pub fn transaction(&self, hash: Hash) -> Result<Option<TransactionRow>, StoreError> {
        let sql = format!("SELECT {COLUMNS} FROM transactions WHERE hash = ?1");
        self.0.find(&sql, [hash.0], transaction_row)
    }

    /// Replaces an open transaction with one of the same account and nonce in one commit: records that both anchor stay
    /// submitted, others are stored again.
    pub fn replace_transaction(&self, old: Hash, new: NewTransaction) -> Result<(), StoreError> {
        self.0.write(move |Session { connection, .. }| {
            let sql = "SELECT account, nonce FROM transactions WHERE hash = ?1 AND state = 0";
            let lane = connection.find(sql, [old.0], |row| Ok((Address(row.get(0)?), unsigned(row, 1)?)))?;
            if lane != Some((new.account, new.nonce)) {
                return Err(transaction_error(old, "is not open with the account and nonce of its replacement"));
            }
            close(connection, old, &TransactionOutcome::Replaced)?;
            connection.run("UPDATE transactions SET replaced_by = ?2 WHERE hash = ?1", params![old.0, new.hash.0])?;
            keep(connection, &new)
        })
    }
}

pub(super) fn transaction_error(hash: Hash, detail: &str) -> StoreError {
    StoreError::Transaction { hash: hash.to_hex(), detail: detail.to_owned() }
}

fn keep(connection: &Connection, new: &NewTransaction) -> Result<(), StoreError> {
    let sql = "SELECT state FROM transactions WHERE hash = ?1";
    match connection.find(sql, [new.hash.0], |row| row.get::<u8>(0))? {
        Some(0) => return Ok(()),
        Some(_) => return Err(transaction_error(new.hash, "is already closed")),
        None => {}
    }
    let nonce = whole("nonce", new.nonce)?;
    let sql = "SELECT 1 FROM transactions WHERE state = 0 AND account = ?1 AND nonce = ?2";
    if connection.has(sql, params![new.account.0, nonce])? {
        return Err(transaction_error(new.hash, "uses the nonce of another open transaction"));
    }
    let (digests, batch): (&[Digest], _) = match &new.anchors {
        Anchors::Nothing => (&[], None),
        Anchors::Digests(digests) => (digests, None),
        Anchors::Batch(root) => (&[], Some(root.0)),
    };
    let bytes: Vec<u8> = digests.iter().flat_map(|digest| digest.0).collect();
    let sql = "INSERT INTO transactions (hash, account, nonce, raw, purpose, digests, signed_at, state, batch)
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, 0, ?8)";
    let now = whole("time", Timestamp::now().0)?;
    let NewTransaction { hash, account, raw, purpose, .. } = new;
    connection.run(sql, params![hash.0, account.0, nonce, raw, purpose, bytes, now, batch])?;
    match new.anchors {
        Anchors::Batch(root) => batches::submit(connection, root, new.hash, new.account),
        _ => digests.iter().try_for_each(|digest| mark(connection, *digest, new.hash)),
    }
}

fn mark(connection: &Connection, digest: Digest, hash: Hash) -> Result<(), StoreError> {
    let sql = "SELECT state FROM records WHERE digest = ?1";
    let found = connection.find(sql, [digest.0], |row| rows::state(row, 0))?;
    // A batched record is anchored with its batch, never individually.
    let ready = |state| state != RecordState::Batched && may(By::Submit, state, RecordState::Submitted);
    if !found.is_some_and(ready) {
        return Err(StoreError::NotReady { digest, found: found.map_or("unknown", RecordState::word) });
    }
    let sql = "UPDATE records SET state = ?2, tx = ?3 WHERE digest = ?1";
    connection.run(sql, params![digest.0, RecordState::Submitted.code(), hash.0])
}

pub(super) fn close(connection: &Connection, hash: Hash, outcome: &TransactionOutcome) -> Result<(), StoreError> {
    let (state, place, gas, reason) = match outcome {
        TransactionOutcome::Mined { block, block_hash, gas_used } => {
            let gas = gas_used.map(|gas| whole("gas", gas)).transpose()?;
            (TransactionState::Mined, Some((whole("block", *block)?, block_hash.0)), gas, None)
        }
        TransactionOutcome::Reverted { reason } => (TransactionState::Reverted, None, None, Some(clean(reason, 200))),
        TransactionOutcome::Replaced => (TransactionState::Replaced, None, None, None),
    };
    let sql = "UPDATE transactions SET state = ?2, block = ?3, block_hash = ?4, gas_used = ?5, reason = ?6
        WHERE hash = ?1";
    let (block, block_hash) = place.unzip();
    if connection.changed(sql, params![hash.0, state as u8, block, block_hash, gas, reason])? == 0 {
        return Err(transaction_error(hash, "is not in the ledger"));
    }
    match state {
        TransactionState::Mined => batches::place_transaction(connection, hash),
        _ => release(connection, hash),
    }
}

/// Its records are stored or batched again, or wait for their batch's transaction.
fn release(connection: &Connection, hash: Hash) -> Result<(), StoreError> {
    let (digests, batch) = carried(connection, hash)?;
    if let Some(root) = batch {
        return batches::release(connection, Hash(root), hash);
    }
    let sql = concat!(
        "UPDATE records SET tx = NULL, state = CASE WHEN state <> ?3 OR ",
        of_its_batch!("tx"),
        " IS NOT NULL THEN state WHEN EXISTS (SELECT 1 FROM leaves WHERE record = n) THEN ?6 ELSE ?4 END
        WHERE digest = ?1 AND tx = ?2 AND block IS NULL AND state IN (?3, ?5)"
    );
    let [submitted, stored, tampered, batched] =
        [RecordState::Submitted, RecordState::Stored, RecordState::Tampered, RecordState::Batched]
            .map(RecordState::code);
    let digests = digests.chunks_exact(Digest::LENGTH);
    connection.run_each(sql, digests.map(|digest| (digest, hash.0, submitted, stored, tampered, batched)))?;
    Ok(())
}

/// Its records' digests, and its batch's root.
fn carried(connection: &Connection, hash: Hash) -> Result<(Vec<u8>, Option<[u8; 32]>), StoreError> {
    let sql = "SELECT digests, batch FROM transactions WHERE hash = ?1";
    Ok(connection.one(sql, [hash.0], |row| Ok((row.get(0)?, row.get(1)?)))?)
}

fn transaction_row(row: &Row<'_>) -> sql::Result<TransactionRow> {
    let state: usize = row.get::<u8>(7)?.into();
    let digests: Vec<u8> = row.get(5)?;
    Ok(TransactionRow {
        hash: Hash(row.get(0)?),
        account: Address(row.get(1)?),
        nonce: unsigned(row, 2)?,
        raw: row.get(3)?,
        purpose: row.get(4)?,
        anchors: match row.get::<Option<_>>(12)?.map(Hash) {
            Some(root) => Anchors::Batch(root),
            None if digests.is_empty() => Anchors::Nothing,
            None => Anchors::Digests(digests.chunks_exact(Digest::LENGTH).filter_map(Digest::from_slice).collect()),
        },
        signed_at: time(row, 6)?,
        state: TransactionState::ALL.get(state).copied().ok_or_else(|| out_of_range(7))?,
        block: optional(row, 8)?,
        gas_used: optional(row, 9)?,
        reason: row.get(10)?,
        replaced_by: row.get::<Option<_>>(11)?.map(Hash),
    })
}

// Nonce lanes: open transactions, and replacing one with another along with everything it carries.

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LaneCount {
    pub open: u64,
    pub highest: Option<u64>,
    /// The oldest's first signature.
    pub oldest: Option<Timestamp>,
}

/// Without its bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenTransaction {
    pub hash: Hash,
    pub nonce: u64,
    pub purpose: String,
    /// Its records go back if it fails; else the call must be signed again.
    pub anchors: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reissue {
    pub hash: Hash,
    /// New, or the same at another price.
    pub nonce: u64,
    pub raw: Vec<u8>,
}

impl Lanes {
    /// From an index.
    pub fn lane_count(&self, account: Address) -> Result<LaneCount, StoreError> {
        let sql = "SELECT count(*), max(nonce), min(signed_at) FROM transactions WHERE state = 0 AND account = ?1";
        self.0.one(sql, [account.0], |row| {
            let (open, highest, oldest) = (unsigned(row, 0)?, optional(row, 1)?, optional(row, 2)?.map(Timestamp));
            Ok(LaneCount { open, highest, oldest })
        })
    }

    /// Of those signed here, whatever became of them.
    pub fn highest_nonce(&self, account: Address) -> Result<Option<u64>, StoreError> {
        self.0.one("SELECT max(nonce) FROM transactions WHERE account = ?1", [account.0], |row| optional(row, 0))
    }

    /// Number, gas and records of the newest `most` anchoring transactions in blocks, from an index.
    pub fn anchoring_gas(&self, account: Address, most: u64) -> Result<(u64, u64, u64), StoreError> {
        let most = whole("transactions", most)?;
        let sql = "SELECT count(*), coalesce(sum(gas_used), 0), coalesce(sum(records), 0) FROM (
                SELECT gas_used, CASE WHEN batch IS NULL THEN length(digests) / 32
                    ELSE (SELECT count FROM batches WHERE root = batch) END AS records
                FROM transactions WHERE account = ?1 AND state = 1 AND gas_used IS NOT NULL
                    AND (batch IS NOT NULL OR length(digests) > 0)
                ORDER BY nonce DESC LIMIT ?2) AS newest";
        let values = params![account.0, most];
        self.0.one(sql, values, |row| Ok((unsigned(row, 0)?, unsigned(row, 1)?, unsigned(row, 2)?)))
    }

    /// By nonce.
    pub fn open_lane(&self, account: Address) -> Result<Vec<OpenTransaction>, StoreError> {
        let sql = "SELECT hash, nonce, purpose, length(digests) > 0 OR batch IS NOT NULL FROM transactions
            WHERE state = 0 AND account = ?1 ORDER BY nonce";
        self.0.list(sql, [account.0], |row| {
            let (hash, nonce) = (Hash(row.get(0)?), unsigned(row, 1)?);
            Ok(OpenTransaction { hash, nonce, purpose: row.get(2)?, anchors: row.get(3)? })
        })
    }

    pub fn raw_transaction(&self, hash: Hash) -> Result<Option<Vec<u8>>, StoreError> {
        self.0.find("SELECT raw FROM transactions WHERE hash = ?1", [hash.0], |row| row.get(0))
    }

    /// Every transaction signed here with a nonce, newest first.
    pub fn of_nonce(&self, account: Address, nonce: u64) -> Result<Vec<(Hash, Vec<u8>)>, StoreError> {
        let nonce = whole("nonce", nonce)?;
        let sql = "SELECT hash, raw FROM transactions WHERE account = ?1 AND nonce = ?2 ORDER BY key DESC";
        self.0.list(sql, params![account.0, nonce], |row| Ok((Hash(row.get(0)?), row.get(1)?)))
    }

    /// Records outcomes in one commit, all or none. Failed or replaced: records are stored or batched again; mined:
    /// they wait for the watcher ([`Batches::mined`]).
    pub fn close_transactions(&self, closings: Vec<(Hash, TransactionOutcome)>) -> Result<(), StoreError> {
        self.0.write_many(closings.len(), move |session| {
            closings.iter().try_for_each(|(hash, outcome)| close(session.connection, *hash, outcome))
        })
    }

    /// Replaces an open transaction with the same call, signed again, in one commit: purpose, age and anchors pass on.
    /// The new one may be one replaced before, but not one closed by the chain.
    pub fn reissue(&self, old: Hash, new: Reissue) -> Result<(), StoreError> {
        let nonce = whole("nonce", new.nonce)?;
        self.0.write(move |Session { connection, .. }| {
            let sql = "INSERT INTO transactions (hash, account, nonce, raw, purpose, digests, signed_at, state, batch)
                SELECT ?2, account, ?3, ?4, purpose, digests, signed_at, 0, batch FROM transactions
                WHERE hash = ?1 AND state = 0
                ON CONFLICT (hash) DO UPDATE SET state = 0, replaced_by = NULL
                WHERE transactions.state = 3 AND transactions.hash <> ?1";
            if connection.changed(sql, params![old.0, new.hash.0, nonce, new.raw])? == 0 {
                return Err(transaction_error(old, "is not open, or nothing about it would change"));
            }
            hand_over(connection, old, new.hash)?;
            supersede(connection, old, new.hash)
        })
    }

    /// The chain chose `winner`, the same call and nonce as the open `loser`: it takes what the loser carries.
    pub fn decide_nonce(&self, loser: Hash, winner: Hash, outcome: TransactionOutcome) -> Result<(), StoreError> {
        self.0.write(move |Session { connection, .. }| {
            hand_over(connection, loser, winner)?;
            supersede(connection, loser, winner)?;
            connection.run("UPDATE transactions SET replaced_by = NULL WHERE hash = ?1", [winner.0])?;
            close(connection, winner, &outcome)
        })
    }
}

fn hand_over(connection: &Connection, from: Hash, to: Hash) -> Result<(), StoreError> {
    let (digests, batch) = carried(connection, from)?;
    if let Some(root) = batch {
        let sql = "UPDATE batches SET tx = ?3 WHERE root = ?1 AND tx = ?2 AND block IS NULL";
        connection.run(sql, [root, from.0, to.0])?;
    }
    let sql = "UPDATE records SET tx = ?3 WHERE digest = ?1 AND tx = ?2 AND block IS NULL";
    connection.run_each(sql, digests.chunks_exact(Digest::LENGTH).map(|digest| (digest, from.0, to.0)))?;
    Ok(())
}

/// Keeps its records.
fn supersede(connection: &Connection, old: Hash, new: Hash) -> Result<(), StoreError> {
    connection.run("UPDATE transactions SET state = 3, replaced_by = ?2 WHERE hash = ?1", [old.0, new.0])
}
