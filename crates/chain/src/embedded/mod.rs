//! The embedded chain: a private network in this process, reached only through JSON-RPC.
//!
//! It runs on its own thread, a proof-of-work search on a second one. Gas is free, and no block is empty.

#[cfg(test)]
mod admission_tests;
#[cfg(test)]
mod age_tests;
mod block;
#[cfg(test)]
mod contract_tests;
mod file;
#[cfg(test)]
mod foreign_tests;
mod machine;
mod node;
#[cfg(test)]
mod payloads;
mod pool;
mod rpc;
mod sealing;
#[cfg(test)]
mod sealing_tests;
#[cfg(test)]
mod state_tests;
mod trie;
#[cfg(test)]
mod trie_tests;
mod world;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError, channel};
use std::time::{Duration, Instant};
use std::{sync::Arc, thread};

use serde_json::Value;
use tokio::sync::{oneshot, watch};

use self::node::Node;
use crate::transport::{TransportError, refused};
use crate::{BlockRef, ChainError, Consensus, crypto::fault, model::Address};

const IDLE: Duration = Duration::from_secs(3600);

/// Pause after a panic.
const REST: Duration = Duration::from_millis(500);

/// Time for requests before checking whether a block is due.
const BURST: Duration = Duration::from_millis(50);

enum Request {
    Work(Box<dyn FnOnce(&mut Node) + Send>),
    End,
}

/// Handle; the chain ends with the last one. Proof of authority then seals what waits (unless its period is a second or
/// more), proof of work abandons its search.
#[derive(Debug, Clone)]
pub struct Embedded {
    pub line: Arc<Line>,
}

#[derive(Debug)]
pub struct Line {
    inlet: Inlet,
    pub head: watch::Receiver<BlockRef>,
    pub consensus: Consensus,
    /// In the order of their turns; under proof of work, the recipient of the fees.
    pub sealers: Vec<Address>,
    /// Closes after the file.
    closing: watch::Receiver<()>,
}

/// The chain ends with it.
#[derive(Debug)]
struct Inlet(Sender<Request>);

impl Drop for Inlet {
    fn drop(&mut self) {
        // A search holds a sender too, so the channel alone would not end.
        drop(self.0.send(Request::End));
    }
}

pub fn file_in(directory: &Path) -> PathBuf {
    directory.join("chain.db")
}

/// Refuses a file of another version, without touching it.
pub fn check_embedded_chain(directory: &Path) -> Result<(), ChainError> {
    file::ChainFile::check(directory)
}

impl Embedded {
    pub async fn open(directory: PathBuf, asked: Option<Consensus>) -> Result<Self, ChainError> {
        let (requests, inbox) = channel();
        let (opened, answer) = oneshot::channel();
        let inlet = Inlet(requests.clone());
        let (running, closing) = watch::channel(());
        let found = Arc::new(move |nonce| drop(requests.send(Request::Work(Box::new(move |node| node.worked(nonce))))));
        let run = move || match Node::open(&directory, asked, Arc::clone(&found) as _) {
            Ok(node) => {
                let (announce, head) = watch::channel(node.head);
                if opened.send(Ok((head, node.consensus, node.sealing.addresses()))).is_ok() {
                    keep_serving(node, &inbox, &announce, || Node::open(&directory, asked, Arc::clone(&found) as _));
                    drop(running);
                }
            }
            Err(error) => drop(opened.send(Err(error))),
        };
        let started = thread::Builder::new().name("authros-chain".into()).spawn(run);
        started.map_err(|error| ChainError::Internal(format!("the chain's thread cannot start: {error}")))?;
        let (head, consensus, sealers) = answer.await.unwrap_or_else(|_| Err(gone()))?;
        Ok(Self { line: Arc::new(Line { inlet, head, consensus, sealers, closing }) })
    }

    /// Ends the chain and waits until its file is closed: exiting earlier leaves a log for the next process to apply.
    pub async fn end(&self) {
        drop(self.line.inlet.0.send(Request::End));
        // Nothing is ever sent: receiving ends with the thread.
        drop(self.line.closing.clone().changed().await);
    }

    async fn run<T: Send + 'static>(&self, act: impl FnOnce(&mut Node) -> T + Send + 'static) -> Result<T, ChainError> {
        let (reply, answer) = oneshot::channel();
        self.begin(move |node| drop(reply.send(act(node))))?;
        answer.await.map_err(|_| gone())
    }

    fn begin(&self, work: impl FnOnce(&mut Node) + Send + 'static) -> Result<(), ChainError> {
        self.line.inlet.0.send(Request::Work(Box::new(work))).map_err(|_| gone())
    }

    pub async fn request(&self, method: &str, parameters: Value) -> Result<Value, TransportError> {
        let method = method.to_owned();
        let answer = self.run(move |node| rpc::answer(node, &method, parameters)).await;
        answer.map_err(|error| refused(-32603, error.to_string()))?
    }

    /// All call data, storage and logs.
    pub async fn dump(&self) -> Result<Vec<Vec<u8>>, ChainError> {
        self.run(|node| dump(node)).await?
    }

    pub async fn copy_to(&self, path: PathBuf) -> Result<(), ChainError> {
        self.run(move |node| node.file.copy_to(&path)).await?
    }

    /// Runs every block again, alongside other requests; returns how many.
    pub async fn audit(&self) -> Result<u64, ChainError> {
        let (reply, answer) = oneshot::channel();
        self.begin(move |node| node.begin_audit(reply))?;
        answer.await.unwrap_or_else(|_| Err(gone()))
    }
}

fn gone() -> ChainError {
    ChainError::Internal("the embedded chain has stopped".into())
}

/// After a panic, drops the state in memory and opens the file again; pending requests fail.
fn keep_serving(
    node: Node,
    inbox: &Receiver<Request>,
    announce: &watch::Sender<BlockRef>,
    open: impl Fn() -> Result<Node, ChainError>,
) {
    let mut next = Ok(node);
    while let Ok(node) = next {
        if catch_unwind(AssertUnwindSafe(|| serve(node, inbox, announce))).is_ok() {
            return;
        }
        thread::sleep(REST);
        next = open();
    }
}

fn serve(mut node: Node, inbox: &Receiver<Request>, announce: &watch::Sender<BlockRef>) {
    let mut open = true;
    while open {
        let idle = if node.audits.is_empty() { IDLE } else { Duration::ZERO };
        match inbox.recv_timeout(node.due().unwrap_or(idle).min(idle)) {
            Ok(request) => {
                let begun = Instant::now();
                let mut next = Ok(request);
                while let Ok(Request::Work(work)) = next {
                    work(&mut node);
                    next = if begun.elapsed() < BURST { inbox.try_recv() } else { Err(TryRecvError::Empty) };
                }
                open = next.is_err();
            }
            Err(RecvTimeoutError::Timeout) => node.go_on_auditing(),
            Err(RecvTimeoutError::Disconnected) => open = false,
        }
        if !open {
            node.finish();
        } else if node.due() == Some(Duration::ZERO) {
            fault::point("block-due");
            node.assemble();
            fault::point("block-sealed");
        }
        announce.send_if_modified(|head| std::mem::replace(head, node.head) != node.head);
    }
}

fn dump(node: &Node) -> Result<Vec<Vec<u8>>, ChainError> {
    let mut all = node.file.all_nodes()?;
    for number in 0..=node.head.number {
        all.extend(node.file.block(number)?.map(|(_, header)| header));
        for one in node.file.block_transactions(number)? {
            all.push(one.raw);
            all.push(one.receipt);
        }
    }
    Ok(all)
}
