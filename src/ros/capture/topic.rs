//! One watched topic: its publishers, its counters, and when it ends.

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::TopicCapture;
use super::node::lock;
use crate::model::{Timestamp, TopicName, TypeName};
use crate::ros::address::Endpoint;
use crate::ros::slave::BusLink;

/// The most addresses complained about; further ones are refused in silence.
const MOST_COMPLAINTS: usize = 64;

/// A publisher of the topic, read by one thread.
pub(super) struct Publisher {
    pub endpoint: Endpoint,
    state: Mutex<PublisherState>,
}

#[derive(Default)]
struct PublisherState {
    /// Whether the master still names it.
    listed: bool,
    /// Its node name while it is read.
    connected: Option<String>,
}

impl Publisher {
    pub fn set_connected(&self, caller_id: Option<&str>) {
        lock(&self.state).connected = caller_id.map(str::to_owned);
    }
}

#[derive(Default)]
struct State {
    publishers: HashMap<Endpoint, Arc<Publisher>>,
    complaints: HashSet<String>,
    type_name: Option<Arc<str>>,
    /// Counts kicks, so that a waiting thread sees one that came just before it waited.
    kicks: u64,
}

/// A watched topic.
pub(super) struct Topic {
    pub name: TopicName,
    /// The name, shared with every message.
    pub label: Arc<str>,
    pub wanted: Option<TypeName>,
    ended: AtomicBool,
    messages: AtomicU64,
    bytes: AtomicU64,
    lost: AtomicU64,
    /// Nanoseconds; 0 = none yet.
    last: AtomicU64,
    state: Mutex<State>,
    wake: Condvar,
}

impl Topic {
    pub fn new(name: TopicName, wanted: Option<TypeName>) -> Self {
        let label = Arc::from(name.as_str());
        Self {
            name,
            label,
            wanted,
            ended: AtomicBool::new(false),
            messages: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            last: AtomicU64::new(0),
            state: Mutex::default(),
            wake: Condvar::new(),
        }
    }

    /// Takes the master's list: returns the publishers that nobody reads yet.
    pub fn list(&self, endpoints: &[Endpoint]) -> Vec<Arc<Publisher>> {
        let mut state = lock(&self.state);
        for (endpoint, publisher) in &state.publishers {
            lock(&publisher.state).listed = endpoints.contains(endpoint);
        }
        let mut fresh = Vec::new();
        for endpoint in endpoints {
            if !state.publishers.contains_key(endpoint) {
                let listed = PublisherState { listed: true, connected: None };
                let publisher = Arc::new(Publisher { endpoint: endpoint.clone(), state: Mutex::new(listed) });
                state.publishers.insert(endpoint.clone(), Arc::clone(&publisher));
                fresh.push(publisher);
            }
        }
        fresh
    }

    pub fn forget(&self, publisher: &Publisher) {
        lock(&self.state).publishers.remove(&publisher.endpoint);
    }

    /// Waits before a publisher is tried again, until `patience` is over or somebody kicks.
    /// `false`: the topic has ended or the master no longer names it; it is forgotten.
    pub fn wait_to_retry(&self, publisher: &Publisher, patience: Duration) -> bool {
        let state = lock(&self.state);
        let kicks = state.kicks;
        let idle = |state: &mut State| state.kicks == kicks && !self.has_ended();
        let waited = self.wake.wait_timeout_while(state, patience, idle);
        let mut state = waited.unwrap_or_else(PoisonError::into_inner).0;
        // Decided under the lock of `list`, so that a publisher named again gets a new thread.
        let goes_on = !self.has_ended() && lock(&publisher.state).listed;
        if !goes_on {
            state.publishers.remove(&publisher.endpoint);
        }
        goes_on
    }

    /// Makes waiting threads try again now.
    pub fn kick(&self) {
        lock(&self.state).kicks += 1;
        self.wake.notify_all();
    }

    pub fn end(&self) {
        self.ended.store(true, Ordering::SeqCst);
        self.kick();
    }

    pub fn has_ended(&self) -> bool {
        self.ended.load(Ordering::SeqCst)
    }

    pub fn set_type(&self, type_name: &Arc<str>) {
        lock(&self.state).type_name = Some(Arc::clone(type_name));
    }

    /// Whether this address is complained about for the first time.
    pub fn first_complaint(&self, address: &str) -> bool {
        let complaints = &mut lock(&self.state).complaints;
        complaints.len() < MOST_COMPLAINTS && complaints.insert(address.to_owned())
    }

    pub fn count_message(&self, bytes: usize, at: Timestamp) {
        self.messages.fetch_add(1, Ordering::Relaxed);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        self.last.fetch_max(at.0, Ordering::Relaxed);
    }

    pub fn count_lost(&self, count: u64) {
        self.lost.fetch_add(count, Ordering::Relaxed);
    }

    pub fn status(&self) -> TopicCapture {
        let state = lock(&self.state);
        let connected = |publisher: &&Arc<Publisher>| lock(&publisher.state).connected.is_some();
        let last = self.last.load(Ordering::Relaxed);
        let wanted = self.wanted.as_ref().map(|wanted| wanted.as_str());
        TopicCapture {
            topic: self.name.clone(),
            type_name: wanted.or(state.type_name.as_deref()).map(str::to_owned),
            publishers: state.publishers.values().filter(connected).count(),
            messages: self.messages.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
            lost_in_transport: self.lost.load(Ordering::Relaxed),
            last_message: (last > 0).then_some(Timestamp(last)),
        }
    }

    pub fn links(&self) -> Vec<BusLink> {
        let state = lock(&self.state);
        let link = |publisher: &Arc<Publisher>| {
            let peer = lock(&publisher.state).connected.as_ref().map(|_| publisher.endpoint.to_string())?;
            Some(BusLink { peer, outbound: false, topic: self.name.to_string() })
        };
        state.publishers.values().filter_map(link).collect()
    }
}
