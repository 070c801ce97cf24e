//! The contents of a reader's own records, whether or not a chain confirms them, for an import to compare with or to seal
//! anew.

use super::Reader;
use crate::crypto::{Anchor, Expected, Names, OpenedRecord, open, signer_id};
use crate::model::{PublicKey, SignerId};
use crate::pipeline::PipelineError;
use crate::store::RecordRow;

impl Reader<'_> {
    /// What this reader sealed in a record; `None` if its bytes are gone or do not open. Waits for ledger and vault.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub fn own_contents(&self, row: &RecordRow) -> Result<Option<OpenedRecord>, PipelineError> {
        Ok(self.own_bytes(row)?.map(|blob| self.open_own(row, &blob)).transpose()?.flatten())
    }

    /// The stored bytes of a record.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub fn own_bytes(&self, row: &RecordRow) -> Result<Option<Vec<u8>>, PipelineError> {
        match self.plant.stored_bytes(row)? {
            Some(blob) => Ok(Some(blob)),
            None => Ok(self.plant.ledger.local_copy(row.digest)?),
        }
    }

    /// Opens an own record with the key that signed it, of the owner or of a device; `None` if it does not open, or
    /// if its signer wrote a false name into it.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn open_own(&self, row: &RecordRow, blob: &[u8]) -> Result<Option<OpenedRecord>, PipelineError> {
        let Some(signer) = self.own_signer(row.signer)?.filter(|_| row.owner == self.reader.address) else {
            return Ok(None);
        };
        let Ok(key) = self.topic_key(row) else { return Ok(None) };
        let names = Names::Derived(self.reader.index());
        let expected = Expected::any_of(self.network.domain, row.owner, names);
        Ok(open(self.plant.provider, blob, &row.signature, &signer, Anchor::Unanchored, &key, &expected).ok())
    }

    fn own_signer(&self, signer: SignerId) -> Result<Option<PublicKey>, PipelineError> {
        let registered = self.registered_keys();
        let known = [self.reader.signing().public].into_iter().chain(registered);
        match known.into_iter().find(|key| signer_id(key) == signer) {
            Some(key) => Ok(Some(key)),
            None => Ok(self.plant.ledger.signer(signer)?),
        }
    }

    /// The signing keys that the reader's account ever registered.
    fn registered_keys(&self) -> Vec<PublicKey> {
        self.network.directory.with_account(self.reader.address, |account| {
            account.map(|account| account.identities.iter().map(|known| known.signing).collect()).unwrap_or_default()
        })
    }

    /// Whether the key with this id is, or was, the reader's own signing key, and no device's.
    pub fn is_own_key(&self, signer: SignerId) -> bool {
        signer_id(&self.reader.signing().public) == signer
            || self.registered_keys().iter().any(|key| signer_id(key) == signer)
    }
}
