//! State shared by the threads of a capture: the watched topics, the count of threads, and what the node shows to the
//! master and to tools.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::topic::Topic;
use super::{CaptureNotice, MessageSink};
use crate::model::{TopicName, TypeName, clean};
use crate::ros::address::Endpoint;
use crate::ros::slave::{BusLink, Node};

/// How long a thread pauses after a panic.
const REST: Duration = Duration::from_millis(500);

/// A lock that survives a panicking thread: the data are plain counters and lists.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the registrar is to do next.
#[derive(Default)]
pub(super) struct Errands {
    /// Topics to query the master about at once.
    pub urgent: BTreeSet<TopicName>,
    /// Topics to unregister.
    pub leaving: BTreeSet<TopicName>,
    /// The capture ends.
    pub stopping: bool,
}

/// Shared by all threads of a capture.
pub(super) struct Shared {
    pub master: Endpoint,
    pub node_name: String,
    pub sink: Arc<dyn MessageSink>,
    pub threads: Threads,
    topics: Mutex<BTreeMap<TopicName, Arc<Topic>>>,
    errands: Mutex<Errands>,
    wake: Condvar,
}

impl Shared {
    pub fn new(master: Endpoint, node_name: String, sink: Arc<dyn MessageSink>) -> Self {
        Self {
            master,
            node_name,
            sink,
            threads: Threads::default(),
            topics: Mutex::default(),
            errands: Mutex::default(),
            wake: Condvar::new(),
        }
    }

    pub fn watch(&self, name: TopicName, wanted: Option<TypeName>) {
        let make = || Arc::new(Topic::new(name.clone(), wanted));
        lock(&self.topics).entry(name.clone()).or_insert_with(make);
        self.send(|errands| {
            errands.leaving.remove(&name);
            errands.urgent.insert(name);
        });
    }

    pub fn unwatch(&self, name: &TopicName) {
        if let Some(topic) = lock(&self.topics).remove(name) {
            topic.end();
            self.send(|errands| {
                errands.urgent.remove(name);
                errands.leaving.insert(name.clone());
            });
        }
    }

    pub fn topics(&self) -> Vec<Arc<Topic>> {
        lock(&self.topics).values().cloned().collect()
    }

    pub fn topic(&self, name: &str) -> Option<Arc<Topic>> {
        lock(&self.topics).get(&name.parse().ok()?).cloned()
    }

    /// Ends all topics; their names stay for unregistering.
    pub fn stop(&self) {
        for topic in self.topics() {
            topic.end();
        }
        self.send(|errands| errands.stopping = true);
    }

    /// Has the master queried about this topic at once.
    pub fn ask_about(&self, name: &TopicName) {
        self.send(|errands| {
            errands.urgent.insert(name.clone());
        });
    }

    pub fn notice(&self, notice: CaptureNotice) {
        self.sink.notice(notice);
    }

    /// Waits up to `patience` for an errand and takes all of them.
    pub fn errands(&self, patience: Duration) -> Errands {
        let idle = |errands: &mut Errands| errands.urgent.is_empty() && errands.leaving.is_empty() && !errands.stopping;
        let waited = self.wake.wait_timeout_while(lock(&self.errands), patience, idle);
        let mut errands = waited.unwrap_or_else(PoisonError::into_inner).0;
        let stopping = errands.stopping;
        let taken = std::mem::take(&mut *errands);
        errands.stopping = stopping;
        taken
    }

    fn send(&self, change: impl FnOnce(&mut Errands)) {
        change(&mut lock(&self.errands));
        self.wake.notify_all();
    }
}

impl Node for Shared {
    fn master_uri(&self) -> String {
        self.master.to_string()
    }

    fn subscriptions(&self) -> Vec<(String, String)> {
        let row = |topic: &Arc<Topic>| {
            (topic.name.to_string(), topic.status().type_name.unwrap_or_else(|| String::from("*")))
        };
        self.topics().iter().map(row).collect()
    }

    fn publications(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    fn links(&self) -> Vec<BusLink> {
        self.topics().iter().flat_map(|topic| topic.links()).collect()
    }

    /// Anyone can send this, so it is only a hint to query the master at once, and a claim to compare with the answer.
    fn publishers_changed(&self, topic: &str, publishers: &[&str]) {
        if let Some(topic) = self.topic(topic) {
            topic.claim(publishers);
            topic.kick();
            self.ask_about(&topic.name);
        }
    }

    fn outlet(&self, _topic: &str) -> Option<(String, u16)> {
        None
    }

    fn shutdown_asked(&self, by: &str, reason: &str) {
        self.notice(CaptureNotice::ShutdownAsked { by: clean(by, 80), reason: clean(reason, 200) });
    }
}

/// Counts running threads, so that shutdown can wait for them, but not forever.
#[derive(Default)]
pub(super) struct Threads {
    running: Arc<(Mutex<usize>, Condvar)>,
}

impl Threads {
    /// Runs `work` in a counted thread until it ends by itself; after a panic, which the panic hook reports, it is
    /// started again.
    pub fn spawn(&self, name: &str, mut work: impl FnMut() + Send + 'static) -> std::io::Result<()> {
        let place = Counted::new(&self.running);
        std::thread::Builder::new().name(name.into()).spawn(move || {
            let _place = place;
            while catch_unwind(AssertUnwindSafe(&mut work)).is_err() {
                std::thread::sleep(REST);
            }
        })?;
        Ok(())
    }

    /// Waits until no thread runs; returns whether that happened before `deadline`.
    pub fn wait_until_none(&self, deadline: Instant) -> bool {
        let (count, changed) = &*self.running;
        let patience = deadline.saturating_duration_since(Instant::now());
        let waited = changed.wait_timeout_while(lock(count), patience, |running| *running > 0);
        !waited.unwrap_or_else(PoisonError::into_inner).1.timed_out()
    }
}

struct Counted(Arc<(Mutex<usize>, Condvar)>);

impl Counted {
    fn new(running: &Arc<(Mutex<usize>, Condvar)>) -> Self {
        *lock(&running.0) += 1;
        Self(Arc::clone(running))
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        *lock(&self.0.0) -= 1;
        self.0.1.notify_all();
    }
}
