//! One watched topic: its publishers, the origin of their messages, and their sequence numbers.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::TopicCapture;
use crate::model::{Timestamp, TopicName, TypeName, clean, pinned_name};
use crate::tcpros::{Endpoint, resolve};
use crate::{graph::Unreached, lock, tcpros::BusLink};

/// Further addresses are refused silently.
const MOST_COMPLAINTS: usize = 64;

/// Claims kept until the master has answered.
const MOST_CLAIMS: usize = 64;

/// A late notice may still name a publisher that the master listed this recently.
const LATELY: Duration = Duration::from_secs(10);

pub(super) struct Publisher {
    pub endpoint: Endpoint,
    /// Unique in this process.
    pub number: u64,
    pub listed_at: Instant,
    /// It registered no earlier than this.
    absent_until: Option<Instant>,
    state: Mutex<PublisherState>,
}

#[derive(Default)]
struct PublisherState {
    listed: bool,
    /// Its node name while it is read.
    connected: Option<Arc<str>>,
    /// Its first caller id, and whom it replaced then.
    judged: Option<(Arc<str>, Option<Rival>)>,
    /// Why it cannot be read, since the last attempt.
    trouble: Option<Unreached>,
}

#[derive(Default)]
struct State {
    publishers: HashMap<Endpoint, Arc<Publisher>>,
    complaints: HashSet<String>,
    lineage: Lineage,
    /// URIs announced as publishers, until the master has answered.
    claims: BTreeSet<String>,
    refuted: HashSet<String>,
    lately: HashMap<Endpoint, Instant>,
    type_name: Option<Arc<str>>,
    /// A waiting thread thereby notices a kick just before its wait.
    kicks: u64,
}

pub(super) struct Topic {
    pub name: TopicName,
    pub label: Arc<str>,
    pub wanted: Option<TypeName>,
    ended: AtomicBool,
    messages: AtomicU64,
    bytes: AtomicU64,
    pub lost: AtomicU64,
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

    /// Takes the master's list, requested at `asked_at`; returns the publishers that nobody reads yet.
    pub fn list(&self, endpoints: &[Endpoint], asked_at: Instant) -> Vec<Arc<Publisher>> {
        let mut state = lock(&self.state);
        let (now, absent_until) = (Instant::now(), state.lineage.asked.replace(asked_at));
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
        lock(&self.state).lineage.asked = Some(at);
    }

    /// It is read under this caller id; returns whom it replaces, decided once for each.
    pub fn connected(&self, publisher: &Publisher, caller_id: &Arc<str>) -> Option<Rival> {
        let state = lock(&self.state);
        let beside = state.publishers.values().filter(|other| other.number != publisher.number).find_map(|other| {
            let same = lock(&other.state).connected.as_deref().is_some_and(|name| {
                // Two runs of an anonymous node have different names, so the master admits both.
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

    /// `taken` if the master has another process under its caller id.
    pub fn disconnected(&self, publisher: &Publisher, caller_id: &Arc<str>, taken: bool) {
        let mut state = lock(&self.state);
        state.lineage.ended(caller_id, (publisher.number, &publisher.endpoint), Instant::now(), taken);
        lock(&publisher.state).connected = None;
    }

    pub fn claim(&self, uris: &[&str]) {
        let claims = &mut lock(&self.state).claims;
        for uri in uris.iter().filter(|uri| uri.len() <= 1024) {
            if claims.len() < MOST_CLAIMS {
                claims.insert((*uri).to_owned());
            }
        }
    }

    pub fn take_claims(&self) -> BTreeSet<String> {
        std::mem::take(&mut lock(&self.state).claims)
    }

    /// The master did not answer: the claims wait for the next answer.
    pub fn give_back(&self, claims: BTreeSet<String>) {
        let kept = &mut lock(&self.state).claims;
        kept.extend(claims.into_iter().take(MOST_CLAIMS));
    }

    /// New claims that the master has not listed lately.
    pub fn unconfirmed(&self, claims: BTreeSet<String>) -> Vec<String> {
        let State { lately, refuted, .. } = &mut *lock(&self.state);
        let listed = |uri: &str| Endpoint::parse(uri).is_some_and(|endpoint| lately.contains_key(&endpoint));
        let doubtful = claims.into_iter().filter(|uri| !listed(uri)).map(|uri| clean(&uri, 120));
        doubtful.filter(|uri| refuted.len() < MOST_COMPLAINTS && refuted.insert(uri.clone())).collect()
    }

    pub fn note_trouble(&self, publisher: &Publisher, trouble: Option<Unreached>) {
        lock(&publisher.state).trouble = trouble;
    }

    pub fn forget(&self, publisher: &Publisher) {
        lock(&self.state).publishers.remove(&publisher.endpoint);
    }

    /// Waits until `patience` is over or a kick. `false`: the topic has ended or the master no longer lists the
    /// publisher, which is forgotten.
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

    pub fn first_complaint(&self, address: &str) -> bool {
        let complaints = &mut lock(&self.state).complaints;
        complaints.len() < MOST_COMPLAINTS && complaints.insert(address.to_owned())
    }

    pub fn count_message(&self, bytes: usize, at: Timestamp) {
        self.messages.fetch_add(1, Ordering::Relaxed);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        self.last.fetch_max(at.0, Ordering::Relaxed);
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

#[derive(Debug, Default)]
pub(super) struct Sequence {
    last: Option<u32>,
}

impl Sequence {
    /// How many numbers are missing before the next. The first, a repeated, and a lower one (a restart) miss none; the
    /// step from the highest to 0 is not a gap.
    pub fn follow(&mut self, next: u32) -> u64 {
        let step = self.last.map_or(1, |last| next.wrapping_sub(last));
        self.last = Some(next);
        // More than half the range ahead counts as behind.
        if (1..1 << 31).contains(&step) { u64::from(step - 1) } else { 0 }
    }
}

pub(super) fn header_seq(body: &[u8]) -> Option<u32> {
    body.first_chunk().copied().map(u32::from_le_bytes)
}

const MOST_ENDED: usize = 256;

static MET: AtomicU64 = AtomicU64::new(1);

pub(crate) fn next_number() -> u64 {
    MET.fetch_add(1, Ordering::Relaxed)
}

/// A publisher with the same caller id, still read when another one registered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rival {
    pub number: u64,
    pub uri: String,
}

/// The sender of a connection's messages, as far as ROS 1 reveals it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// Unique in this process, and kept while the master lists its URI.
    pub number: u64,
    /// As it stated it: clean it before it is shown.
    pub caller_id: Arc<str>,
    /// Host of its URI, in lower case; the peer's address if that is none of this name's.
    pub host: String,
    pub uri: String,
    pub type_name: Arc<str>,
    pub md5sum: Arc<str>,
    /// When the master first listed it.
    pub listed_at: Instant,
    /// The publisher with the same caller id that it replaces or coexists with.
    pub rival: Option<Rival>,
    /// Its node's name is still to come: there is nothing to pin yet.
    pub unnamed: bool,
}

/// The name in its URI, if the peer's address is one of that name's.
pub(super) fn host_of(endpoint: &Endpoint, peer: Option<SocketAddr>, deadline: Instant) -> String {
    let name = endpoint.host.to_ascii_lowercase();
    let Some(peer) = peer.map(|peer| plain(peer.ip())) else { return name };
    let known = resolve(&endpoint.host, endpoint.port, deadline).unwrap_or_default();
    if known.iter().any(|address| plain(address.ip()) == peer) { name } else { peer.to_string() }
}

fn plain(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V6(six) => six.to_ipv4_mapped().map_or(address, IpAddr::V4),
        IpAddr::V4(_) => address,
    }
}

struct Ended {
    number: u64,
    endpoint: Endpoint,
    at: Instant,
    /// By then its caller id was registered to another process.
    taken: bool,
}

#[derive(Default)]
pub(super) struct Lineage {
    ended: HashMap<Arc<str>, Ended>,
    /// When the master's last answer was requested, or failed: a publisher first listed by the next answer was not
    /// registered before.
    asked: Option<Instant>,
}

impl Lineage {
    /// `taken` if the master then had another process under its caller id.
    pub fn ended(&mut self, caller_id: &Arc<str>, (number, endpoint): (u64, &Endpoint), at: Instant, taken: bool) {
        if self.ended.len() >= MOST_ENDED
            && let Some(oldest) = self.ended.iter().min_by_key(|(_, ended)| ended.at).map(|(name, _)| Arc::clone(name))
        {
            self.ended.remove(&oldest);
        }
        self.ended.insert(Arc::clone(caller_id), Ended { number, endpoint: endpoint.clone(), at, taken });
    }

    /// A publisher with this caller id whose connection may have ended only after `number` had registered, which was no
    /// earlier than `absent_until`.
    pub fn rival(&self, caller_id: &str, number: u64, absent_until: Option<Instant>) -> Option<Rival> {
        let former = self.ended.get(caller_id)?;
        let overlapped = former.taken || absent_until.is_none_or(|absent| former.at >= absent);
        let rival = || Rival { number: former.number, uri: former.endpoint.to_string() };
        (former.number != number && overlapped).then(rival)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn gaps_restarts_repeats_and_the_turn() {
        let mut sequence = Sequence::default();
        let missed: Vec<u64> = [7, 8, 8, 12, 0, 1, 3].into_iter().map(|next| sequence.follow(next)).collect();
        assert_eq!(missed, [0, 0, 0, 3, 0, 0, 1]);
        let mut sequence = Sequence::default();
        let missed: Vec<u64> = [u32::MAX - 1, u32::MAX, 0, 2].into_iter().map(|next| sequence.follow(next)).collect();
        assert_eq!(missed, [0, 0, 0, 1]);
        assert_eq!(header_seq(&[1, 0, 0]), None);
        assert_eq!(header_seq(&[2, 1, 0, 0, 9]), Some(258));
    }

    proptest! {
        #[test]
        fn what_is_dropped_is_counted(first in any::<u32>(), kept in prop::collection::vec(any::<bool>(), 1..200)) {
            let mut sequence = Sequence::default();
            sequence.follow(first);
            let mut missed = 0;
            let mut next = first;
            for keep in &kept {
                next = next.wrapping_add(1);
                if *keep {
                    missed += sequence.follow(next);
                }
            }
            let last_kept = kept.iter().rposition(|keep| *keep).map_or(0, |index| index + 1);
            let dropped = kept[..last_kept].iter().filter(|keep| !**keep).count();
            prop_assert_eq!(missed, dropped as u64);
        }
    }
}

#[cfg(test)]
mod origin_tests {
    use super::*;
    use std::time::Duration;

    fn endpoint(port: u16) -> Endpoint {
        Endpoint { host: "Robot".into(), port, path: "/".into() }
    }

    #[test]
    fn a_restart_has_a_look_between_and_a_takeover_has_none() {
        let begun = Instant::now();
        let at = |seconds| begun + Duration::from_secs(seconds);
        let mut lineage = Lineage::default();
        let name: Arc<str> = "/driver".into();
        assert_eq!(lineage.asked, None);
        lineage.asked = Some(at(1));
        lineage.ended(&name, (1, &endpoint(10)), at(2), false);
        // Listed in the answer to the very next query: it had registered while the former was still there.
        let taken = lineage.rival(&name, 2, lineage.asked);
        assert_eq!(taken, Some(Rival { number: 1, uri: "http://Robot:10/".into() }));
        // A query after the end that did not list it: it came later.
        lineage.asked = Some(at(3));
        assert_eq!(lineage.rival(&name, 3, lineage.asked), None);
        // The same publisher again is not a rival, nor is another name.
        assert_eq!(lineage.rival(&name, 1, Some(at(1))), None);
        assert_eq!(lineage.rival("/other", 4, Some(at(1))), None);
        // However much later: its name was already somebody else's when it ended.
        lineage.ended(&name, (5, &endpoint(11)), at(4), true);
        lineage.asked = Some(at(5));
        assert_eq!(lineage.rival("/driver", 6, lineage.asked).map(|rival| rival.number), Some(5));
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let mut lineage = Lineage::default();
        for number in 0..2 * MOST_ENDED as u64 {
            lineage.ended(&format!("/n{number}").into(), (number, &endpoint(1)), Instant::now(), false);
        }
        assert_eq!(lineage.ended.len(), MOST_ENDED);
        assert!(lineage.rival("/n511", 9999, None).is_some() && lineage.rival("/n0", 9999, None).is_none());
    }

    #[test]
    fn the_host_is_where_the_bytes_come_from() {
        let soon = || Instant::now() + Duration::from_secs(2);
        let of = |host: &str, peer: &str| {
            let endpoint = Endpoint { host: host.into(), port: 1, path: "/".into() };
            host_of(&endpoint, Some(peer.parse().expect("address")), soon())
        };
        assert_eq!(of("127.0.0.1", "127.0.0.1:9"), "127.0.0.1");
        assert_eq!(of("LocalHost", "127.0.0.1:9"), "localhost");
        assert_eq!(of("127.0.0.1", "127.0.0.2:9"), "127.0.0.2");
        assert_eq!(of("127.0.0.1", "[::ffff:127.0.0.1]:9"), "127.0.0.1");
    }
}
