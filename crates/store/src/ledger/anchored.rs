//! Anchors made elsewhere: a record that is here gets the one that another ledger made.

use rusqlite::{Connection, OptionalExtension as _, params};

use super::batches::{self, RootSighting};
use super::edges::{By, may};
use super::{Ledger, rows, trail};
use crate::chain::merkle::Inclusion;
use crate::model::{Digest, Hash, RecordState, Timestamp};
use crate::store::StoreError;
use crate::store::database::whole;

impl Ledger {
    /// Notes where a stored record was anchored by another ledger: its place in the batch, and the block of the root
    /// on the chain. From then on it counts as if anchored from here. Returns whether anything changed.
    ///
    /// # Errors
    /// [`StoreError::NotReady`] if the record is unknown here, [`StoreError::Replaced`] if the watcher did not read that
    /// block, [`StoreError::DiskFull`] and the like.
    pub fn take_in(&self, digest: Digest, inclusion: Inclusion, anchor: RootSighting) -> Result<bool, StoreError> {
        self.write(move |session| take_in(session.connection, digest, &inclusion, &anchor))
    }
}

pub(super) fn take_in(
    connection: &Connection,
    digest: Digest,
    inclusion: &Inclusion,
    anchor: &RootSighting,
) -> Result<bool, StoreError> {
    let found = connection
        .prepare_cached("SELECT n, state FROM records WHERE digest = ?1")?
        .query_row([digest.0], |row| Ok((row.get::<_, i64>(0)?, rows::state(row, 1)?)))
        .optional()?;
    let (record, state) = found.ok_or(StoreError::NotReady { digest, found: "unknown" })?;
    if !may(By::Batch, state, RecordState::Batched) {
        return Ok(false);
    }
    let batch = batch_of(connection, digest, inclusion, anchor)?;
    connection
        .prepare_cached("DELETE FROM left_places WHERE batch = ?1 AND record = ?2")?
        .execute(params![batch, record])?;
    keep_leaf(connection, record, batch, inclusion)?;
    connection
        .prepare_cached("UPDATE records SET state = ?2 WHERE n = ?1")?
        .execute(params![record, RecordState::Batched.code()])?;
    batches::see_record(connection, record, batch, anchor)?;
    Ok(true)
}

/// The key of an anchor's batch, which is noted if it is not known yet.
fn batch_of(
    connection: &Connection,
    digest: Digest,
    inclusion: &Inclusion,
    anchor: &RootSighting,
) -> Result<i64, StoreError> {
    if !is_read(connection, anchor)? {
        return Err(StoreError::Replaced { digest, block: anchor.block });
    }
    connection
        .prepare_cached(
            "INSERT INTO batches (root, owner, count, closed_at, account, tx, closed_here)
             VALUES (?1, ?2, ?3, ?4, ?2, ?5, 0) ON CONFLICT DO NOTHING",
        )?
        .execute(params![
            inclusion.root.0,
            anchor.account.0,
            whole("count", inclusion.count)?,
            whole("time", Timestamp::now().0)?,
            anchor.transaction.0
        ])?;
    let key = connection
        .prepare_cached("SELECT key FROM batches WHERE root = ?1")?
        .query_row([inclusion.root.0], |row| row.get(0))?;
    Ok(key)
}

fn keep_leaf(connection: &Connection, record: i64, batch: i64, inclusion: &Inclusion) -> Result<(), StoreError> {
    let path: Vec<u8> = inclusion.path.iter().flat_map(|step: &Hash| step.0).collect();
    connection.prepare_cached("INSERT INTO leaves VALUES (?1, ?2, ?3, ?4)")?.execute(params![
        record,
        batch,
        whole("index", inclusion.index)?,
        path
    ])?;
    Ok(())
}

/// Whether the watcher read this very block. Of old ones not each is kept: no reorg goes as deep.
fn is_read(connection: &Connection, anchor: &RootSighting) -> Result<bool, StoreError> {
    let read = connection
        .prepare_cached(
            "SELECT EXISTS (SELECT 1 FROM trail WHERE block = ?1 AND hash = ?2)
                 OR ?1 + ?3 < coalesce((SELECT max(block) FROM trail), 0)",
        )?
        .query_row(
            params![whole("block", anchor.block)?, anchor.block_hash.0, whole("block", trail::DENSE)?],
            |row| row.get(0),
        )?;
    Ok(read)
}
