//! Merkle batches, their way to the chain and back, and a record's proof.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::branches::Branches;
use super::rows::{self, By, LEARNED_NAME, TOPIC_NAME, may, optional, time, unsigned};
use super::{Batches, Counts, RecordRow, Records, branches, directory, sightings};
use crate::StoreError;
use crate::crypto::merkle::{Inclusion, Leaf};
use crate::database::{capped, whole};
use crate::model::{Address, Digest, Hash, RecordKind, RecordState, RecorderId, SignerId, Timestamp, TopicId};
use crate::sql::{self, Connection, Row, Statement, params};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewBatch {
    pub owner: Address,
    pub root: Hash,
    /// In leaf order, each with its path to the root.
    pub leaves: Vec<(Digest, Vec<Hash>)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WaitingBatch {
    pub root: Hash,
    pub count: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RootSighting {
    pub account: Address,
    pub root: Hash,
    /// As the chain says.
    pub count: u64,
    pub transaction: Hash,
    pub block: u64,
    pub block_hash: Hash,
}

/// A record's place in its batch, and the batch's state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BatchPlace {
    pub inclusion: Inclusion,
    pub closed_at: Timestamp,
    /// That anchored the root, or will.
    pub account: Option<Address>,
    /// Of the root's first anchoring.
    pub block: Option<u64>,
    pub block_hash: Option<Hash>,
    /// That anchored the root, or will.
    pub transaction: Option<Hash>,
    /// A verified record depends on this block, but the ledger knows another one from elsewhere.
    pub is_contradicted: bool,
}

/// Read in one transaction: the watcher's writes between two reads would contradict each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlacedRecord {
    pub row: RecordRow,
    pub place: Option<BatchPlace>,
}

impl PlacedRecord {
    /// The row, with its place if transaction and block are the batch's; `None` if they are the record's own.
    pub fn anchor(self) -> (RecordRow, Option<BatchPlace>) {
        let Self { row, place } = self;
        let place = place.filter(|place| (place.transaction, place.block) == (row.transaction, row.block));
        (row, place)
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Anchors {
    /// A grant, a registration, ….
    Nothing,
    Digests(Vec<Digest>),
    Batch(Hash),
}

impl Batches {
    /// Stores root and paths and moves the records to batched in one commit. A batch closed again waits again only if
    /// its records have left it.
    pub fn close(&self, batch: NewBatch) -> Result<(), StoreError> {
        self.0.write_many(batch.leaves.len(), move |session| close(session.connection, &batch))
    }

    /// Closed batches without a transaction, oldest first.
    pub fn waiting(&self, owner: Address, limit: usize) -> Result<Vec<WaitingBatch>, StoreError> {
        let sql = "SELECT root, count FROM batches INDEXED BY batches_waiting
            WHERE owner = ?1 AND tx IS NULL AND EXISTS (SELECT 1 FROM leaves WHERE batch = key)
            ORDER BY key LIMIT ?2";
        self.0.list(sql, params![owner.0, capped(limit)], |row| {
            Ok(WaitingBatch { root: Hash(row.get(0)?), count: unsigned(row, 1)? })
        })
    }

    /// Of an account's open transactions, by nonce.
    pub fn open_roots(&self, account: Address) -> Result<Vec<Hash>, StoreError> {
        let sql =
            "SELECT batch FROM transactions WHERE state = 0 AND account = ?1 AND batch IS NOT NULL ORDER BY nonce";
        self.0.list(sql, [account.0], |row| row.get(0).map(Hash))
    }

    /// Stored records that an account anchors, for itself or others, and when the first captured one was acknowledged.
    pub fn unbatched(&self, keeper: Address) -> Result<(u64, Option<Timestamp>), StoreError> {
        self.0.read(|connection| {
            // Usually none waits, and a gateway with ten thousand streams asks at each block.
            let stored = RecordState::Stored.code();
            let sql = "SELECT 1 FROM records INDEXED BY records_by_state WHERE state = ?1 LIMIT 1";
            if !connection.has(sql, [stored])? {
                return Ok((0, None));
            }
            let sql = "SELECT coalesce(sum(coalesce((SELECT records FROM counters WHERE stream = streams.key AND state = ?2), 0)), 0),
                min((SELECT acknowledged_at FROM records INDEXED BY records_by_state
                     WHERE state = ?2 AND stream = streams.key ORDER BY captured_at LIMIT 1))
                FROM streams JOIN topics ON topics.key = topic WHERE coalesce(keeper, owner) = ?1";
            let values = params![keeper.0, stored];
            Ok(connection.one(sql, values, |row| Ok((unsigned(row, 0)?, optional(row, 1)?.map(Timestamp))))?)
        })
    }

    /// Stored records that an account anchors, for itself or others, by topic and capture time.
    pub fn stored_leaves(&self, keeper: Address, limit: usize) -> Result<Vec<Leaf>, StoreError> {
        let sql = "SELECT recorders.id, topics.topic_id, seq, digest, topics.owner, recorders.signer FROM streams
            JOIN topics ON topics.key = streams.topic JOIN recorders ON recorders.key = topics.recorder
            JOIN records INDEXED BY records_by_state ON state = ?2 AND stream = streams.key
            WHERE coalesce(topics.keeper, topics.owner) = ?1 ORDER BY streams.key, captured_at LIMIT ?3";
        self.0.list(sql, params![keeper.0, RecordState::Stored.code(), capped(limit)], leaf)
    }

    /// Roots found on the chain: pending records of each batch are now mined, except those in another block of their
    /// own. A root's earliest block counts; roots of other ledgers or leaf counts are skipped. Returns how many records
    /// changed.
    pub fn anchored(&self, sightings: &[RootSighting]) -> Result<u64, StoreError> {
        let sightings = sightings.to_vec();
        self.0.write(move |session| {
            sightings.iter().try_fold(0, |changed, sighting| Ok(changed + see(session.connection, sighting)?))
        })
    }

    /// Roots of this ledger's batches that still wait for a block.
    pub fn waiting_roots(&self, sightings: &[RootSighting]) -> Result<Vec<Hash>, StoreError> {
        self.0.read(|connection| {
            // An anchor that did not count is no reason to read its block again.
            let sql = "SELECT 1 FROM batches WHERE root = ?1 AND count = ?2 AND block IS NULL
                AND NOT EXISTS (SELECT 1 FROM leaves JOIN passed_over ON passed_over.record = leaves.record
                                WHERE leaves.batch = batches.key AND passed_over.block = ?3)";
            let values = |one: RootSighting| {
                Ok::<_, StoreError>((one.root.0, whole("count", one.count)?, whole("block", one.block)?))
            };
            Ok(connection.among(sql, sightings, values, true)?.into_iter().map(|one| one.root).collect())
        })
    }
}

impl Records {
    /// `None` for an unknown record.
    pub fn placed(&self, digest: Digest) -> Result<Option<PlacedRecord>, StoreError> {
        Ok(self.placed_all(&[digest])?.pop().flatten())
    }

    /// In order, all of one moment.
    pub fn placed_all(&self, digests: &[Digest]) -> Result<Vec<Option<PlacedRecord>>, StoreError> {
        self.0.read(|connection| placed_in(connection, digests))
    }

    /// In order, all of one moment; without their rows.
    pub fn places(&self, digests: &[Digest]) -> Result<Vec<Option<BatchPlace>>, StoreError> {
        self.0.read(|connection| {
            let mut places = Places::new(connection)?;
            digests.iter().map(|digest| places.of(*digest)).collect()
        })
    }
}

/// From recorder, topic, number, digest, owner, signer.
pub(super) fn leaf(row: &Row<'_>) -> sql::Result<Leaf> {
    let (recorder, topic_id) = (RecorderId(row.get(0)?), TopicId(row.get(1)?));
    let (owner, signer) = (Address(row.get(4)?), SignerId(row.get(5)?));
    Ok(Leaf { owner, signer, recorder, topic_id, seq: unsigned(row, 2)?, digest: Digest(row.get(3)?) })
}

/// A verified record's batch block differs from the chain's proof or the transaction. Earlier states are read at
/// different moments, and the trail does not say: old blocks are not all kept.
pub(super) const CONTRADICTED: &str = "records.state = 6 AND records.tx IS NULL AND (
    proof = 1 AND batches.block_hash IS DISTINCT FROM (SELECT hash FROM chain_proofs WHERE chain_proofs.block = batches.block)
    OR (batches.block, batches.block_hash) <> (SELECT block, block_hash FROM transactions
        WHERE transactions.hash = batches.tx AND transactions.state = 1)) IS TRUE";

pub(super) fn placed_in(connection: &Connection, digests: &[Digest]) -> Result<Vec<Option<PlacedRecord>>, StoreError> {
    let rows = rows::rows_of(connection, digests)?;
    let mut places = Places::new(connection)?;
    let mut with_place = |row: RecordRow| Ok(PlacedRecord { place: places.of(row.digest)?, row });
    rows.into_iter().map(|row| row.map(&mut with_place).transpose()).collect()
}

struct Places<'a> {
    find: Statement<'a>,
    branches: Branches,
}

impl<'a> Places<'a> {
    fn new(connection: &'a Connection) -> Result<Self, StoreError> {
        let find = connection.prepared(&format!(
            "SELECT leaf, count, branches.path, root, closed_at, account, batches.block, batches.block_hash,
                batches.tx, {CONTRADICTED}
                FROM records JOIN leaves ON record = n JOIN batches ON key = leaves.batch {}
                WHERE digest = ?1",
            branches::JOINED
        ))?;
        Ok(Self { find, branches: Branches::default() })
    }

    fn of(&mut self, digest: Digest) -> Result<Option<BatchPlace>, StoreError> {
        let branches = &mut self.branches;
        Ok(self.find.find([digest.0], |row| place(row, branches))?)
    }
}

fn place(row: &Row<'_>, branches: &mut Branches) -> sql::Result<BatchPlace> {
    let (index, count, root) = (unsigned(row, 0)?, unsigned(row, 1)?, Hash(row.get(3)?));
    let path = branches.path_of(row, 2, root, (index, count))?;
    let (closed_at, account) = (time(row, 4)?, row.get::<Option<_>>(5)?.map(Address));
    let (block, block_hash) = (optional(row, 6)?, row.get::<Option<_>>(7)?.map(Hash));
    let (transaction, is_contradicted) = (row.get::<Option<_>>(8)?.map(Hash), row.get(9)?);
    let inclusion = Inclusion { index, count, path, root };
    Ok(BatchPlace { inclusion, closed_at, account, block, block_hash, transaction, is_contradicted })
}

fn close(connection: &Connection, batch: &NewBatch) -> Result<(), StoreError> {
    let key = match key_of(connection, batch.root)? {
        Some(known) if directory::begin_again(connection, known)? => known,
        Some(_) => return Ok(()),
        None => {
            let leaves = capped(batch.leaves.len());
            let sql = "INSERT INTO batches (root, owner, count, closed_at, closed_here) VALUES (?1, ?2, ?3, ?4, 1)";
            let now = whole("time", Timestamp::now().0)?;
            connection.inserted(sql, "key", params![batch.root.0, batch.owner.0, leaves, now])?
        }
    };
    let mut find = connection.prepared("SELECT n, state FROM records WHERE digest = ?1")?;
    let mut add = connection.prepared("INSERT INTO leaves VALUES (?1, ?2, ?3)")?;
    let mut move_on = connection.prepared("UPDATE records SET state = ?2 WHERE n = ?1")?;
    for (index, (digest, _)) in (0_i64..).zip(&batch.leaves) {
        let found = find.find([digest.0], |row| Ok((row.get::<i64>(0)?, rows::state(row, 1)?)))?;
        let (record, state) = found.ok_or(StoreError::NotReady { digest: *digest, found: "unknown" })?;
        if !may(By::Batch, state, RecordState::Batched) {
            return Err(StoreError::NotReady { digest: *digest, found: state.word() });
        }
        add.execute(params![record, key, index])?;
        move_on.execute(params![record, RecordState::Batched.code()])?;
    }
    let paths = batch.leaves.iter().map(|(_, path)| path.as_slice());
    branches::keep_all(connection, key, batch.leaves.len() as u64, paths)
}

fn key_of(connection: &Connection, root: Hash) -> Result<Option<i64>, StoreError> {
    Ok(connection.find("SELECT key FROM batches WHERE root = ?1", [root.0], |row| row.get(0))?)
}

/// Returns how many records are mined by it.
pub(super) fn see(connection: &Connection, sighting: &RootSighting) -> Result<u64, StoreError> {
    let (block, leaves) = (whole("block", sighting.block)?, whole("count", sighting.count)?);
    let sql = "SELECT key FROM batches WHERE root = ?1 AND count = ?2 AND block IS NULL";
    let found = connection.find(sql, params![sighting.root.0, leaves], |row| row.get::<i64>(0))?;
    let Some(key) = found else { return Ok(0) };
    let sql = "UPDATE batches SET account = ?2, tx = ?3, block = ?4, block_hash = ?5, proof = NULL WHERE key = ?1";
    connection.run(sql, params![key, sighting.account.0, sighting.transaction.0, block, sighting.block_hash.0])?;
    place_transaction(connection, sighting.transaction)?;
    // In one block, a record's own upload says no more than its batch, and a second transaction would contradict it.
    let sql = "UPDATE records SET tx = NULL, block = NULL, block_hash = NULL,
        state = CASE WHEN state IN (?2, ?3) THEN ?4 ELSE state END
        WHERE (block IS NULL OR block = ?5) AND n IN (SELECT record FROM leaves WHERE batch = ?1)";
    let [batched, submitted, mined] = [RecordState::Batched, RecordState::Submitted, RecordState::Mined];
    Ok(connection.changed(sql, params![key, batched.code(), submitted.code(), mined.code(), block])?)
}

/// Moves a mined transaction to its batch's block: its sender may have seen a replaced one.
pub(super) fn place_transaction(connection: &Connection, hash: Hash) -> Result<(), StoreError> {
    let sql = "UPDATE transactions SET (block, block_hash) = (SELECT block, block_hash FROM batches WHERE root = batch)
        WHERE hash = ?1 AND state = 1
        AND EXISTS (SELECT 1 FROM batches WHERE root = batch AND tx = ?1 AND batches.block IS NOT NULL)";
    connection.run(sql, [hash.0])
}

/// A record joined a batch that is already in a block, or is now through this anchor.
pub(super) fn see_record(
    connection: &Connection,
    record: i64,
    batch: i64,
    anchor: &RootSighting,
) -> Result<(), StoreError> {
    if see(connection, anchor)? > 0 {
        return Ok(());
    }
    let sql = "UPDATE records SET state = ?3 WHERE n = ?1 AND (SELECT block FROM batches WHERE key = ?2) IS NOT NULL";
    connection.run(sql, params![record, batch, RecordState::Mined.code()])
}

/// A signed transaction anchors the batch.
pub(super) fn submit(
    connection: &Connection,
    root: Hash,
    transaction: Hash,
    account: Address,
) -> Result<(), StoreError> {
    let detail = |detail: &str| StoreError::Transaction { hash: transaction.to_hex(), detail: detail.to_owned() };
    let key = key_of(connection, root)?.ok_or_else(|| detail("anchors a batch that is not in the ledger"))?;
    let sql = "UPDATE batches SET tx = ?2, account = ?3 WHERE key = ?1 AND tx IS NULL";
    if connection.changed(sql, params![key, transaction.0, account.0])? == 0 {
        return Err(detail("anchors a batch that another transaction anchors"));
    }
    let sql = "UPDATE records SET tx = NULL, state = CASE state WHEN ?2 THEN ?3 ELSE state END
        WHERE block IS NULL AND n IN (SELECT record FROM leaves WHERE batch = ?1)";
    connection.run(sql, params![key, RecordState::Batched.code(), RecordState::Submitted.code()])
}

/// The transaction will never be mined: unless something else anchored the batch, it waits again.
pub(super) fn release(connection: &Connection, root: Hash, transaction: Hash) -> Result<(), StoreError> {
    let Some(key) = key_of(connection, root)? else { return Ok(()) };
    let sql = "UPDATE batches SET tx = NULL, account = NULL WHERE key = ?1 AND tx = ?2 AND block IS NULL";
    if connection.changed(sql, params![key, transaction.0])? == 0 {
        return Ok(());
    }
    let sql = "UPDATE records SET state = ?3 WHERE +state = ?2 AND tx IS NULL
        AND n IN (SELECT record FROM leaves WHERE batch = ?1)";
    connection.run(sql, params![key, RecordState::Submitted.code(), RecordState::Batched.code()])
}

/// Batches from this block on lose it; returns their keys. Any of our open transactions that anchors one continues.
pub(super) fn take_back(connection: &Connection, block: i64) -> Result<Vec<i64>, StoreError> {
    let sql = "UPDATE batches SET block = NULL, block_hash = NULL, (tx, account) =
        (SELECT hash, transactions.account FROM transactions
         WHERE transactions.batch = root AND state = 0 ORDER BY nonce, transactions.key LIMIT 1)
        WHERE block >= ?1 RETURNING key";
    Ok(connection.list(sql, [block], |row| row.get(0))?)
}

impl Batches {
    /// Notes where another ledger anchored a stored record; returns whether anything changed. [`StoreError::NotReady`]
    /// for an unknown record, [`StoreError::Replaced`] if the watcher did not read the block.
    pub fn take_in(&self, digest: Digest, inclusion: Inclusion, anchor: RootSighting) -> Result<bool, StoreError> {
        self.0.write(move |session| take_in(session.connection, digest, &inclusion, &anchor))
    }
}

pub(super) fn take_in(
    connection: &Connection,
    digest: Digest,
    inclusion: &Inclusion,
    anchor: &RootSighting,
) -> Result<bool, StoreError> {
    let sql = "SELECT n, state FROM records WHERE digest = ?1";
    let found = connection.find(sql, [digest.0], |row| Ok((row.get::<i64>(0)?, rows::state(row, 1)?)))?;
    let (record, state) = found.ok_or(StoreError::NotReady { digest, found: "unknown" })?;
    if !may(By::Batch, state, RecordState::Batched) && !leave_for(connection, (record, state), inclusion.root)? {
        return Ok(false);
    }
    let batch = batch_of(connection, digest, inclusion, anchor)?;
    connection.run("DELETE FROM left_places WHERE batch = ?1 AND record = ?2", params![batch, record])?;
    let sql = "INSERT INTO leaves VALUES (?1, ?2, ?3)";
    connection.run(sql, params![record, batch, whole("index", inclusion.index)?])?;
    branches::keep_one(connection, batch, (inclusion.index, inclusion.count), &inclusion.path)?;
    connection.run("UPDATE records SET state = ?2 WHERE n = ?1", params![record, RecordState::Batched.code()])?;
    see_record(connection, record, batch, anchor)?;
    Ok(true)
}

/// Notes the place that a record is about to leave.
pub(super) const LEAVE_PLACE: &str = "INSERT INTO left_places SELECT batch, leaf, record FROM leaves WHERE record = ?1
    ON CONFLICT (batch, leaf) DO UPDATE SET record = excluded.record";

/// Leaves another ledger's batch whose block was taken back, for that ledger's new one.
fn leave_for(connection: &Connection, (record, state): (i64, RecordState), root: Hash) -> Result<bool, StoreError> {
    let sql = "SELECT 1 FROM leaves JOIN batches ON key = batch
             WHERE record = ?1 AND closed_here = 0 AND block IS NULL AND root <> ?2";
    let is_waiting = matches!(state, RecordState::Batched | RecordState::Submitted);
    if !is_waiting || !connection.has(sql, params![record, root.0])? {
        return Ok(false);
    }
    for step in [LEAVE_PLACE, "DELETE FROM leaves WHERE record = ?1", "UPDATE records SET tx = NULL WHERE n = ?1"] {
        connection.run(step, [record])?;
    }
    Ok(true)
}

/// Notes an unknown batch.
fn batch_of(
    connection: &Connection,
    digest: Digest,
    inclusion: &Inclusion,
    anchor: &RootSighting,
) -> Result<i64, StoreError> {
    if !is_read(connection, anchor)? {
        return Err(StoreError::Replaced { digest, block: anchor.block });
    }
    let sql = "INSERT INTO batches (root, owner, count, closed_at, account, tx, closed_here)
        VALUES (?1, ?2, ?3, ?4, ?2, ?5, 0) ON CONFLICT DO NOTHING";
    let (root, count, now) = (inclusion.root.0, whole("count", inclusion.count)?, whole("time", Timestamp::now().0)?);
    connection.run(sql, params![root, anchor.account.0, count, now, anchor.transaction.0])?;
    Ok(connection.one("SELECT key FROM batches WHERE root = ?1", [root], |row| row.get(0))?)
}

/// Old blocks are not all kept, but no reorg reaches them.
fn is_read(connection: &Connection, anchor: &RootSighting) -> Result<bool, StoreError> {
    let sql = "SELECT EXISTS (SELECT 1 FROM trail WHERE block = ?1 AND hash = ?2)
        OR ?1 + ?3 < coalesce((SELECT max(block) FROM trail), 0)";
    let (block, dense) = (whole("block", anchor.block)?, whole("block", sightings::DENSE)?);
    Ok(connection.one(sql, params![block, anchor.block_hash.0, dense], |row| row.get(0))?)
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignerTopic {
    pub signer: SignerId,
    /// Its name, as far as it is known here.
    pub topic: String,
    pub records: BTreeMap<RecordState, u64>,
}

impl Counts {
    /// Counted for keys other than `own`, or for all.
    pub fn signer_topics(&self, owner: Address, own: Option<SignerId>) -> Result<Vec<SignerTopic>, StoreError> {
        self.0.read(|connection| {
            let sql = format!(
                "SELECT r.signer, {TOPIC_NAME} AS topic, c.state, sum(c.records) FROM streams s
                    JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
                    JOIN counters c ON c.stream = s.key {LEARNED_NAME}
                    WHERE t.owner = ?1 AND s.kind = ?2 AND r.signer IS DISTINCT FROM ?3 AND c.records > 0
                    GROUP BY r.signer, {TOPIC_NAME}, c.state"
            );
            let mut found: BTreeMap<(SignerId, String), BTreeMap<RecordState, u64>> = BTreeMap::new();
            connection.each(&sql, params![owner.0, RecordKind::Data.code(), own.map(|own| own.0)], |row| {
                let place = (SignerId(row.get(0)?), row.get(1)?);
                found.entry(place).or_default().insert(rows::state(row, 2)?, unsigned(row, 3)?);
                Ok(())
            })?;
            Ok(found.into_iter().map(|((signer, topic), records)| SignerTopic { signer, topic, records }).collect())
        })
    }
}
