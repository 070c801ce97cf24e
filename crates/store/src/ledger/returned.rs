//! Erased records whose bytes an earlier version took in again: which could have some.

use super::Ledger;
use crate::model::Digest;
use crate::store::StoreError;

impl Ledger {
    /// The records that somebody had erased and whose bytes were deleted, each with whether there is a local copy of it all
    /// the same.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn erased_and_gone(&self) -> Result<Vec<(Digest, bool)>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT digest, EXISTS (SELECT 1 FROM copies WHERE copies.record = n) FROM retained JOIN records ON n = record
                 WHERE EXISTS (SELECT 1 FROM settings WHERE key > 'erased:' AND key < 'erased;')
                 AND records.deleted_at IS NOT NULL
                 AND EXISTS (SELECT 1 FROM settings WHERE key = 'erased:' || lower(hex(report)))",
            )?;
            let rows = statement.query_map([], |row| Ok((Digest(row.get(0)?), row.get(1)?)))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }
}
