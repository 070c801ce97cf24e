//! What one peer may cost: connections, handshakes, frames, bytes, memory, requests to the chain. A peer is an IPv4
//! address or an IPv6 network of 64 bits; all peers of an IPv6 network of 48 bits share bounds of their own. Pure but
//! for its lock: the caller says what time it is.

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

/// The bounds of a gateway.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Connections in all.
    pub connections: usize,
    /// Connections of one peer.
    pub connections_of_peer: usize,
    /// Connections in all that have not authenticated yet; one peer holds at most an eighth of them, a network of IPv6
    /// a quarter. Where all places are taken, the oldest is dropped.
    pub handshakes: usize,
    /// Handshakes of one peer that may come at once.
    pub handshake_burst: f64,
    /// Handshakes of one peer per second in the long run.
    pub handshake_rate: f64,
    /// Frames of one peer per second; more are slowed down.
    pub frame_rate: f64,
    /// Bytes of one peer per second; more are slowed down.
    pub byte_rate: f64,
    /// Requests to the chain of one peer that may come at once, weighed by what they cost.
    pub relay_burst: f64,
    /// The same per second in the long run; more are slowed down.
    pub relay_rate: f64,
    /// Transactions of newcomers from one peer that may come at once.
    pub newcomer_burst: f64,
    /// The same per second in the long run; more are refused.
    pub newcomer_rate: f64,
    /// Bytes of large frames and of messages in parts that one peer may have under way.
    pub quota_of_peer: usize,
    /// The same for all peers together.
    pub quota: usize,
    /// From the connection until the first frame that opens.
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

    /// Handshake places of one network of IPv6.
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

    /// Admits a connection, which is a handshake until [`Seat::authenticated`]. Where every place for handshakes is
    /// taken, the connection that has held one the longest is dropped ([`Seat::evicted`]).
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
