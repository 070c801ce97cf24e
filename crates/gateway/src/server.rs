//! The gateway's server over TCP: listens, admits peers within their limits, rotates the system keys, stops gracefully.
//! What a command does is up to the desk.

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::net::{TcpListener, TcpStream, ToSocketAddrs};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

use crate::model::SignerId;

use super::code::Code;
use super::connection::{Shared, serve};
use super::desk::Desk;
use super::frame::{FrameKind, encode};
use super::hello::{Context, gateway_id};
use super::limits::{Limits, Peers};
use super::line::Line;
use super::system_keys::SystemKeyList;
use super::system_keys::cabinet::Cabinet;
use super::tally::{Sender, Tally};

/// How often the system keys' schedule is checked.
const ROTATION: Duration = Duration::from_secs(10);
/// How long to wait after the system refused a connection (too many open files).
const PAUSE: Duration = Duration::from_millis(100);

/// A running gateway. Dropping it stops it at once; [`Self::stop`] lets requests in progress finish.
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    stop: watch::Sender<bool>,
    task: JoinHandle<JoinSet<()>>,
}

impl Server {
    /// Listens and serves until it is stopped.
    ///
    /// # Errors
    /// If the address cannot be listened on.
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
        let shared = Arc::new(Shared {
            desk,
            context,
            identity,
            cabinet: Mutex::new(cabinet),
            peers: Peers::new(limits),
            binding: tokio::sync::Mutex::new(()),
            tally: Tally::default(),
        });
        let (stop, stopping) = watch::channel(false);
        let task = tokio::spawn(listen(listener, Arc::clone(&shared), stopping));
        Ok(Self { address, shared, stop, task })
    }

    /// The address it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// SM3 of its identity key, which clients pin.
    pub fn id(&self) -> SignerId {
        gateway_id(&self.shared.identity.public)
    }

    /// The current number of connections.
    pub fn connections(&self) -> usize {
        self.shared.peers.connections()
    }

    /// For the operator's display, also while it is stopped.
    pub fn watch(&self) -> ServerWatch {
        ServerWatch(Arc::clone(&self.shared))
    }

    /// State shared by its connections, for tests that serve one themselves.
    #[cfg(test)]
    pub(super) fn shared(&self) -> Arc<Shared> {
        Arc::clone(&self.shared)
    }

    /// Waits until it stops accepting connections through a fault of its own. Drop it then.
    pub async fn broken(&mut self) {
        // How it ended makes no difference.
        drop((&mut self.task).await);
    }

    /// Accepts no more connections, lets requests in progress finish, closes all; whatever takes longer than `patience`
    /// is cut off.
    pub async fn stop(mut self, patience: Duration) {
        self.stop.send_replace(true);
        let Ok(mut connections) = (&mut self.task).await else { return };
        let finished = timeout(patience, async { while connections.join_next().await.is_some() {} }).await;
        if finished.is_err() {
            connections.shutdown().await;
        }
    }
}

/// A view of a server that does not delay it.
#[derive(Clone)]
pub struct ServerWatch(Arc<Shared>);

impl ServerWatch {
    /// The current number of connections, including handshakes.
    pub fn connections(&self) -> usize {
        self.0.peers.connections()
    }

    /// All sessions under a transport key.
    pub fn senders(&self) -> Vec<Sender> {
        self.0.tally.senders()
    }

    /// The refusals since it was started, by reason.
    pub fn refused(&self) -> Vec<(Code, u64)> {
        self.0.tally.refused()
    }

    /// The published list of system keys.
    pub fn system_keys(&self) -> SystemKeyList {
        self.0.system_keys()
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

/// Completes when the gateway is to stop, or its handle is gone.
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
            // If it does not fit into the socket buffer at once, the peer gets nothing, at no cost to us.
            let _ = stream.try_write(&encode(FrameKind::Refusal, &Code::Busy.number().to_be_bytes()));
        }
    }
}

/// Writing keys waits for the disk, so not on the network threads.
fn rotate(shared: &Arc<Shared>) {
    let shared = Arc::clone(shared);
    tokio::task::spawn_blocking(move || {
        if let Err(refusal) = shared.rotate() {
            shared.refused(SocketAddr::from(([0, 0, 0, 0], 0)), &refusal);
        }
    });
}
