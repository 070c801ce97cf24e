//! A line between gateways that counts bytes: each gateway is named to the others by such an address.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{JoinHandle, JoinSet};

use authros_service::Failure;
use authros_service::failure::internal;

/// Bytes read at once.
const CHUNK: usize = 64 * 1024;

/// Passes connections on to one gateway.
pub(super) struct Relay {
    /// Where it listens.
    pub address: String,
    bytes: Arc<AtomicU64>,
    task: JoinHandle<()>,
}

impl Relay {
    /// One before `gateway`.
    ///
    /// # Errors
    /// If no port is free.
    pub async fn open(gateway: SocketAddr) -> Result<Self, Failure> {
        let unopened = |error: std::io::Error| internal(format!("no port for the bytes between gateways: {error}"));
        let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await.map_err(unopened)?;
        let address = listener.local_addr().map_err(unopened)?.to_string();
        let bytes = Arc::<AtomicU64>::default();
        let task = tokio::spawn(listen(listener, gateway, Arc::clone(&bytes)));
        Ok(Self { address, bytes, task })
    }

    /// What went through it so far, both ways, bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn listen(listener: TcpListener, gateway: SocketAddr, bytes: Arc<AtomicU64>) {
    let mut lines = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => {
                if let Ok((asking, _)) = accepted {
                    lines.spawn(join(asking, gateway, Arc::clone(&bytes)));
                }
            }
            Some(_) = lines.join_next() => {}
        }
    }
}

/// Until either end closes: a gateway that is stopped is gone for both directions.
async fn join(asking: TcpStream, gateway: SocketAddr, bytes: Arc<AtomicU64>) {
    let Ok(asked) = TcpStream::connect(gateway).await else { return };
    // Without it the figures would be of waiting; an error only means that they are.
    let _ = (asking.set_nodelay(true), asked.set_nodelay(true));
    let ((from_asking, to_asking), (from_asked, to_asked)) = (asking.into_split(), asked.into_split());
    tokio::select! {
        () = pump(from_asking, to_asked, &bytes) => {}
        () = pump(from_asked, to_asking, &bytes) => {}
    }
}

async fn pump(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, bytes: &AtomicU64) {
    let mut buffer = vec![0; CHUNK];
    while let Ok(length @ 1..) = from.read(&mut buffer).await {
        bytes.fetch_add(length as u64, Ordering::Relaxed);
        if to.write_all(&buffer[..length]).await.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn both_directions_are_counted_and_passed_on() {
        let behind = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let relay = Relay::open(behind.local_addr().expect("an address")).await.expect("opens");
        let mut asking = TcpStream::connect(&relay.address).await.expect("listens");
        asking.write_all(b"what do you hold?").await.expect("sent");
        let (mut asked, _) = behind.accept().await.expect("connected");
        let mut heard = [0; 17];
        asked.read_exact(&mut heard).await.expect("passed on");
        asked.write_all(b"nothing").await.expect("sent");
        let mut answer = [0; 7];
        asking.read_exact(&mut answer).await.expect("passed back");
        assert_eq!((&heard, &answer, relay.bytes()), (b"what do you hold?", b"nothing", 24));
    }
}
