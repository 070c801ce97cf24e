//! An observer that joins a home's site whenever there is one: asserts the conservation law, and notes which records
//! were acknowledged and when, and the state of the background tasks.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use authros::model::ProfileName;
use authros::paths::Home;
use authros::service::command::{ListUploads, SiteStatus};
use authros::service::reply::{LifeLine, SiteView};
use authros::service::{Client, UploadQuery, socket};

/// The time between observations.
const LOOK: Duration = Duration::from_millis(100);
/// How long a site may take to answer before it counts as gone.
const PATIENCE: Duration = Duration::from_secs(20);
/// The most records examined, the newest ones.
const NEWEST: usize = 300;

/// Observations so far.
#[derive(Debug, Default)]
pub struct Seen {
    /// Acknowledged records by digest: topic and number.
    pub noted: BTreeMap<String, (String, u64)>,
    /// When a record was noted that had been captured later than all others.
    pub newest: Option<(u64, Instant)>,
    /// The last counts by state.
    pub life: Option<LifeLine>,
    /// Observations in which the law held.
    pub looks: u64,
    /// The most restarts of each task, by its name.
    pub restarts: BTreeMap<String, u64>,
    /// Names of tasks that ran at the last observation.
    pub running: BTreeSet<String>,
    /// Violations of the law, in words.
    pub broken: Vec<String>,
}

/// The observer's thread; the law is asserted when it finishes.
#[derive(Debug)]
pub struct Conservation {
    seen: Arc<Mutex<Seen>>,
    ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

fn lock(seen: &Mutex<Seen>) -> MutexGuard<'_, Seen> {
    seen.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Conservation {
    /// Watches a profile of the home at `path`, from now on and across restarts of its site.
    pub fn watch(path: &Path, profile: &str) -> Self {
        let (seen, ending) = (Arc::<Mutex<Seen>>::default(), Arc::<AtomicBool>::default());
        let (home, profile) = (Home::new(path.to_owned()), profile.parse().expect("a profile's name"));
        let (sink, told) = (Arc::clone(&seen), Arc::clone(&ending));
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(observe(&home, &profile, &sink, &told));
        });
        Self { seen, ending, thread: Some(thread) }
    }

    /// Observations so far.
    pub fn seen(&self) -> MutexGuard<'_, Seen> {
        lock(&self.seen)
    }

    /// Waits until a record is noted that was captured after `moment`, nanoseconds since 1970; returns when that was.
    pub fn wait_for_capture_after(&self, moment: u64, seconds: u64) -> Option<Instant> {
        super::poll(seconds, || self.seen().newest.filter(|(at, _)| *at > moment).map(|(_, noted)| noted))
    }

    /// Ends, and fails the test if the law was ever violated, or never observed.
    pub fn finish(mut self) -> Seen {
        self.end();
        let seen = std::mem::take(&mut *self.seen());
        assert!(seen.broken.is_empty(), "the conservation law was broken: {:?}", seen.broken);
        assert!(seen.looks > 0, "nobody ever looked");
        seen
    }

    fn end(&mut self) {
        self.ending.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

impl Drop for Conservation {
    fn drop(&mut self) {
        self.end();
    }
}

async fn observe(home: &Home, profile: &ProfileName, seen: &Mutex<Seen>, ending: &AtomicBool) {
    let mut client: Option<Client> = None;
    while !ending.load(Ordering::SeqCst) {
        if client.is_none() {
            client = socket::join(home, profile.clone()).await.ok().flatten().map(|(client, _)| client);
            // Another run begins: its counters may have grown, but never shrunk.
            lock(seen).running.clear();
        }
        if let Some(joined) = &client
            && !matches!(tokio::time::timeout(PATIENCE, look(joined, seen)).await, Ok(Some(())))
        {
            client = None;
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// One observation; nothing if the site went away.
async fn look(client: &Client, seen: &Mutex<Seen>) -> Option<()> {
    if let Ok(view) = client.ask(SiteStatus).await {
        hold_to_the_law(&mut lock(seen), view);
    } else {
        return None;
    }
    let query = UploadQuery { limit: NEWEST, newest_first: true, ..UploadQuery::default() };
    let page = client.ask(ListUploads(query)).await.ok()?;
    let mut seen = lock(seen);
    for record in page.records {
        let captured_at = record.captured_at.0;
        if seen.noted.insert(record.digest.to_string(), (record.topic, record.seq)).is_none()
            && seen.newest.is_none_or(|(newest, _)| newest < captured_at)
        {
            seen.newest = Some((captured_at, Instant::now()));
        }
    }
    Some(())
}

fn hold_to_the_law(seen: &mut Seen, view: SiteView) {
    let life = view.life;
    // Before a profile is open its counts are empty.
    if view.profiles.is_empty() {
        return;
    }
    let accounted = life.verified + life.pending + life.right_ended + life.quarantined + life.dropped + life.tampered;
    if life.captured != accounted {
        seen.broken.push(format!("captured {} is not {accounted}: {life:?}", life.captured));
    }
    if let Some(before) = &seen.life
        && life.captured - life.dropped < before.captured - before.dropped
    {
        seen.broken.push(format!("fewer acknowledged than before: {before:?}, then {life:?}"));
    }
    seen.looks += 1;
    seen.life = Some(life);
    seen.running.clear();
    for task in view.tasks {
        let most = seen.restarts.entry(task.name.clone()).or_default();
        *most = (*most).max(task.restarts);
        if task.next_try.is_none() {
            seen.running.insert(task.name);
        }
    }
}
