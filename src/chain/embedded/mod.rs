//! The embedded chain: a private proof-of-authority network of one signer, in this process.
//!
//! revm executes, SQLite keeps, and JSON-RPC is the only way in, so the room above speaks to it
//! exactly as to any other node. It runs on a thread of its own. Gas costs nothing.

mod block;
#[cfg(test)]
mod contract_model;
#[cfg(test)]
mod contract_tests;
#[cfg(test)]
mod differential_tests;
mod file;
mod json;
mod machine;
mod node;
mod pool;
mod rpc;
mod transaction;

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use serde_json::Value;
use tokio::sync::{oneshot, watch};

use self::node::Node;
pub use self::rpc::Fault;
use super::{BlockRef, ChainError, Consensus};

/// How long the thread sleeps when nothing is due.
const IDLE: Duration = Duration::from_secs(3600);

/// The most requests answered before the clock is looked at again.
const BURST: usize = 256;

enum Request {
    Rpc { method: String, parameters: Value, reply: oneshot::Sender<Result<Value, Fault>> },
    Dump(oneshot::Sender<Result<Vec<Vec<u8>>, ChainError>>),
}

/// A handle on a running embedded chain; the chain ends, after sealing what waits, with its last handle.
#[derive(Debug, Clone)]
pub struct Embedded {
    requests: Sender<Request>,
    head: watch::Receiver<BlockRef>,
}

impl Embedded {
    /// Opens or founds the chain in `directory`.
    ///
    /// # Errors
    /// [`ChainError::File`] or [`ChainError::Tampered`].
    pub async fn open(directory: PathBuf, asked: Option<Consensus>) -> Result<Self, ChainError> {
        let (requests, inbox) = channel();
        let (opened, answer) = oneshot::channel();
        let run = move || match Node::open(&directory, asked) {
            Ok(node) => {
                let (announce, head) = watch::channel(node.head);
                if opened.send(Ok(head)).is_ok() {
                    serve(node, &inbox, &announce);
                }
            }
            Err(error) => drop(opened.send(Err(error))),
        };
        let started = thread::Builder::new().name("authros-chain".into()).spawn(run);
        started.map_err(|error| ChainError::Internal(format!("the chain's thread cannot start: {error}")))?;
        let head = answer.await.unwrap_or_else(|_| Err(gone()))?;
        Ok(Self { requests, head })
    }

    /// Answers a JSON-RPC request.
    ///
    /// # Errors
    /// The [`Fault`] that a node would answer with.
    pub async fn request(&self, method: &str, parameters: Value) -> Result<Value, Fault> {
        let (reply, answer) = oneshot::channel();
        let lost = || Fault { code: -32603, message: gone().to_string(), data: None };
        let request = Request::Rpc { method: method.to_owned(), parameters, reply };
        self.requests.send(request).map_err(|_| lost())?;
        answer.await.unwrap_or_else(|_| Err(lost()))
    }

    /// All call data, storage (keys and values) and logs of the chain.
    ///
    /// # Errors
    /// [`ChainError`] where the file cannot be read.
    pub async fn dump(&self) -> Result<Vec<Vec<u8>>, ChainError> {
        let (reply, answer) = oneshot::channel();
        self.requests.send(Request::Dump(reply)).map_err(|_| gone())?;
        answer.await.unwrap_or_else(|_| Err(gone()))
    }

    /// How its blocks are sealed.
    pub fn consensus(&self) -> Consensus {
        Consensus::POA
    }

    /// Announces every new head.
    pub fn head(&self) -> watch::Receiver<BlockRef> {
        self.head.clone()
    }
}

fn gone() -> ChainError {
    ChainError::Internal("the embedded chain has stopped".into())
}

/// Answers what has come in, seals when a block is due, until all handles are gone.
fn serve(mut node: Node, inbox: &Receiver<Request>, announce: &watch::Sender<BlockRef>) {
    loop {
        let open = match inbox.recv_timeout(node.due().unwrap_or(IDLE)) {
            Ok(request) => {
                handle(&mut node, request);
                for more in inbox.try_iter().take(BURST) {
                    handle(&mut node, more);
                }
                true
            }
            Err(RecvTimeoutError::Timeout) => true,
            Err(RecvTimeoutError::Disconnected) => false,
        };
        let due = node.due();
        if due == Some(Duration::ZERO) || (!open && due.is_some()) {
            node.seal();
            announce.send_replace(node.head);
        }
        if !open {
            return;
        }
    }
}

fn handle(node: &mut Node, request: Request) {
    match request {
        Request::Rpc { method, parameters, reply } => drop(reply.send(rpc::answer(node, &method, parameters))),
        Request::Dump(reply) => drop(reply.send(dump(node))),
    }
}

fn dump(node: &Node) -> Result<Vec<Vec<u8>>, ChainError> {
    let mut all: Vec<Vec<u8>> = Vec::new();
    for (key, value) in node.machine.slots() {
        all.push(key.0.to_vec());
        all.push(value.0.to_vec());
    }
    node.file.replay(|_, _, header, mined| {
        all.push(header);
        for one in mined {
            all.push(one.raw);
            all.push(one.receipt);
        }
        Ok(())
    })?;
    Ok(all)
}
