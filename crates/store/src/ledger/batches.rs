//! Merkle batches: closing them, finding those still to be anchored, their state on the chain, a record's proof.

use rusqlite::{Connection, OptionalExtension as _, Row, params};
use serde::{Deserialize, Serialize};

use super::append::count;
use super::edges::{By, may};
use super::rows::{self, unsigned};
use super::{Ledger, RecordRow, database::whole, named, rights};
use crate::chain::merkle::{Inclusion, Leaf};
use crate::model::{Address, Digest, Hash, RecordState, RecorderId, SignerId, Timestamp, TopicId};
use crate::store::StoreError;

/// A batch to be closed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewBatch {
    /// The account that anchors them.
    pub owner: Address,
    /// Merkle root over the leaves.
    pub root: Hash,
    /// The records in leaf order, each with its path to the root.
    pub leaves: Vec<(Digest, Vec<Hash>)>,
}

/// A closed batch that no transaction anchors yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WaitingBatch {
    /// Merkle root.
    pub root: Hash,
    /// Leaves.
    pub count: u64,
}

/// A root found in a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RootSighting {
    /// The account that anchored it.
    pub account: Address,
    /// The root.
    pub root: Hash,
    /// The number of its leaves, as the chain says.
    pub count: u64,
    /// The transaction that anchored it.
    pub transaction: Hash,
    /// Its block's number.
    pub block: u64,
    /// Its block's hash.
    pub block_hash: Hash,
}

/// A record's place in its batch, and the batch's state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BatchPlace {
    /// Index, count, path and root.
    pub inclusion: Inclusion,
    /// When the batch was closed.
    pub closed_at: Timestamp,
    /// The account that anchored the root, or is to.
    pub account: Option<Address>,
    /// The block of the root's first anchoring.
    pub block: Option<u64>,
    /// That block's hash.
    pub block_hash: Option<Hash>,
    /// The transaction that anchored it, or is to.
    pub transaction: Option<Hash>,
}

/// A record with its place, read in one transaction. Whoever compares the two takes them from here: read one after the
/// other, an honest ledger contradicts itself whenever the watcher writes in between.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlacedRecord {
    /// The record.
    pub row: RecordRow,
    /// Its place, if it is in a batch.
    pub place: Option<BatchPlace>,
}

/// What a transaction anchors.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Anchors {
    /// No records: it is a grant, a registration, ….
    Nothing,
    /// These records, individually.
    Digests(Vec<Digest>),
    /// All records of the batch with this root.
    Batch(Hash),
}

impl Ledger {
    /// Closes a batch: stores its root and every record's path, and moves its records from stored to batched, in one
    /// commit. Closing the same batch again changes nothing, unless its records have left it: then it waits to be
    /// anchored again.
    ///
    /// # Errors
    /// [`StoreError::NotReady`] if a record is not stored; then nothing is written.
    pub fn close_batch(&self, batch: NewBatch) -> Result<(), StoreError> {
        self.write_many(batch.leaves.len(), move |session| close(session.connection, &batch))
    }

    /// Closed batches of an owner that no transaction anchors, oldest first.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn waiting_batches(&self, owner: Address, limit: usize) -> Result<Vec<WaitingBatch>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT root, count FROM batches INDEXED BY batches_waiting
                 WHERE owner = ?1 AND tx IS NULL AND EXISTS (SELECT 1 FROM leaves WHERE batch = key)
                 ORDER BY key LIMIT ?2",
            )?;
            let limit = i64::try_from(limit).unwrap_or(i64::MAX);
            let rows = statement.query_map(params![owner.0, limit], |row| {
                Ok(WaitingBatch { root: Hash(row.get(0)?), count: unsigned(row, 1)? })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Roots anchored by an account's open transactions, by nonce.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn open_roots(&self, account: Address) -> Result<Vec<Hash>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT batch FROM transactions WHERE state = 0 AND account = ?1 AND batch IS NOT NULL ORDER BY nonce",
            )?;
            let rows = statement.query_map([account.0], |row| row.get(0).map(Hash))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// How many stored records that an account anchors (its own, and those it keeps for others) wait for a batch, and
    /// when the first captured of them was acknowledged.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn unbatched(&self, keeper: Address) -> Result<(u64, Option<Timestamp>), StoreError> {
        self.read(|connection| {
            // Usually none waits. Then no stream is looked at: a gateway may have ten thousand, and this is asked at each block.
            let any = connection
                .prepare_cached("SELECT 1 FROM records INDEXED BY records_by_state WHERE state = ?1 LIMIT 1")?
                .exists([RecordState::Stored.code()])?;
            if !any {
                return Ok((0, None));
            }
            let found = connection
                .prepare_cached(
                    "SELECT coalesce(sum(coalesce((SELECT records FROM counters WHERE stream = streams.key AND state = ?2), 0)), 0),
                     min((SELECT acknowledged_at FROM records INDEXED BY records_by_state
                          WHERE state = ?2 AND stream = streams.key ORDER BY captured_at LIMIT 1))
                     FROM streams JOIN topics ON topics.key = topic WHERE coalesce(keeper, owner) = ?1",
                )?
                .query_row(params![keeper.0, RecordState::Stored.code()], |row| {
                    Ok((unsigned(row, 0)?, row.get::<_, Option<i64>>(1)?.map(|at| Timestamp(at.cast_unsigned()))))
                })?;
            Ok(found)
        })
    }

    /// Up to `limit` stored records that an account anchors, its own and those it keeps for others, as leaves, topic by
    /// topic in the order of capture.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn stored_leaves(&self, keeper: Address, limit: usize) -> Result<Vec<Leaf>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT recorders.id, topics.topic_id, seq, digest, topics.owner, recorders.signer FROM streams
                 JOIN topics ON topics.key = streams.topic JOIN recorders ON recorders.key = topics.recorder
                 JOIN records INDEXED BY records_by_state ON state = ?2 AND stream = streams.key
                 WHERE coalesce(topics.keeper, topics.owner) = ?1 ORDER BY streams.key, captured_at LIMIT ?3",
            )?;
            let limit = i64::try_from(limit).unwrap_or(i64::MAX);
            let rows = statement.query_map(params![keeper.0, RecordState::Stored.code(), limit], |row| {
                let (recorder, topic_id) = (RecorderId(row.get(0)?), TopicId(row.get(1)?));
                let (owner, signer) = (Address(row.get(4)?), SignerId(row.get(5)?));
                Ok(Leaf { owner, signer, recorder, topic_id, seq: unsigned(row, 2)?, digest: Digest(row.get(3)?) })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Takes in roots found on the chain: pending records of the batch are now mined, with this transaction and block;
    /// those in a block individually stay there. A root already in a block keeps that block: the earliest counts. Roots
    /// of other ledgers, or over another number of leaves, are skipped. Returns how many records changed; seeing the
    /// same again changes none.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing is recorded.
    pub fn anchored(&self, sightings: &[RootSighting]) -> Result<u64, StoreError> {
        let sightings = sightings.to_vec();
        self.write(move |session| {
            sightings.iter().try_fold(0, |changed, sighting| Ok(changed + see(session.connection, sighting)?))
        })
    }

    /// Which of these roots, of batches of this ledger, it has not taken in: they still wait for a block.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn waiting_roots(&self, sightings: &[RootSighting]) -> Result<Vec<Hash>, StoreError> {
        self.read(|connection| {
            // An anchor that did not count is no reason to read its block again.
            let sql = "SELECT 1 FROM batches WHERE root = ?1 AND count = ?2 AND block IS NULL
                       AND NOT EXISTS (SELECT 1 FROM leaves JOIN passed_over ON passed_over.record = leaves.record
                                       WHERE leaves.batch = batches.key AND passed_over.block = ?3)";
            let mut find = connection.prepare_cached(sql)?;
            let mut waiting = Vec::new();
            for sighting in sightings {
                let (count, block) = (whole("count", sighting.count)?, whole("block", sighting.block)?);
                if find.exists(params![sighting.root.0, count, block])? {
                    waiting.push(sighting.root);
                }
            }
            Ok(waiting)
        })
    }

    /// A record and its place in its batch, of one moment; `None` if the record is not here.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn placed(&self, digest: Digest) -> Result<Option<PlacedRecord>, StoreError> {
        Ok(self.placed_all(&[digest])?.pop().flatten())
    }

    /// The same for several records, in their order, all of one moment.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn placed_all(&self, digests: &[Digest]) -> Result<Vec<Option<PlacedRecord>>, StoreError> {
        self.read(|connection| {
            let rows = named::rows_of(connection, digests)?;
            let mut find = connection.prepare_cached(
                "SELECT leaf, count, path, root, closed_at, account, batches.block, batches.block_hash, batches.tx
                 FROM records JOIN leaves ON record = n JOIN batches ON key = batch WHERE digest = ?1",
            )?;
            let mut with_place = |row: RecordRow| -> Result<PlacedRecord, StoreError> {
                let place = find.query_row([row.digest.0], place).optional()?;
                Ok(PlacedRecord { row, place })
            };
            rows.into_iter().map(|row| row.map(&mut with_place).transpose()).collect()
        })
    }
}

fn place(row: &Row<'_>) -> rusqlite::Result<BatchPlace> {
    let path: Vec<u8> = row.get(2)?;
    Ok(BatchPlace {
        inclusion: Inclusion {
            index: unsigned(row, 0)?,
            count: unsigned(row, 1)?,
            path: path.chunks_exact(Hash::LENGTH).filter_map(Hash::from_slice).collect(),
            root: Hash(row.get(3)?),
        },
        closed_at: Timestamp(unsigned(row, 4)?),
        account: row.get::<_, Option<_>>(5)?.map(Address),
        block: row.get::<_, Option<i64>>(6)?.map(i64::cast_unsigned),
        block_hash: row.get::<_, Option<_>>(7)?.map(Hash),
        transaction: row.get::<_, Option<_>>(8)?.map(Hash),
    })
}

fn close(connection: &Connection, batch: &NewBatch) -> Result<(), StoreError> {
    let key = match key_of(connection, batch.root)? {
        Some(known) if rights::begin_again(connection, known)? => known,
        Some(_) => return Ok(()),
        None => {
            let leaves = i64::try_from(batch.leaves.len()).unwrap_or(i64::MAX);
            connection
                .prepare_cached(
                    "INSERT INTO batches (root, owner, count, closed_at, closed_here) VALUES (?1, ?2, ?3, ?4, 1)",
                )?
                .execute(params![batch.root.0, batch.owner.0, leaves, whole("time", Timestamp::now().0)?])?;
            connection.last_insert_rowid()
        }
    };
    let mut find = connection.prepare_cached("SELECT n, state FROM records WHERE digest = ?1")?;
    let mut add = connection.prepare_cached("INSERT INTO leaves VALUES (?1, ?2, ?3, ?4)")?;
    let mut move_on = connection.prepare_cached("UPDATE records SET state = ?2 WHERE n = ?1")?;
    for (index, (digest, path)) in (0_i64..).zip(&batch.leaves) {
        let found = find.query_row([digest.0], |row| Ok((row.get::<_, i64>(0)?, rows::state(row, 1)?))).optional()?;
        let (record, state) = found.ok_or(StoreError::NotReady { digest: *digest, found: "unknown" })?;
        if !may(By::Batch, state, RecordState::Batched) {
            return Err(StoreError::NotReady { digest: *digest, found: state.word() });
        }
        let path: Vec<u8> = path.iter().flat_map(|step| step.0).collect();
        add.execute(params![record, key, index, path])?;
        move_on.execute(params![record, RecordState::Batched.code()])?;
    }
    Ok(())
}

fn key_of(connection: &Connection, root: Hash) -> Result<Option<i64>, StoreError> {
    let key = connection
        .prepare_cached("SELECT key FROM batches WHERE root = ?1")?
        .query_row([root.0], |row| row.get(0))
        .optional()?;
    Ok(key)
}

/// A root was found in a block; returns how many records are mined by that.
pub(super) fn see(connection: &Connection, sighting: &RootSighting) -> Result<u64, StoreError> {
    let (block, leaves) = (whole("block", sighting.block)?, whole("count", sighting.count)?);
    let found = connection
        .prepare_cached("SELECT key FROM batches WHERE root = ?1 AND count = ?2 AND block IS NULL")?
        .query_row(params![sighting.root.0, leaves], |row| row.get::<_, i64>(0))
        .optional()?;
    let Some(key) = found else { return Ok(0) };
    connection
        .prepare_cached(
            "UPDATE batches SET account = ?2, tx = ?3, block = ?4, block_hash = ?5, proof = NULL WHERE key = ?1",
        )?
        .execute(params![key, sighting.account.0, sighting.transaction.0, block, sighting.block_hash.0])?;
    let changed = connection
        .prepare_cached(
            "UPDATE records SET tx = ?2, block = ?3, block_hash = ?4,
             state = CASE WHEN state IN (?5, ?6) THEN ?7 ELSE state END
             WHERE block IS NULL AND n IN (SELECT record FROM leaves WHERE batch = ?1)",
        )?
        .execute(params![
            key,
            sighting.transaction.0,
            block,
            sighting.block_hash.0,
            RecordState::Batched.code(),
            RecordState::Submitted.code(),
            RecordState::Mined.code(),
        ])?;
    Ok(count(changed))
}

/// A record joined a batch that is already in a block, or is now through this anchor.
pub(super) fn see_record(
    connection: &Connection,
    record: i64,
    batch: i64,
    anchor: &RootSighting,
) -> Result<(), StoreError> {
    let seen = see(connection, anchor)?;
    if seen > 0 {
        return Ok(());
    }
    connection
        .prepare_cached(
            "UPDATE records SET (tx, block, block_hash) = (SELECT tx, block, block_hash FROM batches WHERE key = ?2),
             state = ?3 WHERE n = ?1 AND (SELECT block FROM batches WHERE key = ?2) IS NOT NULL",
        )?
        .execute(params![record, batch, RecordState::Mined.code()])?;
    Ok(())
}

/// A transaction that anchors the batch was signed: its records are now submitted.
pub(super) fn submit(
    connection: &Connection,
    root: Hash,
    transaction: Hash,
    account: Address,
) -> Result<(), StoreError> {
    let detail = |detail: &str| StoreError::Transaction { hash: transaction.to_hex(), detail: detail.to_owned() };
    let key = key_of(connection, root)?.ok_or_else(|| detail("anchors a batch that is not in the ledger"))?;
    let taken = connection
        .prepare_cached("UPDATE batches SET tx = ?2, account = ?3 WHERE key = ?1 AND tx IS NULL")?
        .execute(params![key, transaction.0, account.0])?;
    if taken == 0 {
        return Err(detail("anchors a batch that another transaction anchors"));
    }
    connection
        .prepare_cached(
            "UPDATE records SET tx = ?2, state = CASE state WHEN ?3 THEN ?4 ELSE state END
             WHERE block IS NULL AND n IN (SELECT record FROM leaves WHERE batch = ?1)",
        )?
        .execute(params![key, transaction.0, RecordState::Batched.code(), RecordState::Submitted.code()])?;
    Ok(())
}

/// The transaction will never be mined: unless something else anchored the batch, it waits again.
pub(super) fn release(connection: &Connection, root: Hash, transaction: Hash) -> Result<(), StoreError> {
    let Some(key) = key_of(connection, root)? else { return Ok(()) };
    let freed = connection
        .prepare_cached("UPDATE batches SET tx = NULL, account = NULL WHERE key = ?1 AND tx = ?2 AND block IS NULL")?
        .execute(params![key, transaction.0])?;
    if freed == 0 {
        return Ok(());
    }
    connection
        .prepare_cached(
            "UPDATE records SET tx = NULL, state = CASE state WHEN ?3 THEN ?4 ELSE state END
             WHERE block IS NULL AND tx = ?2 AND n IN (SELECT record FROM leaves WHERE batch = ?1)",
        )?
        .execute(params![key, transaction.0, RecordState::Submitted.code(), RecordState::Batched.code()])?;
    Ok(())
}

/// Blocks from this one on are gone, and batches lose their block. Whichever account anchored them, one of our open
/// transactions that does so continues.
pub(super) fn take_back(connection: &Connection, block: i64) -> Result<(), StoreError> {
    connection
        .prepare_cached(
            "UPDATE batches SET block = NULL, block_hash = NULL, (tx, account) =
             (SELECT hash, transactions.account FROM transactions
              WHERE transactions.batch = root AND state = 0 ORDER BY nonce, transactions.key LIMIT 1)
             WHERE block >= ?1",
        )?
        .execute([block])?;
    Ok(())
}
