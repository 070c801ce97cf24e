//! The site's link to its chain: whether there is a chain and a contract now, the newest head, the watcher's progress.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::freshness::{Freshness, NotFresh};
use crate::chain::{BlockRef, Chain};
use crate::model::steady_clock::look;
use crate::pipeline::Network;
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::{input, internal};
use crate::service::hub::Hub;
use crate::service::reply::Failure;

/// The state of the link.
#[derive(Clone)]
pub enum NetworkState {
    /// This run needs no chain, or is ending.
    Off,
    /// First attempt.
    Connecting,
    /// Connected, but no contract is known yet: the first registration deploys one.
    Bare(Chain),
    /// Working.
    Up(Box<Network>),
    /// Another chain answers than the pinned one, or the same one wiped: anchoring stands still until the pinned one is
    /// back.
    Swapped(Failure),
    /// The last attempt failed; another follows.
    Down {
        /// Why.
        failure: Failure,
        /// When the next attempt is made.
        next: Instant,
    },
}

/// The link, used by every part that needs the chain.
pub(in crate::site) struct Link {
    hub: Arc<Hub>,
    state: watch::Sender<NetworkState>,
    scanned: watch::Sender<u64>,
    silent: AtomicBool,
    /// The newest head, and when the chain reported it.
    head: Mutex<Option<(Instant, BlockRef)>>,
    freshness: Mutex<Freshness>,
}

impl Link {
    /// A link to be connected, or none if this run needs no chain.
    pub fn new(hub: Arc<Hub>, needed: bool) -> Self {
        let state = if needed { NetworkState::Connecting } else { NetworkState::Off };
        let (state, scanned) = (watch::channel(state).0, watch::channel(0).0);
        Self {
            hub,
            state,
            scanned,
            silent: AtomicBool::new(false),
            head: Mutex::default(),
            freshness: Mutex::default(),
        }
    }

    /// Its present state.
    pub fn state(&self) -> watch::Ref<'_, NetworkState> {
        self.state.borrow()
    }

    /// The chain, if connected to one now.
    pub fn connected(&self) -> Option<Chain> {
        match &*self.state() {
            NetworkState::Bare(chain) => Some(chain.clone()),
            NetworkState::Up(network) => Some(network.chain.clone()),
            _ => None,
        }
    }

    /// Follows the state.
    pub fn follow(&self) -> watch::Receiver<NetworkState> {
        self.state.subscribe()
    }

    /// Sets a new state.
    pub fn set(&self, state: NetworkState) {
        // It may be another chain, or another node.
        *self.freshness() = Freshness::default();
        self.state.send_replace(state);
    }

    /// Another chain answers than the pinned one: everything that needs the chain stands still.
    pub fn lose_chain(&self, failure: Failure) {
        self.hub.notice(NoticeLevel::Error, &failure.message);
        self.lost(NetworkState::Swapped(failure));
    }

    /// The chain is gone, unless the site is ending anyway.
    pub fn lost(&self, to: NetworkState) {
        self.state.send_if_modified(|state| {
            let ending = matches!(state, NetworkState::Off);
            if !ending {
                *state = to;
            }
            !ending
        });
        self.hub.changed(Part::Health);
        self.hub.changed(Part::Chain);
    }

    /// The chain, as soon as the first attempt has ended.
    ///
    /// # Errors
    /// Why the link is down.
    pub async fn chain(&self) -> Result<Chain, Failure> {
        match self.settled().await? {
            NetworkState::Bare(chain) => Ok(chain),
            NetworkState::Up(network) => Ok(network.chain),
            _ => Err(off()),
        }
    }

    /// The state, as soon as the first attempt has ended.
    ///
    /// # Errors
    /// Why the link is down.
    pub async fn settled(&self) -> Result<NetworkState, Failure> {
        let mut state = self.state.subscribe();
        let settled = state.wait_for(|state| !matches!(state, NetworkState::Connecting)).await;
        let settled = settled.map_err(|_| off())?.clone();
        match settled {
            NetworkState::Down { failure, .. } | NetworkState::Swapped(failure) => Err(failure),
            settled => Ok(settled),
        }
    }

    /// The network with its contract.
    ///
    /// # Errors
    /// Why the link is down, or that no contract is known yet.
    pub async fn network(&self) -> Result<Network, Failure> {
        match self.settled().await? {
            NetworkState::Up(network) => Ok(*network),
            NetworkState::Bare(_) => {
                Err(input("no contract is deployed yet; `authros register` deploys one, or set chain.contract"))
            }
            _ => Err(off()),
        }
    }

    /// The network, if it is up right now.
    pub fn network_now(&self) -> Option<Network> {
        match &*self.state.borrow() {
            NetworkState::Up(network) => Some((**network).clone()),
            _ => None,
        }
    }

    fn freshness(&self) -> MutexGuard<'_, Freshness> {
        self.freshness.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that everything was read up to this head, which the chain reported when it was asked at `asked`.
    pub fn saw_head(&self, head: BlockRef, asked: Instant) {
        *self.head.lock().unwrap_or_else(PoisonError::into_inner) = Some((Instant::now(), head));
        self.freshness().read(head, asked, look().machine.seconds());
    }

    /// The newest block, if everything up to it was read and it is known now that it is the newest.
    ///
    /// # Errors
    /// [`NotFresh`]: nobody's right is known.
    pub fn view(&self) -> Result<BlockRef, NotFresh> {
        self.freshness().judge(Instant::now())
    }

    /// The chain was asked at `asked` and reported this head; whether everything up to it was read.
    pub fn is_named(&self, head: &BlockRef, asked: Instant) -> bool {
        self.freshness().is_named(head, asked)
    }

    /// Measures how often blocks come, where that is due.
    pub async fn measure(&self, chain: &Chain) {
        if self.freshness().is_to_measure() {
            // A node that does not answer is noticed as such.
            let due = chain.due_within().await.unwrap_or_default();
            self.freshness().measured(due);
        }
    }

    /// The newest head reported by the chain.
    pub fn newest_head(&self) -> Option<BlockRef> {
        self.head.lock().unwrap_or_else(PoisonError::into_inner).map(|(_, head)| head)
    }

    /// The newest head, unless the chain has not reported one for `longest`.
    pub fn fresh_head(&self, longest: Duration) -> Option<BlockRef> {
        let seen = *self.head.lock().unwrap_or_else(PoisonError::into_inner);
        seen.filter(|(at, _)| at.elapsed() <= longest).map(|(_, head)| head)
    }

    /// The watcher has seen everything up to this block.
    pub fn has_scanned(&self, number: u64) {
        self.scanned.send_replace(number);
    }

    /// Follows the watcher's progress.
    pub fn scans(&self) -> watch::Receiver<u64> {
        self.scanned.subscribe()
    }

    /// Waits until the watcher has seen block `number`.
    pub async fn scanned(&self, number: u64) {
        let mut scanned = self.scanned.subscribe();
        // An error means that the site is ending.
        drop(scanned.wait_for(|seen| *seen >= number).await);
    }

    /// Notes whether the chain answered the last time it was asked.
    pub fn answers(&self, answers: bool) {
        let before = self.silent.swap(!answers, Ordering::AcqRel);
        if before == answers {
            self.hub.changed(Part::Health);
        }
    }

    /// Whether the chain did not answer the last time it was asked.
    pub fn is_silent(&self) -> bool {
        self.silent.load(Ordering::Acquire)
    }
}

fn off() -> Failure {
    internal("this site was started without a chain, or is stopping; run the command again")
}
