//! The subscriptions of one connection: the entries of all of them arrive on one channel.

use std::collections::HashMap;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::task::AbortHandle;
use tokio::time::{Instant, sleep_until};

use crate::gateway::code::{Code, Refusal};
use crate::gateway::command::Entry;

/// The most entries that wait; beyond that the desk waits.
const WAITING: usize = 8;

/// How soon it is asked again whether an entry may be sent, while the chain is not fresh.
const AGAIN: Duration = Duration::from_millis(500);

/// An entry of a subscription, or its end.
pub(super) struct Fed {
    /// The request that subscribed.
    pub request: u32,
    /// `None` at the end.
    pub entry: Option<Entry>,
}

pub(super) struct Feeds {
    sender: mpsc::Sender<Fed>,
    receiver: mpsc::Receiver<Fed>,
    running: HashMap<u32, AbortHandle>,
    /// An entry that waits for the chain, and when it is tried again. Those behind it wait too: it is one chain for all.
    paused: Option<(Fed, Instant)>,
}

impl Feeds {
    pub fn new() -> Self {
        let (sender, receiver) = mpsc::channel(WAITING);
        Self { sender, receiver, running: HashMap::new(), paused: None }
    }

    pub fn has(&self, request: u32) -> bool {
        self.running.contains_key(&request)
    }

    /// Whether another subscription may be added.
    pub fn check_room(&self, request: u32, most: usize) -> Result<(), Refusal> {
        if self.has(request) {
            return Err(Refusal::new(Code::Malformed, "a subscription of the same number"));
        }
        if self.running.len() >= most {
            return Err(Refusal::new(Code::Quota, "too many subscriptions"));
        }
        Ok(())
    }

    pub fn add(&mut self, request: u32, mut entries: mpsc::Receiver<Entry>) {
        let sender = self.sender.clone();
        let task = tokio::spawn(async move {
            while let Some(entry) = entries.recv().await {
                if sender.send(Fed { request, entry: Some(entry) }).await.is_err() {
                    return;
                }
            }
            // If nobody is listening any more, there is nobody to notify.
            let _ = sender.send(Fed { request, entry: None }).await;
        });
        self.running.insert(request, task.abort_handle());
    }

    pub fn remove(&mut self, request: u32) {
        if let Some(task) = self.running.remove(&request) {
            task.abort();
        }
        self.paused.take_if(|(fed, _)| fed.request == request);
    }

    /// Keeps an entry until the chain is known again; nothing is sent before it.
    pub fn pause(&mut self, fed: Fed) {
        self.paused = Some((fed, Instant::now() + AGAIN));
    }

    /// Waits for an entry. Can be cancelled at any point.
    pub async fn next(&mut self) -> Fed {
        if let Some((_, again)) = &self.paused {
            sleep_until(*again).await;
        }
        if let Some((fed, _)) = self.paused.take() {
            return fed;
        }
        match self.receiver.recv().await {
            Some(fed) => fed,
            // The sender beside it lives as long.
            None => std::future::pending().await,
        }
    }

    /// An entry that is already there.
    pub fn waiting(&mut self) -> Option<Fed> {
        match &self.paused {
            Some((_, again)) if *again > Instant::now() => None,
            Some(_) => self.paused.take().map(|(fed, _)| fed),
            None => self.receiver.try_recv().ok(),
        }
    }
}

impl Drop for Feeds {
    fn drop(&mut self) {
        self.running.values().for_each(AbortHandle::abort);
    }
}
