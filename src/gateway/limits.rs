//! What one peer may cost: connections, handshakes, frames, bytes, memory. A peer is an IPv4 address or an
//! IPv6 network of 64 bits. Pure but for its lock: the caller says what time it is.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::code::{Code, Refusal};

/// The bounds of a gateway.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Connections in all.
    pub connections: usize,
    /// Connections of one peer.
    pub connections_of_peer: usize,
    /// Connections in all that have not authenticated yet.
    pub handshakes: usize,
    /// Handshakes of one peer that may come at once.
    pub handshake_burst: f64,
    /// Handshakes of one peer per second in the long run.
    pub handshake_rate: f64,
    /// Frames of one peer per second; more are slowed down.
    pub frame_rate: f64,
    /// Bytes of one peer per second; more are slowed down.
    pub byte_rate: f64,
    /// Bytes of messages in parts that one peer may have under way.
    pub quota_of_peer: usize,
    /// The same for all peers together.
    pub quota: usize,
    /// Until a peer has authenticated.
    pub hello_time: Duration,
    /// Until a frame that has begun, or a message in parts, is whole.
    pub frame_time: Duration,
    /// Without any frame.
    pub idle_time: Duration,
    /// Until the peer takes what is sent to it.
    pub write_time: Duration,
    /// Subscriptions of one connection.
    pub subscriptions: usize,
    /// Connections in all that read the chain without a transport key.
    pub visits: usize,
    /// The same of one peer.
    pub visits_of_peer: usize,
    /// How long one of them may last.
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
            quota_of_peer: 256 << 20,
            quota: 1 << 30,
            hello_time: Duration::from_secs(10),
            frame_time: Duration::from_secs(30),
            idle_time: Duration::from_secs(600),
            write_time: Duration::from_secs(30),
            subscriptions: 16,
            visits: 64,
            visits_of_peer: 8,
            visit_time: Duration::from_secs(600),
        }
    }
}

/// Fills at a rate, up to a burst; may run into debt, which is to be waited for.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    level: f64,
    rate: f64,
    burst: f64,
    at: Instant,
}

impl Bucket {
    fn new(rate: f64, burst: f64, now: Instant) -> Self {
        Self { level: burst, rate, burst, at: now }
    }

    fn fill(&mut self, now: Instant) {
        let passed = now.saturating_duration_since(self.at).as_secs_f64();
        self.level = (self.level + passed * self.rate).min(self.burst);
        self.at = now.max(self.at);
    }

    fn take_if_there(&mut self, now: Instant) -> bool {
        self.fill(now);
        let there = self.level >= 1.0;
        if there {
            self.level -= 1.0;
        }
        there
    }

    /// How long to wait until what is taken has been filled again.
    fn take(&mut self, now: Instant, amount: f64) -> Duration {
        self.fill(now);
        self.level -= amount;
        Duration::try_from_secs_f64((-self.level / self.rate).max(0.0)).unwrap_or(Duration::MAX)
    }

    fn is_full(&mut self, now: Instant) -> bool {
        self.fill(now);
        self.level >= self.burst
    }
}

#[derive(Debug)]
struct Peer {
    connections: usize,
    visits: usize,
    charged: usize,
    handshakes: Bucket,
    frames: Bucket,
    bytes: Bucket,
}

#[derive(Debug, Default)]
struct Counts {
    connections: usize,
    handshakes: usize,
    visits: usize,
    charged: usize,
    peers: HashMap<IpAddr, Peer>,
}

/// All peers of a gateway.
#[derive(Debug, Clone)]
pub struct Peers {
    limits: Limits,
    counts: Arc<Mutex<Counts>>,
}

/// Peers remembered without a connection, at most; the rest are forgotten, and their buckets with them.
const MOST_REMEMBERED: usize = 16_384;

fn peer_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6((address.to_bits() & (u128::MAX << 64)).into()),
        address @ IpAddr::V4(_) => address,
    }
}

impl Peers {
    /// With nobody connected.
    pub fn new(limits: Limits) -> Self {
        Self { limits, counts: Arc::default() }
    }

    /// The bounds.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    fn lock(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Connections there are now.
    pub fn connections(&self) -> usize {
        self.lock().connections
    }

    /// Admits a connection, which is a handshake until [`Seat::authenticated`].
    ///
    /// # Errors
    /// [`Refusal`] with `Busy`.
    pub fn admit(&self, address: IpAddr, now: Instant) -> Result<Seat, Refusal> {
        let (limits, key) = (&self.limits, peer_of(address));
        let mut counts = self.lock();
        if counts.connections >= limits.connections || counts.handshakes >= limits.handshakes {
            return Err(Refusal::new(Code::Busy, "too many connections"));
        }
        if !counts.peers.contains_key(&key) && counts.peers.len() >= MOST_REMEMBERED {
            counts.forget_idle(now);
        }
        let peer = counts.peers.entry(key).or_insert_with(|| Peer::new(limits, now));
        if peer.connections >= limits.connections_of_peer {
            return Err(Refusal::new(Code::Busy, format_args!("too many connections of {key}")));
        }
        if !peer.handshakes.take_if_there(now) {
            return Err(Refusal::new(Code::Busy, format_args!("too many handshakes of {key}")));
        }
        peer.connections += 1;
        counts.connections += 1;
        counts.handshakes += 1;
        Ok(Seat { peers: self.clone(), key, in_handshake: true, visits: false })
    }
}

impl Peer {
    fn new(limits: &Limits, now: Instant) -> Self {
        Self {
            connections: 0,
            visits: 0,
            charged: 0,
            handshakes: Bucket::new(limits.handshake_rate, limits.handshake_burst, now),
            frames: Bucket::new(limits.frame_rate, limits.frame_rate, now),
            bytes: Bucket::new(limits.byte_rate, limits.byte_rate, now),
        }
    }
}

impl Counts {
    /// Drops peers without a connection: first those that owe nothing, then, in a flood, all.
    fn forget_idle(&mut self, now: Instant) {
        self.peers.retain(|_, peer| peer.connections > 0 || !peer.handshakes.is_full(now));
        if self.peers.len() >= MOST_REMEMBERED {
            self.peers.retain(|_, peer| peer.connections > 0);
        }
    }
}

/// A connection's place; given back when dropped.
#[derive(Debug)]
pub struct Seat {
    peers: Peers,
    key: IpAddr,
    in_handshake: bool,
    visits: bool,
}

impl Seat {
    /// The handshake is over.
    pub fn authenticated(&mut self) {
        if std::mem::take(&mut self.in_handshake) {
            self.peers.lock().handshakes -= 1;
        }
    }

    /// The connection reads the chain without a transport key: the handshake is over, and it takes a visitor's place
    /// until it ends.
    ///
    /// # Errors
    /// [`Refusal`] with `Busy`.
    pub fn visit(&mut self) -> Result<(), Refusal> {
        if self.visits {
            return Ok(());
        }
        {
            let mut counts = self.peers.lock();
            let limits = &self.peers.limits;
            let room = counts.visits < limits.visits;
            let peer = counts.peers.get_mut(&self.key).filter(|peer| room && peer.visits < limits.visits_of_peer);
            let Some(peer) = peer else {
                return Err(Refusal::new(Code::Busy, format_args!("too many visitors, one more of {}", self.key)));
            };
            peer.visits += 1;
            counts.visits += 1;
        }
        self.visits = true;
        self.authenticated();
        Ok(())
    }

    /// Counts one frame; how long the connection must wait before it reads on.
    pub fn pace(&self, now: Instant, bytes: usize) -> Duration {
        let mut counts = self.peers.lock();
        let Some(peer) = counts.peers.get_mut(&self.key) else { return Duration::ZERO };
        let bytes = u32::try_from(bytes).map_or(f64::MAX, f64::from);
        peer.frames.take(now, 1.0).max(peer.bytes.take(now, bytes))
    }

    /// Charges memory to the peer until the charge is dropped.
    ///
    /// # Errors
    /// [`Refusal`] with `Quota`.
    pub fn charge(&self, bytes: usize) -> Result<Charge, Refusal> {
        let mut counts = self.peers.lock();
        let limits = &self.peers.limits;
        let fits = counts.charged.saturating_add(bytes) <= limits.quota;
        let peer = counts.peers.get_mut(&self.key);
        let Some(peer) = peer.filter(|peer| fits && peer.charged.saturating_add(bytes) <= limits.quota_of_peer) else {
            return Err(Refusal::new(Code::Quota, format_args!("no room for {bytes} bytes of {}", self.key)));
        };
        peer.charged += bytes;
        counts.charged += bytes;
        Ok(Charge { peers: self.peers.clone(), key: self.key, bytes })
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.authenticated();
        let mut counts = self.peers.lock();
        counts.connections -= 1;
        counts.visits -= usize::from(self.visits);
        if let Some(peer) = counts.peers.get_mut(&self.key) {
            peer.connections -= 1;
            peer.visits -= usize::from(self.visits);
        }
    }
}

/// Memory charged to a peer.
#[derive(Debug)]
pub struct Charge {
    peers: Peers,
    key: IpAddr,
    bytes: usize,
}

impl Drop for Charge {
    fn drop(&mut self) {
        let mut counts = self.peers.lock();
        counts.charged = counts.charged.saturating_sub(self.bytes);
        if let Some(peer) = counts.peers.get_mut(&self.key) {
            peer.charged = peer.charged.saturating_sub(self.bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    fn small() -> Limits {
        Limits {
            connections: 4,
            connections_of_peer: 2,
            handshakes: 3,
            handshake_burst: 5.0,
            handshake_rate: 1.0,
            frame_rate: 10.0,
            byte_rate: 1000.0,
            quota_of_peer: 100,
            quota: 150,
            ..Limits::default()
        }
    }

    fn other(last: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, last])
    }

    #[test]
    fn connections_and_handshakes_are_bounded_and_given_back() {
        let (peers, now) = (Peers::new(small()), Instant::now());
        let seats = [peers.admit(HERE, now).expect("one"), peers.admit(HERE, now).expect("two")];
        assert_eq!(peers.admit(HERE, now).expect_err("third of one peer").code, Code::Busy);
        let mut third = peers.admit(other(1), now).expect("another peer");
        assert_eq!(peers.admit(other(2), now).expect_err("fourth handshake").code, Code::Busy);
        third.authenticated();
        let fourth = peers.admit(other(2), now).expect("a handshake ended");
        assert_eq!(peers.connections(), 4);
        drop((seats, third, fourth));
        assert_eq!(peers.connections(), 0);
        for _ in 0..3 {
            peers.admit(HERE, now).expect("burst not used up");
        }
        assert_eq!(peers.admit(HERE, now).expect_err("burst used up").code, Code::Busy);
        peers.admit(HERE, now + Duration::from_secs(1)).expect("filled again");
    }

    #[test]
    fn frames_and_bytes_over_the_rate_wait() {
        let (peers, now) = (Peers::new(small()), Instant::now());
        let seat = peers.admit(HERE, now).expect("admitted");
        assert_eq!(seat.pace(now, 1000), Duration::ZERO);
        assert_eq!(seat.pace(now, 500), Duration::from_millis(500));
        assert_eq!(seat.pace(now + Duration::from_secs(2), 0), Duration::ZERO);
        let later = now + Duration::from_secs(60);
        let waits: Vec<Duration> = (0..12).map(|_| seat.pace(later, 0)).collect();
        assert!(waits[9].is_zero() && !waits[10].is_zero(), "{waits:?}");
    }

    #[test]
    fn memory_is_charged_by_peer_and_in_all() {
        let (peers, now) = (Peers::new(small()), Instant::now());
        let (one, two) = (peers.admit(HERE, now).expect("one"), peers.admit(other(1), now).expect("two"));
        let charge = one.charge(100).expect("fits");
        assert_eq!(one.charge(1).expect_err("peer's quota").code, Code::Quota);
        assert_eq!(two.charge(51).expect_err("all quota").code, Code::Quota);
        drop(charge);
        two.charge(100).expect("given back");
        assert!(one.charge(usize::MAX).is_err());
    }

    #[test]
    fn a_network_of_ipv6_is_one_peer_and_a_flood_of_peers_is_forgotten() {
        let address = |text: &str| text.parse::<IpAddr>().expect("address");
        assert_eq!(peer_of(address("2001:db8::1")), peer_of(address("2001:db8::2:3")));
        assert_ne!(peer_of(address("2001:db8::1")), peer_of(address("2001:db8:0:1::1")));
        assert_eq!(peer_of(address("::ffff:10.0.0.1")), other(1));
        let (peers, now) = (Peers::new(small()), Instant::now());
        let seat = peers.admit(HERE, now).expect("stays");
        for number in 0..40_000u32 {
            drop(peers.admit(IpAddr::from(number.to_be_bytes()), now).expect("admitted"));
        }
        assert!(peers.lock().peers.len() <= MOST_REMEMBERED);
        drop(seat);
    }
}
