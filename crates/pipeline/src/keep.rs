//! The one way of a sealed record into a site, whoever sealed it: backlog and reserve are asked, then come the vault, the
//! ledger and with it the acknowledgement.

use crate::crypto::fault;
use crate::model::RecordState;
use crate::store::{NewRecord, StoreError};

use super::Plant;

impl Plant {
    /// Whether new records are taken now: the disk has room, and no more wait than may for a vault that takes nothing.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::Backlog`], or of the ledger.
    pub fn takes_records(&self) -> Result<(), StoreError> {
        self.ledger.takes_records()?;
        if self.vault.durable() {
            return Ok(());
        }
        let (waiting, limit) = (self.ledger.backlog()?, self.backlog);
        if waiting <= limit { Ok(()) } else { Err(StoreError::Backlog { waiting, limit }) }
    }

    /// Keeps records with their bytes: nothing is written before they are known to be taken; their bytes are durable,
    /// in the vault or, where that may forget, in the ledger, before `acknowledge` has written their rows.
    ///
    /// # Errors
    /// As [`Self::takes_records`], [`StoreError::Conflict`] where another record contradicts one, and of the vault: the
    /// ledger has none of them then. Else of `acknowledge`.
    pub fn keep<R: AsMut<[NewRecord]>, T>(
        &self,
        mut records: R,
        acknowledge: impl FnOnce(R) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.takes_records()?;
        self.ledger.check_foreign(records.as_mut())?;
        if self.vault.durable() {
            self.put(records.as_mut())?;
        }
        acknowledge(records)
    }

    fn put(&self, records: &mut [NewRecord]) -> Result<(), StoreError> {
        let bytes = records.iter().filter_map(|record| Some((record.digest, record.local_copy.as_deref()?)));
        self.vault.put(&bytes.collect::<Vec<_>>())?;
        fault::point("vault-put");
        for record in records {
            record.local_copy = None;
            if record.state == RecordState::Sealed {
                record.state = RecordState::Stored;
            }
        }
        Ok(())
    }
}
