//! Brings sealed records from the ledger's local copies into a vault that is not itself durable, and restores what that
//! vault lost: whenever its servers no longer hold what the ledger has noted (another run, evictions, a flush), all
//! local copies are compared, and records without one are looked for.
//!
//! If a part of the vault is down, the records of that part wait and all others continue.

use std::time::{Duration, Instant};

use crate::crypto::fault;
use crate::model::{Digest, RecordState, Timestamp};
use crate::stages::Stage;
use crate::store::notes::{VaultGone, VaultRuns};
use crate::store::{AuditedRecord, RecordQuery, RecordRow, StoreError};
use crate::{PipelineError, Plant};

/// Records per round.
const ROUND: usize = 64;
/// The pause between passes while nothing is to be done, or something cannot be done.
const IDLE: Duration = Duration::from_millis(500);
/// The pause between attempts to restore what could not be restored at once.
const PUT_BACK_AGAIN: Duration = Duration::from_secs(3);
/// The pause between attempts to reach a vault that does not answer.
const RETRY: Duration = Duration::from_secs(1);

/// The result of a pass over the sealed records.
#[derive(Debug, Default)]
pub struct Pass {
    /// Records now in the vault.
    pub stored: usize,
    /// Records waiting for a part of the vault.
    pub waiting: usize,
    /// Why they wait.
    pub failure: Option<StoreError>,
}

/// Moves every `sealed` record that the vault accepts into it.
///
/// # Errors
/// Errors of the ledger; nothing is lost, the local copies stay.
pub fn store_pass(plant: &Plant) -> Result<Pass, PipelineError> {
    let mut pass = Pass::default();
    let mut after = None;
    loop {
        let query = RecordQuery { state: Some(RecordState::Sealed), limit: ROUND, after, ..RecordQuery::default() };
        let page = plant.ledger.list(&query)?;
        let digests: Vec<Digest> = page.rows.iter().map(|row| row.digest).collect();
        store_round(plant, &digests, &mut pass)?;
        match page.next {
            Some(next) => after = Some(next),
            None => return Ok(pass),
        }
        // A vault that is down as a whole is not offered every record. If it went down after the first ones, more might
        // come than it has time to refuse, and nobody would be told.
        let gone = matches!(pass.failure, Some(StoreError::Unreachable { .. }));
        if plant.vault.is_one() && (gone || pass.stored == 0 && pass.failure.is_some()) {
            return Ok(pass);
        }
    }
}

fn store_round(plant: &Plant, digests: &[Digest], pass: &mut Pass) -> Result<(), PipelineError> {
    let begun = Instant::now();
    let mut entries = Vec::with_capacity(digests.len());
    for digest in digests {
        if !plant.vault.answers(*digest) {
            pass.waiting += 1;
        } else if let Some(copy) = plant.ledger.local_copy(*digest)? {
            entries.push((*digest, copy));
        }
    }
    if entries.is_empty() {
        return Ok(());
    }
    let borrowed: Vec<_> = entries.iter().map(|(digest, bytes)| (*digest, bytes.as_slice())).collect();
    fault::point("store-read");
    let put = plant.vault.put_each(&borrowed);
    fault::point("store-put");
    plant.ledger.advance(&put.stored, RecordState::Sealed, RecordState::Stored)?;
    fault::point("store-advanced");
    pass.stored += put.stored.len();
    pass.waiting += entries.len() - put.stored.len();
    pass.failure = put.failure.or_else(|| pass.failure.take());
    if let Some(stages) = plant.observer.stages().filter(|_| !put.stored.is_empty()) {
        stages.spent(Stage::Store, begun.elapsed());
    }
    Ok(())
}

/// The result of comparing all local copies with the vault.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct PutBack {
    /// Records that the vault had lost and has again.
    pub put_back: u64,
    /// Records whose bytes in the vault were wrong; they are right again.
    pub replaced: u64,
    /// Records whose part of the vault does not answer.
    pub waiting: u64,
}

/// Compares every local copy of a record that should be in the vault with its contents, and stores the right bytes.
///
/// # Errors
/// Errors of the ledger.
pub fn put_back(plant: &Plant, stopped: &dyn Fn() -> bool) -> Result<PutBack, PipelineError> {
    let (mut found, mut after) = (PutBack::default(), None);
    while !stopped() {
        let digests = plant.ledger.held_copies(after, ROUND)?;
        let Some(last) = digests.last() else { return Ok(found) };
        after = Some(*last);
        for digest in digests {
            compare(plant, digest, &mut found)?;
            if found.waiting > 0 && plant.vault.is_one() && plant.vault.ailing().is_some() {
                return Ok(found);
            }
        }
    }
    found.waiting += 1;
    Ok(found)
}

fn compare(plant: &Plant, digest: Digest, found: &mut PutBack) -> Result<(), PipelineError> {
    let sealed = plant.ledger.record(digest)?.is_none_or(|row| row.state == RecordState::Sealed);
    if sealed {
        return Ok(());
    }
    let there = if plant.vault.answers(digest) { plant.vault.get(digest) } else { Ok(None) };
    let Some(copy) = plant.ledger.local_copy(digest)? else { return Ok(()) };
    let counter = match there {
        Ok(Some(bytes)) if bytes == copy => return Ok(()),
        Ok(Some(_)) => &mut found.replaced,
        Ok(None) if plant.vault.answers(digest) => &mut found.put_back,
        _ => {
            found.waiting += 1;
            return Ok(());
        }
    };
    match plant.vault.put(&[(digest, &copy)]) {
        Ok(()) => {
            fault::point("put-back");
            *counter += 1;
        }
        Err(_) => found.waiting += 1,
    }
    Ok(())
}

/// A vault's state, as last seen by its storer.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Condition {
    /// It accepts records.
    #[default]
    Takes,
    /// It does not, or not all of them; they wait on disk and are tried again.
    Waits {
        /// The obstacle, as the store reports it.
        why: String,
        /// Records waiting on disk.
        records: u64,
    },
    /// It accepts records; this many verified ones are missing from it, and there is no copy of them here.
    Lacks(u64),
}

/// Looks after one vault until the site ends.
struct Storer<'a> {
    plant: &'a Plant,
    /// When outstanding work may be tried again, and the obstacle.
    again: Option<(Instant, String)>,
    /// Verified records that are missing.
    gone: u64,
}

/// Works until `stopped`; waits while nothing is to be done or the vault fails.
pub fn run(plant: &Plant, stopped: &dyn Fn() -> bool, wait: &dyn Fn(Duration), stored: &dyn Fn()) {
    let mut storer = Storer { plant, again: None, gone: known_gone(plant) };
    while !stopped() {
        let healed = storer.heal(stopped);
        let (idle, failure) = storer.store(stored);
        let ailing = || plant.vault.ailing().map(|why| why.to_string());
        plant.observer.vault(storer.condition(failure.or(healed.err()).or_else(ailing)));
        if idle {
            wait(IDLE);
        }
    }
}

/// What the previous run knew to be missing.
fn known_gone(plant: &Plant) -> u64 {
    plant.ledger.notes.read(&VaultGone {}).ok().flatten().unwrap_or(0)
}

impl Storer<'_> {
    fn alert(&self, text: String) {
        self.plant.observer.alert(true, text);
    }

    fn condition(&self, failure: Option<String>) -> Condition {
        match failure {
            // If the ledger itself does not answer, the failure says so.
            Some(why) => Condition::Waits { why, records: self.plant.ledger.sealed().unwrap_or(0) },
            None if self.gone > 0 => Condition::Lacks(self.gone),
            None => Condition::Takes,
        }
    }

    /// One pass; returns whether there is nothing more to do now, and the obstacle.
    fn store(&mut self, stored: &dyn Fn()) -> (bool, Option<String>) {
        let pass = match store_pass(self.plant) {
            Ok(pass) => pass,
            Err(error) => return (true, Some(error.to_string())),
        };
        if pass.stored > 0 {
            self.plant.observer.records_changed();
            stored();
        }
        let why = pass.failure.map(|failure| failure.to_string());
        let why = why.or_else(|| (pass.waiting > 0).then(|| "a part of the vault does not answer yet".to_owned()));
        (pass.stored == 0 || pass.waiting > 0, why)
    }

    /// Restores what the vault held before and does not hold now.
    ///
    /// # Errors
    /// In words, why it is not known or cannot be done now; it is tried again.
    fn heal(&mut self, stopped: &dyn Fn() -> bool) -> Result<(), String> {
        if let Some((_, why)) = self.again.as_ref().filter(|(again, _)| Instant::now() < *again) {
            return Err(why.clone());
        }
        let healed = self.heal_now(stopped).unwrap_or_else(|error| Err((RETRY, error.to_string())));
        self.again = healed.as_ref().err().map(|(pause, why)| (Instant::now() + *pause, why.clone()));
        healed.map_err(|(_, why)| why)
    }

    /// The inner error is when to try again, and why.
    fn heal_now(&mut self, stopped: &dyn Fn() -> bool) -> Result<Result<(), (Duration, String)>, PipelineError> {
        let runs = self.plant.vault.runs()?;
        let known = self.plant.ledger.notes.read(&VaultRuns {})?;
        if known.as_ref() == Some(&runs) {
            return Ok(Ok(()));
        }
        let found = put_back(self.plant, stopped)?;
        self.tell(&found, known.is_some());
        if found.waiting > 0 {
            return Ok(Err((PUT_BACK_AGAIN, "what it may have lost is still being compared".to_owned())));
        }
        let missing = look_for_all(self.plant, stopped)?;
        self.tell_missing(&missing)?;
        if !stopped() {
            self.plant.ledger.notes.write(&VaultRuns {}, &runs)?;
        }
        Ok(Ok(()))
    }

    fn tell(&self, found: &PutBack, known: bool) {
        if found.replaced > 0 {
            let count = found.replaced;
            self.alert(format!("{count} records in the vault were altered; they have been repaired"));
        }
        if found.put_back > 0 {
            let text =
                format!("the vault had lost {} records; they were put back from their local copies", found.put_back);
            self.plant.observer.alert(known, text);
        }
    }

    fn tell_missing(&mut self, missing: &Missing) -> Result<(), PipelineError> {
        if missing.newly > 0 {
            let count = missing.newly;
            self.alert(format!(
                "MISSING: the vault lost {count} verified records that have no local copy; restore it from a backup; \
                 `authros audit` lists them"
            ));
        }
        if missing.back > 0 {
            self.plant.observer.alert(false, format!("{} records are back in the vault", missing.back));
        }
        if missing.gone != self.gone {
            self.gone = missing.gone;
            self.plant.ledger.notes.write(&VaultGone {}, &missing.gone)?;
        }
        Ok(())
    }
}

/// Records asked for at once.
const MISSING_ROUND: usize = 256;

/// The result of checking all verified records without a local copy.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Missing {
    /// Missing records, including those known before.
    pub gone: u64,
    /// Of these, those not known before.
    pub newly: u64,
    /// Records that were missing or altered and are intact again.
    pub back: u64,
}

/// Checks for every verified record whose bytes only the vault has.
///
/// # Errors
/// Errors of ledger and vault.
pub fn look_for_all(plant: &Plant, stopped: &dyn Fn() -> bool) -> Result<Missing, PipelineError> {
    let (mut found, mut after) = (Missing::default(), Some(0));
    while let Some(from) = after.filter(|_| !stopped()) {
        let page = plant.ledger.inspection.audit_page(from, Timestamp(0), MISSING_ROUND)?;
        after = page.next;
        let rows: Vec<RecordRow> =
            page.records.into_iter().flatten().filter(depends_on_vault).map(|one| one.row).collect();
        look_for(plant, &rows, &mut found)?;
    }
    Ok(found)
}

/// Whether only the vault can have its bytes, or they were once found wrong there. A robot has handed what is in no
/// block over to its gateway.
fn depends_on_vault(record: &AuditedRecord) -> bool {
    let settled = match record.row.state {
        RecordState::Verified => !record.has_copy,
        state => state == RecordState::Tampered,
    };
    settled && record.row.block.is_some() && record.row.deleted_at.is_none()
}

fn look_for(plant: &Plant, rows: &[RecordRow], found: &mut Missing) -> Result<(), PipelineError> {
    let digests: Vec<Digest> = rows.iter().map(|row| row.digest).collect();
    let (mut lost, mut back) = (Vec::new(), Vec::new());
    for (row, there) in rows.iter().zip(plant.vault.contains_many(&digests)?) {
        match row.state {
            RecordState::Verified if !there && is_gone(plant, row.digest)? => lost.push(row.digest),
            RecordState::Tampered if !there => found.gone += u64::from(plant.ledger.local_copy(row.digest)?.is_none()),
            RecordState::Tampered if is_right(plant, row.digest)? => back.push(row.digest),
            _ => {}
        }
    }
    if !lost.is_empty() {
        let marked = plant.ledger.advance(&lost, RecordState::Verified, RecordState::Tampered)?;
        fault::point("missing");
        (found.gone, found.newly) = (found.gone + marked, found.newly + marked);
        plant.observer.tampered(&lost);
        plant.observer.records_changed();
    }
    if !back.is_empty() {
        found.back += plant.ledger.heal(&back)?;
        plant.observer.records_changed();
    }
    Ok(())
}

/// Whether it is still missing when checked again: retention may have deleted it since its row was read.
fn is_gone(plant: &Plant, digest: Digest) -> Result<bool, PipelineError> {
    let now = plant.ledger.record(digest)?;
    let kept = now.is_some_and(|row| row.state == RecordState::Verified && row.deleted_at.is_none());
    Ok(kept
        && plant.ledger.retained(digest)?.is_none()
        && plant.ledger.local_copy(digest)?.is_none()
        && !plant.vault.contains(digest)?)
}

fn is_right(plant: &Plant, digest: Digest) -> Result<bool, PipelineError> {
    let bytes = plant.vault.get(digest)?;
    Ok(bytes.is_some_and(|bytes| plant.provider.sm3(&[&bytes]) == digest.0))
}
