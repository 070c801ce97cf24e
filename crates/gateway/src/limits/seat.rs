//! A connection's place at a gateway, and memory charged to its peer; both are returned on drop.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::Peers;
use super::counts::Place;
use crate::gateway::code::{Code, Refusal};

/// A connection's place; returned on drop.
#[derive(Debug)]
pub struct Seat {
    peers: Peers,
    place: Place,
    /// Its number among the handshakes, and the signal that it must go.
    handshake: Option<(u64, oneshot::Receiver<()>)>,
    /// The same among the visitors.
    visit: Option<(u64, oneshot::Receiver<()>)>,
}

impl Seat {
    pub(super) fn new(peers: Peers, place: Place, number: u64, evicted: oneshot::Receiver<()>) -> Self {
        Self { peers, place, handshake: Some((number, evicted)), visit: None }
    }

    /// The handshake is over.
    pub fn authenticated(&mut self) {
        if let Some((number, _)) = self.handshake.take() {
            self.peers.lock().leave_handshake(number);
        }
    }

    /// Completes when the connection has to make room for another handshake or visitor; never once it is authenticated.
    /// Can be cancelled at any point.
    pub async fn evicted(&mut self) {
        if let Some((_, evicted)) = self.handshake.as_mut().or(self.visit.as_mut())
            && evicted.await.is_ok()
        {
            (self.handshake, self.visit) = (None, None);
            return;
        }
        std::future::pending().await
    }

    /// The connection reads the chain without a transport key: the handshake is over, and it takes a visitor's place
    /// until it ends or has to make room for another visitor ([`Self::evicted`]).
    ///
    /// # Errors
    /// [`Refusal`] with `Busy`.
    pub fn visit(&mut self) -> Result<(), Refusal> {
        if self.visit.is_none() {
            self.visit = Some(self.peers.lock().enter_visit(self.place, &self.peers.limits)?);
            self.authenticated();
        }
        Ok(())
    }

    /// Counts one frame; returns how long the connection must wait before it reads on.
    pub fn pace(&self, now: Instant, bytes: usize) -> Duration {
        let mut counts = self.peers.lock();
        let Some(peer) = counts.peers.get_mut(&self.place.peer) else { return Duration::ZERO };
        let bytes = u32::try_from(bytes).map_or(f64::MAX, f64::from);
        peer.frames.take(now, 1.0).max(peer.bytes.take(now, bytes))
    }

    /// Counts a request to the chain by its weight; returns how long it must wait before it is passed on.
    pub fn pace_relay(&self, now: Instant, weight: u32) -> Duration {
        let mut counts = self.peers.lock();
        let Some(peer) = counts.peers.get_mut(&self.place.peer) else { return Duration::ZERO };
        peer.relays.take(now, f64::from(weight))
    }

    /// Counts a transaction of a peer without a transport key: each one makes the chain longer forever.
    ///
    /// # Errors
    /// [`Refusal`] with `Quota`.
    pub fn newcomer(&self, now: Instant) -> Result<(), Refusal> {
        if self.peers.lock().take_newcomer(&self.place, &self.peers.limits, now) {
            return Ok(());
        }
        Err(Refusal::new(
            Code::Quota,
            format_args!("too many transactions of newcomers, one more from {}", self.place.peer),
        ))
    }

    /// Charges memory to the peer until the charge is dropped.
    ///
    /// # Errors
    /// [`Refusal`] with `Quota`.
    pub fn charge(&self, bytes: usize) -> Result<Charge, Refusal> {
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
        counts.change(&self.place, |peer| peer.connections = peer.connections.saturating_sub(1));
        counts.change_network(&self.place, |network| network.connections = network.connections.saturating_sub(1));
    }
}

/// Memory charged to a peer.
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
        counts.change(&self.place, |peer| peer.charged = peer.charged.saturating_sub(self.bytes));
    }
}
