//! The site's link to its chain: its state, the newest head and its freshness, the watcher's progress.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::chain::{BlockRef, Chain, MEASURED};
use crate::crypto::EoaSecret;
use crate::hub::Hub;
use crate::model::steady_clock::look;
use crate::model::{Address, Domain, ErrorKind, locked};
use crate::pipeline::anchorer::{self, MOST_LANES};
use crate::pipeline::{LaneState, Network, Owner};
use crate::reply::{Failure, NoticeLevel, Part, Result, input, internal, refused};
use crate::site::Parts;

/// Subject of notices about the chain: the health's part.
pub const ABOUT: &str = "chain";

/// A trouble on the way to the chain. One that is not the chain's does not end with an answer of the chain.
pub fn tell_trouble(hub: &Hub, kind: ErrorKind, text: &str) {
    match kind {
        ErrorKind::Unreachable => hub.notice_about(ABOUT, NoticeLevel::Error, text),
        _ => hub.alarm(text),
    }
}

/// `Swapped` = another chain answers, or the pinned one wiped: anchoring pauses until the pinned one returns.
#[derive(Clone)]
pub enum NetworkState {
    Off,
    Connecting,
    Bare(Chain),
    Up(Box<Network>),
    Swapped(Failure),
    Down { failure: Failure, next: Instant },
}

pub struct Link {
    hub: Arc<Hub>,
    state: watch::Sender<NetworkState>,
    scanned: watch::Sender<u64>,
    silent: AtomicBool,
    /// The newest head, and when the chain reported it.
    head: Mutex<Option<(Instant, BlockRef)>>,
    freshness: Mutex<Freshness>,
}

impl Link {
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

    pub fn state(&self) -> watch::Ref<'_, NetworkState> {
        self.state.borrow()
    }

    pub fn connected(&self) -> Option<Chain> {
        match &*self.state() {
            NetworkState::Bare(chain) => Some(chain.clone()),
            NetworkState::Up(network) => Some(network.chain.clone()),
            _ => None,
        }
    }

    pub fn follow(&self) -> watch::Receiver<NetworkState> {
        self.state.subscribe()
    }

    pub fn set(&self, state: NetworkState) {
        // It may be another chain, or another node.
        *locked(&self.freshness) = Freshness::default();
        self.state.send_replace(state);
        self.changed();
    }

    fn changed(&self) {
        self.hub.changed(Part::Health);
        self.hub.changed(Part::Chain);
    }

    pub fn lose_chain(&self, failure: Failure) {
        self.hub.notice_about(ABOUT, NoticeLevel::Error, &failure.message);
        self.lost(NetworkState::Swapped(failure));
    }

    /// Leaves the state of a site that ends as it is.
    pub fn lost(&self, to: NetworkState) {
        self.state.send_if_modified(|state| {
            let ending = matches!(state, NetworkState::Off);
            if !ending {
                *state = to;
            }
            !ending
        });
        self.changed();
    }

    pub async fn chain(&self) -> Result<Chain> {
        match self.settled().await? {
            NetworkState::Bare(chain) => Ok(chain),
            NetworkState::Up(network) => Ok(network.chain),
            _ => Err(off()),
        }
    }

    pub async fn settled(&self) -> Result<NetworkState> {
        let mut state = self.state.subscribe();
        let settled = state.wait_for(|state| !matches!(state, NetworkState::Connecting)).await;
        let settled = settled.map_err(|_| off())?.clone();
        match settled {
            NetworkState::Down { failure, .. } | NetworkState::Swapped(failure) => Err(failure),
            settled => Ok(settled),
        }
    }

    pub async fn network(&self) -> Result<Network> {
        match self.settled().await? {
            NetworkState::Up(network) => Ok(*network),
            NetworkState::Bare(_) => Err(input(
                "no contract is deployed yet; `authros identity register` deploys one, or set chain.contract",
            )),
            _ => Err(off()),
        }
    }

    pub fn network_now(&self) -> Option<Network> {
        match &*self.state.borrow() {
            NetworkState::Up(network) => Some((**network).clone()),
            _ => None,
        }
    }

    /// Everything up to `head` was read; the chain reported it when asked at `asked`.
    pub fn saw_head(&self, head: BlockRef, asked: Instant) {
        *locked(&self.head) = Some((Instant::now(), head));
        locked(&self.freshness).read(head, asked, look().machine.seconds());
    }

    pub fn view(&self) -> Result<BlockRef, NotFresh> {
        locked(&self.freshness).judge(Instant::now())
    }

    pub fn is_named(&self, head: &BlockRef, asked: Instant) -> bool {
        locked(&self.freshness).is_named(head, asked)
    }

    pub async fn measure(&self, chain: &Chain) {
        if locked(&self.freshness).is_to_measure() {
            // Other checks notice a silent node.
            let due = chain.due_within().await.unwrap_or_default();
            locked(&self.freshness).measured(due);
        }
    }

    pub fn newest_head(&self) -> Option<BlockRef> {
        locked(&self.head).map(|(_, head)| head)
    }

    pub fn fresh_head(&self, longest: Duration) -> Option<BlockRef> {
        let seen = *locked(&self.head);
        seen.filter(|(at, _)| at.elapsed() <= longest).map(|(_, head)| head)
    }

    pub fn has_scanned(&self, number: u64) {
        self.scanned.send_replace(number);
    }

    pub fn scans(&self) -> watch::Receiver<u64> {
        self.scanned.subscribe()
    }

    pub async fn scanned(&self, number: u64) {
        let mut scanned = self.scanned.subscribe();
        drop(scanned.wait_for(|seen| *seen >= number).await);
    }

    pub fn answers(&self, answers: bool) {
        let before = self.silent.swap(!answers, Ordering::AcqRel);
        if before == answers {
            self.hub.changed(Part::Health);
            if answers {
                self.hub.notice_about(ABOUT, NoticeLevel::Info, "the chain answers again");
            }
        }
    }

    pub fn is_silent(&self) -> bool {
        self.silent.load(Ordering::Acquire)
    }
}

fn off() -> Failure {
    internal("this site was started without a chain, or is stopping; run the command again")
}

/// How long a view holds, and how late a block may be.
pub const GRACE: Duration = Duration::from_secs(2);

/// Blocks in the median delay.
const REMEMBERED: usize = 15;

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotFresh {
    #[error("no block of the chain was read yet")]
    Unread,
    /// The node did not answer lately, or names a block that was not read.
    #[error("the newest block was read {0} s ago, and the chain has not confirmed since that it is the newest")]
    Silent(u64),
    #[error("block {block} is {age} s old here, and the next one was due after {due} s: the node may be cut off")]
    Late { block: u64, age: u64, due: u64 },
    /// It came later than others, or faster than it was sealed.
    #[error("the node is catching up: block {block} is an old one")]
    Behind { block: u64 },
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    head: BlockRef,
    confirmed: Instant,
    since: Instant,
    /// Its age by the local clock when it came.
    age: Duration,
    /// It came no faster than its own time says, so the node is not catching up.
    is_paced: bool,
    /// Delay beyond the usual one here, independent of the local clock.
    lag: Duration,
}

#[derive(Debug, Default)]
pub struct Freshness {
    seen: Option<Seen>,
    due: Option<Duration>,
    measured: Option<u64>,
    was_late: bool,
    origin: Option<Instant>,
    /// Seconds from a block's own time to its arrival, up to a constant.
    delays: VecDeque<i64>,
}

impl Freshness {
    pub fn read(&mut self, head: BlockRef, asked: Instant, clock: u64) {
        let before = self.seen;
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.head.hash == head.hash) {
            seen.confirmed = asked;
            return;
        }
        let passed = before.map(|before| asked.saturating_duration_since(before.since));
        let stated = before.map_or(0, |before| head.timestamp.saturating_sub(before.head.timestamp));
        self.was_late |= passed.zip(self.due).is_some_and(|(passed, due)| passed > due + GRACE);
        self.seen = Some(Seen {
            head,
            confirmed: asked,
            since: asked,
            age: Duration::from_secs(clock.saturating_sub(head.timestamp)),
            is_paced: passed.is_some_and(|passed| passed * 2 >= Duration::from_secs(stated)),
            lag: self.lag(head, asked),
        });
    }

    /// The median of earlier blocks cancels one sealer's wrong clock.
    fn lag(&mut self, head: BlockRef, asked: Instant) -> Duration {
        let whole = |seconds: u64| i64::try_from(seconds).unwrap_or(i64::MAX);
        let passed = asked.saturating_duration_since(*self.origin.get_or_insert(asked)).as_secs();
        let delay = whole(passed).saturating_sub(whole(head.timestamp));
        let mut sorted: Vec<i64> = self.delays.iter().copied().collect();
        sorted.sort_unstable();
        let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(delay);
        self.delays.push_back(delay);
        if self.delays.len() > REMEMBERED {
            self.delays.pop_front();
        }
        Duration::from_secs(u64::try_from(delay.saturating_sub(usual)).unwrap_or(0))
    }

    pub fn is_named(&mut self, head: &BlockRef, asked: Instant) -> bool {
        let Some(seen) = self.seen.as_mut().filter(|seen| seen.head.hash == head.hash) else { return false };
        seen.confirmed = seen.confirmed.max(asked);
        true
    }

    pub fn is_to_measure(&self) -> bool {
        let Some(seen) = &self.seen else { return false };
        let is_old = |block: u64| seen.head.number < block || seen.head.number - block >= MEASURED;
        self.was_late || self.measured.is_none_or(is_old)
    }

    /// A busy chain shows no pauses: the known ones still count, unless a block was late.
    pub fn measured(&mut self, due: Option<Duration>) {
        self.due = due.or(self.due.filter(|_| !self.was_late));
        (self.measured, self.was_late) = (self.seen.map(|seen| seen.head.number), false);
    }

    pub fn judge(&self, now: Instant) -> Result<BlockRef, NotFresh> {
        let seen = self.seen.ok_or(NotFresh::Unread)?;
        let block = seen.head.number;
        let silence = now.saturating_duration_since(seen.confirmed);
        if silence > GRACE {
            return Err(NotFresh::Silent(silence.as_secs()));
        }
        let Some(due) = self.due else { return Ok(seen.head) };
        let age = now.saturating_duration_since(seen.since);
        if age > due + GRACE {
            return Err(NotFresh::Late { block, age: age.as_secs(), due: due.as_secs() });
        }
        if seen.lag > due + GRACE || !seen.is_paced && seen.age > due + GRACE {
            return Err(NotFresh::Behind { block });
        }
        Ok(seen.head)
    }
}

const LOOK: Duration = Duration::from_secs(2);

type Derived = std::collections::HashMap<(Address, Domain), Arc<Vec<(Address, EoaSecret)>>>;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pause {
    pub text: String,
    /// Somebody has to do something about it.
    pub is_alarm: bool,
}

pub struct Lanes {
    parts: Parts,
    extra: Mutex<Derived>,
}

impl Lanes {
    pub fn new(parts: &Parts) -> Self {
        Self { parts: parts.clone(), extra: Mutex::default() }
    }

    fn extra(&self, owner: &Owner, network: &Network) -> Result<Arc<Vec<(Address, EoaSecret)>>> {
        let mut known = locked(&self.extra);
        let key = (owner.address, network.domain);
        if let Some(found) = known.get(&key) {
            return Ok(Arc::clone(found));
        }
        let keys = anchorer::extra(&owner.eoa(), &network.domain, MOST_LANES)?;
        let found = Arc::new(keys.into_iter().map(|key| (key.address(), key)).collect::<Vec<_>>());
        known.insert(key, Arc::clone(&found));
        Ok(found)
    }

    pub fn of(&self, owner: &Owner, network: &Network) -> Result<Vec<EoaSecret>> {
        let mut lanes = vec![owner.eoa()];
        if self.parts.config.lanes > 1 {
            let wanted = usize::from(self.parts.config.lanes) - 1;
            let extra = self.extra(owner, network)?;
            let ready = extra.iter().take(wanted).filter(|(account, _)| network.directory.identity(*account).is_ok());
            lanes.extend(ready.map(|(_, key)| key.clone()));
        }
        Ok(lanes)
    }

    /// Also finds extra accounts that the settings no longer use; `None` = the owner's own.
    pub fn key(&self, owner: &Owner, network: &Network, account: Option<Address>) -> Result<EoaSecret> {
        let Some(account) = account.filter(|account| *account != owner.address) else { return Ok(owner.eoa()) };
        let extra = self.extra(owner, network)?;
        let found = extra.iter().find(|(other, _)| *other == account).map(|(_, key)| key.clone());
        found.ok_or_else(|| {
            refused(format!(
                "{account} does not anchor for {}; `authros chain status` lists the accounts that do",
                owner.profile
            ))
        })
    }

    pub fn lane_states(&self, owner: &Owner, network: &Network) -> Result<Vec<LaneState>> {
        let mut states = vec![self.parts.sender.state_of(owner.address)?];
        let wanted = usize::from(self.parts.config.lanes).saturating_sub(1);
        for (index, (account, _)) in self.extra(owner, network)?.iter().enumerate() {
            let state = self.parts.sender.state_of(*account)?;
            if index < wanted || state.open > 0 {
                states.push(state);
            }
        }
        Ok(states)
    }

    /// What pauses each open owner's lanes; the worst, if several are paused.
    pub fn pauses(&self, network: &Network) -> Vec<(Address, Option<Pause>)> {
        let pause = |owner: &Arc<Owner>| {
            let lanes = self.lane_states(owner, network).unwrap_or_default().into_iter();
            let paused = lanes.filter_map(|lane| {
                let reason = lane.paused?;
                Some(Pause { text: reason.text(lane.account), is_alarm: reason.is_alarm() })
            });
            (owner.address, paused.max_by_key(|pause| pause.is_alarm))
        };
        self.parts.owners.all().iter().map(pause).collect()
    }

    pub async fn tend(&self, network: &Network) {
        for owner in self.parts.owners.all() {
            if let Err(failure) = self.tend_lanes_of(&owner, network).await {
                let text = format!("transactions of {} are waiting: {}", owner.profile, failure.message);
                tell_trouble(&self.parts.hub, failure.kind, &text);
            }
        }
    }

    async fn tend_lanes_of(&self, owner: &Owner, network: &Network) -> Result<()> {
        let mut keys = vec![owner.eoa()];
        for (account, key) in self.extra(owner, network)?.iter() {
            // Includes those above a lowered setting.
            let state = self.parts.sender.state_of(*account)?;
            if state.open > 0 || state.paused.is_some() {
                keys.push(key.clone());
            }
        }
        for key in keys {
            for reason in self.parts.sender.tend(&network.chain, &key).await? {
                self.parts.hub.alarm(&format!("the contract rejected a transaction of {}: {reason}", owner.profile));
            }
        }
        Ok(())
    }

    pub async fn keep_extra(self: Arc<Self>, owner: Arc<Owner>) {
        while !self.parts.life.is_stopping() && self.parts.owners.is_open(&owner) {
            if let Some(network) = self.parts.link.network_now()
                && network.directory.identity(owner.address).is_ok()
                && let Err(failure) = self.ready_extra(&owner, &network).await
            {
                let text = format!("an extra anchoring account of {} is not ready: {}", owner.profile, failure.message);
                self.parts.hub.warn(&text);
            }
            if !self.parts.life.beat(LOOK).await {
                return;
            }
        }
    }

    async fn ready_extra(&self, owner: &Owner, network: &Network) -> Result<()> {
        let wanted = usize::from(self.parts.config.lanes) - 1;
        for (_, key) in self.extra(owner, network)?.iter().take(wanted) {
            anchorer::ensure_ready(&self.parts.plant, network, &self.parts.sender, owner, key).await?;
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "freshness_tests.rs"]
mod freshness_tests;
