//! What the features of a site share.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, watch};
use tokio::time::Instant;

use super::audit::Log;
use super::chain::link::Link;
use super::identity::Owners;
use super::leading::worker_name;
use super::storage::{may_hold, open_ledger, open_on_server};
use super::supervision::Supervisor;
use crate::chain::{Policy, check_embedded_chain};
use crate::config::Config;
use crate::crypto::provider;
use crate::hub::Hub;
use crate::model::{ProfileName, clean, locked};
use crate::paths::Home;
use crate::pipeline::{Owner, Plant, Sender};
use crate::reply::{ProgressView, Result};
use crate::store::{CacheSettings, Ciphertext, Claim, Ledger};

#[derive(Clone)]
pub(super) struct Parts {
    pub home: Home,
    pub config: Arc<Config>,
    pub plant: Plant,
    pub hub: Arc<Hub>,
    pub log: Arc<Log>,
    pub owners: Arc<Owners>,
    pub link: Arc<Link>,
    pub life: Arc<Lifetime>,
    pub supervisor: Arc<Supervisor>,
    pub sender: Arc<Sender>,
    pub runs: Runs,
}

/// Receives each owner as it is opened.
pub(super) type Opened = mpsc::UnboundedReceiver<Arc<Owner>>;

impl Parts {
    /// Opens the store of a home; the last value says whether the home is a copy of another, or its database was restored.
    pub fn open(home: Home, config: Config, needs_chain: bool) -> Result<(Self, Opened, bool)> {
        let (events, _) = broadcast::channel(1024);
        let hub = Arc::new(Hub::new(events));
        // An older program changes nothing in a newer home: all files are checked before the first is opened.
        Ledger::check_version(&home.ledger())?;
        check_embedded_chain(&home.chain())?;
        let (ledger, copied) = match &config.store_url {
            Some(url) => open_on_server(&home, url, config.store_roots.as_deref(), needs_chain)?,
            None => open_ledger(&home)?,
        };
        // What begins now depends on who holds it.
        if needs_chain {
            let claim = if may_hold(&ledger, &home)? { Claim::Take } else { Claim::Nothing };
            ledger.lease.beat(&worker_name(None), claim)?;
        }
        let ciphertext = match &config.cache_url {
            Some(url) => {
                let settings = CacheSettings { url: url.clone(), roots: config.cache_roots.clone() };
                Ciphertext::cached(&ledger, &settings)?
            }
            None => Ciphertext::of(&ledger),
        };
        let provider = provider(config.provider);
        let plant = Plant { ledger: ledger.clone(), ciphertext, provider, observer: hub.clone() };
        let life = Arc::new(Lifetime::new());
        let (open, opened) = mpsc::unbounded_channel();
        let parts = Self {
            supervisor: Arc::new(Supervisor::new(Arc::clone(&hub), Arc::clone(&life))),
            log: Arc::new(Log::new(ledger.audit.clone(), Arc::clone(&hub))),
            owners: Arc::new(Owners::new(home.clone(), open)),
            link: Arc::new(Link::new(Arc::clone(&hub), needs_chain)),
            sender: Arc::new(Sender::new(ledger, hub.clone(), Policy { cap: config.max_fee, floor: config.min_price })),
            home,
            config: Arc::new(config),
            plant,
            hub,
            life,
            runs: Runs::default(),
        };
        Ok((parts, opened, copied))
    }

    /// Whether this is a gateway's home whose records are in a database.
    pub fn is_on_server(&self) -> bool {
        self.config.store_url.is_some()
    }

    /// Whether the chain is known only from a gateway's word.
    pub fn is_joined(&self) -> bool {
        self.config.site.is_some()
    }
}

static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);

pub(super) struct Lifetime {
    /// Background tasks are not restarted from then on.
    ending: AtomicBool,
    /// Whether it stays, instead of ending with one command.
    stays: AtomicBool,
    stopping: watch::Sender<bool>,
}

impl Lifetime {
    pub fn new() -> Self {
        Self { ending: AtomicBool::new(false), stays: AtomicBool::new(false), stopping: watch::channel(false).0 }
    }

    /// Nothing new begins; captured messages are still stored.
    pub fn end(&self) {
        self.ending.store(true, Ordering::Release);
    }

    pub fn stay(&self) {
        self.stays.store(true, Ordering::Release);
    }

    pub fn is_to_stay(&self) -> bool {
        self.stays.load(Ordering::Acquire)
    }

    /// Everything captured is stored.
    pub fn stop(&self) {
        self.stopping.send_replace(true);
    }

    /// It may still be storing captured messages.
    pub fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Acquire)
    }

    pub fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    pub async fn stopped(&self) {
        let mut stopping = self.stopping.subscribe();
        // An error means that the site is gone, which is an end too.
        drop(stopping.wait_for(|stopping| *stopping).await);
    }

    /// Pauses; `false` = the site stops.
    pub async fn rest(&self, pause: Duration) -> bool {
        tokio::select! {
            () = tokio::time::sleep(pause) => true,
            () = self.stopped() => false,
        }
    }

    /// Waits for the next whole multiple of `period`; `false` = the site stops.
    pub async fn beat(&self, period: Duration) -> bool {
        let now = Instant::now();
        self.rest(next(*BEGUN, now, period) - now).await
    }
}

/// The next whole multiple of `period`, at least half a period away, so that work ending shortly before a beat does not
/// begin again immediately.
fn next(begun: Instant, now: Instant, period: Duration) -> Instant {
    let nanoseconds = period.as_nanos().max(1);
    let since = (now - begun).as_nanos() + nanoseconds / 2;
    let until = nanoseconds - since % nanoseconds + nanoseconds / 2;
    now + Duration::from_nanos(u64::try_from(until).unwrap_or(u64::MAX))
}

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
        *locked(&self.step) = word;
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
            step: (*locked(&self.step)).to_owned(),
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
        locked(&self.0).push(Arc::clone(&run));
        Running { runs: self.clone(), run }
    }

    pub fn of(&self, profile: &ProfileName) -> Vec<ProgressView> {
        let runs = locked(&self.0);
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
        let mut runs = locked(&self.runs.0);
        runs.retain(|run| !Arc::ptr_eq(run, &self.run));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beat_is_a_whole_multiple_half_a_period_away_at_least() {
        let (begun, period) = (Instant::now(), Duration::from_secs(2));
        let after = |milliseconds: u64| {
            next(begun, begun + Duration::from_millis(milliseconds), period).duration_since(begun).as_millis()
        };
        assert_eq!(after(0), 2000);
        assert_eq!(after(1000), 4000);
        assert_eq!(after(999), 2000);
        assert_eq!(after(2500), 4000);
        assert_eq!(after(3999), 6000);
    }
}

#[cfg(test)]
mod progress_tests {
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
