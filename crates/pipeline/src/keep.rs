//! The only way for a sealed record into a site: the reserve is checked, row and bytes are written in one commit, which
//! acknowledges it, and only then the cache learns of it.

use crate::store::{NewRecord, RecordRow, StoreError};

use super::Plant;

impl Plant {
    /// In the commit of `acknowledge`; after an error none is stored. Bytes that were deleted here do not come back.
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

    /// Perhaps from the cache. Deleted bytes are gone, even where store or cache have them again.
    pub fn stored_bytes(&self, row: &RecordRow) -> Result<Option<Vec<u8>>, StoreError> {
        if row.deleted_at.is_some() {
            return Ok(None);
        }
        self.ciphertext.through_cache(row.digest)
    }
}
