//! The gateway's server over TCP; the desk decides what commands do.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Duration, Instant};
use std::{collections::BTreeMap, io, net::SocketAddr};

use tokio::net::{TcpListener, TcpStream, ToSocketAddrs};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

use crate::connection::{Shared, serve};
use crate::frame::{FrameKind, Line, encode};
use crate::limits::{Limits, Peers};
use crate::model::{Address, ProfileName, SignerId, Timestamp};
use crate::system_keys::{Cabinet, SystemKeyList};
use crate::{crypto::signer_id, desk::Desk, error::Code, hello::Context};

/// Between checks of the system keys' schedule.
const ROTATION: Duration = Duration::from_secs(10);
/// After the system refused a connection (too many open files).
const PAUSE: Duration = Duration::from_millis(100);

/// Dropping it cuts off requests; [`Self::stop`] lets them finish.
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    stop: watch::Sender<bool>,
    task: JoinHandle<JoinSet<()>>,
}

impl Server {
    pub async fn start(
        address: impl ToSocketAddrs,
        desk: Arc<dyn Desk>,
        context: Context,
        cabinet: Cabinet,
        limits: Limits,
    ) -> io::Result<Self> {
        let listener = TcpListener::bind(address).await?;
        let address = listener.local_addr()?;
        let identity = cabinet.identity().clone();
        let (has_workers, grace) = (cabinet.is_shared(), cabinet.grace());
        let kept = RwLock::new(Arc::new(cabinet.kept().clone()));
        let (cabinet, peers, tally) = (Mutex::new(cabinet), Peers::new(limits), Tally::default());
        let binding = tokio::sync::Mutex::new(());
        let shared =
            Arc::new(Shared { desk, context, identity, cabinet, kept, has_workers, grace, peers, binding, tally });
        let (stop, stopping) = watch::channel(false);
        let task = tokio::spawn(listen(listener, Arc::clone(&shared), stopping));
        Ok(Self { address, shared, stop, task })
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// SM3 of its identity key, which clients pin.
    pub fn id(&self) -> SignerId {
        signer_id(&self.shared.identity.public)
    }

    pub fn connections(&self) -> usize {
        self.shared.peers.connections()
    }

    /// For the operator's display, also while it is stopped.
    pub fn watch(&self) -> ServerWatch {
        ServerWatch(Arc::clone(&self.shared))
    }

    /// Returns if it stops accepting connections by a fault; drop it then.
    pub async fn broken(&mut self) {
        drop((&mut self.task).await);
    }

    /// Lets requests in progress finish, for at most `patience`.
    pub async fn stop(mut self, patience: Duration) {
        self.stop.send_replace(true);
        let Ok(mut connections) = (&mut self.task).await else { return };
        let finished = timeout(patience, async { while connections.join_next().await.is_some() {} }).await;
        if finished.is_err() {
            connections.shutdown().await;
        }
    }
}

/// Does not delay the server.
#[derive(Clone)]
pub struct ServerWatch(Arc<Shared>);

impl ServerWatch {
    /// Includes handshakes.
    pub fn connections(&self) -> usize {
        self.0.peers.connections()
    }

    /// Sessions under a transport key, the longest connected first.
    pub fn senders(&self) -> Vec<Sender> {
        self.0.tally.lock().senders.values().cloned().collect()
    }

    /// Since the start.
    pub fn refused(&self) -> Vec<(Code, u64)> {
        self.0.tally.lock().refused.iter().map(|(code, count)| (*code, *count)).collect()
    }

    pub fn system_keys(&self) -> SystemKeyList {
        self.0.system_keys().list.clone()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn listen(listener: TcpListener, shared: Arc<Shared>, mut stop: watch::Receiver<bool>) -> JoinSet<()> {
    let mut connections = JoinSet::new();
    let stopping = stop.clone();
    let mut rotation = interval(ROTATION);
    rotation.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, peer)) => admit(&mut connections, &shared, stream, peer, stopping.clone()),
                Err(_) => sleep(PAUSE).await,
            },
            Some(_) = connections.join_next() => {}
            _ = rotation.tick() => rotate(&shared),
            () = stopped(&mut stop) => return connections,
        }
    }
}

/// Also when the handle is gone.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    // Both outcomes mean the same.
    let _ = stop.wait_for(|stop| *stop).await;
}

fn admit(
    connections: &mut JoinSet<()>,
    shared: &Arc<Shared>,
    stream: TcpStream,
    peer: SocketAddr,
    stop: watch::Receiver<bool>,
) {
    match shared.peers.admit(peer.ip(), Instant::now()) {
        Ok(seat) => {
            connections.spawn(serve(Arc::clone(shared), Line::new(stream), peer, seat, stop));
        }
        Err(refusal) => {
            shared.refused(peer, &refusal);
            // If the socket buffer is full the peer gets nothing, at no cost to us.
            let _ = stream.try_write(&encode(FrameKind::Refusal, &Code::Busy.number().to_be_bytes()));
        }
    }
}

/// Writing keys waits for the disk, so not on the network threads.
fn rotate(shared: &Arc<Shared>) {
    let shared = Arc::clone(shared);
    tokio::task::spawn_blocking(move || shared.rotate());
}

/// Its session is under its transport key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sender {
    pub name: ProfileName,
    pub account: Address,
    pub peer: SocketAddr,
    pub since: Timestamp,
    /// Of this session.
    pub frames: u64,
    /// Of these frames.
    pub bytes: u64,
    pub last: Timestamp,
}

#[derive(Debug, Default)]
struct Counts {
    next: u64,
    senders: BTreeMap<u64, Sender>,
    refused: BTreeMap<Code, u64>,
}

/// Clones share the counts.
#[derive(Debug, Clone, Default)]
pub struct Tally(Arc<Mutex<Counts>>);

impl Tally {
    fn lock(&self) -> MutexGuard<'_, Counts> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts the session until the guard is dropped.
    pub fn enter(&self, name: ProfileName, account: Address, peer: SocketAddr) -> Presence {
        let now = Timestamp::now();
        let sender = Sender { name, account, peer, since: now, frames: 0, bytes: 0, last: now };
        let mut counts = self.lock();
        counts.next += 1;
        let number = counts.next;
        counts.senders.insert(number, sender);
        Presence { tally: self.clone(), number }
    }

    pub fn refuse(&self, code: Code) {
        *self.lock().refused.entry(code).or_default() += 1;
    }
}

#[derive(Debug)]
pub struct Presence {
    tally: Tally,
    number: u64,
}

impl Presence {
    pub fn frame(&self, bytes: usize) {
        if let Some(sender) = self.tally.lock().senders.get_mut(&self.number) {
            sender.frames += 1;
            sender.bytes = sender.bytes.saturating_add(u64::try_from(bytes).unwrap_or(u64::MAX));
            sender.last = Timestamp::now();
        }
    }
}

impl Drop for Presence {
    fn drop(&mut self) {
        self.tally.lock().senders.remove(&self.number);
    }
}

#[cfg(test)]
mod tally_tests {
    use super::*;

    impl Server {
        /// State shared by its connections, for tests that serve one themselves.
        pub(crate) fn shared(&self) -> Arc<Shared> {
            Arc::clone(&self.shared)
        }
    }

    #[test]
    fn a_session_counts_while_it_lasts_and_refusals_stay() {
        let tally = Tally::default();
        let peer = SocketAddr::from(([127, 0, 0, 1], 4_711));
        let presence = tally.enter("robot1".parse().expect("a name"), Address([7; 20]), peer);
        presence.frame(100);
        presence.frame(28);
        let senders: Vec<Sender> = tally.lock().senders.values().cloned().collect();
        assert_eq!((senders.len(), senders[0].frames, senders[0].bytes), (1, 2, 128));
        drop(presence);
        assert!(tally.lock().senders.is_empty());
        tally.refuse(Code::Tag);
        tally.refuse(Code::Tag);
        assert_eq!(tally.lock().refused, BTreeMap::from([(Code::Tag, 2)]));
    }
}
