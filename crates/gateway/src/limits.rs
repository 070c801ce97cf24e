//! What one peer may cost. A peer is an IPv4 address or an IPv6 network of 64 bits; those of an IPv6 network of 48 bits
//! also share limits. Pure except for its lock: the caller passes the time.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::error::{Code, Refusal, Result};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    pub connections: usize,
    pub connections_of_peer: usize,
    /// Unauthenticated, in total; a peer has at most an eighth, an IPv6 network a quarter. A newcomer drops the oldest.
    pub handshakes: usize,
    /// Burst of one peer.
    pub handshake_burst: f64,
    /// Of one peer per second, sustained.
    pub handshake_rate: f64,
    /// Of one peer per second; more are slowed down.
    pub frame_rate: f64,
    /// Of one peer per second; more are slowed down.
    pub byte_rate: f64,
    /// Burst of one peer, weighted by cost.
    pub relay_burst: f64,
    /// The same per second, sustained; more are slowed down.
    pub relay_rate: f64,
    /// Burst of newcomers' transactions from one peer; four times as many from all.
    pub newcomer_burst: f64,
    /// Per second, sustained, of one peer and of all; more are refused: each makes the chain longer for ever.
    pub newcomer_rate: f64,
    /// Bytes of large frames and messages in parts that one peer may have in flight.
    pub quota_of_peer: usize,
    /// Of all peers.
    pub quota: usize,
    /// From connecting to the first frame that opens.
    pub hello_time: Duration,
    /// For a whole frame or message in parts.
    pub frame_time: Duration,
    pub idle_time: Duration,
    /// Until the peer accepts what is sent.
    pub write_time: Duration,
    /// Visitors, who read the chain without a transport key, in total. A newcomer evicts one as in `enter_visit`.
    pub visits: usize,
    /// Of one peer.
    pub visits_of_peer: usize,
    /// The longest.
    pub visit_time: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 10_000,
            connections_of_peer: 1_000,
            handshakes: 512,
            handshake_burst: 200.0,
            handshake_rate: 10.0,
            frame_rate: 20_000.0,
            byte_rate: 256e6,
            relay_burst: 2_000.0,
            relay_rate: 400.0,
            newcomer_burst: 64.0,
            newcomer_rate: 0.2,
            quota_of_peer: 256 << 20,
            quota: 1 << 30,
            hello_time: Duration::from_secs(10),
            frame_time: Duration::from_secs(30),
            idle_time: Duration::from_secs(600),
            write_time: Duration::from_secs(30),
            visits: 64,
            visits_of_peer: 8,
            visit_time: Duration::from_secs(600),
        }
    }
}

#[derive(Debug, Clone)]
pub struct Peers {
    limits: Limits,
    counts: Arc<Mutex<Counts>>,
}

impl Peers {
    pub fn new(limits: Limits) -> Self {
        Self { limits, counts: Arc::default() }
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    fn lock(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn connections(&self) -> usize {
        self.lock().connections
    }

    /// A handshake until [`Seat::authenticated`]. Drops the oldest handshake if every place is taken
    /// ([`Seat::evicted`]).
    pub fn admit(&self, address: IpAddr, now: Instant) -> Result<Seat> {
        let limits = &self.limits;
        let mut counts = self.lock();
        if counts.connections >= limits.connections {
            return Err(Refusal::new(Code::Busy, "too many connections"));
        }
        let place = counts.place_of(address, limits, now);
        counts.check_room(&place, limits, now)?;
        let (number, evicted) = counts.enter(place, limits.handshakes);
        Ok(Seat { peers: self.clone(), place, handshake: Some((number, evicted)), visit: None })
    }
}

/// Fills at a rate, up to a burst; may go into debt, which must be waited out.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    level: f64,
    rate: f64,
    burst: f64,
    at: Instant,
}

impl Bucket {
    pub fn new(rate: f64, burst: f64, now: Instant) -> Self {
        Self { level: burst, rate, burst, at: now }
    }

    fn fill(&mut self, now: Instant) {
        let passed = now.saturating_duration_since(self.at).as_secs_f64();
        self.level = (self.level + passed * self.rate).min(self.burst);
        self.at = now.max(self.at);
    }

    pub fn take_if_there(&mut self, now: Instant) -> bool {
        self.fill(now);
        let there = self.level >= 1.0;
        if there {
            self.level -= 1.0;
        }
        there
    }

    /// How long the debt lasts.
    pub fn take(&mut self, now: Instant, amount: f64) -> Duration {
        self.fill(now);
        self.level -= amount;
        Duration::try_from_secs_f64((-self.level / self.rate).max(0.0)).unwrap_or(Duration::MAX)
    }

    pub fn is_full(&mut self, now: Instant) -> bool {
        self.fill(now);
        self.level >= self.burst
    }
}

/// Returned on drop.
#[derive(Debug)]
pub struct Seat {
    peers: Peers,
    place: Place,
    /// Number among the handshakes, and the signal to go.
    handshake: Option<(u64, oneshot::Receiver<()>)>,
    /// The same among the visitors.
    visit: Option<(u64, oneshot::Receiver<()>)>,
}

impl Seat {
    pub fn authenticated(&mut self) {
        if let Some((number, _)) = self.handshake.take() {
            self.peers.lock().leave_handshake(number);
        }
    }

    /// Completes when the connection must make room; never once it is authenticated. Cancel-safe.
    pub async fn evicted(&mut self) {
        if let Some((_, evicted)) = self.handshake.as_mut().or(self.visit.as_mut())
            && evicted.await.is_ok()
        {
            (self.handshake, self.visit) = (None, None);
            return;
        }
        std::future::pending().await
    }

    /// Ends the handshake; takes a visitor's place until the connection ends or makes room ([`Self::evicted`]).
    pub fn visit(&mut self) -> Result<()> {
        if self.visit.is_none() {
            self.visit = Some(self.peers.lock().enter_visit(self.place, &self.peers.limits)?);
            self.authenticated();
        }
        Ok(())
    }

    /// Counts a frame; returns how long to wait before reading on.
    pub fn pace(&self, now: Instant, bytes: usize) -> Duration {
        let mut counts = self.peers.lock();
        let Some(peer) = counts.peers.get_mut(&self.place.peer) else { return Duration::ZERO };
        let bytes = u32::try_from(bytes).map_or(f64::MAX, f64::from);
        peer.frames.take(now, 1.0).max(peer.bytes.take(now, bytes))
    }

    /// Counts a request by its weight; returns how long to wait before forwarding it.
    pub fn pace_relay(&self, now: Instant, weight: u32) -> Duration {
        let mut counts = self.peers.lock();
        let Some(peer) = counts.peers.get_mut(&self.place.peer) else { return Duration::ZERO };
        peer.relays.take(now, f64::from(weight))
    }

    /// Counts a transaction from a peer without a transport key.
    pub fn newcomer(&self, now: Instant) -> Result<()> {
        if self.peers.lock().take_newcomer(&self.place, &self.peers.limits, now) {
            return Ok(());
        }
        let peer = self.place.peer;
        Err(Refusal::new(Code::Quota, format_args!("too many transactions of newcomers, one more from {peer}")))
    }

    /// Until the charge is dropped.
    pub fn charge(&self, bytes: usize) -> Result<Charge> {
        let mut counts = self.peers.lock();
        let limits = &self.peers.limits;
        let fits = counts.charged.saturating_add(bytes) <= limits.quota;
        let peer = counts.peers.get_mut(&self.place.peer);
        let Some(peer) = peer.filter(|peer| fits && peer.charged.saturating_add(bytes) <= limits.quota_of_peer) else {
            return Err(Refusal::new(Code::Quota, format_args!("no room for {bytes} bytes from {}", self.place.peer)));
        };
        peer.charged += bytes;
        counts.charged += bytes;
        Ok(Charge { peers: self.peers.clone(), place: self.place, bytes })
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.authenticated();
        let mut counts = self.peers.lock();
        if let Some((number, _)) = self.visit.take() {
            counts.leave_visit(number);
        }
        counts.connections = counts.connections.saturating_sub(1);
        counts.change(&self.place, |share| share.connections = share.connections.saturating_sub(1));
    }
}

#[derive(Debug)]
pub struct Charge {
    peers: Peers,
    place: Place,
    bytes: usize,
}

impl Drop for Charge {
    fn drop(&mut self) {
        let mut counts = self.peers.lock();
        counts.charged = counts.charged.saturating_sub(self.bytes);
        if let Some(peer) = counts.peers.get_mut(&self.place.peer) {
            peer.charged = peer.charged.saturating_sub(self.bytes);
        }
    }
}

/// Peers, and networks.
const MOST_REMEMBERED: usize = 16_384;
/// Between searches for peers to forget.
const FORGETTING: Duration = Duration::from_secs(1);
/// Multiple of a peer's share for an IPv6 network.
const PEERS_OF_NETWORK: usize = 4;
/// Shared by all peers not remembered: forgetting their debts would pay them.
const UNREMEMBERED: IpAddr = IpAddr::V6(Ipv6Addr::UNSPECIFIED);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Place {
    pub peer: IpAddr,
    pub network: Option<IpAddr>,
}

/// Held by a peer, or by the peers of a network.
#[derive(Debug)]
struct Share {
    pub connections: usize,
    pub handshakes: usize,
    pub visits: usize,
    arrivals: Bucket,
}

#[derive(Debug)]
struct Peer {
    pub share: Share,
    pub charged: usize,
    pub frames: Bucket,
    pub bytes: Bucket,
    pub relays: Bucket,
    newcomers: Bucket,
}

/// May have to make room.
#[derive(Debug)]
struct Evictable {
    place: Place,
    evict: oneshot::Sender<()>,
}

#[derive(Debug, Default)]
struct Counts {
    pub connections: usize,
    pub charged: usize,
    /// Of all peers.
    newcomers: Option<Bucket>,
    /// Unauthenticated connections, oldest first.
    handshaking: BTreeMap<u64, Evictable>,
    /// Visitors, oldest first.
    visiting: BTreeMap<u64, Evictable>,
    numbers: u64,
    /// The last search.
    forgot: Option<Instant>,
    pub peers: HashMap<IpAddr, Peer>,
    pub networks: HashMap<IpAddr, Share>,
}

fn masked(address: Ipv6Addr, bits: u32) -> IpAddr {
    IpAddr::V6((address.to_bits() & (u128::MAX << (128 - bits))).into())
}

fn place_of(address: IpAddr) -> Place {
    match address.to_canonical() {
        IpAddr::V6(address) => Place { peer: masked(address, 64), network: Some(masked(address, 48)) },
        address @ IpAddr::V4(_) => Place { peer: address, network: None },
    }
}

impl Share {
    /// Of one peer, or `times` as many.
    fn new(limits: &Limits, times: f64, now: Instant) -> Self {
        let arrivals = Bucket::new(limits.handshake_rate * times, limits.handshake_burst * times, now);
        Self { connections: 0, handshakes: 0, visits: 0, arrivals }
    }

    /// Holds and owes nothing.
    fn is_idle(&mut self, now: Instant) -> bool {
        self.connections == 0 && self.arrivals.is_full(now)
    }
}

impl Peer {
    fn new(limits: &Limits, now: Instant) -> Self {
        Self {
            share: Share::new(limits, 1.0, now),
            charged: 0,
            frames: Bucket::new(limits.frame_rate, limits.frame_rate, now),
            bytes: Bucket::new(limits.byte_rate, limits.byte_rate, now),
            relays: Bucket::new(limits.relay_rate, limits.relay_burst, now),
            newcomers: Bucket::new(limits.newcomer_rate, limits.newcomer_burst, now),
        }
    }

    /// Holds and owes nothing.
    fn is_idle(&mut self, now: Instant) -> bool {
        self.share.is_idle(now) && self.charged == 0 && self.relays.is_full(now) && self.newcomers.is_full(now)
    }
}

#[expect(clippy::cast_precision_loss, reason = "a handful")]
const TIMES: f64 = PEERS_OF_NETWORK as f64;

impl Counts {
    /// Creates peer and network if necessary.
    pub fn place_of(&mut self, address: IpAddr, limits: &Limits, now: Instant) -> Place {
        let mut place = place_of(address);
        if !self.peers.contains_key(&place.peer) && self.peers.len() >= MOST_REMEMBERED {
            self.forget_idle(now);
            if self.peers.len() >= MOST_REMEMBERED {
                place.peer = UNREMEMBERED;
            }
        }
        self.peers.entry(place.peer).or_insert_with(|| Peer::new(limits, now));
        if let Some(mut network) = place.network {
            if !self.networks.contains_key(&network) && self.networks.len() >= MOST_REMEMBERED {
                self.forget_idle(now);
                if self.networks.len() >= MOST_REMEMBERED {
                    network = UNREMEMBERED;
                }
            }
            self.networks.entry(network).or_insert_with(|| Share::new(limits, TIMES, now));
            place.network = Some(network);
        }
        place
    }

    /// Forgets idle ones; in a flood not for every connection.
    fn forget_idle(&mut self, now: Instant) {
        if self.forgot.is_some_and(|at| now.saturating_duration_since(at) < FORGETTING) {
            return;
        }
        self.forgot = Some(now);
        self.peers.retain(|_, peer| !peer.is_idle(now));
        self.networks.retain(|_, network| !network.is_idle(now));
    }

    /// Counts an arrival if one more connection fits.
    pub fn check_room(&mut self, place: &Place, limits: &Limits, now: Instant) -> Result<()> {
        let busy = |what: &str, of: &IpAddr| Err(Refusal::new(Code::Busy, format_args!("too many {what} of {of}")));
        let all = limits.connections_of_peer.saturating_mul(PEERS_OF_NETWORK);
        let network = place.network.and_then(|key| Some((key, self.networks.get_mut(&key)?)));
        let network = network.map(|(key, share)| (key, share, all, limits.handshakes.div_ceil(4)));
        let peer = self.peers.get_mut(&place.peer).map(|peer| (place.peer, &mut peer.share));
        let peer = peer.map(|(key, share)| (key, share, limits.connections_of_peer, limits.handshakes.div_ceil(8)));
        for (key, share, connections, handshakes) in network.into_iter().chain(peer) {
            if share.connections >= connections {
                return busy("connections", &key);
            }
            // Those under way may finish; otherwise a crowd behind one address would drop each other forever.
            if share.handshakes >= handshakes || !share.arrivals.take_if_there(now) {
                return busy("handshakes", &key);
            }
        }
        Ok(())
    }

    /// Gives the handshake a place, if necessary the oldest one's.
    pub fn enter(&mut self, place: Place, most: usize) -> (u64, oneshot::Receiver<()>) {
        while self.handshaking.len() >= most.max(1) {
            let Some(oldest) = self.handshaking.keys().next().copied() else { break };
            if let Some(dropped) = self.leave_handshake(oldest) {
                // One that is ending needs no notice.
                let _ = dropped.send(());
            }
        }
        let (evict, evicted) = oneshot::channel();
        self.numbers += 1;
        self.handshaking.insert(self.numbers, Evictable { place, evict });
        self.connections += 1;
        self.change(&place, |share| {
            share.connections += 1;
            share.handshakes += 1;
        });
        (self.numbers, evicted)
    }

    /// Returns a place, if there still is one.
    pub fn leave_handshake(&mut self, number: u64) -> Option<oneshot::Sender<()>> {
        let Evictable { place, evict } = self.handshaking.remove(&number)?;
        self.change(&place, |share| share.handshakes = share.handshakes.saturating_sub(1));
        Some(evict)
    }

    /// Of a peer and its network.
    pub fn change(&mut self, place: &Place, change: impl Fn(&mut Share)) {
        let network = place.network.and_then(|key| self.networks.get_mut(&key));
        let peer = self.peers.get_mut(&place.peer).map(|peer| &mut peer.share);
        peer.into_iter().chain(network).for_each(change);
    }

    /// Evicts the oldest visitor of the largest holder if all places are taken: many addresses must not keep others out.
    pub fn enter_visit(&mut self, place: Place, limits: &Limits) -> Result<(u64, oneshot::Receiver<()>)> {
        let of_network = limits.visits_of_peer.saturating_mul(2);
        let network = place.network.and_then(|key| self.networks.get(&key));
        let has_share = network.is_some_and(|network| network.visits >= of_network)
            || self.peers.get(&place.peer).is_none_or(|peer| peer.share.visits >= limits.visits_of_peer);
        if has_share {
            return Err(Refusal::new(Code::Busy, format_args!("too many visitors, one more from {}", place.peer)));
        }
        while self.visiting.len() >= limits.visits.max(1) {
            let Some(dropped) = self.visit_to_end().and_then(|number| self.leave_visit(number)) else { break };
            // One that is ending needs no notice.
            let _ = dropped.send(());
        }
        let (evict, evicted) = oneshot::channel();
        self.numbers += 1;
        self.visiting.insert(self.numbers, Evictable { place, evict });
        self.change(&place, |share| share.visits += 1);
        Ok((self.numbers, evicted))
    }

    /// The oldest of the network, or peer without one, that has most.
    fn visit_to_end(&self) -> Option<u64> {
        let held = |place: &Place| match place.network {
            Some(network) => self.networks.get(&network).map_or(0, |network| network.visits),
            None => self.peers.get(&place.peer).map_or(0, |peer| peer.share.visits),
        };
        let visits = self.visiting.iter().map(|(number, visit)| (held(&visit.place), Reverse(*number)));
        visits.max().map(|(_, Reverse(number))| number)
    }

    /// `false` if its peer, or all peers, have sent as many as they may.
    pub fn take_newcomer(&mut self, place: &Place, limits: &Limits, now: Instant) -> bool {
        if self.peers.get_mut(&place.peer).is_some_and(|peer| !peer.newcomers.take_if_there(now)) {
            return false;
        }
        let all =
            self.newcomers.get_or_insert_with(|| Bucket::new(limits.newcomer_rate, limits.newcomer_burst * TIMES, now));
        all.take_if_there(now)
    }

    /// Returns a place, if there still is one.
    pub fn leave_visit(&mut self, number: u64) -> Option<oneshot::Sender<()>> {
        let Evictable { place, evict } = self.visiting.remove(&number)?;
        self.change(&place, |share| share.visits = share.visits.saturating_sub(1));
        Some(evict)
    }
}

#[cfg(test)]
mod tests;
