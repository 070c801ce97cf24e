//! The only way for a sealed record into a site, whoever sealed it: backlog and reserve are checked, then come the
//! vault, the ledger and with it the acknowledgement.

use crate::crypto::fault;
use crate::model::{Digest, RecordState};
use crate::store::{NewRecord, RecordRow, StoreError};

use super::Plant;

impl Plant {
    /// Whether new records are accepted now: the disk has room, and no more are waiting than allowed for a vault that
    /// accepts nothing.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::Backlog`], or errors of the ledger.
    pub fn takes_records(&self) -> Result<(), StoreError> {
        self.ledger.takes_records()?;
        if self.vault.durable() {
            return Ok(());
        }
        let (waiting, limit) = (self.ledger.backlog()?, self.backlog);
        if waiting <= limit { Ok(()) } else { Err(StoreError::Backlog { waiting, limit }) }
    }

    /// Stores records with their bytes: nothing is written before they are known to be accepted; their bytes are
    /// durable, in the vault or, if that may forget, in the ledger, before `acknowledge` has written their rows. What was
    /// deleted here is acknowledged as known, and its bytes do not come back.
    ///
    /// # Errors
    /// See [`Self::takes_records`]; [`StoreError::Conflict`] if another record contradicts one; errors of the vault.
    /// The ledger has none of them then. Otherwise errors of `acknowledge`.
    pub fn keep<R: AsMut<[NewRecord]>, T>(
        &self,
        mut records: R,
        acknowledge: impl FnOnce(R) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.takes_records()?;
        self.ledger.check_foreign(records.as_mut())?;
        if !self.vault.durable() {
            return acknowledge(records);
        }
        let put = self.put(records.as_mut())?;
        let done = acknowledge(records)?;
        // What was erased between the look at it and the write came back with the bytes.
        let again = self.ledger.retained_of(&put)?;
        if !again.is_empty() {
            self.vault.scour(&again)?;
        }
        Ok(done)
    }

    /// The bytes that the vault has of a record. Deleted ones are gone.
    ///
    /// # Errors
    /// Errors of the vault.
    pub fn stored_bytes(&self, row: &RecordRow) -> Result<Option<Vec<u8>>, StoreError> {
        if row.deleted_at.is_some() {
            return Ok(None);
        }
        self.vault.get(row.digest)
    }

    /// Returns those of other recorders whose bytes were written.
    fn put(&self, records: &mut [NewRecord]) -> Result<Vec<Digest>, StoreError> {
        let retained = self.ledger.retained_among(records)?;
        let kept = || records.iter().filter(|record| !retained.contains(&record.digest));
        let bytes = kept().filter_map(|record| Some((record.digest, record.local_copy.as_deref()?)));
        self.vault.put(&bytes.collect::<Vec<_>>())?;
        fault::point("vault-put");
        let foreign = kept().filter(|record| record.foreign.is_some()).map(|record| record.digest).collect();
        for record in records {
            record.local_copy = None;
            if record.state == RecordState::Sealed {
                record.state = RecordState::Stored;
            }
        }
        Ok(foreign)
    }
}
