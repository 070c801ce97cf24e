//! The embedded chain's JSON-RPC over HTTP, for other tools on this machine: cast, web3, ethers, curl.
//!
//! They may read, and send signed transactions. Anyone who may open a connection on this machine can do as much, so it
//! listens only on loopback, and only while it is explicitly run. There is no ws; news comes through filters.

mod http;
mod rpc;
#[cfg(test)]
mod tests;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::timeout;

use self::http::{Broken, Refusal};
use self::rpc::Service;
use crate::{Chain, ChainError};

/// The limits of a caller.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// The most connections at a time.
    connections: usize,
    /// Time to send a request, counted from the end of the previous answer, and to receive an answer.
    patience: Duration,
    /// Time the chain may take for an answer.
    work: Duration,
}

const LIMITS: Limits = Limits { connections: 256, patience: Duration::from_secs(15), work: Duration::from_secs(30) };

const BUSY: Refusal = Refusal { status: "503 Service Unavailable", why: "too many connections; try again" };
const SLOW: Refusal = Refusal { status: "408 Request Timeout", why: "the request did not arrive in time" };
const LONG: Refusal =
    Refusal { status: "503 Service Unavailable", why: "the chain took too long; ask for less at once" };

/// Opens the listener, on loopback only.
///
/// # Errors
/// [`ChainError::Input`] for another address, or one that cannot be bound.
pub async fn listen(address: SocketAddr) -> Result<TcpListener, ChainError> {
    if !address.ip().is_loopback() {
        return Err(ChainError::Input(format!(
            "{address} can be reached by other machines, and the chain cannot tell who is asking; listen on 127.0.0.1 \
             and use an ssh tunnel from elsewhere"
        )));
    }
    TcpListener::bind(address).await.map_err(|error| {
        ChainError::Input(format!("the chain cannot be served at {address}: {error}; choose another port"))
    })
}

impl Chain {
    /// Answers JSON-RPC on `listener` until `stop`; all connections end with it.
    ///
    /// # Errors
    /// [`ChainError::Input`] if the chain is a node, which serves itself.
    pub async fn serve(&self, listener: TcpListener, stop: impl Future<Output = ()> + Send) -> Result<(), ChainError> {
        self.serve_within(LIMITS, listener, stop).await
    }

    async fn serve_within(
        &self,
        limits: Limits,
        listener: TcpListener,
        stop: impl Future<Output = ()> + Send,
    ) -> Result<(), ChainError> {
        let embedded = self.transport().embedded().cloned();
        let Some(embedded) = embedded else {
            return Err(ChainError::Input(format!(
                "this chain is the node at {}; point other tools there",
                self.url()
            )));
        };
        let service = Arc::new(Service::new(embedded));
        let places = Arc::new(Semaphore::new(limits.connections));
        let turned_away = Arc::new(Semaphore::new(limits.connections));
        // Its connections end with it.
        let mut open = JoinSet::new();
        tokio::pin!(stop);
        loop {
            let accepted = tokio::select! {
                () = &mut stop => return Ok(()),
                accepted = listener.accept() => accepted,
                Some(_) = open.join_next() => continue,
            };
            let Ok((stream, _)) = accepted else {
                // Out of descriptors, for example: not a reason to spin.
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            };
            let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                turn_away(&mut open, &turned_away, stream, limits);
                continue;
            };
            let service = Arc::clone(&service);
            open.spawn(async move {
                let _place = place;
                // A peer that disconnects has only itself to blame.
                drop(connection(stream, &service, limits).await);
            });
        }
    }
}

/// Says that there is no free place, and waits briefly until that was read.
fn turn_away(open: &mut JoinSet<()>, waiting: &Arc<Semaphore>, stream: TcpStream, limits: Limits) {
    let Ok(place) = Arc::clone(waiting).try_acquire_owned() else {
        // Nobody waits for the callers in a flood.
        drop(stream.try_write(&http::refusal(BUSY)));
        return;
    };
    open.spawn(async move {
        let _place = place;
        drop(refuse(&mut BufReader::new(stream), BUSY, limits).await);
    });
}

async fn connection(stream: TcpStream, service: &Service, limits: Limits) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let mut stream = BufReader::new(stream);
    loop {
        let request = match timeout(limits.patience, http::read(&mut stream)).await {
            Ok(Ok(request)) => request,
            Ok(Err(Broken::Gone)) => return Ok(()),
            Ok(Err(Broken::Refused(refusal))) => return refuse(&mut stream, refusal, limits).await,
            Err(_) => return refuse(&mut stream, SLOW, limits).await,
        };
        let Ok(body) = timeout(limits.work, service.answer(&request.body)).await else {
            return refuse(&mut stream, LONG, limits).await;
        };
        send(&mut stream, &http::answer(&body, request.keep), limits).await?;
        if !request.keep {
            return stream.shutdown().await;
        }
    }
}

async fn send(stream: &mut BufReader<TcpStream>, bytes: &[u8], limits: Limits) -> std::io::Result<()> {
    timeout(limits.patience, stream.write_all(bytes)).await.map_err(|_| std::io::ErrorKind::TimedOut)?
}

async fn refuse(stream: &mut BufReader<TcpStream>, refusal: Refusal, limits: Limits) -> std::io::Result<()> {
    send(stream, &http::refusal(refusal), limits).await?;
    stream.shutdown().await?;
    // Closing with unread bytes would reset the connection and lose the answer.
    let rest = &mut stream.take(4 * http::LONGEST_BODY as u64);
    drop(timeout(Duration::from_secs(1), tokio::io::copy(rest, &mut tokio::io::sink())).await);
    Ok(())
}
