//! One watched topic: its publishers, its counters, and its end.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::TopicCapture;
use super::node::lock;
use super::origin::{Lineage, Rival, next_number};
use crate::model::{Timestamp, TopicName, TypeName, clean, pinned_name};
use crate::ros::address::Endpoint;
use crate::ros::graph::Unreached;
use crate::ros::slave::BusLink;

/// The most addresses reported; further ones are refused silently.
const MOST_COMPLAINTS: usize = 64;

/// The most claims of publishers kept until the master has answered.
const MOST_CLAIMS: usize = 64;

/// A publisher that the master listed this recently may still be named in a late notice from the master.
const LATELY: Duration = Duration::from_secs(10);

/// A publisher of the topic, read by one thread.
pub(super) struct Publisher {
    pub endpoint: Endpoint,
    /// Unique in this process.
    pub number: u64,
    /// When an answer of the master first listed it.
    pub listed_at: Instant,
    /// It registered no earlier than this.
    absent_until: Option<Instant>,
    state: Mutex<PublisherState>,
}

#[derive(Default)]
struct PublisherState {
    /// Whether the master still lists it.
    listed: bool,
    /// Its node name while it is read.
    connected: Option<Arc<str>>,
    /// The caller id that it first came with, and whom it replaced then.
    judged: Option<(Arc<str>, Option<Rival>)>,
    /// Why it cannot be read, since the last attempt.
    trouble: Option<Unreached>,
}

#[derive(Default)]
struct State {
    publishers: HashMap<Endpoint, Arc<Publisher>>,
    complaints: HashSet<String>,
    lineage: Lineage,
    /// URIs that somebody announced as publishers, until the master has answered.
    claims: BTreeSet<String>,
    /// Claims already reported.
    refuted: HashSet<String>,
    /// When the master last listed each.
    lately: HashMap<Endpoint, Instant>,
    type_name: Option<Arc<str>>,
    /// Counts kicks, so that a waiting thread notices one that came just before it waited.
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

    /// Takes the master's list: returns the publishers that nobody reads yet. `asked_at` is when that list was
    /// requested.
    pub fn list(&self, endpoints: &[Endpoint], asked_at: Instant) -> Vec<Arc<Publisher>> {
        let mut state = lock(&self.state);
        let (now, absent_until) = (Instant::now(), state.lineage.absent_until());
        state.lineage.asked(asked_at);
        state.lately.retain(|_, at| now.saturating_duration_since(*at) < LATELY);
        state.lately.extend(endpoints.iter().map(|endpoint| (endpoint.clone(), now)));
        for (endpoint, publisher) in &state.publishers {
            lock(&publisher.state).listed = endpoints.contains(endpoint);
        }
        let mut fresh = Vec::new();
        for endpoint in endpoints {
            if !state.publishers.contains_key(endpoint) {
                let listed = PublisherState { listed: true, ..PublisherState::default() };
                let publisher = Arc::new(Publisher {
                    endpoint: endpoint.clone(),
                    number: next_number(),
                    listed_at: now,
                    absent_until,
                    state: Mutex::new(listed),
                });
                state.publishers.insert(endpoint.clone(), Arc::clone(&publisher));
                fresh.push(publisher);
            }
        }
        fresh
    }

    /// The master was queried then and was down.
    pub fn asked(&self, at: Instant) {
        lock(&self.state).lineage.asked(at);
    }

    /// A publisher is being read under this caller id; returns whom it replaces, decided once for each.
    pub fn connected(&self, publisher: &Publisher, caller_id: &Arc<str>) -> Option<Rival> {
        let state = lock(&self.state);
        let beside = state.publishers.values().filter(|other| other.number != publisher.number).find_map(|other| {
            let same = lock(&other.state).connected.as_deref().is_some_and(|name| {
                // Two runs of an anonymous node have different names, so the master lets both be there.
                name == &**caller_id
                    || other.listed_at < publisher.listed_at && pinned_name(name) == pinned_name(caller_id)
            });
            same.then(|| Rival { number: other.number, uri: other.endpoint.to_string() })
        });
        let before = state.lineage.rival(caller_id, publisher.number, publisher.absent_until);
        let mut own = lock(&publisher.state);
        own.connected = Some(Arc::clone(caller_id));
        match &own.judged {
            Some((known, rival)) if known == caller_id => rival.clone(),
            _ => {
                let rival = beside.or(before);
                own.judged = Some((Arc::clone(caller_id), rival.clone()));
                rival
            }
        }
    }

    /// A publisher's connection has ended; `taken` if the master has somebody else under its caller id.
    pub fn disconnected(&self, publisher: &Publisher, caller_id: &Arc<str>, taken: bool) {
        let mut state = lock(&self.state);
        state.lineage.ended(caller_id, (publisher.number, &publisher.endpoint), Instant::now(), taken);
        lock(&publisher.state).connected = None;
    }

    /// Somebody claims that these are the publishers.
    pub fn claim(&self, uris: &[&str]) {
        let claims = &mut lock(&self.state).claims;
        for uri in uris.iter().filter(|uri| uri.len() <= 1024) {
            if claims.len() < MOST_CLAIMS {
                claims.insert((*uri).to_owned());
            }
        }
    }

    /// The claims so far, to be compared with an answer requested now.
    pub fn take_claims(&self) -> BTreeSet<String> {
        std::mem::take(&mut lock(&self.state).claims)
    }

    /// The master did not answer: the claims wait for the next time.
    pub fn give_back(&self, claims: BTreeSet<String>) {
        let kept = &mut lock(&self.state).claims;
        kept.extend(claims.into_iter().take(MOST_CLAIMS));
    }

    /// The claims that the master does not list and has not listed lately, without duplicates.
    pub fn unconfirmed(&self, claims: BTreeSet<String>) -> Vec<String> {
        let state = &mut *lock(&self.state);
        let listed = |uri: &str| Endpoint::parse(uri).is_some_and(|endpoint| state.lately.contains_key(&endpoint));
        let doubtful: Vec<String> = claims.into_iter().filter(|uri| !listed(uri)).map(|uri| clean(&uri, 120)).collect();
        let mut fresh = Vec::new();
        for uri in doubtful {
            if state.refuted.len() < MOST_COMPLAINTS && state.refuted.insert(uri.clone()) {
                fresh.push(uri);
            }
        }
        fresh
    }

    /// Why a publisher cannot be read; `None` = it can.
    pub fn note_trouble(&self, publisher: &Publisher, trouble: Option<Unreached>) {
        lock(&publisher.state).trouble = trouble;
    }

    pub fn forget(&self, publisher: &Publisher) {
        lock(&self.state).publishers.remove(&publisher.endpoint);
    }

    /// Waits before a publisher is tried again, until `patience` is over or it is kicked. `false`: the topic has ended
    /// or the master no longer lists the publisher; it is forgotten.
    pub fn wait_to_retry(&self, publisher: &Publisher, patience: Duration) -> bool {
        let state = lock(&self.state);
        let kicks = state.kicks;
        let idle = |state: &mut State| state.kicks == kicks && !self.has_ended();
        let waited = self.wake.wait_timeout_while(state, patience, idle);
        let mut state = waited.unwrap_or_else(PoisonError::into_inner).0;
        // Decided under the lock of `list`, so that a publisher listed again gets a new thread.
        let goes_on = !self.has_ended() && lock(&publisher.state).listed;
        if !goes_on {
            state.publishers.remove(&publisher.endpoint);
        }
        goes_on
    }

    /// Makes waiting threads try again at once.
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

    /// Whether this address is reported for the first time.
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
        let trouble = |publisher: &Arc<Publisher>| {
            let state = lock(&publisher.state);
            state.trouble.clone().filter(|_| state.listed && state.connected.is_none())
        };
        let mut unreached: Vec<Unreached> = state.publishers.values().filter_map(trouble).collect();
        unreached.sort_by(|one, other| (&one.node, &one.place).cmp(&(&other.node, &other.place)));
        let last = self.last.load(Ordering::Relaxed);
        let wanted = self.wanted.as_ref().map(|wanted| wanted.as_str());
        TopicCapture {
            topic: self.name.clone(),
            type_name: wanted.or(state.type_name.as_deref()).map(str::to_owned),
            publishers: state.publishers.values().filter(connected).count(),
            unreached,
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
