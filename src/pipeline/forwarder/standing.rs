//! What becomes of records that a gateway took over.

use tokio::task::block_in_place;

use crate::gateway::{Client, Standing};
use crate::model::{Digest, RecordState};
use crate::pipeline::PipelineError;
use crate::store::RecordQuery;

use super::{ForwardError, Forwarder};

/// Records asked about at once.
const PAGE: usize = 1024;

impl Forwarder {
    /// Asks how the next page of submitted records stands, and moves those that the gateway decided about.
    pub(super) async fn check(&mut self, client: &mut Client) -> Result<(), ForwardError> {
        let query = RecordQuery {
            state: Some(RecordState::Submitted),
            limit: PAGE,
            after: self.cursor.take(),
            ..RecordQuery::default()
        };
        let page = block_in_place(|| self.plant.ledger.list(&query))?;
        if page.rows.is_empty() {
            return Ok(());
        }
        let digests: Vec<Digest> = page.rows.iter().map(|row| row.digest).collect();
        let standings = client.check(&digests).await?;
        let of = |wanted: Standing| -> Vec<Digest> {
            digests.iter().zip(&standings).filter(|(_, found)| **found == wanted).map(|(digest, _)| *digest).collect()
        };
        let (verified, unknown, tampered) = (of(Standing::Verified), of(Standing::Unknown), of(Standing::Tampered));
        self.cursor = page.next;
        self.moved |= !verified.is_empty();
        block_in_place(|| self.decide(&verified, &unknown, &tampered))?;
        Ok(())
    }

    fn decide(&self, verified: &[Digest], unknown: &[Digest], tampered: &[Digest]) -> Result<(), PipelineError> {
        let (ledger, observer) = (&self.plant.ledger, &self.plant.observer);
        if !verified.is_empty() {
            ledger.settle_forwarded(verified, RecordState::Verified)?;
            observer.verified(verified);
            self.forget(verified)?;
        }
        if !unknown.is_empty() && ledger.settle_forwarded(unknown, RecordState::Stored)? > 0 {
            let count = unknown.len();
            observer.alert(
                true,
                format!(
                    "the gateway signed for {count} records and no longer knows them; they are sent again, its receipts are kept"
                ),
            );
        }
        if !tampered.is_empty() && ledger.settle_forwarded(tampered, RecordState::Tampered)? > 0 {
            observer.tampered(tampered);
            let count = tampered.len();
            observer.alert(
                true,
                format!(
                    "{count} records were altered at the gateway after it signed for them; the originals are kept here"
                ),
            );
        }
        if !(verified.is_empty() && unknown.is_empty() && tampered.is_empty()) {
            observer.records_changed();
        }
        Ok(())
    }

    fn forget(&self, digests: &[Digest]) -> Result<(), PipelineError> {
        Ok(self.plant.vault.discard(digests)?)
    }

    /// Deletes ciphertext of verified records that an end between the two steps has left behind.
    ///
    /// # Errors
    /// Of ledger and vault.
    pub fn tidy(&self) -> Result<(), PipelineError> {
        let mut after = None;
        loop {
            let query = RecordQuery {
                state: Some(RecordState::Verified),
                limit: PAGE,
                newest_first: true,
                after,
                ..RecordQuery::default()
            };
            let page = self.plant.ledger.list(&query)?;
            let mut left = Vec::new();
            for row in &page.rows {
                if self.plant.vault.contains(row.digest)? {
                    left.push(row.digest);
                }
            }
            self.forget(&left)?;
            after = page.next;
            if left.is_empty() || after.is_none() {
                return Ok(());
            }
        }
    }
}
