//! The contents of a reader's own record, whether or not it is on the chain yet, for an import to compare with.

use super::Reader;
use crate::crypto::{Anchor, Expected, OpenedRecord, open};
use crate::pipeline::PipelineError;
use crate::store::RecordRow;

impl Reader<'_> {
    /// What this reader sealed in a record; `None` if its bytes are gone or do not open. Waits for ledger and vault.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub fn own_contents(&self, row: &RecordRow) -> Result<Option<OpenedRecord>, PipelineError> {
        let stored = match self.plant.stored_bytes(row)? {
            Some(blob) => Some(blob),
            None => self.plant.ledger.local_copy(row.digest)?,
        };
        let Some(blob) = stored.filter(|_| row.owner == self.reader.address) else { return Ok(None) };
        let Ok(keys) = self.keys_for(row) else { return Ok(None) };
        let signers = [Some(self.reader.signing().public), self.plant.ledger.signer(row.signer)?];
        let expected = Expected::any_of(self.network.domain, row.owner);
        let opened = signers.iter().flatten().find_map(|signer| {
            let mut tried = keys.iter().map(|key| {
                open(self.plant.provider, &blob, &row.signature, signer, Anchor::Unanchored, key, &expected)
            });
            tried.find_map(Result::ok)
        });
        Ok(opened)
    }
}
