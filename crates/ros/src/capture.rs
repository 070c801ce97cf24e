//! The monitoring node: captures every message of the watched topics, of any type. One thread reads one publisher, so
//! that none can starve another; a registrar keeps the subscriptions alive at the master.

mod reader;
mod topic;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use topic::Topic;

use crate::model::{Timestamp, TopicName, TypeName, clean};
use crate::tcpros::{BusLink, Node, SlaveServer};
use crate::tcpros::{Endpoint, own_host};
use crate::xmlrpc::{CallError, Value, call};
use crate::{Result, RosError, graph::Unreached, lock};

pub(crate) use topic::next_number;
pub use topic::{Origin, Rival};

/// Limit of the master's answers, and of resolving names at the start.
const PATIENCE: Duration = Duration::from_secs(2);

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    pub topic: Arc<str>,
    /// `package/Type`
    pub type_name: Arc<str>,
    /// 32 hex characters, as the publisher stated it.
    pub md5sum: Arc<str>,
    /// As the publisher stated it.
    pub definition: Arc<str>,
    /// As the publisher stated it: clean it before it is shown.
    pub caller_id: Arc<str>,
    pub origin: Arc<Origin>,
    pub latching: bool,
    /// When the complete message had arrived.
    pub captured_at: Timestamp,
    /// If the type begins with a header.
    pub header_seq: Option<u32>,
    pub tags: Vec<(String, String)>,
    /// Without its length; of ROS 2 with its encapsulation header.
    pub body: Vec<u8>,
}

/// Called from several threads at once, in order per publisher.
pub trait MessageSink: Send + Sync {
    /// May block; meanwhile that publisher's socket is not read.
    fn accept(&self, message: Message);
    /// The definition arrived after some of the publisher's messages; this message has no body.
    fn define(&self, message: Message) {
        drop(message);
    }
    /// Must not block.
    fn notice(&self, notice: CaptureNotice);
}

/// Texts from peers in it are cleaned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CaptureNotice {
    /// A publisher is being read.
    PublisherConnected { topic: Arc<str>, origin: Arc<Origin> },
    /// A publisher that was being read is gone, or its topic is no longer captured.
    PublisherLost { topic: Arc<str>, caller_id: String, number: u64, reason: String },
    /// Claimed by somebody, not listed by the master, and not contacted.
    UnconfirmedPublisher { topic: Arc<str>, publisher: String },
    /// Listed by the master and unreadable; reported once until it can be read.
    PublisherUnreachable { topic: Arc<str>, publisher: String, reason: String },
    /// It sends another type than requested, and is not captured.
    TypeMismatch { topic: Arc<str>, caller_id: String, wanted: String, found: String },
    /// Its description of its messages is inconsistent; they are captured as sent.
    Contradiction { topic: Arc<str>, caller_id: String, contradiction: String },
    /// Messages never arrived: how many, and the first and last of the missing numbers.
    LostInTransport { topic: Arc<str>, caller_id: String, count: u64, numbers: (u32, u32) },
    /// For example a message beyond the length cap.
    Refused { topic: Arc<str>, publisher: String, reason: String },
    /// The ROS 2 reader is restarted; missed messages are reported when their publishers are heard again.
    ReadingBroken { reason: String },
    /// A publisher vanished while nothing could be read of it.
    EndUnknown { topic: Arc<str>, caller_id: String, at_least: u64 },
    /// A request to shut down, which this node ignores.
    ShutdownAsked { by: String, reason: String },
}

#[derive(Debug, Clone)]
pub struct CaptureOptions {
    /// `http://HOST:PORT`
    pub master_uri: String,
    /// The host at which others reach this node (`ROS_HOSTNAME` or `ROS_IP`); chosen automatically if not set.
    pub own_host: Option<String>,
    /// Must be unique: a master shuts down the older of two nodes with the same name.
    pub node_name: String,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicCapture {
    pub topic: TopicName,
    /// The type requested, otherwise the one last seen.
    pub type_name: Option<String>,
    pub publishers: usize,
    /// Listed by the master and unreadable.
    pub unreached: Vec<Unreached>,
    pub messages: u64,
    pub bytes: u64,
    pub lost_in_transport: u64,
    pub last_message: Option<Timestamp>,
}

pub struct Capture {
    shared: Arc<Shared>,
    registrar: Threads,
    slave: SlaveServer,
}

impl Capture {
    /// Watches nothing yet. The master need not be running.
    pub fn start(options: CaptureOptions, sink: Arc<dyn MessageSink>) -> Result<Self> {
        let master = Endpoint::of_master(&options.master_uri)?;
        let host = own_host(options.own_host.as_deref(), &master, Instant::now() + PATIENCE)?;
        let shared = Arc::new(Shared {
            master,
            node_name: options.node_name,
            sink,
            threads: Threads::default(),
            topics: Mutex::default(),
            errands: Mutex::default(),
            wake: Condvar::new(),
        });
        let slave = SlaveServer::start(&host, Arc::clone(&shared) as _)?;
        let registrar = Threads::default();
        let work = Work { shared: Arc::clone(&shared), slave_uri: slave.uri.clone() };
        let spawned = registrar.spawn("ros-registrar", move || work.run());
        spawned.map_err(|error| RosError::system("start a thread", &error))?;
        Ok(Self { shared, registrar, slave })
    }

    /// With `type_name` only publishers of that type are read. Watching a topic again changes nothing.
    pub fn watch(&self, topic: TopicName, type_name: Option<TypeName>) {
        let make = || Arc::new(Topic::new(topic.clone(), type_name));
        lock(&self.shared.topics).entry(topic.clone()).or_insert_with(make);
        self.shared.send(|errands| {
            errands.leaving.remove(&topic);
            errands.urgent.insert(topic);
        });
    }

    pub fn unwatch(&self, topic: &TopicName) {
        if let Some(watched) = lock(&self.shared.topics).remove(topic) {
            watched.end();
            self.shared.send(|errands| {
                errands.urgent.remove(topic);
                errands.leaving.insert(topic.clone());
            });
        }
    }

    pub fn uri(&self) -> &str {
        &self.slave.uri
    }

    pub fn watched(&self) -> Vec<(TopicName, Option<TypeName>)> {
        self.shared.topics().iter().map(|topic| (topic.name.clone(), topic.wanted.clone())).collect()
    }

    pub fn status(&self) -> Vec<TopicCapture> {
        self.shared.topics().iter().map(|topic| topic.status()).collect()
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        let deadline = Instant::now() + PATIENCE;
        self.shared.topics().iter().for_each(|topic| topic.end());
        // The topics' names stay for unregistering.
        self.shared.send(|errands| errands.stopping = true);
        self.registrar.wait_until_none(deadline);
        self.shared.threads.wait_until_none(deadline);
    }
}

/// Pause of a thread after a panic.
const AFTER_A_PANIC: Duration = Duration::from_millis(500);

#[derive(Default)]
struct Errands {
    pub urgent: BTreeSet<TopicName>,
    pub leaving: BTreeSet<TopicName>,
    pub stopping: bool,
}

struct Shared {
    pub master: Endpoint,
    pub node_name: String,
    pub sink: Arc<dyn MessageSink>,
    pub threads: Threads,
    topics: Mutex<BTreeMap<TopicName, Arc<Topic>>>,
    errands: Mutex<Errands>,
    wake: Condvar,
}

impl Shared {
    pub fn topics(&self) -> Vec<Arc<Topic>> {
        lock(&self.topics).values().cloned().collect()
    }

    pub fn topic(&self, name: &str) -> Option<Arc<Topic>> {
        lock(&self.topics).get(&name.parse().ok()?).cloned()
    }

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

    fn links(&self) -> Vec<BusLink> {
        self.topics().iter().flat_map(|topic| topic.links()).collect()
    }

    /// Anyone can send this: it is only a hint to query the master, and a claim to compare with the answer.
    fn publishers_changed(&self, topic: &str, publishers: &[&str]) {
        if let Some(topic) = self.topic(topic) {
            topic.claim(publishers);
            topic.kick();
            self.ask_about(&topic.name);
        }
    }

    fn shutdown_asked(&self, by: &str, reason: &str) {
        self.notice(CaptureNotice::ShutdownAsked { by: clean(by, 80), reason: clean(reason, 200) });
    }
}

/// Counts running threads, so that shutdown can wait for them, but not forever.
#[derive(Default)]
struct Threads {
    running: Arc<(Mutex<usize>, Condvar)>,
}

impl Threads {
    /// Runs `work` in a counted thread until it returns; after a panic, which the panic hook reports, it starts again.
    pub fn spawn(&self, name: &str, mut work: impl FnMut() + Send + 'static) -> std::io::Result<()> {
        *lock(&self.running.0) += 1;
        let place = Counted(Arc::clone(&self.running));
        std::thread::Builder::new().name(name.into()).spawn(move || {
            let _place = place;
            while catch_unwind(AssertUnwindSafe(&mut work)).is_err() {
                std::thread::sleep(AFTER_A_PANIC);
            }
        })?;
        Ok(())
    }

    pub fn wait_until_none(&self, deadline: Instant) {
        let (count, changed) = &*self.running;
        let patience = deadline.saturating_duration_since(Instant::now());
        drop(changed.wait_timeout_while(lock(count), patience, |running| *running > 0));
    }
}

struct Counted(Arc<(Mutex<usize>, Condvar)>);

impl Drop for Counted {
    fn drop(&mut self) {
        *lock(&self.0.0) -= 1;
        self.0.1.notify_all();
    }
}

/// Interval between registrations of every topic.
const PERIOD: Duration = Duration::from_millis(500);

/// Pause between two rounds, in durations of a round, however many topics there are.
const REST: u32 = 10;

const MOST_PUBLISHERS: usize = 256;

struct Work {
    shared: Arc<Shared>,
    slave_uri: String,
}

impl Work {
    fn run(&self) {
        let mut next_round = Instant::now();
        loop {
            let errands = self.shared.errands(next_round.saturating_duration_since(Instant::now()));
            if errands.stopping {
                let mut names = errands.leaving;
                names.extend(self.shared.topics().iter().map(|topic| topic.name.clone()));
                return self.unregister(&names, Instant::now() + Duration::from_secs(1));
            }
            self.unregister(&errands.leaving, Instant::now() + PATIENCE);
            if Instant::now() < next_round {
                let urgent = errands.urgent.iter().filter_map(|name| self.shared.topic(name.as_str())).collect();
                self.register(urgent);
            } else {
                let begun = Instant::now();
                let topics = self.shared.topics();
                // A newly watched topic is urgent: it does not wait for the round.
                let period = if topics.is_empty() { PATIENCE } else { PERIOD };
                self.register(topics);
                next_round = Instant::now() + period.max(begun.elapsed() * REST);
            }
        }
    }

    /// An urgent topic goes first, but only once: a flood of hints for one topic must not starve the others.
    fn register(&self, topics: Vec<Arc<Topic>>) {
        let mut queue: VecDeque<_> = topics.into();
        let mut hurried = BTreeSet::new();
        while let Some(topic) = queue.pop_front() {
            if !topic.has_ended() && !self.register_one(&topic) {
                return;
            }
            let errands = self.shared.errands(Duration::ZERO);
            if errands.stopping {
                return;
            }
            self.unregister(&errands.leaving, Instant::now() + PATIENCE);
            for name in errands.urgent {
                match self.shared.topic(name.as_str()) {
                    Some(topic) if hurried.insert(name) => queue.push_front(topic),
                    _ => {}
                }
            }
        }
    }

    /// Whether the master answered.
    fn register_one(&self, topic: &Arc<Topic>) -> bool {
        // Taken first: only an answer requested later can contradict a claim.
        let claims = topic.take_claims();
        let asked_at = Instant::now();
        let params = self.params(&[topic.name.as_str(), "*"]);
        match call(&self.shared.master, "registerSubscriber", &params, Instant::now() + PATIENCE) {
            Ok(publishers) => {
                meet(&self.shared, topic, &publishers.texts(), asked_at);
                // Nobody connects to publishers that the master did not list.
                for publisher in topic.unconfirmed(claims) {
                    let topic = Arc::clone(&topic.label);
                    self.shared.notice(CaptureNotice::UnconfirmedPublisher { topic, publisher });
                }
                true
            }
            Err(error) => {
                topic.give_back(claims);
                if matches!(error, CallError::Connect(_)) {
                    // Without a master nobody is registered.
                    topic.asked(asked_at);
                }
                false
            }
        }
    }

    fn params(&self, middle: &[&str]) -> Vec<Value> {
        let (name, uri) = (self.shared.node_name.as_str(), self.slave_uri.as_str());
        std::iter::once(name).chain(middle.iter().copied()).chain([uri]).map(Value::from).collect()
    }

    fn unregister(&self, names: &BTreeSet<TopicName>, deadline: Instant) {
        for name in names {
            let params = self.params(&[name.as_str()]);
            // A master that is gone has forgotten the subscription too.
            if call(&self.shared.master, "unregisterSubscriber", &params, deadline).is_err() {
                return;
            }
        }
    }
}

fn meet(shared: &Arc<Shared>, topic: &Arc<Topic>, uris: &[String], asked_at: Instant) {
    let refuse = |publisher: &str, reason: &str| {
        if topic.first_complaint(publisher) {
            shared.notice(CaptureNotice::Refused {
                topic: Arc::clone(&topic.label),
                publisher: clean(publisher, 120),
                reason: reason.to_owned(),
            });
        }
    };
    let mut endpoints = Vec::new();
    for uri in uris {
        match Endpoint::parse(uri) {
            Some(_) if endpoints.len() >= MOST_PUBLISHERS => refuse("all others", "too many publishers"),
            Some(endpoint) => endpoints.push(endpoint),
            None => refuse(uri, "its address is not http://HOST:PORT"),
        }
    }
    for publisher in topic.list(&endpoints, asked_at) {
        if let Err(error) = reader::spawn(shared, topic, Arc::clone(&publisher)) {
            topic.forget(&publisher);
            refuse(&publisher.endpoint.to_string(), &format!("no thread to read it: {error}"));
        }
    }
}

#[cfg(test)]
mod tests;
