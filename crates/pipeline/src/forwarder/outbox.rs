//! What all lines to the gateways of a robot share: its ledger and vault, what is set aside, what else there is to do.

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::task::block_in_place;

use super::{CopyKeeping, Errand, LONGEST_RETRY, Link, Pace};
use crate::gateway::{GatewayError, Upload};
use crate::model::{Digest, RecordState, Signature, Timestamp};
use crate::pipeline::{PipelineError, Plant};
use crate::store::RecordQuery;
use crate::store::files::free_bytes;

/// The most records in one upload.
pub(super) const WINDOW: usize = 256;
/// The most bytes in one upload, unless a single record is larger.
const WINDOW_BYTES: usize = 4 * 1024 * 1024;
/// Copies given up at once.
const PAGE: usize = 256;

/// Records that wait for another attempt on their own.
pub(super) struct Aside {
    /// Since when the first of them has been waiting.
    since: Option<Instant>,
    /// How many of the next uploads are sent one by one, because one of them is refused.
    singly: usize,
    /// Before they are sent again; it doubles.
    retry: Duration,
}

impl Aside {
    pub fn new(retry: Duration) -> Self {
        Self { since: None, singly: 0, retry }
    }
}

/// The outbox of a robot.
pub(super) struct Outbox {
    pub plant: Plant,
    pub home: PathBuf,
    pub pace: Pace,
    pub link: watch::Sender<Link>,
    pub errand: Arc<tokio::sync::Mutex<Option<Box<dyn Errand>>>>,
    pub refused: Arc<Mutex<HashSet<Digest>>>,
    pub aside: Mutex<Aside>,
    pub tidied: Mutex<Option<Instant>>,
    pub keeping: CopyKeeping,
    pub resend_after: Duration,
}

impl Outbox {
    pub fn refused(&self) -> MutexGuard<'_, HashSet<Digest>> {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn aside(&self) -> MutexGuard<'_, Aside> {
        self.aside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One of these records is refused: if it is the only one it is set aside, otherwise it is searched for.
    pub fn set_aside(&self, digests: &[Digest], error: &GatewayError) {
        let [digest] = digests else {
            self.aside().singly = digests.len();
            return;
        };
        self.set_one_aside(*digest, error);
    }

    /// A record is refused for its own sake.
    pub fn set_one_aside(&self, digest: Digest, error: &GatewayError) {
        self.refused().insert(digest);
        self.aside().since.get_or_insert_with(Instant::now);
        self.plant.observer.alert(true, format!("record {digest} stays in the outbox: {error}"));
    }

    /// Records refused for their own sake are sent again when their pause is over: gateways get repaired, and settings
    /// change.
    pub fn retry_refused(&self) {
        let mut aside = self.aside();
        if aside.since.is_some_and(|since| since.elapsed() >= aside.retry) {
            self.refused().clear();
            aside.since = None;
            aside.retry = (aside.retry * 2).min(LONGEST_RETRY);
        }
    }

    /// The next records to send, their bytes compared with their digests.
    pub fn window(&self) -> Result<Vec<(Digest, Upload)>, PipelineError> {
        let refused = self.refused().clone();
        let most = {
            let mut aside = self.aside();
            let singly = aside.singly > 0;
            aside.singly = aside.singly.saturating_sub(1);
            if singly { 1 } else { WINDOW }
        };
        let limit = most + refused.len();
        let query = RecordQuery { state: Some(RecordState::Stored), limit, ..RecordQuery::default() };
        let rows = self.plant.ledger.list(&query)?.rows;
        let waiting = rows.into_iter().filter(|row| !refused.contains(&row.digest)).take(most);
        self.packed(waiting.map(|row| (row.digest, row.signature)), RecordState::Stored)
    }

    /// As many of these, in this state, as fit into one upload, their bytes compared with their digests.
    pub fn packed(
        &self,
        records: impl Iterator<Item = (Digest, Signature)>,
        state: RecordState,
    ) -> Result<Vec<(Digest, Upload)>, PipelineError> {
        let (mut window, mut bytes, mut spoilt) = (Vec::new(), 0, Vec::new());
        for (digest, signature) in records {
            let blob = self.plant.vault.get(digest)?;
            let Some(blob) = blob.filter(|blob| self.plant.provider.sm3(&[blob]) == digest.0) else {
                spoilt.push(digest);
                continue;
            };
            if !window.is_empty() && bytes + blob.len() > WINDOW_BYTES {
                break;
            }
            bytes += blob.len();
            window.push((digest, Upload { signature, blob }));
        }
        if !spoilt.is_empty() {
            self.plant.ledger.advance(&spoilt, state, RecordState::Tampered)?;
            self.plant.observer.tampered(&spoilt);
            let count = spoilt.len();
            self.plant
                .observer
                .alert(true, format!("{count} records in the outbox are damaged or missing; they were not sent"));
        }
        Ok(window)
    }

    /// Tidies now and then.
    pub fn keep_tidy(&self) -> Result<(), PipelineError> {
        let mut tidied = self.tidied.lock().unwrap_or_else(PoisonError::into_inner);
        if tidied.is_none_or(|at| at.elapsed() >= self.pace.tidy) {
            block_in_place(|| self.tidy())?;
            *tidied = Some(Instant::now());
        }
        Ok(())
    }

    /// See [`super::Forwarder::tidy`].
    pub fn tidy(&self) -> Result<(), PipelineError> {
        let time = u64::try_from(self.keeping.time.as_nanos()).unwrap_or(u64::MAX);
        let due = Timestamp(Timestamp::now().0.saturating_sub(time));
        loop {
            let old = self.plant.ledger.proven_before(due, PAGE)?;
            if old.is_empty() {
                break;
            }
            self.give_up(&old)?;
        }
        // A little more than the reserve, so that records are still accepted.
        let wanted = self.keeping.reserve.saturating_add(self.keeping.reserve / 2);
        if wanted > 0 && free_bytes(&self.home)? < wanted {
            let oldest = self.plant.ledger.proven_before(Timestamp(i64::MAX.unsigned_abs()), PAGE)?;
            if !oldest.is_empty() {
                self.give_up(&oldest)?;
                let text = format!("the disk is nearly full: {} proven records were deleted early", oldest.len());
                self.plant.observer.alert(false, text);
            }
        }
        Ok(())
    }

    fn give_up(&self, digests: &[Digest]) -> Result<(), PipelineError> {
        // Deleted first: after an interruption it is deleted again.
        self.plant.vault.discard(digests)?;
        Ok(self.plant.ledger.proven_gone(digests)?)
    }
}
