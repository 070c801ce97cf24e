//! Progress of long work: imports, exports, audits, back-ups.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::model::{ProfileName, clean};
use crate::service::reply::ProgressView;

/// Characters.
const WIDEST: usize = 300;

pub(super) struct Run {
    profile: ProfileName,
    subject: String,
    unit: &'static str,
    step: Mutex<&'static str>,
    done: Arc<AtomicU64>,
    of: AtomicU64,
    units: AtomicU64,
}

impl Run {
    pub fn step(&self, word: &'static str) {
        *self.step.lock().unwrap_or_else(PoisonError::into_inner) = word;
    }

    /// Sets `done` of `of`, and the units.
    pub fn at(&self, done: u64, of: u64, units: u64) {
        self.done.store(done, Ordering::Relaxed);
        self.expect(of);
        self.units.store(units, Ordering::Relaxed);
    }

    /// 0 = unknown.
    pub fn expect(&self, of: u64) {
        self.of.store(of, Ordering::Relaxed);
    }

    pub fn more(&self, done: u64) {
        self.done.fetch_add(done, Ordering::Relaxed);
    }

    pub fn one_more(&self) {
        self.units.fetch_add(1, Ordering::Relaxed);
    }

    /// For work that counts on its own.
    pub fn counter(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.done)
    }

    fn view(&self) -> ProgressView {
        let (done, of) = (self.done.load(Ordering::Relaxed), self.of.load(Ordering::Relaxed));
        ProgressView {
            step: (*self.step.lock().unwrap_or_else(PoisonError::into_inner)).to_owned(),
            file: self.subject.clone(),
            // More may come than was expected.
            done: if of > 0 { done.min(of) } else { done },
            of,
            // Records are the measure of the work itself.
            messages: if self.unit == "records" { done } else { self.units.load(Ordering::Relaxed) },
            unit: self.unit.to_owned(),
        }
    }
}

#[derive(Clone, Default)]
pub(super) struct Runs(Arc<Mutex<Vec<Arc<Run>>>>);

impl Runs {
    /// Begins work for a profile: its subject, first step, and unit.
    pub fn begin(&self, profile: &ProfileName, subject: &str, step: &'static str, unit: &'static str) -> Running {
        let (profile, subject) = (profile.clone(), clean(subject, WIDEST));
        let (done, of, units) = (Arc::default(), AtomicU64::default(), AtomicU64::default());
        let run = Arc::new(Run { profile, subject, unit, step: Mutex::new(step), done, of, units });
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(&run));
        Running { runs: self.clone(), run }
    }

    pub fn of(&self, profile: &ProfileName) -> Vec<ProgressView> {
        let runs = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        runs.iter().filter(|run| run.profile == *profile).map(|run| run.view()).collect()
    }
}

/// Removes the run when dropped.
pub(super) struct Running {
    runs: Runs,
    pub run: Arc<Run>,
}

impl Drop for Running {
    fn drop(&mut self) {
        let mut runs = self.runs.0.lock().unwrap_or_else(PoisonError::into_inner);
        runs.retain(|run| !Arc::ptr_eq(run, &self.run));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_runs_is_told_to_whom_it_belongs_until_it_ends() {
        let (alice, bob): (ProfileName, ProfileName) =
            ("alice".parse().expect("a name"), "bob".parse().expect("a name"));
        let runs = Runs::default();
        let audit = runs.begin(&alice, "this home", "auditing", "records");
        audit.run.expect(1_000);
        audit.run.counter().fetch_add(250, Ordering::Relaxed);
        assert!(runs.of(&bob).is_empty());
        let told = runs.of(&alice);
        assert_eq!((told[0].done, told[0].of, told[0].messages, told[0].unit.as_str()), (250, 1_000, 250, "records"));
        audit.run.more(900);
        assert_eq!(runs.of(&alice)[0].done, 1_000, "never more than all");
        let import = runs.begin(&alice, "run.bag", "hashing", "messages");
        import.run.step("importing");
        import.run.at(5, 6, 2);
        let told = runs.of(&alice);
        assert_eq!((told[1].step.as_str(), told[1].done, told[1].messages), ("importing", 5, 2));
        drop(audit);
        assert_eq!(runs.of(&alice).len(), 1);
        drop(import);
        assert!(runs.of(&alice).is_empty());
    }
}
