//! What the watcher saw on the chain: anchors in blocks, depth, replaced blocks.

use rusqlite::{Connection, OptionalExtension as _, params};

use super::append::count;
use super::edges::{By, may};
use super::rows::unsigned;
use super::{Ledger, batches, database::whole, rows};
use crate::model::{Address, Digest, Hash, RecordState, Timestamp};
use crate::store::StoreError;

/// An anchor found in a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sighting {
    /// The record's owner, as the chain says.
    pub owner: Address,
    /// The anchored digest.
    pub digest: Digest,
    /// The transaction that anchored it.
    pub transaction: Hash,
    /// Its block's number.
    pub block: u64,
    /// Its block's hash.
    pub block_hash: Hash,
}

struct Standing {
    n: i64,
    state: RecordState,
    block: Option<i64>,
    block_hash: Option<[u8; 32]>,
}

impl Ledger {
    /// Takes in anchors found on the chain: whatever a pending record's state was, it is now mined, with this
    /// transaction and block. A mined record moves to the block seen last; a tampered one only notes its block. Digests
    /// of other ledgers are skipped. Returns how many records changed; seeing the same again changes none.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing is recorded.
    pub fn mined(&self, sightings: &[Sighting]) -> Result<u64, StoreError> {
        let sightings = sightings.to_vec();
        self.write_many(sightings.len(), move |session| {
            sightings.iter().try_fold(0, |changed, sighting| Ok(changed + see(session.connection, sighting)?))
        })
    }

    /// Which of these anchors, of records of this ledger, it has not taken in: their records still wait for a block.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn waiting_digests(&self, sightings: &[Sighting]) -> Result<Vec<Digest>, StoreError> {
        self.read(|connection| {
            // An anchor that did not count is no reason to read its block again.
            let sql =
                "SELECT 1 FROM passed_over JOIN records ON n = record WHERE digest = ?1 AND passed_over.block = ?2";
            let mut passed_over = connection.prepare_cached(sql)?;
            let mut waiting = Vec::new();
            for sighting in sightings {
                let found = standing(connection, sighting)?.filter(|found| found.block.is_none());
                let is_open = found.is_some_and(|found| may(By::Sight, found.state, RecordState::Mined));
                if is_open && !passed_over.exists(params![sighting.digest.0, whole("block", sighting.block)?])? {
                    waiting.push(sighting.digest);
                }
            }
            Ok(waiting)
        })
    }

    /// Mined records in blocks up to this one are now confirmed; returns when each was captured, unordered.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is.
    pub fn confirm(&self, up_to_block: u64) -> Result<Vec<Timestamp>, StoreError> {
        let block = whole("block", up_to_block)?;
        self.write(move |session| {
            let (mined, confirmed) = (RecordState::Mined.code(), RecordState::Confirmed.code());
            let mut statement = session.connection.prepare_cached(
                "UPDATE records INDEXED BY records_by_state SET state = ?3 WHERE state = ?2 AND block <= ?1
                 RETURNING captured_at",
            )?;
            let times = statement.query_map(params![block, mined, confirmed], |row| unsigned(row, 0).map(Timestamp))?;
            Ok(times.collect::<Result<_, _>>()?)
        })
    }

    /// Blocks from this one on are gone: their mined and confirmed records lose their block. If the record's own
    /// transaction was signed here, it counts as open again and the record as submitted, so that the sender sends the
    /// same bytes again; otherwise the record is stored, or batched, and will be anchored again. Returns how many
    /// records moved. The blocks leave the trail; its walker stays where it is.
    ///
    /// Verified records stay: a block deeper than the required confirmations disappears only if the chain is broken,
    /// and that is for the operator to decide. [`Ledger::verified_from`] counts them and [`Ledger::unverify`] moves
    /// them the same way.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none moves.
    pub fn unmine(&self, from_block: u64) -> Result<u64, StoreError> {
        self.take_back(from_block, &[RecordState::Mined, RecordState::Confirmed])
    }

    /// Like [`Ledger::unmine`], for verified records.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none moves.
    pub fn unverify(&self, from_block: u64) -> Result<u64, StoreError> {
        self.take_back(from_block, &[RecordState::Verified])
    }

    /// How many verified records are anchored in this block or later.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn verified_from(&self, block: u64) -> Result<u64, StoreError> {
        let block = whole("block", block)?;
        self.read(|connection| {
            let found = connection
                .prepare_cached("SELECT count(*) FROM records WHERE state = ?1 AND block >= ?2")?
                .query_row(params![RecordState::Verified.code(), block], |row| rows::unsigned(row, 0))?;
            Ok(found)
        })
    }

    fn take_back(&self, from_block: u64, states: &'static [RecordState]) -> Result<u64, StoreError> {
        let block = whole("block", from_block)?;
        self.write(move |session| {
            let connection = session.connection;
            connection
                .prepare_cached(
                    "UPDATE transactions SET state = 0, block = NULL, block_hash = NULL, gas_used = NULL
                     WHERE state = 1 AND block >= ?1",
                )?
                .execute([block])?;
            batches::take_back(connection, block)?;
            // In the same commit, so that no anchor in one of them is taken in from elsewhere until the chain is read again.
            connection.prepare_cached("DELETE FROM trail WHERE block >= ?1")?.execute([block])?;
            connection.prepare_cached("DELETE FROM passed_over WHERE block >= ?1")?.execute([block])?;
            connection
                .prepare_cached(
                    "UPDATE records SET tx = NULL, block = NULL, block_hash = NULL WHERE state = ?1 AND block >= ?2",
                )?
                .execute(params![RecordState::Tampered.code(), block])?;
            states.iter().try_fold(0, |moved, state| Ok(moved + unplace(connection, *state, block)?))
        })
    }
}

fn see(connection: &Connection, sighting: &Sighting) -> Result<u64, StoreError> {
    let block = whole("block", sighting.block)?;
    let Some(standing) = standing(connection, sighting)? else { return Ok(0) };
    let known = standing.block == Some(block) && standing.block_hash == Some(sighting.block_hash.0);
    let state = match standing.state {
        state if may(By::Sight, state, RecordState::Mined) => RecordState::Mined,
        RecordState::Mined | RecordState::Tampered if !known => standing.state,
        _ => return Ok(0),
    };
    connection
        .prepare_cached("UPDATE records SET state = ?2, tx = ?3, block = ?4, block_hash = ?5 WHERE n = ?1")?
        .execute(params![standing.n, state.code(), sighting.transaction.0, block, sighting.block_hash.0])?;
    Ok(u64::from(state == RecordState::Mined))
}

fn standing(connection: &Connection, sighting: &Sighting) -> Result<Option<Standing>, StoreError> {
    let found = connection
        .prepare_cached(
            "SELECT n, state, block, block_hash FROM records JOIN topics ON key = topic
             WHERE digest = ?1 AND owner = ?2",
        )?
        .query_row(params![sighting.digest.0, sighting.owner.0], |row| {
            Ok(Standing { n: row.get(0)?, state: rows::state(row, 1)?, block: row.get(2)?, block_hash: row.get(3)? })
        })
        .optional()?;
    Ok(found)
}

/// Removes the block from the records of one state. Each goes to the best that is left for it: its own open
/// transaction, its batch's place on the chain, its batch's open transaction, another open upload of it.
fn unplace(connection: &Connection, from: RecordState, block: i64) -> Result<u64, StoreError> {
    const OPEN: &str = "EXISTS (SELECT 1 FROM transactions WHERE hash = records.tx AND transactions.state = 0)";
    const LEAF: &str = "EXISTS (SELECT 1 FROM leaves WHERE record = n)";
    const UPLOAD: &str = "(SELECT hash FROM transactions WHERE transactions.state = 0
         AND transactions.digests = records.digest ORDER BY nonce, key LIMIT 1)";
    let of_batch = |column: &str| {
        format!("(SELECT batches.{column} FROM leaves JOIN batches ON key = batch WHERE record = records.n)")
    };
    let gone = "block = NULL, block_hash = NULL";
    let (its_tx, its_block, its_hash) = (of_batch("tx"), of_batch("block"), of_batch("block_hash"));
    let steps = [
        (RecordState::Submitted, gone.to_owned(), OPEN.to_owned()),
        (
            RecordState::Mined,
            format!("tx = {its_tx}, block = {its_block}, block_hash = {its_hash}"),
            format!("{its_block} IS NOT NULL"),
        ),
        (RecordState::Submitted, format!("tx = {its_tx}, {gone}"), format!("{its_tx} IS NOT NULL")),
        (RecordState::Batched, format!("tx = NULL, {gone}"), LEAF.to_owned()),
        (RecordState::Submitted, format!("tx = {UPLOAD}, {gone}"), format!("{UPLOAD} IS NOT NULL")),
        (RecordState::Stored, format!("tx = NULL, {gone}"), "1".to_owned()),
    ];
    let mut moved = 0;
    for (to, values, condition) in steps {
        if from != to && !may(By::Reorg, from, to) {
            return Err(StoreError::IllegalEdge { from, to });
        }
        let sql = format!(
            "UPDATE records INDEXED BY records_by_state SET state = ?3, {values}
             WHERE state = ?1 AND block >= ?2 AND {condition}"
        );
        moved += count(connection.prepare_cached(&sql)?.execute(params![from.code(), block, to.code()])?);
    }
    Ok(moved)
}
