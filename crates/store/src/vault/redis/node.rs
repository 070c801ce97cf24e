//! One Redis server and its connection, reopened by the next call after a failure.
//!
//! Every new connection first checks the server's configuration, because a restart may have changed it.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use redis::{ConnectionInfo, ErrorKind, IntoConnectionInfo, RedisError, RedisResult, ServerErrorKind, cmd};

use super::connection::Connection;
use super::{Address, Place};
use crate::StoreError;
use crate::model::{Timestamp, clean};
use crate::vault::{Finding, Gravity, Setup};

/// How long an unresponsive server is left alone: callers meanwhile get the previous error at once, so nobody waits a
/// second time for the same silence.
const REST: Duration = Duration::from_secs(1);
/// A failure that took longer than this counts as silence.
const SILENCE: Duration = Duration::from_secs(1);
/// How often the server's configuration is checked, and whether it accepts writes.
const LOOK: Duration = Duration::from_secs(2);
/// The mark's name; no record's key begins like this.
pub(super) const MARK: &str = "authros:mark";

/// Why a node did not do as asked.
#[derive(Debug)]
pub(super) struct Failure {
    /// An error to report.
    pub error: StoreError,
    /// Another node of the cluster has the slot, for good (`true`) or while it moves.
    pub redirect: Option<(String, bool)>,
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self { error, redirect: None }
    }
}

/// How a node is found.
enum Source {
    Fixed(Box<ConnectionInfo>),
    /// The sentinels, their name for the master, its database.
    Sentinels(Vec<ConnectionInfo>, String, String),
}

/// One server.
pub(super) struct Node {
    address: Address,
    source: Source,
    /// The server, without secrets.
    shown: String,
    link: Mutex<Link>,
    /// Separate from the link, so that reading it never waits for the network.
    findings: Mutex<Vec<Finding>>,
}

/// What is known about the server.
#[derive(Default)]
struct Link {
    connection: Option<Connection>,
    run_id: Option<String>,
    /// Until when it is left alone, and why.
    resting: Option<(Instant, StoreError)>,
    /// When its configuration was last checked.
    looked: Option<Instant>,
}

impl Link {
    fn rests(&self) -> Option<StoreError> {
        self.resting.as_ref().filter(|(until, _)| Instant::now() < *until).map(|(_, why)| why.clone())
    }

    /// Notes that the server does not answer. It is left alone if that took long since `begun`; one that refuses at
    /// once may be tried again at once.
    fn rest(&mut self, why: &StoreError, begun: Instant) {
        self.connection = None;
        if matches!(why, StoreError::Unreachable { .. }) {
            let now = Instant::now();
            let rest = if now.duration_since(begun) >= SILENCE { REST } else { Duration::ZERO };
            self.resting = Some((now + rest, why.clone()));
        }
    }
}

impl Node {
    /// The server at an address, or the master named by its sentinels; not connected yet.
    ///
    /// # Errors
    /// [`StoreError::VaultUrl`].
    pub(super) fn new(address: &Address) -> Result<Self, StoreError> {
        let source = match &address.place {
            Place::Server(url) => Source::Fixed(Box::new(server(url, &address.shown)?)),
            Place::Sentinels(hosts, master, database) => {
                let sentinels = hosts.iter().map(|host| server(&format!("redis://{host}/"), &address.shown));
                Source::Sentinels(sentinels.collect::<Result<_, _>>()?, master.clone(), database.clone())
            }
            Place::Cluster(_) => {
                let detail = "a cluster is not a single server".to_owned();
                return Err(StoreError::VaultUrl { url: address.shown.clone(), detail });
            }
        };
        Ok(Self::at(address, source, address.shown.clone()))
    }

    /// One node of a cluster; not connected yet.
    ///
    /// # Errors
    /// [`StoreError::VaultUrl`].
    pub(super) fn member(address: &Address, host: &str) -> Result<Self, StoreError> {
        let shown = clean(&format!("redis://{host}"), 120);
        let source = Source::Fixed(Box::new(server(&address.server(host, "0"), &shown)?));
        Ok(Self::at(address, source, shown))
    }

    fn at(address: &Address, source: Source, shown: String) -> Self {
        let address = address.clone();
        Self { address, source, shown, link: Mutex::default(), findings: Mutex::default() }
    }

    fn link(&self) -> MutexGuard<'_, Link> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Connects if there is no connection.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`], [`StoreError::VaultRefused`], [`StoreError::Policy`].
    pub(super) fn reach(&self) -> Result<(), StoreError> {
        let mut link = self.link();
        if link.connection.is_some() { Ok(()) } else { self.connect(&mut link) }
    }

    fn connect(&self, link: &mut Link) -> Result<(), StoreError> {
        if let Some(why) = link.rests() {
            return Err(why);
        }
        let begun = Instant::now();
        let connected = self.connected();
        match connected {
            Ok(connection) => {
                (link.connection, link.resting, link.looked) = (Some(connection), None, Some(Instant::now()));
                Ok(())
            }
            Err(error) => {
                link.rest(&error, begun);
                Err(error)
            }
        }
    }

    fn connected(&self) -> Result<Connection, StoreError> {
        let mut connection = self.dial()?;
        cmd("PING").exec(&mut connection).map_err(|e| self.error(&e))?;
        self.examine(&mut connection)?;
        Ok(connection)
    }

    /// Checks the server's configuration.
    ///
    /// # Errors
    /// [`StoreError::Policy`] if it may evict records.
    fn examine(&self, connection: &mut Connection) -> Result<(), StoreError> {
        let findings = self.look(connection)?;
        let refused = findings.iter().find(|finding| finding.gravity == Gravity::Refused).cloned();
        *self.findings.lock().unwrap_or_else(PoisonError::into_inner) = findings;
        match refused {
            Some(Finding { server, text, advice, .. }) => Err(StoreError::Policy { url: server, detail: text, advice }),
            None => Ok(()),
        }
    }

    fn dial(&self) -> Result<Connection, StoreError> {
        match &self.source {
            Source::Fixed(server) => Connection::open(server).map_err(|e| self.error(&e)),
            Source::Sentinels(sentinels, master, database) => {
                let host = self.master(sentinels, master)?;
                let server = server(&self.address.server(&host, database), &self.shown)?;
                let mut connection = Connection::open(&server).map_err(|e| self.error(&e))?;
                let role: Vec<redis::Value> = cmd("ROLE").query(&mut connection).map_err(|e| self.error(&e))?;
                let role = role.into_iter().next().map(redis::from_redis_value::<String>);
                if !matches!(role, Some(Ok(role)) if role == "master") {
                    return Err(self.gone(&format!("{} is not the master yet", clean(&host, 80))));
                }
                Ok(connection)
            }
        }
    }

    /// HOST:PORT of the master, from the first sentinel that answers.
    fn master(&self, sentinels: &[ConnectionInfo], name: &str) -> Result<String, StoreError> {
        let mut failure = self.gone("there are no sentinels");
        for sentinel in sentinels {
            let asked = Connection::open(sentinel).and_then(|mut connection| {
                let mut question = cmd("SENTINEL");
                question.arg("GET-MASTER-ADDR-BY-NAME").arg(name);
                question.query::<Option<(String, u16)>>(&mut connection)
            });
            match asked {
                Ok(Some((host, port))) if host.contains(':') => return Ok(format!("[{host}]:{port}")),
                Ok(Some((host, port))) => return Ok(format!("{host}:{port}")),
                Ok(None) => failure = self.gone(&format!("its sentinels know no master '{}'", clean(name, 60))),
                Err(error) => failure = self.error(&error),
            }
        }
        Err(failure)
    }

    /// The server's configuration.
    fn look(&self, connection: &mut Connection) -> Result<Vec<Finding>, StoreError> {
        let mut ask = |name: &str| match configuration(connection, name) {
            Err(error) if is_lost(&error) => Err(self.error(&error)),
            found => Ok(found.ok().flatten()),
        };
        let mut setup = Setup {
            eviction: ask("maxmemory-policy")?,
            appends: ask("appendonly")?,
            syncs: ask("appendfsync")?,
            coverage: None,
        };
        if matches!(self.address.place, Place::Cluster(_)) {
            setup.coverage = ask("cluster-require-full-coverage")?;
        }
        Ok(setup.findings(&self.shown))
    }

    /// Problems with its configuration, as of the last connection.
    pub(super) fn findings(&self) -> Vec<Finding> {
        self.findings.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Does idempotent `work`; if an old connection turns out to be dead, once more on a new one.
    pub(super) fn with<T>(&self, work: impl Fn(&mut Connection) -> RedisResult<T>) -> Result<T, Failure> {
        let mut link = self.link();
        let begun = Instant::now();
        if let Some(connection) = link.connection.as_mut() {
            match work(connection) {
                Err(error) if is_lost(&error) => {
                    link.connection = None;
                    if error.is_timeout() {
                        let why = self.error(&error);
                        link.rest(&why, begun);
                        return Err(why.into());
                    }
                }
                other => return other.map_err(|error| self.failure(&error)),
            }
        }
        self.connect(&mut link)?;
        let Some(connection) = link.connection.as_mut() else { return Err(self.gone("it closed").into()) };
        work(connection).map_err(|error| {
            let failure = self.failure(&error);
            if is_lost(&error) {
                link.connection = None;
                if failure.redirect.is_none() {
                    link.rest(&failure.error, begun);
                }
            }
            failure
        })
    }

    /// Identifies the server's present contents: the id of its run, its number of evictions, and the mark under `mark`,
    /// which a FLUSHALL deletes and which is then set anew. If the text changes, records may be gone. Every two seconds
    /// it also checks the configuration, and whether the server accepts writes.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`], [`StoreError::Policy`], [`StoreError::VaultFull`] and the like.
    pub(super) fn run(&self, mark: &str) -> Result<String, StoreError> {
        let due = self.link().looked.is_none_or(|at| at.elapsed() >= LOOK);
        let found = self.with(|connection| held(connection, mark, due)).map_err(|failure| failure.error)?;
        if due {
            self.look_again()?;
        }
        self.link().run_id = Some(found.clone());
        Ok(found)
    }

    /// Why it was not reachable the last time.
    pub(super) fn ailing(&self) -> Option<StoreError> {
        self.link().resting.as_ref().map(|(_, why)| why.clone())
    }

    /// Checks the configuration of a connected server; one that may evict records is no longer used.
    fn look_again(&self) -> Result<(), StoreError> {
        let mut link = self.link();
        link.looked = Some(Instant::now());
        let Some(connection) = link.connection.as_mut() else { return Ok(()) };
        let begun = Instant::now();
        self.examine(connection).inspect_err(|error| link.rest(error, begun))
    }

    /// The id of the last run it reported.
    pub(super) fn known_run(&self) -> Option<String> {
        self.link().run_id.clone()
    }

    fn gone(&self, detail: &str) -> StoreError {
        StoreError::Unreachable { url: self.shown.clone(), detail: detail.to_owned() }
    }

    fn failure(&self, error: &RedisError) -> Failure {
        let first = first_error(error);
        let redirect = first.as_ref().and_then(|(code, detail)| {
            let host = detail.as_deref()?.split_ascii_whitespace().nth(1)?.to_owned();
            matches!(code.as_str(), "MOVED" | "ASK").then(|| (host, code == "MOVED"))
        });
        Failure { error: self.error(error), redirect }
    }

    fn error(&self, error: &RedisError) -> StoreError {
        let url = self.shown.clone();
        let detail = clean(&error.to_string(), 160);
        match first_error(error).map(|(code, _)| code).as_deref() {
            Some("OOM") => StoreError::VaultFull { url },
            Some("LOADING" | "MASTERDOWN" | "CLUSTERDOWN" | "TRYAGAIN" | "BUSY" | "READONLY" | "MOVED" | "ASK") => {
                StoreError::Unreachable { url, detail }
            }
            _ if error.kind() == ErrorKind::AuthenticationFailed => StoreError::VaultRefused { url, detail },
            _ if is_lost(error) => StoreError::Unreachable { url, detail },
            _ => StoreError::VaultRefused { url, detail },
        }
    }
}

/// The server at a URL.
fn server(url: &str, shown: &str) -> Result<ConnectionInfo, StoreError> {
    url.into_connection_info().map_err(|error| {
        let detail = clean(error.detail().unwrap_or(error.category()), 120);
        StoreError::VaultUrl { url: shown.to_owned(), detail }
    })
}

/// The server's error code with its words; for a pipeline, that of its first failed command.
fn first_error(error: &RedisError) -> Option<(String, Option<String>)> {
    if let Some(code) = error.code() {
        return Some((code.to_owned(), error.detail().map(str::to_owned)));
    }
    let all = error.clone().into_server_errors()?;
    all.first().map(|(_, error)| (error.code().to_owned(), error.details().map(str::to_owned)))
}

/// Whether the connection is no longer usable. A master that became a replica accepts no more writes.
fn is_lost(error: &RedisError) -> bool {
    let demoted = error.kind() == ErrorKind::Server(ServerErrorKind::ReadOnly);
    demoted || error.is_io_error() || error.is_unrecoverable_error()
}

fn configuration(connection: &mut Connection, name: &str) -> RedisResult<Option<String>> {
    let found: Vec<String> = cmd("CONFIG").arg("GET").arg(name).query(connection)?;
    Ok(found.into_iter().nth(1))
}

/// Run, evictions and mark in one text. `write`: the mark is written again, which a full server refuses.
fn held(connection: &mut Connection, mark: &str, write: bool) -> RedisResult<String> {
    let run = figure(connection, "server", "run_id:")?;
    let evicted = figure(connection, "stats", "evicted_keys:")?;
    let found: Option<String> = cmd("GET").arg(mark).query(connection)?;
    let token = match found {
        Some(token) if write => {
            // Only if it is still there: a missing one must be noticed the next time.
            cmd("SET").arg(mark).arg(&token).arg("XX").exec(connection)?;
            token
        }
        Some(token) => token,
        None => {
            cmd("SET").arg(mark).arg(fresh_token()).arg("NX").exec(connection)?;
            cmd("GET").arg(mark).query::<Option<String>>(connection)?.unwrap_or_default()
        }
    };
    Ok(format!("{run}/{evicted}/{}", clean(&token, 40)))
}

/// One of the server's figures; empty if it does not say.
fn figure(connection: &mut Connection, section: &str, name: &str) -> RedisResult<String> {
    match cmd("INFO").arg(section).query::<String>(connection) {
        Ok(text) => Ok(text.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default().trim().to_owned()),
        Err(error) if is_lost(&error) => Err(error),
        Err(_) => Ok(String::new()),
    }
}

/// A mark that was never set before. If there are no random numbers, the time must do.
fn fresh_token() -> String {
    let mut token = [0; 8];
    if getrandom::fill(&mut token).is_err() {
        token = Timestamp::now().0.to_be_bytes();
    }
    format!("{:016x}", u64::from_be_bytes(token))
}
