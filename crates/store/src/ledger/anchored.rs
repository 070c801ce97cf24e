//! Anchors made elsewhere: records that come with one are acknowledged together with it, others get it later.

use std::collections::{BTreeMap, HashMap, HashSet};

use rusqlite::{Connection, OptionalExtension as _, params};

use super::append::{self, Born, Placed};
use super::batches::{self, RootSighting};
use super::edges::{By, may};
use super::kept::add_signer;
use super::{Ledger, NewRecord, Session, rows, trail};
use crate::chain::merkle::Inclusion;
use crate::model::{Digest, Hash, PublicKey, RecordState, SignerId, Timestamp};
use crate::store::StoreError;
use crate::store::database::whole;

/// A record's place in a batch, and the block of the root on the chain.
type Anchor = (Digest, Inclusion, RootSighting);

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

    /// Acknowledges records with the anchors that another gateway made of them, in one commit, so that nobody here anchors
    /// them again; a record that was here without an anchor gets it. The keys of the devices that signed them are stored in
    /// the same commit. Returns how many are anchored by this.
    ///
    /// # Errors
    /// See [`Ledger::append`] and [`Ledger::take_in`], that of the first record that has one; then nothing is acknowledged.
    pub fn append_anchored(
        &self,
        records: Vec<NewRecord>,
        anchors: Vec<Anchor>,
        devices: BTreeMap<SignerId, PublicKey>,
    ) -> Result<u64, StoreError> {
        self.takes_records()?;
        self.write_many(records.len(), move |session| {
            devices.iter().try_for_each(|(id, key)| add_signer(session.connection, *id, *key))?;
            let now = whole("time", Timestamp::now().0)?;
            let of_digest: HashMap<Digest, &Anchor> = anchors.iter().map(|anchor| (anchor.0, anchor)).collect();
            let (mut batches, mut born) = (Batches::default(), HashSet::new());
            for record in &records {
                let anchor = of_digest.get(&record.digest).filter(|_| may_be_batched(record.state));
                match (append::free_place(session, record)?, anchor) {
                    (None, _) => {}
                    (Some(place), None) => {
                        append::insert(session, record, place, &Born::waiting(record), now).map(drop)?
                    }
                    (Some(place), Some(anchor)) => {
                        add_anchored(session, (record, place), anchor, &mut batches, now)?;
                        born.insert(record.digest);
                    }
                }
            }
            let known = anchors.iter().filter(|anchor| !born.contains(&anchor.0));
            known.into_iter().try_fold(born.len() as u64, |taken, (digest, inclusion, anchor)| {
                Ok(taken + u64::from(take_in(session.connection, *digest, inclusion, anchor)?))
            })
        })
    }
}

fn may_be_batched(state: RecordState) -> bool {
    may(By::Batch, state, RecordState::Batched)
}

/// Batches that records of one commit are in: each is looked up once.
type Batches = HashMap<(Hash, u64, RootSighting), Batch>;

/// A batch's key, and where on the chain its root is: transaction, block, the block's hash.
#[derive(Clone, Copy)]
struct Batch {
    key: i64,
    block: Option<(Hash, i64, Hash)>,
}

/// A record that is not known here is added as mined, in its batch.
fn add_anchored(
    session: &mut Session<'_>,
    (record, place): (&NewRecord, Placed),
    (digest, inclusion, anchor): &Anchor,
    batches: &mut Batches,
    now: i64,
) -> Result<(), StoreError> {
    let which = (inclusion.root, inclusion.count, *anchor);
    let batch = match batches.get(&which) {
        Some(batch) => *batch,
        None => {
            let batch = note_batch(session.connection, *digest, inclusion, anchor)?;
            batches.insert(which, batch);
            batch
        }
    };
    let row = append::insert(session, record, place, &Born::anchored(batch.block), now)?;
    keep_leaf(session.connection, row, batch.key, inclusion)
}

/// Notes the batch of an anchor, and the block in which its root is: this one, or an earlier one.
fn note_batch(
    connection: &Connection,
    digest: Digest,
    inclusion: &Inclusion,
    anchor: &RootSighting,
) -> Result<Batch, StoreError> {
    let key = batch_of(connection, digest, inclusion, anchor)?;
    batches::see(connection, anchor)?;
    let block = connection
        .prepare_cached("SELECT tx, block, block_hash FROM batches WHERE key = ?1 AND block IS NOT NULL")?
        .query_row([key], |row| Ok((Hash(row.get(0)?), row.get(1)?, Hash(row.get(2)?))))
        .optional()?;
    Ok(Batch { key, block })
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
    if !may_be_batched(state) {
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
            "INSERT INTO batches (root, owner, count, closed_at, account, tx)
             VALUES (?1, ?2, ?3, ?4, ?2, ?5) ON CONFLICT DO NOTHING",
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
