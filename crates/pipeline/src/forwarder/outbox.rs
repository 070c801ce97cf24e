//! What waits to be sent and what is set aside, and how long copies are kept that the gateway has too.

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::{CopyKeeping, LONGEST_RETRY, Pace};
use crate::gateway::{GatewayError, Upload};
use crate::model::{Digest, RecordState, Timestamp};
use crate::pipeline::{PipelineError, Plant};
use crate::store::RecordQuery;
use crate::store::files::free_bytes;

/// The most records in one upload.
const WINDOW: usize = 256;
/// The most bytes in one upload, unless a single record is larger.
const WINDOW_BYTES: usize = 4 * 1024 * 1024;
/// Copies given up at once.
const PAGE: usize = 256;

/// The outbox of a robot.
pub(super) struct Outbox {
    pub plant: Plant,
    home: PathBuf,
    keeping: CopyKeeping,
    /// Records refused for their own sake.
    refused: Arc<Mutex<HashSet<Digest>>>,
    pub pace: Pace,
    /// Since when the first of them has been waiting for another attempt.
    aside_since: Option<Instant>,
    /// How many of the next uploads are sent one by one, because one of them is refused.
    singly: usize,
    /// Before they are sent again; it doubles.
    retry: Duration,
    tidied: Option<Instant>,
}

impl Outbox {
    pub fn new(
        plant: Plant,
        home: PathBuf,
        keeping: CopyKeeping,
        refused: Arc<Mutex<HashSet<Digest>>>,
        pace: Pace,
    ) -> Self {
        let retry = pace.retry;
        Self { plant, home, keeping, refused, pace, aside_since: None, singly: 0, retry, tidied: None }
    }

    fn refused(&self) -> MutexGuard<'_, HashSet<Digest>> {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One of these records is refused: if it is the only one it is set aside, otherwise it is searched for.
    pub fn set_aside(&mut self, digests: &[Digest], error: &GatewayError) {
        let [digest] = digests else {
            self.singly = digests.len();
            return;
        };
        self.refused().insert(*digest);
        self.aside_since.get_or_insert_with(Instant::now);
        self.plant.observer.alert(true, format!("record {digest} stays in the outbox: {error}"));
    }

    /// Records refused for their own sake are sent again when their pause is over: gateways get repaired, and settings
    /// change.
    pub fn retry_refused(&mut self) {
        if self.aside_since.is_some_and(|since| since.elapsed() >= self.retry) {
            self.refused().clear();
            self.aside_since = None;
            self.retry = (self.retry * 2).min(LONGEST_RETRY);
        }
    }

    /// The next records to send, their bytes compared with their digests.
    pub fn window(&mut self) -> Result<Vec<(Digest, Upload)>, PipelineError> {
        let refused = self.refused().clone();
        let most = if self.singly > 0 { 1 } else { WINDOW };
        self.singly = self.singly.saturating_sub(1);
        let limit = most + refused.len();
        let query = RecordQuery { state: Some(RecordState::Stored), limit, ..RecordQuery::default() };
        let rows = self.plant.ledger.list(&query)?.rows;
        let (mut window, mut bytes, mut spoilt) = (Vec::new(), 0, Vec::new());
        for row in rows.into_iter().filter(|row| !refused.contains(&row.digest)).take(most) {
            let blob = self.plant.vault.get(row.digest)?;
            let Some(blob) = blob.filter(|blob| self.plant.provider.sm3(&[blob]) == row.digest.0) else {
                spoilt.push(row.digest);
                continue;
            };
            if !window.is_empty() && bytes + blob.len() > WINDOW_BYTES {
                break;
            }
            bytes += blob.len();
            window.push((row.digest, Upload { signature: row.signature, blob }));
        }
        if !spoilt.is_empty() {
            self.plant.ledger.advance(&spoilt, RecordState::Stored, RecordState::Tampered)?;
            self.plant.observer.tampered(&spoilt);
            let count = spoilt.len();
            self.plant
                .observer
                .alert(true, format!("{count} records in the outbox are damaged or missing; they were not sent"));
        }
        Ok(window)
    }

    /// Tidies now and then.
    pub fn keep_tidy(&mut self) -> Result<(), PipelineError> {
        if self.tidied.is_none_or(|at| at.elapsed() >= self.pace.tidy) {
            block_in_place(|| self.tidy())?;
            self.tidied = Some(Instant::now());
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
