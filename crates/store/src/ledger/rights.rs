//! Records whose signer may not sign for its owner wait here, and anchors that do not count are ignored. The ledger
//! does not know who has which right; its callers do.

use rusqlite::{Connection, OptionalExtension as _, params};

use super::Ledger;
use super::append::count;
use super::edges::{By, may};
use super::rows;
use crate::chain::merkle::Leaf;
use crate::model::{Address, Digest, RecordState, RecorderId, SignerId, TopicId};
use crate::store::StoreError;

/// The most records moved in one commit.
const MOST: usize = 8192;

/// A signer with records still to be anchored by an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WaitingSigner {
    /// The owner it signed for.
    pub owner: Address,
    /// The key's id.
    pub signer: SignerId,
    /// Some of them are waiting for the right.
    pub held: bool,
    /// Some of them are ready to be anchored.
    pub ready: bool,
}

/// The streams of one signer and owner that an account anchors.
const STREAMS: &str =
    "SELECT s.key FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
     WHERE coalesce(t.keeper, t.owner) = ?1 AND t.owner = ?2 AND r.signer = ?3";

impl Ledger {
    /// The signers of the records that `keeper` anchors and that are stored, in a closed batch, or waiting for a right.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn waiting_signers(&self, keeper: Address) -> Result<Vec<WaitingSigner>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT t.owner, r.signer, max(c.state = ?2), max(c.state <> ?2)
                 FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
                 JOIN counters c ON c.stream = s.key
                 WHERE coalesce(t.keeper, t.owner) = ?1 AND c.records > 0 AND c.state IN (?2, ?3, ?4)
                 GROUP BY t.owner, r.signer",
            )?;
            let [held, stored, batched] =
                [RecordState::RightEnded, RecordState::Stored, RecordState::Batched].map(RecordState::code);
            let found = statement.query_map(params![keeper.0, held, stored, batched], |row| {
                let (owner, signer) = (Address(row.get(0)?), SignerId(row.get(1)?));
                Ok(WaitingSigner { owner, signer, held: row.get(2)?, ready: row.get(3)? })
            })?;
            Ok(found.collect::<Result<_, _>>()?)
        })
    }

    /// A signer's right has ended: those of its records that no transaction anchors now wait. Unsent batches that
    /// contain one of them are dissolved, and their other records are stored again. Returns how many records began to
    /// wait; 0 once all do.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is moved.
    pub fn hold_signer(&self, keeper: Address, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.write_many(MOST, move |session| {
            for batch in unsent_batches(session.connection, keeper, owner, signer)? {
                dissolve(session.connection, batch)?;
            }
            shift(session.connection, (keeper, owner, signer), RecordState::Stored, RecordState::RightEnded)
        })
    }

    /// A signer's right is back: its records are stored, and anchored like all others. Returns how many; 0 once none
    /// waits any more.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is moved.
    pub fn free_signer(&self, keeper: Address, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.write_many(MOST, move |session| {
            shift(session.connection, (keeper, owner, signer), RecordState::RightEnded, RecordState::Stored)
        })
    }

    /// The blocks of these confirmed records do not count, because their signers had no right at that time: they leave
    /// their batches and are stored, to be anchored again. Returns how many were confirmed.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is moved.
    pub fn pass_over(&self, digests: &[Digest]) -> Result<u64, StoreError> {
        let digests = digests.to_vec();
        self.write_many(digests.len(), move |session| {
            digests.iter().try_fold(0, |moved, digest| Ok(moved + pass_over_one(session.connection, *digest)?))
        })
    }

    /// Whether the chain has this record in a block that does not count; it is not uploaded individually again, because
    /// the contract accepts that only once.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn was_passed_over(&self, digest: Digest) -> Result<bool, StoreError> {
        self.read(|connection| {
            let sql = "SELECT 1 FROM passed_over JOIN records ON n = record WHERE digest = ?1";
            Ok(connection.prepare_cached(sql)?.exists([digest.0])?)
        })
    }

    /// Stored records that an account anchors and whose blocks were ignored, as leaves.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn passed_over_leaves(&self, keeper: Address, limit: usize) -> Result<Vec<Leaf>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT recorders.id, topics.topic_id, seq, digest, topics.owner, recorders.signer FROM passed_over
                 JOIN records ON n = passed_over.record JOIN topics ON topics.key = records.topic
                 JOIN recorders ON recorders.key = topics.recorder
                 WHERE state = ?2 AND coalesce(topics.keeper, topics.owner) = ?1 ORDER BY n LIMIT ?3",
            )?;
            let limit = i64::try_from(limit).unwrap_or(i64::MAX);
            let found = statement.query_map(params![keeper.0, RecordState::Stored.code(), limit], |row| {
                let (recorder, topic_id) = (RecorderId(row.get(0)?), TopicId(row.get(1)?));
                let (seq, digest, owner) = (rows::unsigned(row, 2)?, Digest(row.get(3)?), Address(row.get(4)?));
                let signer = SignerId(row.get(5)?);
                Ok(Leaf { owner, signer, recorder, topic_id, seq, digest })
            })?;
            Ok(found.collect::<Result<_, _>>()?)
        })
    }
}

/// Moves up to [`MOST`] records of a signer.
fn shift(
    connection: &Connection,
    (keeper, owner, signer): (Address, Address, SignerId),
    from: RecordState,
    to: RecordState,
) -> Result<u64, StoreError> {
    if !may(By::Right, from, to) {
        return Err(StoreError::IllegalEdge { from, to });
    }
    let sql = format!(
        "UPDATE records SET state = ?5 WHERE n IN (SELECT n FROM records INDEXED BY records_by_state
         WHERE state = ?4 AND stream IN ({STREAMS}) LIMIT {MOST})"
    );
    let values = params![keeper.0, owner.0, signer.0, from.code(), to.code()];
    Ok(count(connection.prepare_cached(&sql)?.execute(values)?))
}

/// Closed, unsent batches that contain records of a signer.
fn unsent_batches(
    connection: &Connection,
    keeper: Address,
    owner: Address,
    signer: SignerId,
) -> Result<Vec<i64>, StoreError> {
    let sql = format!(
        "SELECT DISTINCT batch FROM records INDEXED BY records_by_state JOIN leaves ON record = n
         JOIN batches ON key = batch WHERE state = ?4 AND stream IN ({STREAMS})
         AND batches.tx IS NULL AND batches.block IS NULL"
    );
    let mut statement = connection.prepare_cached(&sql)?;
    let values = params![keeper.0, owner.0, signer.0, RecordState::Batched.code()];
    let found = statement.query_map(values, |row| row.get(0))?;
    Ok(found.collect::<Result<_, _>>()?)
}

/// An unsent batch is dissolved; its root stays known as this ledger's.
fn dissolve(connection: &Connection, batch: i64) -> Result<(), StoreError> {
    let [batched, stored] = [RecordState::Batched, RecordState::Stored];
    if !may(By::Right, batched, stored) {
        return Err(StoreError::IllegalEdge { from: batched, to: stored });
    }
    connection
        .prepare_cached(
            "UPDATE records SET state = ?3 WHERE state = ?2 AND n IN (SELECT record FROM leaves WHERE batch = ?1)",
        )?
        .execute(params![batch, batched.code(), stored.code()])?;
    connection
        .prepare_cached("REPLACE INTO left_places SELECT batch, leaf, record FROM leaves WHERE batch = ?1")?
        .execute([batch])?;
    connection.prepare_cached("DELETE FROM leaves WHERE batch = ?1")?.execute([batch])?;
    Ok(())
}

fn pass_over_one(connection: &Connection, digest: Digest) -> Result<u64, StoreError> {
    let [confirmed, stored] = [RecordState::Confirmed, RecordState::Stored];
    if !may(By::Right, confirmed, stored) {
        return Err(StoreError::IllegalEdge { from: confirmed, to: stored });
    }
    let found: Option<i64> = connection
        .prepare_cached("SELECT n FROM records WHERE digest = ?1 AND state = ?2 AND block IS NOT NULL")?
        .query_row(params![digest.0, confirmed.code()], |row| row.get(0))
        .optional()?;
    let Some(record) = found else { return Ok(0) };
    for step in [
        "REPLACE INTO passed_over SELECT n, tx, block FROM records WHERE n = ?1",
        "REPLACE INTO left_places SELECT batch, leaf, record FROM leaves WHERE record = ?1",
        "DELETE FROM leaves WHERE record = ?1",
    ] {
        connection.prepare_cached(step)?.execute([record])?;
    }
    connection
        .prepare_cached("UPDATE records SET state = ?2, tx = NULL, block = NULL, block_hash = NULL WHERE n = ?1")?
        .execute(params![record, stored.code()])?;
    Ok(1)
}

/// A batch that all its records left is closed over the same ones again: it waits, as if it had never been sent.
pub(super) fn begin_again(connection: &Connection, batch: i64) -> Result<bool, StoreError> {
    let in_use = connection.prepare_cached("SELECT 1 FROM leaves WHERE batch = ?1")?.exists([batch])?;
    if in_use {
        return Ok(false);
    }
    connection.prepare_cached("DELETE FROM left_places WHERE batch = ?1")?.execute([batch])?;
    connection
        .prepare_cached(
            "UPDATE batches SET tx = NULL, account = NULL, block = NULL, block_hash = NULL, closed_here = 1
             WHERE key = ?1",
        )?
        .execute([batch])?;
    Ok(true)
}
