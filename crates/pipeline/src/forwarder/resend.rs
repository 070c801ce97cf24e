//! Records that a gateway signed for and has not proven in time: the next gateway gets them too. A receipt ends sending,
//! never keeping, so the bytes are here; each gateway gets a record once.

use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::gateway::{Client, Upload};
use crate::model::{Digest, RecordState, Signature, Timestamp, clean};
use crate::pipeline::PipelineError;

use super::ForwardError;
use super::line::Line;
use super::outbox::WINDOW;

/// The longest time between two looks.
const LONGEST_LOOK: Duration = Duration::from_secs(10);

impl Line {
    /// Looks now and then whether records wait for this gateway because another one does not prove them.
    pub(super) fn has_overdue(&mut self) -> bool {
        if self.roster.len() < 2 {
            return false;
        }
        let every = (self.outbox.resend_after / 4).max(self.outbox.pace.check).min(LONGEST_LOOK);
        if let Some((_, any)) = self.overdue.filter(|(looked, _)| looked.elapsed() < every) {
            return any;
        }
        // If the ledger cannot be read, whoever writes to it says so.
        let any = block_in_place(|| self.overdue_here()).is_ok_and(|found| !found.is_empty());
        self.overdue = Some((Instant::now(), any));
        any
    }

    /// The records that are to come here next.
    fn overdue_here(&self) -> Result<Vec<(Digest, Signature)>, PipelineError> {
        let after = u64::try_from(self.outbox.resend_after.as_nanos()).unwrap_or(u64::MAX);
        let before = Timestamp(Timestamp::now().0.saturating_sub(after));
        let (ledger, refused) = (&self.outbox.plant.ledger, self.outbox.refused().clone());
        let mut found = Vec::new();
        // What is set aside stays in front of the rest.
        for late in ledger.overdue(before, self.gate.fingerprint, WINDOW + refused.len())? {
            if self.roster.next_for(&late.gateways) == Some(self.place)
                && !refused.contains(&late.digest)
                && let Some(row) = ledger.record(late.digest)?
            {
                found.push((row.digest, row.signature));
            }
        }
        Ok(found)
    }

    /// Sends the next of them; returns how many the gateway took over.
    pub(super) async fn resend(&mut self, client: &mut Client) -> Result<usize, ForwardError> {
        if !self.has_overdue() {
            return Ok(0);
        }
        let most = if self.singly > 0 { 1 } else { WINDOW };
        self.singly = self.singly.saturating_sub(1);
        let window = block_in_place(|| {
            let overdue = self.overdue_here()?;
            self.outbox.packed(overdue.into_iter().take(most), RecordState::Submitted)
        })?;
        let (digests, uploads): (Vec<Digest>, Vec<Upload>) = window.into_iter().unzip();
        let Some(first) = digests.first() else {
            self.overdue = Some((Instant::now(), false));
            return Ok(0);
        };
        let (count, address) = (digests.len(), &self.gate.endpoint.address);
        let taken = format!(
            "another gateway signed for {count} records but did not prove them in time; {} now has them too",
            clean(address, 255)
        );
        match self.send(client, uploads).await? {
            None => self.outbox.plant.observer.alert(false, taken),
            Some(refused) if count == 1 => self.outbox.set_one_aside(*first, &refused),
            Some(_) => self.singly = count,
        }
        Ok(count)
    }
}
