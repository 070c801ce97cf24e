//! A Redis cluster: which node has which slots, learnt from any node that answers, and again after changes.
//!
//! A node that is down affects only what is in its slots, and is left alone for a moment before it is tried again.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Duration, Instant};

use redis::{RedisResult, Value, cmd, from_redis_value};

use super::connection::Connection;
use super::node::{Failure, MARK, Node};
use super::{Address, Place, SLOTS, slot};
use crate::StoreError;
use crate::model::clean;

/// How long an unresponsive node is left alone.
const REST: Duration = Duration::from_secs(1);
/// The shortest time between requests for the map of slots that no node asked for.
const ASKED_EVERY: Duration = Duration::from_secs(1);
/// Names tried for a node's mark.
const MARKS_TRIED: u32 = 4096;

/// One node, and when it may be tried again.
pub(super) struct Member {
    pub(super) host: String,
    pub(super) node: Node,
    resting: Mutex<Option<(Instant, StoreError)>>,
}

impl Member {
    fn new(address: &Address, host: &str) -> Result<Self, StoreError> {
        Ok(Self { host: host.to_owned(), node: Node::member(address, host)?, resting: Mutex::default() })
    }

    fn resting(&self) -> MutexGuard<'_, Option<(Instant, StoreError)>> {
        self.resting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Why it is left alone now, if it is.
    pub(super) fn rests(&self) -> Option<StoreError> {
        self.resting().as_ref().filter(|(until, _)| Instant::now() < *until).map(|(_, why)| why.clone())
    }

    /// Does idempotent `work` there.
    pub(super) fn with<T>(&self, work: impl Fn(&mut Connection) -> RedisResult<T>) -> Result<T, Failure> {
        if let Some(why) = self.rests() {
            return Err(why.into());
        }
        let done = self.node.with(work);
        if let Err(Failure { error: error @ StoreError::Unreachable { .. }, redirect: None }) = &done {
            *self.resting() = Some((Instant::now() + REST, error.clone()));
        }
        done
    }
}

/// Which node has which slots.
#[derive(Default)]
struct Map {
    /// Index among the members, by slot.
    slots: Vec<Option<u16>>,
    members: Vec<Arc<Member>>,
}

/// The nodes of a cluster.
pub(super) struct Cluster {
    address: Address,
    map: RwLock<Map>,
    asked: Mutex<Option<Instant>>,
}

impl Cluster {
    /// Learns the map of slots and examines every node; one that does not answer is examined when it does.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] if none answers, [`StoreError::Policy`] if one may evict records.
    pub(super) fn open(address: Address) -> Result<Self, StoreError> {
        let cluster = Self { address, map: RwLock::default(), asked: Mutex::default() };
        cluster.learn()?;
        for member in cluster.members() {
            match member.with(|connection| cmd("PING").exec(connection)) {
                Err(Failure { error, .. }) if !error.is_passing() => return Err(error),
                _ => {}
            }
        }
        Ok(cluster)
    }

    /// All nodes that have slots.
    pub(super) fn members(&self) -> Vec<Arc<Member>> {
        self.map.read().unwrap_or_else(PoisonError::into_inner).members.clone()
    }

    /// The node that has a slot, as far as known.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] if none has it.
    pub(super) fn of(&self, slot: u16) -> Result<Arc<Member>, StoreError> {
        let map = self.map.read().unwrap_or_else(PoisonError::into_inner);
        let index = map.slots.get(usize::from(slot)).copied().flatten();
        let member = index.and_then(|index| map.members.get(usize::from(index)));
        member.cloned().ok_or_else(|| self.unreachable(&format!("no node serves slot {slot}")))
    }

    /// A name for a node's mark, in one of its own slots; `None` if it has too few of them to find one.
    pub(super) fn mark_of(&self, member: &Member) -> Option<String> {
        let is_there = |name: &String| self.of(slot(name)).is_ok_and(|other| other.host == member.host);
        (0..MARKS_TRIED).map(|number| format!("{MARK}:{number}")).find(is_there)
    }

    fn unreachable(&self, detail: &str) -> StoreError {
        StoreError::Unreachable { url: self.address.shown.clone(), detail: detail.to_owned() }
    }

    /// Does idempotent `work` on the node with the slot, following it if it has moved.
    ///
    /// # Errors
    /// Errors of the node, or if the slot has none.
    pub(super) fn with<T>(&self, slot: u16, work: impl Fn(&mut Connection) -> RedisResult<T>) -> Result<T, StoreError> {
        let member = self.of(slot)?;
        let failure = match member.with(&work) {
            Ok(done) => return Ok(done),
            Err(failure) => failure,
        };
        match failure.redirect {
            Some((host, false)) => {
                let member = self.by_host(&host)?;
                let asking = member.with(|connection| {
                    cmd("ASKING").exec(connection)?;
                    work(connection)
                });
                asking.map_err(|failure| failure.error)
            }
            Some((_, true)) => {
                self.learn()?;
                self.of(slot)?.with(work).map_err(|failure| failure.error)
            }
            // Another one may have taken over its slots.
            None if matches!(failure.error, StoreError::Unreachable { .. }) && self.may_ask() => {
                drop(self.learn());
                let other = self.of(slot)?;
                if Arc::ptr_eq(&member, &other) {
                    return Err(failure.error);
                }
                other.with(work).map_err(|failure| failure.error)
            }
            None => Err(failure.error),
        }
    }

    fn may_ask(&self) -> bool {
        let asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        asked.is_none_or(|at| at.elapsed() >= ASKED_EVERY)
    }

    fn by_host(&self, host: &str) -> Result<Arc<Member>, StoreError> {
        let known = self.members().into_iter().find(|member| member.host == host);
        known.map_or_else(|| Member::new(&self.address, host).map(Arc::new), Ok)
    }

    /// Asks the nodes, known ones first, until one says who has which slots.
    pub(super) fn learn(&self) -> Result<(), StoreError> {
        *self.asked.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        let Place::Cluster(seeds) = &self.address.place else { return Err(self.unreachable("it is not a cluster")) };
        let mut hosts: Vec<String> = self.members().iter().map(|member| member.host.clone()).collect();
        hosts.extend(seeds.iter().filter(|seed| !self.members().iter().any(|member| member.host == **seed)).cloned());
        let mut failure = self.unreachable("it has no nodes");
        for host in hosts {
            let answer = self.by_host(&host).map_err(Failure::from).and_then(|member| {
                member.with(|connection| cmd("CLUSTER").arg("SLOTS").query::<Vec<Value>>(connection))
            });
            match answer {
                Ok(ranges) if !ranges.is_empty() => return self.take(&host, ranges),
                Ok(_) => failure = self.unreachable(&format!("{} knows of no slots", clean(&host, 80))),
                Err(Failure { error, .. }) => failure = error,
            }
        }
        Err(failure)
    }

    fn take(&self, asked: &str, ranges: Vec<Value>) -> Result<(), StoreError> {
        let mut map = Map { slots: vec![None; usize::from(SLOTS)], members: Vec::new() };
        for range in ranges {
            let (first, last, host) =
                range_of(asked, range).ok_or_else(|| self.unreachable("its slot map cannot be read"))?;
            let index = match map.members.iter().position(|member| member.host == host) {
                Some(index) => index,
                None => {
                    map.members.push(self.by_host(&host)?);
                    map.members.len() - 1
                }
            };
            let index = u16::try_from(index).ok();
            map.slots.iter_mut().take(usize::from(last) + 1).skip(usize::from(first)).for_each(|slot| *slot = index);
        }
        *self.map.write().unwrap_or_else(PoisonError::into_inner) = map;
        Ok(())
    }
}

/// First and last slot, and HOST:PORT of the master, from `[first, last, [host, port, …], …]`. A node that does not
/// know its own name leaves it out: then it is the node that was asked.
fn range_of(asked: &str, range: Value) -> Option<(u16, u16, String)> {
    let Value::Array(parts) = range else { return None };
    let mut parts = parts.into_iter();
    let first: u16 = from_redis_value(parts.next()?).ok()?;
    let last: u16 = from_redis_value(parts.next()?).ok()?;
    let Value::Array(master) = parts.next()? else { return None };
    let mut master = master.into_iter();
    let host: Option<String> = from_redis_value(master.next()?).ok()?;
    let port: u16 = from_redis_value(master.next()?).ok()?;
    let own = asked.rsplit_once(':').map_or(asked, |(host, _)| host);
    let host = host.filter(|host| !host.is_empty()).unwrap_or_else(|| own.to_owned());
    let host = if host.contains(':') && !host.starts_with('[') { format!("[{host}]") } else { host };
    (first <= last && last < SLOTS).then(|| (first, last, format!("{host}:{port}")))
}
