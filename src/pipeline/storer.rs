//! Brings sealed records from the ledger's local copies into a vault that is not itself durable, and puts back what
//! that vault lost: whenever its servers are not the runs that the ledger has noted, all local copies are compared.
//!
//! Where a part of the vault is gone, the records of that part wait and all others go on.

use std::time::{Duration, Instant};

use crate::crypto::fault;
use crate::model::{Digest, RecordState};
use crate::store::{RecordQuery, StoreError};

use super::stages::Stage;
use super::{PipelineError, Plant};

/// Records a round.
const ROUND: usize = 64;
/// Between two passes while nothing is to be done, or something cannot be done.
const IDLE: Duration = Duration::from_millis(500);
/// Between two attempts to put back what could not be put back at once.
const PUT_BACK_AGAIN: Duration = Duration::from_secs(3);
/// The ledger's note of the runs that hold everything.
const RUNS: &str = "vault:runs";

/// What a pass over the sealed records did.
#[derive(Debug, Default)]
pub struct Pass {
    /// Records that are in the vault now.
    pub stored: usize,
    /// Records that wait for a part of the vault.
    pub waiting: usize,
    /// Why they wait.
    pub failure: Option<StoreError>,
}

/// Moves every `sealed` record into the vault that it takes.
///
/// # Errors
/// Of the ledger; nothing is lost, the local copies stay.
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
        // A vault that is gone as a whole is not offered every record.
        if pass.stored == 0 && pass.failure.is_some() && plant.vault.is_one() {
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

/// What the comparison of all local copies with the vault found.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct PutBack {
    /// Records that the vault had lost and has again.
    pub put_back: u64,
    /// Records whose bytes in the vault were others; they are right again.
    pub replaced: u64,
    /// Records whose part of the vault does not answer.
    pub waiting: u64,
}

/// Compares every local copy of a record that should be in the vault with what is there, and puts the right bytes in.
///
/// # Errors
/// Of the ledger.
pub fn put_back(plant: &Plant, stopped: &dyn Fn() -> bool) -> Result<PutBack, PipelineError> {
    let (mut found, mut after) = (PutBack::default(), None);
    while !stopped() {
        let digests = plant.ledger.held_copies(after, ROUND)?;
        let Some(last) = digests.last() else { return Ok(found) };
        after = Some(*last);
        for digest in digests {
            compare(plant, digest, &mut found)?;
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

/// Looks after one vault until the site ends.
struct Storer<'a> {
    plant: &'a Plant,
    /// When what is owed may be tried again.
    again: Option<Instant>,
    failing: bool,
}

/// Works until `stopped`; waits while nothing is to be done or the vault fails.
pub fn run(plant: &Plant, stopped: &dyn Fn() -> bool, wait: &dyn Fn(Duration), stored: &dyn Fn()) {
    let mut storer = Storer { plant, again: None, failing: false };
    while !stopped() {
        storer.heal(stopped);
        if storer.store(stored) {
            wait(IDLE);
        }
    }
}

impl Storer<'_> {
    fn alert(&self, text: String) {
        self.plant.observer.alert(true, text);
    }

    /// One pass; whether there is nothing more to do now.
    fn store(&mut self, stored: &dyn Fn()) -> bool {
        let pass = match store_pass(self.plant) {
            Ok(pass) => pass,
            Err(error) => {
                self.alert(format!("the vault does not take records, they wait in the ledger: {error}"));
                return true;
            }
        };
        if let Some(failure) = pass.failure {
            let waiting = pass.waiting;
            self.alert(format!(
                "the vault does not take {waiting} records or more, they wait in the ledger: {failure}"
            ));
        } else if self.failing && pass.waiting == 0 {
            self.plant.observer.alert(false, "the vault takes all records again".to_owned());
        }
        self.failing = pass.waiting > 0;
        if pass.stored > 0 {
            self.plant.observer.records_changed();
            stored();
        }
        pass.stored == 0 || pass.waiting > 0
    }

    /// Puts back what runs of the vault's servers before the present ones held.
    fn heal(&mut self, stopped: &dyn Fn() -> bool) {
        if self.again.is_some_and(|again| Instant::now() < again) {
            return;
        }
        if let Err(error) = self.heal_now(stopped) {
            self.again = Some(Instant::now() + PUT_BACK_AGAIN);
            self.alert(format!("it is not known whether the vault lost records; it is asked again: {error}"));
        }
    }

    fn heal_now(&mut self, stopped: &dyn Fn() -> bool) -> Result<(), PipelineError> {
        let runs = self.plant.vault.runs()?;
        let known = self.plant.ledger.setting(RUNS)?;
        if known.as_ref() == Some(&runs) {
            return Ok(());
        }
        let found = put_back(self.plant, stopped)?;
        if found.replaced > 0 {
            let count = found.replaced;
            self.alert(format!(
                "{count} records in the vault were not the bytes that were stored; they are right again"
            ));
        }
        if found.put_back > 0 {
            let text =
                format!("the vault had lost {} records; they were put back from their local copies", found.put_back);
            self.plant.observer.alert(known.is_some(), text);
        }
        if found.waiting > 0 {
            self.again = Some(Instant::now() + PUT_BACK_AGAIN);
            return Ok(());
        }
        self.again = None;
        Ok(self.plant.ledger.put_setting(RUNS, &runs)?)
    }
}
