//! How old waiting records are, and when each signer was last heard of: a few look-ups in the index of states for each
//! stream, whatever the number of records.

use rusqlite::{OptionalExtension as _, params};

use super::Ledger;
use crate::model::{Address, RecordKind, RecordState, SignerId, Timestamp};
use crate::store::StoreError;

/// A signer with the time of its last capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastSeen {
    /// The key that signed them.
    pub signer: SignerId,
    /// When the newest was captured, by its recorder's clock.
    pub at: Timestamp,
}

/// The states of a record that is here but in no block.
const UNANCHORED: [RecordState; 4] =
    [RecordState::Sealed, RecordState::Stored, RecordState::Batched, RecordState::Submitted];

/// The newest record of a signer, as far as it is here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NewestRecord {
    /// The epoch that seals it.
    pub epoch: u64,
    /// When it was captured, by its recorder's clock.
    pub captured_at: Timestamp,
    /// When it was written to disk here.
    pub acknowledged_at: Timestamp,
}

/// Accounts with records here; once each.
pub(super) const OWNERS: &str = "SELECT DISTINCT owner FROM topics LIMIT ?1";
/// When an owner's oldest record of a kind and state was captured.
pub(super) const OLDEST: &str = "SELECT min((SELECT min(captured_at) FROM records WHERE state = ?3 AND stream = s.key))
                      FROM streams s JOIN topics t ON t.key = s.topic WHERE t.owner = ?1 AND s.kind = ?2";
/// Losses without a gap record.
pub(super) const UNTOLD: &str = "SELECT count(*) FROM gaps WHERE report IS NULL";

/// Signers, and when the newest record of each was captured, whatever its state.
pub(super) fn last_seen() -> String {
    let newest = RecordState::ALL.iter().map(|state| {
        format!("coalesce((SELECT max(captured_at) FROM records WHERE state = {} AND stream = s.key), 0)", state.code())
    });
    format!(
        "SELECT r.signer, max(max({})) AS at FROM streams s JOIN topics t ON t.key = s.topic
         JOIN recorders r ON r.key = t.recorder WHERE kind = ?1 GROUP BY r.signer ORDER BY at DESC LIMIT ?2",
        newest.collect::<Vec<_>>().join(", ")
    )
}

impl Ledger {
    /// The accounts whose records are here, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn owners(&self, limit: usize) -> Result<Vec<Address>, StoreError> {
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        self.read(|connection| {
            let mut statement = connection.prepare_cached(OWNERS)?;
            let rows = statement.query_map([limit], |row| Ok(Address(row.get(0)?)))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// When an owner's oldest data record that is in no block yet was captured.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn oldest_unanchored(&self, owner: Address) -> Result<Option<Timestamp>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(OLDEST)?;
            let mut oldest: Option<i64> = None;
            for state in UNANCHORED {
                let values = params![owner.0, RecordKind::Data.code(), i64::from(state.code())];
                let found: Option<i64> = statement.query_row(values, |row| row.get(0))?;
                oldest = oldest.into_iter().chain(found).min();
            }
            Ok(oldest.and_then(|at| u64::try_from(at).ok()).map(Timestamp))
        })
    }

    /// When each signer's newest data record was captured, for the `limit` most recent signers.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn last_seen(&self, limit: usize) -> Result<Vec<LastSeen>, StoreError> {
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        self.read(|connection| {
            let mut statement = connection.prepare_cached(&last_seen())?;
            let rows = statement.query_map(params![RecordKind::Data.code(), limit], |row| {
                let at: i64 = row.get(1)?;
                Ok(LastSeen { signer: SignerId(row.get(0)?), at: Timestamp(at.cast_unsigned()) })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// The record that a signer captured last for an owner, of those with the highest number of their topic.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn newest_of(&self, owner: Address, signer: SignerId) -> Result<Option<NewestRecord>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT x.epoch, x.captured_at, x.acknowledged_at FROM topics t
                 JOIN recorders r ON r.key = t.recorder
                 JOIN records x ON x.topic = t.key AND x.seq = (SELECT max(seq) FROM records WHERE topic = t.key)
                 WHERE t.owner = ?1 AND r.signer = ?2 ORDER BY x.captured_at DESC LIMIT 1",
            )?;
            let found = statement.query_row(params![owner.0, signer.0], |row| {
                let time = |column| super::rows::unsigned(row, column).map(Timestamp);
                let epoch = super::rows::unsigned(row, 0)?;
                Ok(NewestRecord { epoch, captured_at: time(1)?, acknowledged_at: time(2)? })
            });
            Ok(found.optional()?)
        })
    }

    /// Losses not yet reported in a gap record: entries by place and reason, not messages.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn untold_gaps(&self) -> Result<u64, StoreError> {
        self.read(|connection| {
            Ok(connection.prepare_cached(UNTOLD)?.query_row([], |row| super::rows::unsigned(row, 0))?)
        })
    }
}
