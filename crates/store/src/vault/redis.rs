//! The vault on Redis: a cache and sharing point, never the authoritative copy. One server, the master named by
//! sentinels, or a cluster. Keys are digests, so the nodes of a cluster share the records evenly.

mod cluster;
mod connection;
mod node;

use std::collections::BTreeMap;
use std::sync::Arc;

use redis::{FromRedisValue, Pipeline, RedisResult, Value, cmd, from_redis_value, pipe};

use self::cluster::{Cluster, Member};
use self::connection::Connection;
use self::node::{Failure, Node};
use super::{Finding, Stored, Usage, Vault};
use crate::StoreError;
use crate::model::{Digest, clean};

/// The most bytes sent in one pipeline; a larger record is sent alone.
const LARGEST_PIPELINE: usize = 8 << 20;
const PREFIX: &str = "authros:";
const KEYS_PER_SCAN: usize = 500;

/// A vault on Redis.
pub struct RedisVault {
    /// The URL without secrets.
    shown: String,
    servers: Servers,
}

enum Servers {
    One(Box<Node>),
    Many(Cluster),
}

/// Entries for one node of a cluster.
type Group<'a> = (Arc<Member>, Vec<(Digest, &'a [u8])>);

/// One server, for operations on each.
enum Server {
    One,
    Of(Arc<Member>),
}

impl RedisVault {
    /// Connects to a URL and checks the policy. One server: `redis://[USER:PASSWORD@]HOST:PORT/DB` or
    /// `redis+unix:///PATH[?db=N]`; a master known to sentinels:
    /// `redis+sentinel://[USER:PASSWORD@]HOST:PORT,HOST:PORT/MASTER[/DB]`; a cluster:
    /// `redis+cluster://[USER:PASSWORD@]HOST:PORT,HOST:PORT`.
    ///
    /// # Errors
    /// [`StoreError::VaultUrl`], [`StoreError::Unreachable`], [`StoreError::VaultRefused`], and [`StoreError::Policy`]
    /// if a server may evict keys.
    pub fn open(url: &str) -> Result<Self, StoreError> {
        let address = Address::parse(url)?;
        let shown = address.shown.clone();
        let servers = match address.place {
            Place::Cluster(_) => Servers::Many(Cluster::open(address)?),
            _ => {
                let node = Node::new(&address)?;
                node.reach()?;
                Servers::One(Box::new(node))
            }
        };
        Ok(Self { shown, servers })
    }

    /// Problems with the configuration of the servers at a URL.
    ///
    /// # Errors
    /// See [`Self::open`], except for [`StoreError::Policy`], which is among the findings.
    pub(super) fn examine(url: &str) -> Result<Vec<Finding>, StoreError> {
        match Self::open(url) {
            Ok(vault) => Ok(vault.findings()),
            Err(StoreError::Policy { url: server, detail: text, advice }) => {
                Ok(vec![Finding { gravity: super::Gravity::Refused, server, text, advice }])
            }
            Err(error) => Err(error),
        }
    }

    fn findings(&self) -> Vec<Finding> {
        match &self.servers {
            Servers::One(node) => node.findings(),
            Servers::Many(cluster) => cluster.members().iter().flat_map(|member| member.node.findings()).collect(),
        }
    }

    /// Does idempotent `work` on the server that holds a record.
    fn with<T>(&self, digest: Digest, work: impl Fn(&mut Connection) -> RedisResult<T>) -> Result<T, StoreError> {
        match &self.servers {
            Servers::One(node) => node.with(work).map_err(|failure| failure.error),
            Servers::Many(cluster) => cluster.with(slot(&key(digest)), work),
        }
    }

    fn servers(&self) -> Vec<Server> {
        match &self.servers {
            Servers::One(_) => vec![Server::One],
            Servers::Many(cluster) => cluster.members().into_iter().map(Server::Of).collect(),
        }
    }

    fn on<T>(&self, server: &Server, work: impl Fn(&mut Connection) -> RedisResult<T>) -> Result<T, Failure> {
        match (server, &self.servers) {
            (Server::Of(member), _) => member.with(work),
            (Server::One, Servers::One(node)) => node.with(work),
            (Server::One, Servers::Many(_)) => {
                let detail = "it is a cluster".to_owned();
                Err(StoreError::Unreachable { url: self.shown.clone(), detail }.into())
            }
        }
    }

    /// Stores entries that belong to one server; their sizes decide the number of pieces.
    fn put_there(&self, server: &Server, entries: &[(Digest, &[u8])]) -> Result<(), Failure> {
        let mut rest = entries;
        while !rest.is_empty() {
            let (now, later) = rest.split_at(pipeline_length(rest));
            self.on(server, |connection| {
                let mut pipeline = pipe();
                for (digest, bytes) in now {
                    pipeline.cmd("SET").arg(key(*digest)).arg(*bytes);
                }
                ask::<Value>(connection, &pipeline).map(drop)
            })?;
            rest = later;
        }
        Ok(())
    }

    /// Each node takes its own; entries whose slots have moved are stored one by one.
    fn put_apart(&self, cluster: &Cluster, entries: &[(Digest, &[u8])]) -> Stored {
        let mut stored = Stored::default();
        let mut groups: BTreeMap<usize, Group<'_>> = BTreeMap::new();
        for entry in entries {
            match cluster.of(slot(&key(entry.0))) {
                Ok(member) => {
                    let place = Arc::as_ptr(&member) as usize;
                    groups.entry(place).or_insert_with(|| (member, Vec::new())).1.push(*entry);
                }
                Err(error) => stored.failure = Some(error),
            }
        }
        for (member, group) in groups.into_values() {
            match self.put_there(&Server::Of(member), &group) {
                Ok(()) => stored.stored.extend(group.iter().map(|(digest, _)| *digest)),
                Err(Failure { error, redirect: None }) if !matches!(error, StoreError::Unreachable { .. }) => {
                    stored.failure = Some(error);
                }
                Err(_) => self.put_singly(&group, &mut stored),
            }
        }
        stored
    }

    fn put_singly(&self, entries: &[(Digest, &[u8])], stored: &mut Stored) {
        for (digest, bytes) in entries {
            match self.with(*digest, |connection| cmd("SET").arg(key(*digest)).arg(*bytes).exec(connection)) {
                Ok(()) => stored.stored.push(*digest),
                Err(error) => {
                    let gone = matches!(error, StoreError::Unreachable { .. });
                    stored.failure = Some(error);
                    if gone && !self.answers(*digest) {
                        return;
                    }
                }
            }
        }
    }

    /// Walks all records; `each` receives a few hundred keys at a time.
    fn scan(&self, mut each: impl FnMut(&Server, Vec<String>) -> Result<(), StoreError>) -> Result<(), StoreError> {
        for server in self.servers() {
            let mut cursor = 0;
            loop {
                let found = self.on(&server, |connection| {
                    let mut scan = cmd("SCAN");
                    scan.arg(cursor).arg("MATCH").arg(format!("{PREFIX}*")).arg("COUNT").arg(KEYS_PER_SCAN);
                    scan.query::<(u64, Vec<String>)>(connection)
                });
                let (next, mut keys) = found.map_err(|failure| failure.error)?;
                keys.retain(|key| !key.starts_with(node::MARK));
                if !keys.is_empty() {
                    each(&server, keys)?;
                }
                if next == 0 {
                    break;
                }
                cursor = next;
            }
        }
        Ok(())
    }

    fn lengths(&self, server: &Server, keys: &[String]) -> Result<Vec<u64>, StoreError> {
        let lengths = self.on(server, |connection| {
            let mut pipeline = pipe();
            for key in keys {
                pipeline.cmd("STRLEN").arg(key);
            }
            ask(connection, &pipeline)
        });
        lengths.map_err(|failure| failure.error)
    }
}

impl Vault for RedisVault {
    fn name(&self) -> &str {
        &self.shown
    }

    fn durable(&self) -> bool {
        false
    }

    fn put(&self, entries: &[(Digest, &[u8])]) -> Result<(), StoreError> {
        self.put_each(entries).failure.map_or(Ok(()), Err)
    }

    fn put_each(&self, entries: &[(Digest, &[u8])]) -> Stored {
        match &self.servers {
            Servers::Many(cluster) => self.put_apart(cluster, entries),
            Servers::One(_) => match self.put_there(&Server::One, entries) {
                Ok(()) => Stored { stored: entries.iter().map(|(digest, _)| *digest).collect(), failure: None },
                Err(failure) => Stored { stored: Vec::new(), failure: Some(failure.error) },
            },
        }
    }

    fn answers(&self, digest: Digest) -> bool {
        match &self.servers {
            Servers::One(_) => true,
            Servers::Many(cluster) => cluster.of(slot(&key(digest))).is_ok_and(|member| member.rests().is_none()),
        }
    }

    fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError> {
        self.with(digest, |connection| cmd("GET").arg(key(digest)).query(connection))
    }

    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        if digests.len() < 2 || !self.is_one() {
            return digests.iter().map(|digest| self.get(*digest)).collect();
        }
        let found = self.on(&Server::One, |connection| {
            let mut pipeline = pipe();
            for digest in digests {
                pipeline.cmd("GET").arg(key(*digest));
            }
            ask(connection, &pipeline)
        });
        found.map_err(|failure| failure.error)
    }

    fn fronts(&self, digests: &[Digest], length: usize) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        let last = length.saturating_sub(1);
        // A missing key is an empty text here.
        let some = |bytes: Vec<u8>| (!bytes.is_empty()).then_some(bytes);
        if !self.is_one() {
            let front = |digest: &Digest| {
                self.with(*digest, |connection| cmd("GETRANGE").arg(key(*digest)).arg(0).arg(last).query(connection))
            };
            return digests.iter().map(|digest| front(digest).map(some)).collect();
        }
        let found: Result<Vec<Vec<u8>>, Failure> = self.on(&Server::One, |connection| {
            let mut pipeline = pipe();
            for digest in digests {
                pipeline.cmd("GETRANGE").arg(key(*digest)).arg(0).arg(last);
            }
            ask(connection, &pipeline)
        });
        Ok(found.map_err(|failure| failure.error)?.into_iter().map(some).collect())
    }

    fn delete(&self, digest: Digest) -> Result<bool, StoreError> {
        self.with(digest, |connection| cmd("DEL").arg(key(digest)).query(connection))
    }

    fn contains(&self, digest: Digest) -> Result<bool, StoreError> {
        self.with(digest, |connection| cmd("EXISTS").arg(key(digest)).query(connection))
    }

    fn usage(&self) -> Result<Usage, StoreError> {
        let mut usage = Usage::default();
        self.scan(|server, keys| {
            let lengths = self.lengths(server, &keys)?;
            usage.entries += u64::try_from(lengths.len()).unwrap_or(u64::MAX);
            usage.bytes += lengths.iter().sum::<u64>();
            Ok(())
        })?;
        Ok(usage)
    }

    fn policy_warnings(&self) -> Vec<String> {
        self.findings().iter().map(Finding::line).collect()
    }

    fn dump(&self, each: &mut dyn FnMut(Digest, &[u8])) -> Result<(), StoreError> {
        self.scan(|_, keys| {
            for digest in keys.iter().filter_map(|key| key.strip_prefix(PREFIX)?.parse().ok()) {
                if let Some(bytes) = self.get(digest)? {
                    each(digest, &bytes);
                }
            }
            Ok(())
        })
    }

    fn replace(&self, digest: Digest, bytes: &[u8]) -> Result<bool, StoreError> {
        self.with(digest, |connection| {
            let answer: Value = cmd("SET").arg(key(digest)).arg(bytes).arg("XX").query(connection)?;
            Ok(answer != Value::Nil)
        })
    }

    fn runs(&self) -> Result<String, StoreError> {
        match &self.servers {
            Servers::One(node) => node.run(node::MARK),
            Servers::Many(cluster) => {
                let mut runs =
                    cluster.members().iter().map(|member| run_of(cluster, member)).collect::<Result<Vec<_>, _>>()?;
                runs.sort();
                Ok(runs.join(" "))
            }
        }
    }

    fn ailing(&self) -> Option<StoreError> {
        match &self.servers {
            Servers::One(node) => node.ailing(),
            Servers::Many(cluster) => cluster.members().iter().find_map(|member| member.node.ailing()),
        }
    }

    fn is_one(&self) -> bool {
        matches!(self.servers, Servers::One(_))
    }

    fn contains_many(&self, digests: &[Digest]) -> Result<Vec<bool>, StoreError> {
        if digests.len() < 2 || !self.is_one() {
            return digests.iter().map(|digest| self.contains(*digest)).collect();
        }
        let found = self.on(&Server::One, |connection| {
            let mut pipeline = pipe();
            for digest in digests {
                pipeline.cmd("EXISTS").arg(key(*digest));
            }
            ask(connection, &pipeline)
        });
        found.map_err(|failure| failure.error)
    }
}

/// The present contents of a cluster's node, as in [`Node::run`]. One that does not answer counts as unchanged until it
/// does; one that may evict records is reported.
fn run_of(cluster: &Cluster, member: &Member) -> Result<String, StoreError> {
    let found = match (member.rests(), cluster.mark_of(member)) {
        (None, Some(mark)) => match member.node.run(&mark) {
            Ok(run) => Some(run),
            Err(error @ (StoreError::Policy { .. } | StoreError::VaultFull { .. })) => return Err(error),
            Err(_) => None,
        },
        _ => None,
    };
    Ok(format!("{}={}", member.host, found.or_else(|| member.node.known_run()).unwrap_or_default()))
}

fn key(digest: Digest) -> String {
    format!("{PREFIX}{digest}")
}

/// How many of the entries fit into one pipeline; at least one.
fn pipeline_length(entries: &[(Digest, &[u8])]) -> usize {
    let mut bytes = 0;
    let fitting = entries.iter().take_while(|(_, blob)| {
        bytes += blob.len();
        bytes <= LARGEST_PIPELINE
    });
    fitting.count().max(1)
}

// The address of a Redis: one server, the master named by sentinels, or the nodes of a cluster.

/// A vault's URL, parsed.
#[derive(Clone, PartialEq, Eq)]
struct Address {
    /// Its name, without secrets.
    pub shown: String,
    /// `USER:PASSWORD@` as written; empty if there is none.
    credentials: String,
    /// What it leads to.
    pub place: Place,
}

/// The kind of address.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Place {
    /// One server, at a URL that the client understands.
    Server(String),
    /// Sentinels as HOST:PORT, their name for the master, its database.
    Sentinels(Vec<String>, String, String),
    /// Nodes of a cluster as HOST:PORT; the rest are learnt from them.
    Cluster(Vec<String>),
}

impl Address {
    /// Parses `redis://[USER:PASSWORD@]HOST:PORT/DB`, `redis+unix:///PATH[?db=N]`,
    /// `redis+sentinel://[USER:PASSWORD@]HOST:PORT,HOST:PORT/MASTER[/DB]` or
    /// `redis+cluster://[USER:PASSWORD@]HOST:PORT,HOST:PORT`.
    ///
    /// # Errors
    /// [`StoreError::VaultUrl`].
    fn parse(url: &str) -> Result<Self, StoreError> {
        let shown = redact(url);
        let wrong = |detail: &str| StoreError::VaultUrl { url: shown.clone(), detail: detail.to_owned() };
        let (scheme, rest) = url.split_once("://").unwrap_or(("", url));
        let (credentials, rest) = match rest.rsplit_once('@') {
            Some((credentials, rest)) if scheme.starts_with("redis+") => (format!("{credentials}@"), rest),
            _ => (String::new(), rest),
        };
        let place = match scheme {
            "redis+sentinel" => {
                let mut parts = rest.split('/');
                let hosts = hosts(parts.next().unwrap_or_default()).map_err(wrong)?;
                let master = parts.next().filter(|name| !name.is_empty());
                let master = master.ok_or_else(|| wrong("the master's name is missing after the sentinels"))?;
                let database = parts.next().unwrap_or("0");
                if database.parse::<u16>().is_err() || parts.next().is_some() {
                    return Err(wrong("the database must be a number"));
                }
                Place::Sentinels(hosts, master.to_owned(), database.to_owned())
            }
            "redis+cluster" => Place::Cluster(hosts(rest.trim_end_matches('/')).map_err(wrong)?),
            _ => Place::Server(url.to_owned()),
        };
        Ok(Self { shown, credentials, place })
    }

    /// The URL of one server of a cluster, or of a master.
    fn server(&self, host: &str, database: &str) -> String {
        format!("redis://{}{host}/{database}", self.credentials)
    }
}

fn hosts(text: &str) -> Result<Vec<String>, &'static str> {
    let good = |host: &str| {
        let port = host.rsplit_once(':').filter(|(name, _)| !name.is_empty()).map(|(_, port)| port.parse::<u16>());
        matches!(port, Some(Ok(1..))) && host.bytes().all(|byte| byte.is_ascii_graphic() && !b"/?#@".contains(&byte))
    };
    let hosts: Vec<String> = text.split(',').map(str::to_owned).collect();
    if hosts.iter().all(|host| good(host)) { Ok(hosts) } else { Err("servers must be HOST:PORT, separated by commas") }
}

/// The URL without user, password and query, safe to show.
fn redact(url: &str) -> String {
    let plain = url.split_once(['?', '#']).map_or(url, |(before, _)| before);
    let Some((scheme, rest)) = plain.split_once("://") else { return clean(plain, 80) };
    let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
    let hidden = if host.len() == rest.len() { "" } else { "***@" };
    clean(&format!("{scheme}://{hidden}{host}"), 120)
}

// Hash slots of a Redis cluster: which node has which keys.

/// How many there are.
const SLOTS: u16 = 16_384;

/// The slot of a key without a hash tag: CRC-16/XMODEM of it (Redis cluster specification, appendix A).
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

// Several commands sent at once, and an answer read for each.
//
// The library's own pipeline goes on reading after a silence and waits for its time-out once for every answer that does
// not come: 64 commands to a server that is stopped held the connection for three minutes.

/// The answers to all commands, in their order. Ends at the first silence; a command that the server refuses is
/// reported after all answers are read, so that the connection stays usable.
fn ask<T: FromRedisValue>(connection: &mut Connection, commands: &Pipeline) -> RedisResult<Vec<T>> {
    if commands.is_empty() {
        return Ok(Vec::new());
    }
    connection.send(&commands.get_packed_pipeline())?;
    let values = connection.replies(commands.len())?;
    values.into_iter().map(|value| Ok(from_redis_value(value.extract_error()?)?)).collect()
}

#[cfg(test)]
mod address_tests {
    use super::*;

    #[test]
    fn sentinels_and_clusters_are_understood_and_secrets_hidden() {
        let place = |url: &str| Address::parse(url).map(|address| address.place).ok();
        let two = vec!["a:1".to_owned(), "[::1]:2".to_owned()];
        assert_eq!(place("redis+cluster://a:1,[::1]:2"), Some(Place::Cluster(two.clone())));
        let sentinels = |database: &str| Place::Sentinels(two.clone(), "mine".to_owned(), database.to_owned());
        assert_eq!(place("redis+sentinel://u:p@a:1,[::1]:2/mine"), Some(sentinels("0")));
        assert_eq!(place("redis+sentinel://a:1,[::1]:2/mine/3"), Some(sentinels("3")));
        assert_eq!(place("redis://h:1/0"), Some(Place::Server("redis://h:1/0".to_owned())));
        for bad in ["cluster://", "cluster://a", "cluster://a:0", "cluster://a:1,", "cluster://a:1/x", "sentinel://a:1"]
        {
            assert_eq!(place(&format!("redis+{bad}")), None, "{bad}");
        }
        assert_eq!(place("redis+sentinel://a:1/mine/x"), None);
        let address = Address::parse("redis+cluster://me:s3cret@a:1,b:2").expect("good");
        assert_eq!(address.server("b:2", "0"), "redis://me:s3cret@b:2/0");
        assert!(!address.shown.contains("s3cret") && address.shown.contains("a:1,b:2"), "{}", address.shown);
        let error = Address::parse("redis+sentinel://me:s3cret@a:1").map(drop).expect_err("no master");
        assert!(!error.to_string().contains("s3cret"), "{error}");
    }
}

#[cfg(test)]
mod slots_tests {
    use super::*;

    #[test]
    fn slots_are_those_of_the_specification() {
        // The specification's own check value, and slots that `CLUSTER KEYSLOT` of Redis 7.0 gives.
        assert_eq!((slot("123456789"), 0x31c3 % SLOTS), (12_739, 12_739));
        assert_eq!((slot("foo"), slot("bar"), slot("")), (12_182, 5_061, 0));
    }
}
