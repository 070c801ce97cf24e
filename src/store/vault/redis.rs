//! The vault on Redis: a cache and sharing point, never the truth.
//!
//! One connection, made anew on the next call after a failure. Every new connection first looks at the
//! server's eviction policy, because a restart may have brought another configuration.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use redis::{Client, Connection, ErrorKind, RedisError, RedisResult, Value, cmd, pipe};

use super::{Usage, Vault};
use crate::model::{Digest, clean};
use crate::store::StoreError;

const TIMEOUT: Duration = Duration::from_secs(3);
/// The most bytes sent in one pipeline; a larger record goes alone.
const LARGEST_PIPELINE: usize = 8 << 20;
const PREFIX: &str = "authros:";
const KEYS_PER_SCAN: usize = 500;

/// A vault on a Redis server, reached by TCP or by a Unix socket.
pub struct RedisVault {
    client: Client,
    /// The URL without secrets.
    url: String,
    link: Mutex<Link>,
    /// Apart from the link, so that asking for them never waits for the network.
    warnings: Mutex<Vec<String>>,
}

/// What is known about the server.
#[derive(Default)]
struct Link {
    connection: Option<Connection>,
    run_id: Option<String>,
    restarted: bool,
}

impl RedisVault {
    /// Connects to `redis://[USER:PASSWORD@]HOST:PORT/DB` or `redis+unix:///PATH[?db=N]` and checks the policy.
    ///
    /// # Errors
    /// [`StoreError::VaultUrl`], [`StoreError::Unreachable`], [`StoreError::VaultRefused`], and
    /// [`StoreError::Policy`] where the server may throw keys away.
    pub fn open(url: &str) -> Result<Self, StoreError> {
        let shown = redact(url);
        let client = Client::open(url).map_err(|error| {
            let detail = clean(error.detail().unwrap_or(error.category()), 120);
            StoreError::VaultUrl { url: shown.clone(), detail }
        })?;
        let vault = Self { client, url: shown, link: Mutex::default(), warnings: Mutex::default() };
        vault.connect(&mut vault.link())?;
        Ok(vault)
    }

    fn link(&self) -> MutexGuard<'_, Link> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn connect(&self, link: &mut Link) -> Result<(), StoreError> {
        let mut connection = self.client.get_connection_with_timeout(TIMEOUT).map_err(|e| self.error(&e))?;
        let limits = connection.set_read_timeout(Some(TIMEOUT)).and(connection.set_write_timeout(Some(TIMEOUT)));
        limits.map_err(|e| self.error(&e))?;
        cmd("PING").exec(&mut connection).map_err(|e| self.error(&e))?;
        *self.warnings.lock().unwrap_or_else(PoisonError::into_inner) = self.check_policy(&mut connection)?;
        let run_id = run_id(&mut connection).map_err(|e| self.error(&e))?;
        link.restarted |= link.run_id.as_ref().is_some_and(|known| Some(known) != run_id.as_ref());
        link.run_id = run_id.or(link.run_id.take());
        link.connection = Some(connection);
        Ok(())
    }

    fn check_policy(&self, connection: &mut Connection) -> Result<Vec<String>, StoreError> {
        let mut warnings = Vec::new();
        match configuration(connection, "maxmemory-policy") {
            Ok(Some(policy)) if policy != "noeviction" => {
                return Err(StoreError::Policy { url: self.url.clone(), policy: clean(&policy, 40) });
            }
            Ok(Some(_)) => {}
            Ok(None) => warnings.push(self.unseen()),
            Err(error) if is_lost(&error) => return Err(self.error(&error)),
            Err(_) => warnings.push(self.unseen()),
        }
        if configuration(connection, "appendonly").is_ok_and(|value| value.as_deref() == Some("no")) {
            warnings.push(format!(
                "Redis at {} keeps no append-only file and forgets what it took in when it is killed; \
                 run `CONFIG SET appendonly yes` and put it into redis.conf",
                self.url
            ));
        }
        Ok(warnings)
    }

    fn unseen(&self) -> String {
        format!(
            "Redis at {} does not show its configuration; make sure that maxmemory-policy is noeviction \
             and appendonly is yes",
            self.url
        )
    }

    /// Does idempotent `work`; where an old connection turns out to be dead, once more on a new one.
    fn with<T>(&self, work: impl Fn(&mut Connection) -> RedisResult<T>) -> Result<T, StoreError> {
        let mut link = self.link();
        if let Some(connection) = link.connection.as_mut() {
            match work(connection) {
                Err(error) if is_lost(&error) => {
                    link.connection = None;
                    if error.is_timeout() {
                        return Err(self.error(&error));
                    }
                }
                other => return other.map_err(|error| self.error(&error)),
            }
        }
        self.connect(&mut link)?;
        let Some(connection) = link.connection.as_mut() else { return Err(self.gone()) };
        work(connection).map_err(|error| {
            if is_lost(&error) {
                link.connection = None;
            }
            self.error(&error)
        })
    }

    fn gone(&self) -> StoreError {
        StoreError::Unreachable { url: self.url.clone(), detail: "the connection was closed".to_owned() }
    }

    fn error(&self, error: &RedisError) -> StoreError {
        let url = self.url.clone();
        let detail = clean(&error.to_string(), 160);
        match code(error).as_deref() {
            Some("OOM") => StoreError::VaultFull { url },
            Some("LOADING" | "MASTERDOWN" | "CLUSTERDOWN" | "TRYAGAIN" | "BUSY") => {
                StoreError::Unreachable { url, detail }
            }
            _ if error.kind() == ErrorKind::AuthenticationFailed => StoreError::VaultRefused { url, detail },
            _ if is_lost(error) => StoreError::Unreachable { url, detail },
            _ => StoreError::VaultRefused { url, detail },
        }
    }

    /// Walks all records; `each` gets keys a few hundred at a time.
    fn scan(&self, mut each: impl FnMut(Vec<String>) -> Result<(), StoreError>) -> Result<(), StoreError> {
        let mut cursor = 0;
        loop {
            let (next, keys) = self.with(|connection| {
                let mut scan = cmd("SCAN");
                scan.arg(cursor).arg("MATCH").arg(format!("{PREFIX}*")).arg("COUNT").arg(KEYS_PER_SCAN);
                scan.query::<(u64, Vec<String>)>(connection)
            })?;
            if !keys.is_empty() {
                each(keys)?;
            }
            if next == 0 {
                return Ok(());
            }
            cursor = next;
        }
    }

    fn lengths(&self, keys: &[String]) -> Result<Vec<u64>, StoreError> {
        self.with(|connection| {
            let mut pipeline = pipe();
            for key in keys {
                pipeline.cmd("STRLEN").arg(key);
            }
            pipeline.query(connection)
        })
    }
}

impl Vault for RedisVault {
    fn name(&self) -> &str {
        &self.url
    }

    fn durable(&self) -> bool {
        false
    }

    fn put(&self, entries: &[(Digest, &[u8])]) -> Result<(), StoreError> {
        let mut rest = entries;
        while !rest.is_empty() {
            let (now, later) = rest.split_at(pipeline_length(rest));
            self.with(|connection| {
                let mut pipeline = pipe();
                for (digest, bytes) in now {
                    pipeline.cmd("SET").arg(key(*digest)).arg(*bytes).ignore();
                }
                pipeline.exec(connection)
            })?;
            rest = later;
        }
        Ok(())
    }

    fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError> {
        self.with(|connection| cmd("GET").arg(key(digest)).query(connection))
    }

    fn delete(&self, digest: Digest) -> Result<bool, StoreError> {
        self.with(|connection| cmd("DEL").arg(key(digest)).query(connection))
    }

    fn contains(&self, digest: Digest) -> Result<bool, StoreError> {
        self.with(|connection| cmd("EXISTS").arg(key(digest)).query(connection))
    }

    fn usage(&self) -> Result<Usage, StoreError> {
        let mut usage = Usage::default();
        self.scan(|keys| {
            let lengths = self.lengths(&keys)?;
            usage.entries += u64::try_from(lengths.len()).unwrap_or(u64::MAX);
            usage.bytes += lengths.iter().sum::<u64>();
            Ok(())
        })?;
        Ok(usage)
    }

    fn policy_warnings(&self) -> Vec<String> {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn dump(&self, each: &mut dyn FnMut(Digest, &[u8])) -> Result<(), StoreError> {
        self.scan(|keys| {
            for digest in keys.iter().filter_map(|key| key.strip_prefix(PREFIX)?.parse().ok()) {
                if let Some(bytes) = self.get(digest)? {
                    each(digest, &bytes);
                }
            }
            Ok(())
        })
    }

    fn replace(&self, digest: Digest, bytes: &[u8]) -> Result<bool, StoreError> {
        self.with(|connection| {
            let answer: Value = cmd("SET").arg(key(digest)).arg(bytes).arg("XX").query(connection)?;
            Ok(answer != Value::Nil)
        })
    }

    fn restarted(&self) -> Result<bool, StoreError> {
        let found = self.with(run_id)?;
        let mut link = self.link();
        let changed = found.is_some() && link.run_id.is_some() && found != link.run_id;
        link.run_id = found.or(link.run_id.take());
        Ok(std::mem::take(&mut link.restarted) || changed)
    }
}

fn key(digest: Digest) -> String {
    format!("{PREFIX}{digest}")
}

/// How many of the entries fit one pipeline; at least one.
fn pipeline_length(entries: &[(Digest, &[u8])]) -> usize {
    let mut bytes = 0;
    let fitting = entries.iter().take_while(|(_, blob)| {
        bytes += blob.len();
        bytes <= LARGEST_PIPELINE
    });
    fitting.count().max(1)
}

/// The server's error code; of a pipeline, that of its first failed command.
fn code(error: &RedisError) -> Option<String> {
    let first = || error.clone().into_server_errors()?.first().map(|(_, error)| error.code().to_owned());
    error.code().map(str::to_owned).or_else(first)
}

/// Whether the connection is of no more use.
fn is_lost(error: &RedisError) -> bool {
    error.is_io_error() || error.is_unrecoverable_error()
}

fn configuration(connection: &mut Connection, name: &str) -> RedisResult<Option<String>> {
    let found: Vec<String> = cmd("CONFIG").arg("GET").arg(name).query(connection)?;
    Ok(found.into_iter().nth(1))
}

/// The server's id of this run; nothing where it does not say.
fn run_id(connection: &mut Connection) -> RedisResult<Option<String>> {
    match cmd("INFO").arg("server").query::<String>(connection) {
        Ok(text) => Ok(text.lines().find_map(|line| line.strip_prefix("run_id:")).map(|id| id.trim().to_owned())),
        Err(error) if is_lost(&error) => Err(error),
        Err(_) => Ok(None),
    }
}

/// The URL without user, password and query, safe to show.
fn redact(url: &str) -> String {
    let plain = url.split_once(['?', '#']).map_or(url, |(before, _)| before);
    let Some((scheme, rest)) = plain.split_once("://") else { return clean(plain, 80) };
    let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
    let hidden = if host.len() == rest.len() { "" } else { "***@" };
    clean(&format!("{scheme}://{hidden}{host}"), 120)
}
