//! The only way for a sealed record into a site, this owner's or another's: the reserve is checked, then row and bytes are written
//! in one commit, which acknowledges it, and only then the cache is told, which nobody waits for.

use crate::store::{NewRecord, RecordRow, StoreError};

use super::Plant;

impl Plant {
    /// Stores records with their bytes, in the commit of `acknowledge`. What was deleted here is acknowledged as known, and
    /// its bytes do not come back.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] while records are held back; errors of `acknowledge`. None of them is stored then.
    pub fn keep<R: AsRef<[NewRecord]>, T>(
        &self,
        records: R,
        acknowledge: impl FnOnce(R) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.ledger.records.takes_records()?;
        let cached = self.ciphertext.is_cached();
        let digests: Vec<_> = records.as_ref().iter().filter(|_| cached).map(|record| record.digest).collect();
        let done = acknowledge(records)?;
        self.ciphertext.written(digests);
        Ok(done)
    }

    /// The stored bytes of a record, for a reader: the cache may have them. Deleted ones are gone, even where they lie in
    /// the store or the cache again.
    pub fn stored_bytes(&self, row: &RecordRow) -> Result<Option<Vec<u8>>, StoreError> {
        if row.deleted_at.is_some() {
            return Ok(None);
        }
        self.ciphertext.through_cache(row.digest)
    }
}
