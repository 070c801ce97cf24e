//! One server, the master that sentinels name, or a cluster's nodes. Only the writing thread asks a failed one, so
//! readers wait for a silence once.

use std::collections::BTreeMap;
use std::error::Error;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};

use redis::{
    ConnectionInfo, ErrorKind, Pipeline, RedisError, RedisResult, ServerErrorKind, Value, cmd, from_redis_value, pipe,
};
use tokio_rustls::rustls::ClientConfig;

use super::address::{Address, Place};
use super::connection::Connection;
use super::{Away, CacheSettings, KEPT};
use crate::StoreError;
use crate::model::{Digest, Timestamp, clean};

const MOST_IDLE: usize = 4;
const MOST_NODES: usize = 1_000;
const SLOTS: u16 = 16_384;

pub(super) enum Answer {
    /// Not yet compared with the digest.
    Bytes(Vec<u8>),
    Nothing,
    /// No reply that Redis gives.
    Nonsense,
}

pub(super) struct Servers {
    address: Address,
    tls: Option<Arc<ClientConfig>>,
    /// `None` for a cluster.
    one: Option<Arc<Node>>,
    cluster: RwLock<Slots>,
}

#[derive(Default)]
struct Slots {
    /// Index among the nodes, by slot.
    owners: Vec<Option<u16>>,
    nodes: Vec<Arc<Node>>,
}

impl Servers {
    /// Connects to none yet.
    pub(super) fn new(settings: &CacheSettings) -> Result<Self, StoreError> {
        let address = Address::parse(&settings.url)?;
        let wrong = |detail| StoreError::CacheUrl { url: address.shown.clone(), detail };
        let tls = address
            .is_tls
            .then(|| authros_tls::tls(settings.roots.as_deref()).map(Arc::new))
            .transpose()
            .map_err(wrong)?;
        let one = match &address.place {
            Place::Cluster(_) => None,
            Place::Server(_) | Place::Sentinels(..) => Some(Arc::new(Node::new(address.clone(), tls.clone()))),
        };
        Ok(Self { address, tls, one, cluster: RwLock::default() })
    }

    pub(super) fn shown(&self) -> &str {
        &self.address.shown
    }

    fn nodes(&self) -> Vec<Arc<Node>> {
        match &self.one {
            Some(node) => vec![Arc::clone(node)],
            None => self.cluster.read().unwrap_or_else(PoisonError::into_inner).nodes.clone(),
        }
    }

    fn node_of(&self, key: &str) -> Option<Arc<Node>> {
        if let Some(node) = &self.one {
            return Some(Arc::clone(node));
        }
        let slots = self.cluster.read().unwrap_or_else(PoisonError::into_inner);
        let index = slots.owners.get(usize::from(slot(key))).copied().flatten()?;
        slots.nodes.get(usize::from(index)).cloned()
    }

    pub(super) fn away(&self) -> Option<Away> {
        let nodes = self.nodes();
        let mut away: Vec<Away> = nodes.iter().filter_map(|node| node.away().clone()).collect();
        let number = away.len();
        away.sort_by_key(|away| away.since);
        let first = away.into_iter().next()?;
        let why = match nodes.len() {
            1 => first.why,
            all => format!("{number} of {all} nodes, {}", first.why),
        };
        Some(Away { since: first.since, why })
    }

    pub(super) fn is_gone(&self) -> bool {
        self.nodes().iter().all(|node| node.away().is_some())
    }

    /// Pings the nodes, and asks a cluster for its slots.
    pub(super) fn probe(&self) {
        if self.one.is_none() {
            self.learn();
        }
        self.nodes().iter().for_each(|node| node.probe());
    }

    pub(super) fn get(&self, digest: Digest) -> Answer {
        let key = key(digest);
        let Some(node) = self.node_of(&key) else { return Answer::Nothing };
        match node.with(|connection| connection.get(&key)) {
            Ok(Some(bytes)) => Answer::Bytes(bytes),
            Ok(None) | Err(Failure::Other) => Answer::Nothing,
            Err(Failure::Nonsense) => Answer::Nonsense,
        }
    }

    /// Returns how many were taken.
    pub(super) fn put(&self, entries: &[(Digest, Vec<u8>)]) -> usize {
        let mut pipelines = Pipelines::default();
        for (digest, bytes) in entries {
            let key = key(*digest);
            if let Some(node) = self.node_of(&key) {
                pipelines.of(node, *digest).cmd("SET").arg(key).arg(bytes).arg("EX").arg(KEPT);
            }
        }
        let taken = pipelines.sent().filter(|(_, reply)| matches!(reply, Some(Value::Okay))).count();
        if taken < entries.len() && self.one.is_none() {
            // Slots may have moved.
            self.learn();
        }
        taken
    }

    /// Returns those that servers may still have.
    pub(super) fn delete(&self, digests: &[Digest]) -> Vec<Digest> {
        let (mut left, mut pipelines) = (Vec::new(), Pipelines::default());
        for digest in digests {
            let key = key(*digest);
            match self.node_of(&key) {
                Some(node) => {
                    pipelines.of(node, *digest).cmd("DEL").arg(key);
                }
                None => left.push(*digest),
            }
        }
        let failed = pipelines.sent().filter(|(_, reply)| !matches!(reply, Some(Value::Int(_))));
        left.extend(failed.map(|(digest, _)| digest));
        left
    }

    /// The first node that knows the slots wins, known ones first.
    fn learn(&self) {
        let Place::Cluster(seeds) = &self.address.place else { return };
        let known = self.nodes();
        let is_known = |seed: &&String| known.iter().any(|node| node.shown == **seed);
        let others: Vec<_> = seeds.iter().filter(|seed| !is_known(seed)).filter_map(|seed| self.member(seed)).collect();
        for node in known.iter().chain(&others) {
            let ranges = node.with(|connection| cmd("CLUSTER").arg("SLOTS").query::<Vec<Value>>(connection));
            if let Some(slots) = ranges.ok().and_then(|ranges| self.slots(&node.shown, ranges, &known)) {
                *self.cluster.write().unwrap_or_else(PoisonError::into_inner) = slots;
                return;
            }
        }
        if known.is_empty() {
            // So that its state can be shown; the next probe asks again.
            let slots = Slots { owners: Vec::new(), nodes: others };
            *self.cluster.write().unwrap_or_else(PoisonError::into_inner) = slots;
        }
    }

    fn member(&self, host: &str) -> Option<Arc<Node>> {
        let place = Place::Server(Box::new(self.address.server(host, "0").ok()?));
        let address = Address { shown: clean(host, 120), place, ..self.address.clone() };
        Some(Arc::new(Node::new(address, self.tls.clone())))
    }

    fn slots(&self, asked: &str, ranges: Vec<Value>, known: &[Arc<Node>]) -> Option<Slots> {
        let mut slots = Slots { owners: vec![None; usize::from(SLOTS)], nodes: Vec::new() };
        for range in ranges {
            let (first, last, host) = range_of(asked, range)?;
            let index = match slots.nodes.iter().position(|node| node.shown == host) {
                Some(index) => index,
                None if slots.nodes.len() < MOST_NODES => {
                    let node = known.iter().find(|node| node.shown == host).cloned();
                    slots.nodes.push(node.or_else(|| self.member(&host))?);
                    slots.nodes.len() - 1
                }
                None => return None,
            };
            let index = u16::try_from(index).ok();
            let (first, last) = (usize::from(first), usize::from(last));
            slots.owners.iter_mut().take(last + 1).skip(first).for_each(|owner| *owner = index);
        }
        (!slots.nodes.is_empty()).then_some(slots)
    }
}

/// First and last slot, and HOST:PORT of the master, from `[first, last, [host, port, …], …]`.
/// A node that does not know its own name leaves it out: use the queried one.
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
    (first <= last && last < SLOTS).then(|| (first, last, clean(&format!("{host}:{port}"), 120)))
}

#[derive(Default)]
struct Pipelines(BTreeMap<String, (Arc<Node>, Pipeline, Vec<Digest>)>);

impl Pipelines {
    /// For one more command about this record.
    fn of(&mut self, node: Arc<Node>, digest: Digest) -> &mut Pipeline {
        let (_, pipeline, digests) = self.0.entry(node.shown.clone()).or_insert_with(|| (node, pipe(), Vec::new()));
        digests.push(digest);
        pipeline
    }

    /// Each command's record and reply.
    fn sent(self) -> impl Iterator<Item = (Digest, Option<Value>)> {
        self.0.into_values().flat_map(|(node, pipeline, digests)| {
            let asked = node.with(|connection| {
                let replies = connection.ask(&pipeline)?;
                replies.iter().try_for_each(demoted)?;
                Ok(replies)
            });
            digests.into_iter().zip(asked.unwrap_or_default().into_iter().map(Some).chain(std::iter::repeat(None)))
        })
    }
}

/// A master that became a replica refuses writes: its sentinels know the new one.
fn demoted(reply: &Value) -> RedisResult<()> {
    match reply {
        Value::ServerError(error) if error.code() == "READONLY" => Err(error.clone().into()),
        _ => Ok(()),
    }
}

enum Failure {
    Nonsense,
    Other,
}

struct Node {
    address: Address,
    tls: Option<Arc<ClientConfig>>,
    /// Without secrets; HOST:PORT of a cluster's node.
    shown: String,
    idle: Mutex<Vec<Connection>>,
    away: Mutex<Option<Away>>,
}

impl Node {
    fn new(address: Address, tls: Option<Arc<ClientConfig>>) -> Self {
        Self { shown: address.shown.clone(), address, tls, idle: Mutex::default(), away: Mutex::default() }
    }

    fn away(&self) -> MutexGuard<'_, Option<Away>> {
        self.away.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Connection>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Retries on a new connection if an idle one turns out to be closed.
    fn with<T>(&self, work: impl Fn(&mut Connection) -> RedisResult<T>) -> Result<T, Failure> {
        if self.away().is_some() {
            return Err(Failure::Other);
        }
        let kept = self.idle().pop();
        if let Some(mut connection) = kept {
            match work(&mut connection) {
                Err(error) if is_closed(&error) => self.idle().clear(),
                done => return self.settle(connection, done),
            }
        }
        match self.connect() {
            Ok(mut connection) => {
                let done = work(&mut connection);
                self.settle(connection, done)
            }
            Err(error) => Err(self.failed(&error)),
        }
    }

    fn keep(&self, connection: Connection) {
        let mut idle = self.idle();
        if idle.len() < MOST_IDLE {
            idle.push(connection);
        }
    }

    fn settle<T>(&self, connection: Connection, done: RedisResult<T>) -> Result<T, Failure> {
        match done {
            Ok(done) => {
                self.keep(connection);
                Ok(done)
            }
            // Another node has the record, now or soon: this one is well.
            Err(error) if matches!(error.code(), Some("MOVED" | "ASK" | "TRYAGAIN")) => {
                self.keep(connection);
                Err(Failure::Other)
            }
            Err(error) => Err(self.failed(&error)),
        }
    }

    fn failed(&self, error: &RedisError) -> Failure {
        self.idle().clear();
        let fault = self.tls.as_ref().and_then(|_| authros_tls::tls_fault(io_error(error)?, "cache.roots"));
        let is_nonsense = fault.is_none() && is_nonsense(error);
        let why = match fault {
            Some(fault) => format!("{} {}; {}", self.shown, fault.reason, fault.advice),
            None if error.is_timeout() => format!("{} does not answer in time", self.shown),
            None => clean(&format!("{}: {error}", self.shown), 200),
        };
        let mut away = self.away();
        let since = away.as_ref().map_or_else(Timestamp::now, |away| away.since);
        *away = Some(Away { since, why });
        if is_nonsense { Failure::Nonsense } else { Failure::Other }
    }

    fn probe(&self) {
        let ping = |connection: &mut Connection| cmd("PING").query::<String>(connection);
        if self.away().is_none() {
            drop(self.with(ping));
            return;
        }
        let asked = self.connect().and_then(|mut connection| ping(&mut connection).map(|_| connection));
        match asked {
            Ok(connection) => {
                self.keep(connection);
                *self.away() = None;
            }
            Err(error) => drop(self.failed(&error)),
        }
    }

    fn connect(&self) -> RedisResult<Connection> {
        let (hosts, master, database) = match &self.address.place {
            Place::Server(server) => return Connection::open(server, self.tls.as_ref()),
            Place::Sentinels(hosts, master, database) => (hosts, master, database),
            Place::Cluster(_) => return Err(io::Error::other("a cluster is not a single server").into()),
        };
        let host = self.master(hosts, master)?;
        let server = self.address.server(&host, database).map_err(io::Error::other)?;
        let mut connection = Connection::open(&server, self.tls.as_ref())?;
        let role: Vec<Value> = cmd("ROLE").query(&mut connection)?;
        let role = role.into_iter().next().map(from_redis_value::<String>);
        match role {
            Some(Ok(role)) if role == "master" => Ok(connection),
            _ => Err(io::Error::other(format!("{} is not the master yet", clean(&host, 80))).into()),
        }
    }

    /// HOST:PORT, from the first sentinel that answers.
    fn master(&self, sentinels: &[ConnectionInfo], name: &str) -> RedisResult<String> {
        let mut failure = RedisError::from(io::Error::other("there are no sentinels"));
        for sentinel in sentinels {
            let asked = Connection::open(sentinel, self.tls.as_ref()).and_then(|mut connection| {
                let mut question = cmd("SENTINEL");
                question.arg("GET-MASTER-ADDR-BY-NAME").arg(name);
                question.query::<Option<(String, u16)>>(&mut connection)
            });
            match asked {
                Ok(Some((host, port))) if host.contains(':') => return Ok(format!("[{host}]:{port}")),
                Ok(Some((host, port))) => return Ok(format!("{host}:{port}")),
                Ok(None) => {
                    let words = format!("its sentinels know no master '{}'", clean(name, 60));
                    failure = io::Error::other(words).into();
                }
                Err(error) => failure = error,
            }
        }
        Err(failure)
    }
}

/// An idle connection is unusable, or its server became a replica.
fn is_closed(error: &RedisError) -> bool {
    let demoted = error.kind() == ErrorKind::Server(ServerErrorKind::ReadOnly);
    demoted || error.is_connection_dropped()
}

fn is_nonsense(error: &RedisError) -> bool {
    matches!(error.kind(), ErrorKind::Parse | ErrorKind::UnexpectedReturnType)
        || io_error(error).is_some_and(|error| error.kind() == io::ErrorKind::InvalidData)
}

/// The library wraps it once.
fn io_error(error: &RedisError) -> Option<&io::Error> {
    error.source()?.downcast_ref::<Arc<dyn Error + Send + Sync>>()?.downcast_ref()
}

fn key(digest: Digest) -> String {
    format!("authros:{digest}")
}

/// CRC-16/XMODEM of a key without a hash tag (Redis cluster specification, appendix A).
fn slot(key: &str) -> u16 {
    let crc = key.bytes().fold(0u16, |crc, byte| {
        (0..8).fold(
            crc ^ (u16::from(byte) << 8),
            |crc, _| {
                if crc & 0x8000 == 0 { crc << 1 } else { (crc << 1) ^ 0x1021 }
            },
        )
    });
    crc % SLOTS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_are_those_of_the_specification() {
        // The specification's own check value, and slots that `CLUSTER KEYSLOT` of Redis 7.0 gives.
        assert_eq!((slot("123456789"), 0x31c3 % SLOTS), (12_739, 12_739));
        assert_eq!((slot("foo"), slot("bar"), slot("")), (12_182, 5_061, 0));
    }
}
