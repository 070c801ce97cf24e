//! Who holds what at a gateway; who is waiting to authenticate and who is visiting, oldest first.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};
use std::net::{IpAddr, Ipv6Addr};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::Limits;
use super::bucket::Bucket;
use crate::gateway::code::{Code, Refusal};

/// The most peers, and networks, remembered.
pub(super) const MOST_REMEMBERED: usize = 16_384;
/// Time between searches for peers to forget.
const FORGETTING: Duration = Duration::from_secs(1);
/// How many times as much an IPv6 network may use as one peer.
const PEERS_OF_NETWORK: usize = 4;
/// All peers not remembered share one entry: forgetting the debts of others would pay them.
const UNREMEMBERED: IpAddr = IpAddr::V6(Ipv6Addr::UNSPECIFIED);

/// The peer and network of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    pub peer: IpAddr,
    /// For IPv6 only.
    pub network: Option<IpAddr>,
}

#[derive(Debug)]
pub(super) struct Peer {
    pub connections: usize,
    pub handshakes: usize,
    pub visits: usize,
    pub charged: usize,
    arrivals: Bucket,
    pub frames: Bucket,
    pub bytes: Bucket,
    pub relays: Bucket,
    newcomers: Bucket,
}

/// What the peers of a network hold together.
#[derive(Debug)]
pub(super) struct Network {
    pub connections: usize,
    pub handshakes: usize,
    pub visits: usize,
    arrivals: Bucket,
}

/// A connection that may have to make room for another one.
#[derive(Debug)]
struct Evictable {
    place: Place,
    evict: oneshot::Sender<()>,
}

#[derive(Debug, Default)]
pub(super) struct Counts {
    pub connections: usize,
    pub charged: usize,
    /// Transactions of newcomers, all peers together.
    newcomers: Option<Bucket>,
    /// Connections that have not authenticated, by number, the oldest first.
    handshaking: BTreeMap<u64, Evictable>,
    /// Connections that read the chain without a transport key, likewise.
    visiting: BTreeMap<u64, Evictable>,
    numbers: u64,
    /// When idle peers were last forgotten.
    forgot: Option<Instant>,
    pub peers: HashMap<IpAddr, Peer>,
    pub networks: HashMap<IpAddr, Network>,
}

fn masked(address: Ipv6Addr, bits: u32) -> IpAddr {
    IpAddr::V6((address.to_bits() & (u128::MAX << (128 - bits))).into())
}

/// The peer that an address belongs to, and its network.
pub(super) fn place_of(address: IpAddr) -> Place {
    match address.to_canonical() {
        IpAddr::V6(address) => Place { peer: masked(address, 64), network: Some(masked(address, 48)) },
        address @ IpAddr::V4(_) => Place { peer: address, network: None },
    }
}

impl Peer {
    fn new(limits: &Limits, now: Instant) -> Self {
        Self {
            connections: 0,
            handshakes: 0,
            visits: 0,
            charged: 0,
            arrivals: Bucket::new(limits.handshake_rate, limits.handshake_burst, now),
            frames: Bucket::new(limits.frame_rate, limits.frame_rate, now),
            bytes: Bucket::new(limits.byte_rate, limits.byte_rate, now),
            relays: Bucket::new(limits.relay_rate, limits.relay_burst, now),
            newcomers: Bucket::new(limits.newcomer_rate, limits.newcomer_burst, now),
        }
    }

    /// Whether it holds nothing and owes nothing.
    fn is_idle(&mut self, now: Instant) -> bool {
        let buckets = [&mut self.arrivals, &mut self.relays, &mut self.newcomers];
        let owes = buckets.into_iter().any(|bucket| !bucket.is_full(now));
        self.connections == 0 && self.charged == 0 && !owes
    }
}

impl Network {
    fn new(limits: &Limits, now: Instant) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let peers = PEERS_OF_NETWORK as f64;
        let arrivals = Bucket::new(limits.handshake_rate * peers, limits.handshake_burst * peers, now);
        Self { connections: 0, handshakes: 0, visits: 0, arrivals }
    }
}

impl Counts {
    /// Where a connection from `address` is counted; creates its peer and network if necessary.
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
            self.networks.entry(network).or_insert_with(|| Network::new(limits, now));
            place.network = Some(network);
        }
        place
    }

    /// Forgets those that hold nothing and owe nothing; in a flood not for every connection.
    fn forget_idle(&mut self, now: Instant) {
        if self.forgot.is_some_and(|at| now.saturating_duration_since(at) < FORGETTING) {
            return;
        }
        self.forgot = Some(now);
        self.peers.retain(|_, peer| !peer.is_idle(now));
        self.networks.retain(|_, network| network.connections > 0 || !network.arrivals.is_full(now));
    }

    /// Whether one more connection fits here; if so, it is counted as an arrival.
    ///
    /// # Errors
    /// [`Refusal`] with `Busy`.
    pub fn check_room(&mut self, place: &Place, limits: &Limits, now: Instant) -> Result<(), Refusal> {
        let busy = |what: &str, of: &IpAddr| Err(Refusal::new(Code::Busy, format_args!("too many {what} of {of}")));
        let network = place.network.and_then(|key| self.networks.get_mut(&key).map(|network| (key, network)));
        if let Some((key, network)) = network {
            if network.connections >= limits.connections_of_peer.saturating_mul(PEERS_OF_NETWORK) {
                return busy("connections", &key);
            }
            if network.handshakes >= limits.handshakes_of_network() || !network.arrivals.take_if_there(now) {
                return busy("handshakes", &key);
            }
        }
        let Some(peer) = self.peers.get_mut(&place.peer) else { return Ok(()) };
        if peer.connections >= limits.connections_of_peer {
            return busy("connections", &place.peer);
        }
        // Those under way may finish; otherwise a crowd behind one address would drop each other forever.
        if peer.handshakes >= limits.handshakes_of_peer() || !peer.arrivals.take_if_there(now) {
            return busy("handshakes", &place.peer);
        }
        Ok(())
    }

    /// Counts a connection and gives its handshake a place, if necessary the oldest one's.
    pub fn enter(&mut self, place: Place, most: usize) -> (u64, oneshot::Receiver<()>) {
        while self.handshaking.len() >= most.max(1) {
            let Some(oldest) = self.handshaking.keys().next().copied() else { break };
            if let Some(dropped) = self.leave_handshake(oldest) {
                // One that is ending by itself needs no notice.
                let _ = dropped.send(());
            }
        }
        let (evict, evicted) = oneshot::channel();
        self.numbers += 1;
        self.handshaking.insert(self.numbers, Evictable { place, evict });
        self.connections += 1;
        self.change(&place, |peer| (peer.connections, peer.handshakes) = (peer.connections + 1, peer.handshakes + 1));
        self.change_network(&place, |network| {
            (network.connections, network.handshakes) = (network.connections + 1, network.handshakes + 1);
        });
        (self.numbers, evicted)
    }

    /// Returns a handshake's place; does nothing if it has none any more.
    pub fn leave_handshake(&mut self, number: u64) -> Option<oneshot::Sender<()>> {
        let Evictable { place, evict } = self.handshaking.remove(&number)?;
        self.change(&place, |peer| peer.handshakes = peer.handshakes.saturating_sub(1));
        self.change_network(&place, |network| network.handshakes = network.handshakes.saturating_sub(1));
        Some(evict)
    }

    /// Changes the counts of a peer.
    pub fn change(&mut self, place: &Place, change: impl FnOnce(&mut Peer)) {
        if let Some(peer) = self.peers.get_mut(&place.peer) {
            change(peer);
        }
    }

    /// Changes the counts of a network.
    pub fn change_network(&mut self, place: &Place, change: impl FnOnce(&mut Network)) {
        if let Some(network) = place.network.and_then(|key| self.networks.get_mut(&key)) {
            change(network);
        }
    }

    /// Gives a connection a visitor's place. If all are taken, the oldest visitor of those who hold the most has to go:
    /// somebody with many addresses must not keep others out.
    ///
    /// # Errors
    /// [`Refusal`] with `Busy` if its peer or network holds its share already.
    pub fn enter_visit(&mut self, place: Place, limits: &Limits) -> Result<(u64, oneshot::Receiver<()>), Refusal> {
        let of_network = limits.visits_of_peer.saturating_mul(2);
        let network = place.network.and_then(|key| self.networks.get(&key));
        let has_share = network.is_some_and(|network| network.visits >= of_network)
            || self.peers.get(&place.peer).is_none_or(|peer| peer.visits >= limits.visits_of_peer);
        if has_share {
            return Err(Refusal::new(Code::Busy, format_args!("too many visitors, one more from {}", place.peer)));
        }
        while self.visiting.len() >= limits.visits.max(1) {
            let Some(dropped) = self.visit_to_end().and_then(|number| self.leave_visit(number)) else { break };
            // One that is ending by itself needs no notice.
            let _ = dropped.send(());
        }
        let (evict, evicted) = oneshot::channel();
        self.numbers += 1;
        self.visiting.insert(self.numbers, Evictable { place, evict });
        self.change(&place, |peer| peer.visits += 1);
        self.change_network(&place, |network| network.visits += 1);
        Ok((self.numbers, evicted))
    }

    /// The oldest visit of the network, or peer without one, that holds the most.
    fn visit_to_end(&self) -> Option<u64> {
        let held = |place: &Place| match place.network {
            Some(network) => self.networks.get(&network).map_or(0, |network| network.visits),
            None => self.peers.get(&place.peer).map_or(0, |peer| peer.visits),
        };
        let visits = self.visiting.iter().map(|(number, visit)| (held(&visit.place), Reverse(*number)));
        visits.max().map(|(_, Reverse(number))| number)
    }

    /// Counts a transaction of a newcomer; `false` if its peer, or all peers together, have sent as many as they may.
    pub fn take_newcomer(&mut self, place: &Place, limits: &Limits, now: Instant) -> bool {
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let burst = limits.newcomer_burst * PEERS_OF_NETWORK as f64;
        if self.peers.get_mut(&place.peer).is_some_and(|peer| !peer.newcomers.take_if_there(now)) {
            return false;
        }
        let all = self.newcomers.get_or_insert_with(|| Bucket::new(limits.newcomer_rate, burst, now));
        all.take_if_there(now)
    }

    /// Returns a visitor's place; does nothing if it has none any more.
    pub fn leave_visit(&mut self, number: u64) -> Option<oneshot::Sender<()>> {
        let Evictable { place, evict } = self.visiting.remove(&number)?;
        self.change(&place, |peer| peer.visits = peer.visits.saturating_sub(1));
        self.change_network(&place, |network| network.visits = network.visits.saturating_sub(1));
        Some(evict)
    }
}
