//! A connection between a client and a gateway that can be silenced, truncated, cut and redirected.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;

struct Shared {
    upstream: Mutex<SocketAddr>,
    muted: AtomicBool,
    /// Bytes still passed from clients; then the connection breaks.
    left: AtomicI64,
    cut: watch::Sender<u64>,
}

pub struct Relay {
    pub address: SocketAddr,
    shared: Arc<Shared>,
    task: JoinHandle<()>,
}

impl Relay {
    pub async fn to(upstream: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("listens");
        let address = listener.local_addr().expect("address");
        let shared = Arc::new(Shared {
            upstream: Mutex::new(upstream),
            muted: AtomicBool::new(false),
            left: AtomicI64::new(i64::MAX),
            cut: watch::channel(0).0,
        });
        let task = tokio::spawn(accept(listener, Arc::clone(&shared)));
        Self { address, shared, task }
    }

    /// From now on the gateway's answers are dropped.
    pub fn mute(&self) {
        self.shared.muted.store(true, Ordering::SeqCst);
    }

    /// After this many more bytes from a client the connection breaks, once.
    pub fn break_after(&self, bytes: i64) {
        self.shared.left.store(bytes, Ordering::SeqCst);
    }

    /// Whether the connection broke as planned.
    pub fn broke(&self) -> bool {
        self.shared.left.load(Ordering::SeqCst) < 0
    }

    /// Breaks all connections; new ones work normally.
    pub fn cut(&self) {
        self.shared.muted.store(false, Ordering::SeqCst);
        self.shared.left.store(i64::MAX, Ordering::SeqCst);
        self.shared.cut.send_modify(|number| *number += 1);
    }

    /// New connections lead here.
    pub fn lead_to(&self, upstream: SocketAddr) {
        *self.shared.upstream.lock().unwrap_or_else(PoisonError::into_inner) = upstream;
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.task.abort();
        self.shared.cut.send_modify(|number| *number += 1);
    }
}

async fn accept(listener: TcpListener, shared: Arc<Shared>) {
    while let Ok((client, _)) = listener.accept().await {
        let upstream = *shared.upstream.lock().unwrap_or_else(PoisonError::into_inner);
        let Ok(gateway) = TcpStream::connect(upstream).await else { continue };
        let ((from_client, to_client), (from_gateway, to_gateway)) = (client.into_split(), gateway.into_split());
        let mut cut = shared.cut.subscribe();
        let (up, down) = (Arc::clone(&shared), Arc::clone(&shared));
        tokio::spawn(async move {
            tokio::select! {
                () = requests(from_client, to_gateway, &up) => {}
                () = answers(from_gateway, to_client, &down) => {}
                _ = cut.changed() => {}
            }
        });
    }
}

async fn requests(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, shared: &Shared) {
    let mut buffer = vec![0; 4096];
    loop {
        let Ok(count @ 1..) = from.read(&mut buffer).await else { return };
        let most = i64::try_from(count).expect("small");
        let left = shared.left.load(Ordering::SeqCst);
        if left < most {
            let part = usize::try_from(left.max(0)).expect("small");
            drop(to.write_all(&buffer[..part]).await);
            shared.left.store(-1, Ordering::SeqCst);
            return;
        }
        if left != i64::MAX {
            shared.left.store(left - most, Ordering::SeqCst);
        }
        if to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}

async fn answers(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, shared: &Shared) {
    let mut buffer = vec![0; 4096];
    loop {
        let Ok(count @ 1..) = from.read(&mut buffer).await else { return };
        if !shared.muted.load(Ordering::SeqCst) && to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}
