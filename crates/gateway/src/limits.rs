//! What one peer may cost: connections, handshakes, frames, bytes, memory, requests to the chain. A peer is an IPv4
//! address or an IPv6 network of 64 bits; all peers of an IPv6 network of 48 bits also share limits. Pure except for
//! its lock: the caller passes the time.

use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::code::{Code, Refusal};

mod bucket;
mod counts;
mod seat;
#[cfg(test)]
mod tests;

use counts::Counts;
pub use seat::{Charge, Seat};

/// The limits of a gateway.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Total connections.
    pub connections: usize,
    /// Connections of one peer.
    pub connections_of_peer: usize,
    /// Total unauthenticated connections; one peer holds at most an eighth of them, an IPv6 network a quarter. When all
    /// places are taken, the oldest is dropped.
    pub handshakes: usize,
    /// Handshakes of one peer at once.
    pub handshake_burst: f64,
    /// Sustained handshakes of one peer per second.
    pub handshake_rate: f64,
    /// Frames of one peer per second; more are slowed down.
    pub frame_rate: f64,
    /// Bytes of one peer per second; more are slowed down.
    pub byte_rate: f64,
    /// Requests to the chain of one peer at once, weighted by their cost.
    pub relay_burst: f64,
    /// The same per second, sustained; more are slowed down.
    pub relay_rate: f64,
    /// Transactions of newcomers from one peer at once; four times as many from all peers together.
    pub newcomer_burst: f64,
    /// The same per second, sustained, of one peer and of all together; more are refused: each one makes the chain longer
    /// for ever.
    pub newcomer_rate: f64,
    /// Bytes of large frames and of messages in parts that one peer may have in flight.
    pub quota_of_peer: usize,
    /// The same for all peers together.
    pub quota: usize,
    /// From connecting until the first frame that opens.
    pub hello_time: Duration,
    /// Until a frame that has begun, or a message in parts, is complete.
    pub frame_time: Duration,
    /// Without any frames.
    pub idle_time: Duration,
    /// Until the peer accepts what is sent to it.
    pub write_time: Duration,
    /// Subscriptions of one connection.
    pub subscriptions: usize,
    /// Total connections that read the chain without a transport key. When all places are taken, the oldest of those who
    /// hold the most is dropped.
    pub visits: usize,
    /// The same of one peer.
    pub visits_of_peer: usize,
    /// The longest life of such a connection.
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
            subscriptions: 16,
            visits: 64,
            visits_of_peer: 8,
            visit_time: Duration::from_secs(600),
        }
    }
}

impl Limits {
    /// Handshake places of one peer.
    fn handshakes_of_peer(&self) -> usize {
        self.handshakes.div_ceil(8)
    }

    /// Handshake places of one IPv6 network.
    fn handshakes_of_network(&self) -> usize {
        self.handshakes.div_ceil(4)
    }
}

/// All peers of a gateway.
#[derive(Debug, Clone)]
pub struct Peers {
    limits: Limits,
    counts: Arc<Mutex<Counts>>,
}

impl Peers {
    /// With no connections.
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

    /// The current number of connections.
    pub fn connections(&self) -> usize {
        self.lock().connections
    }

    /// Admits a connection, which is a handshake until [`Seat::authenticated`]. If every handshake place is taken, the
    /// connection that has held one the longest is dropped ([`Seat::evicted`]).
    ///
    /// # Errors
    /// [`Refusal`] with `Busy`.
    pub fn admit(&self, address: IpAddr, now: Instant) -> Result<Seat, Refusal> {
        let limits = &self.limits;
        let mut counts = self.lock();
        if counts.connections >= limits.connections {
            return Err(Refusal::new(Code::Busy, "too many connections"));
        }
        let place = counts.place_of(address, limits, now);
        counts.check_room(&place, limits, now)?;
        let (number, evicted) = counts.enter(place, limits.handshakes);
        Ok(Seat::new(self.clone(), place, number, evicted))
    }
}
