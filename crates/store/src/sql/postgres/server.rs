//! Where a PostgreSQL database is, and how it is connected to. Its address is shown without user and password.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};
use tokio_postgres::config::{Host, SslMode, TargetSessionAttrs};
use tokio_postgres::tls::{MakeTlsConnect, NoTls, TlsConnect};
use tokio_postgres::{Config, Socket};
use tokio_postgres_rustls::MakeRustlsConnect;

use super::{Client, Watermark, detail_of, drive, kind_of_state, password, wait};
use crate::StoreError;
use crate::model::{Timestamp, clean, coarse};
use crate::sql::{Error, Kind, Refusal, Result};

/// With each host: one that is cut off does not answer, and the primary may be the next.
const PATIENCE: Duration = Duration::from_secs(3);
/// A silent peer is asked, and given up some seconds later.
const SILENCE: Duration = Duration::from_secs(10);
pub(super) const USUAL_PORT: u16 = 5432;
const SCHEMES: [&str; 2] = ["postgres://", "postgresql://"];
/// The client's own words.
const NO_WRITES: &str = "database does not allow writes";
const NO_PASSWORD: &str = "password missing";

/// What a user's or the database's own settings must not change: nothing ends a commit that waits for a standby. The server
/// ends what a machine that is cut off has begun, which would keep its locks for hours.
const SESSION: &str = "SET statement_timeout = 0; SET idle_in_transaction_session_timeout = 0; SET lock_timeout = 0;
    SET client_min_messages = warning; SET tcp_keepalives_idle = 10; SET tcp_keepalives_interval = 5;
    SET tcp_keepalives_count = 2; SET tcp_user_timeout = 20000";

/// Of a writer between two statements of a transaction: one that was stopped must not keep its locks, the lease's among them.
/// Nothing ends a commit by it.
const LONGEST_PAUSE: &str = "SET idle_in_transaction_session_timeout = '4s'";

/// What a transaction has changed so far; `settle` adds it to the counts and empties them. ON COMMIT DELETE ROWS would lock
/// them, and each such lock is in the server's log. The server makes and drops them in commits of their own. If those waited
/// for a standby, a primary without one could never shut down.
const PENDING: &str = "SET synchronous_commit = local;
    CREATE TEMPORARY TABLE pending_counters (
        stream BIGINT NOT NULL, state BIGINT NOT NULL, records BIGINT NOT NULL, bytes BIGINT NOT NULL,
        taken_in BIGINT NOT NULL, PRIMARY KEY (stream, state)
    );
    CREATE TEMPORARY TABLE pending_epochs (
        stream BIGINT NOT NULL, epoch BIGINT NOT NULL, records BIGINT NOT NULL, first_at BIGINT, last_at BIGINT,
        PRIMARY KEY (stream, epoch)
    )";
/// Until the transaction's end.
const ALONE: &str = "SELECT pg_advisory_xact_lock(1096109105)";
const SCHEMA: &str = concat!(include_str!("../../ledger/postgres.sql"), include_str!("../../ledger/indexes.sql"));
const VERSION: i64 = 1;
const IS_MADE: &str = "SELECT 1 WHERE to_regclass('about') IS NOT NULL";
const VERSION_OF: &str = "SELECT version FROM about";
/// Tables of the store that the user may not write.
const CLOSED: &str = "SELECT count(*) FROM pg_class WHERE relkind = 'r'
    AND NOT (has_table_privilege(oid, 'INSERT') AND has_table_privilege(oid, 'UPDATE'))
    AND relnamespace = (SELECT relnamespace FROM pg_class WHERE oid = to_regclass('about'))";
/// What keeps writes away, asked of a server that takes none.
const IS_STANDBY: &str = "SELECT pg_is_in_recovery()::INTEGER";
/// Milliseconds since 1970.
const CLOCK: &str = "SELECT (extract(epoch FROM clock_timestamp()) * 1000)::BIGINT";
/// Leases and rights end by the server's clock, captured records carry this machine's.
const APART: Duration = Duration::from_secs(120);

/// What drives connections, as long as there are any. `None` while it ends.
pub(super) struct Driver(Option<Runtime>);

impl Drop for Driver {
    fn drop(&mut self) {
        // Also where waiting is forbidden.
        self.0.take().into_iter().for_each(Runtime::shutdown_background);
    }
}

pub(crate) struct Server {
    driver: Arc<Driver>,
    config: Config,
    tls: Option<MakeRustlsConnect>,
    place: PathBuf,
    watermark: Arc<Watermark>,
}

impl fmt::Debug for Server {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Server").field("place", &self.place).finish_non_exhaustive()
    }
}

impl Server {
    pub fn is_address(text: &str) -> bool {
        SCHEMES.iter().any(|scheme| text.starts_with(scheme))
    }

    /// Connects to nothing yet. `roots`: a PEM file of authorities, or those of this machine.
    pub fn at(url: &str, roots: Option<&Path>) -> std::result::Result<Self, StoreError> {
        // The parser's words may hold a part of the URL.
        let refused = |detail: &str| StoreError::ServerUrl { detail: detail.to_owned() };
        if !Self::is_address(url) {
            return Err(refused("it does not begin with postgres://"));
        }
        // The parser takes what follows the first one for the host, and shows it.
        let authority = url.split_once("://").map_or(url, |(_, rest)| rest);
        if authority.split(['/', '?']).next().is_some_and(|authority| authority.matches('@').count() > 1) {
            return Err(refused("an @ in its user or password is written %40"));
        }
        let mut config: Config = url.parse().map_err(|_| refused("it is not an address of a database"))?;
        if config.get_hosts().is_empty() {
            return Err(refused("it names no host"));
        }
        if config.get_password().is_none()
            && let Some(password) = password::of_environment(&config)?
        {
            config.password(password.as_bytes());
        }
        let is_remote = config.get_hosts().iter().any(is_remote)
            || config.get_hostaddrs().iter().any(|address| !address.is_loopback());
        if is_remote && config.get_ssl_mode() == SslMode::Prefer {
            config.ssl_mode(SslMode::Require);
        }
        let has_tls = config.get_ssl_mode() != SslMode::Disable
            && config.get_hosts().iter().any(|host| matches!(host, Host::Tcp(_)));
        let tls = has_tls.then(|| authros_tls::tls(roots)).transpose().map_err(|why| refused(&why))?;
        config.application_name("authros").connect_timeout(PATIENCE).tcp_user_timeout(SILENCE * 2);
        config.keepalives_idle(SILENCE).keepalives_interval(SILENCE / 2).keepalives_retries(2);
        config.target_session_attrs(TargetSessionAttrs::ReadWrite);
        let place = place(&config);
        let runtime = Builder::new_multi_thread().worker_threads(1).thread_name("postgres").enable_all().build();
        let runtime = runtime.map_err(|error| StoreError::home(&place, &error))?;
        let driver = Arc::new(Driver(Some(runtime)));
        let watermark = Arc::new(Watermark::in_memory()?);
        Ok(Self { driver, config, tls: tls.map(MakeRustlsConnect::new), place, watermark })
    }

    /// Compared with what a home remembers of it.
    pub fn remembered_by(self, watermark: Watermark) -> Self {
        Self { watermark: Arc::new(watermark), ..self }
    }

    /// Scheme, hosts and database.
    pub fn place(&self) -> &Path {
        &self.place
    }

    /// Makes the tables in an empty database.
    pub fn writer(&self) -> std::result::Result<Client, StoreError> {
        let client = self.begun()?;
        if self.check(&client)? {
            // Nothing was written, so nothing waits for a standby.
            client.undo()?;
        } else {
            client.script(SCHEMA)?;
            client.commit()?;
        }
        Ok(client)
    }

    /// Refuses what cannot be this home's store; `false` = the tables are not made yet. For all who open the store, also those
    /// who only look.
    pub fn check(&self, client: &Client) -> std::result::Result<bool, StoreError> {
        self.check_clock(client)?;
        let (is_made, server) = (self.is_made(client)?, self.place.clone());
        match self.watermark.check(client, is_made)? {
            true if is_made => return Err(StoreError::ServerRestored { server }),
            true => return Err(StoreError::ServerEmpty { server, commits: self.watermark.commits() }),
            false if is_made => may_write(client)?,
            false => {}
        }
        Ok(is_made)
    }

    /// Inside a transaction by which the database, although restored, has what this home has seen.
    pub fn renewing(&self) -> std::result::Result<Client, StoreError> {
        let client = self.begun()?;
        self.watermark.accept(&client)?;
        Ok(client)
    }

    /// Whether it lacked, at the last connection, what this home has seen.
    pub fn is_behind(&self) -> bool {
        self.watermark.is_behind()
    }

    /// Inside a transaction, alone with the tables.
    fn begun(&self) -> std::result::Result<Client, StoreError> {
        let client = self.connect()?;
        client.script(LONGEST_PAUSE)?;
        client.script(PENDING)?;
        client.begin()?;
        client.script(ALONE)?;
        Ok(client)
    }

    /// Whether the store's tables are there, in the form that this program knows.
    fn is_made(&self, client: &Client) -> std::result::Result<bool, StoreError> {
        if client.number(IS_MADE)?.is_none() {
            return Ok(false);
        }
        let taken = "a table about is another program's";
        let version = client.number(VERSION_OF).map_err(|error| match error.kind {
            Kind::Altered => Error::new(Kind::Refused(Refusal::Taken), taken),
            _ => error,
        });
        match version? {
            None | Some(VERSION) => Ok(true),
            Some(found) => Err(StoreError::Newer { file: self.place.clone(), found, known: VERSION }),
        }
    }

    fn check_clock(&self, client: &Client) -> std::result::Result<(), StoreError> {
        let before = milliseconds();
        let there = client.number(CLOCK)?.unwrap_or_default();
        let here = before.midpoint(milliseconds());
        match apart(there - here) {
            None => Ok(()),
            Some(apart) => Err(StoreError::ServerClock { server: self.place.clone(), apart }),
        }
    }

    pub fn connect(&self) -> Result<Client> {
        let client = self.connect_with(&self.config).map_err(|error| match error.kind {
            Kind::Standby => Error::new(Kind::Standby, self.why_no_writes()),
            _ => error,
        })?;
        client.script(SESSION)?;
        Ok(client)
    }

    fn why_no_writes(&self) -> &'static str {
        let mut config = self.config.clone();
        config.target_session_attrs(TargetSessionAttrs::Any);
        match self.connect_with(&config).and_then(|client| client.number(IS_STANDBY)) {
            Ok(Some(0)) => "its user may only read (default_transaction_read_only)",
            Ok(_) => "it is a standby",
            Err(_) => "it is a standby, or its user may only read",
        }
    }

    fn connect_with(&self, config: &Config) -> Result<Client> {
        match self.tls.clone() {
            Some(tls) => self.connect_by(config.clone(), tls),
            None => self.connect_by(config.clone(), NoTls),
        }
    }

    fn connect_by<T>(&self, config: Config, tls: T) -> Result<Client>
    where
        T: MakeTlsConnect<Socket, Stream: Send + 'static> + Send + 'static,
        T::TlsConnect: TlsConnect<Socket, Future: Send> + Send,
    {
        let Some(runtime) = &self.driver.0 else { return Err(Error::new(Kind::Broken, "the store is closed")) };
        let warnings = Arc::new(AtomicU64::new(0));
        let opening = runtime.spawn(async move { config.connect(tls).await });
        let opened = wait(opening).map_err(|error| Error::new(Kind::Broken, clean(&error.to_string(), 200)))?;
        let (client, connection) = opened.map_err(|error| {
            let kind = error.code().map_or_else(|| kind_of_connecting(&error), kind_of_state);
            Error::new(kind, detail_of(&error))
        })?;
        runtime.spawn(drive(connection, Arc::clone(&warnings)));
        Ok(Client::new(client, warnings, Arc::clone(&self.watermark), Arc::clone(&self.driver)))
    }
}

/// Of this machine's clock.
pub(crate) fn milliseconds() -> i64 {
    i64::try_from(Timestamp::now().0 / 1_000_000).unwrap_or(i64::MAX)
}

/// `1 h ahead of`, if clocks that differ by these milliseconds differ too much.
pub(crate) fn apart(ahead: i64) -> Option<String> {
    let word = if ahead > 0 { "ahead of" } else { "behind" };
    let length = Duration::from_millis(ahead.unsigned_abs());
    (length > APART).then(|| format!("{} {word}", coarse(length)))
}

/// Of an error that no server named. The client refuses a server that takes no writes, or asks for a password that there is not,
/// by errors of its own.
fn kind_of_connecting(error: &tokio_postgres::Error) -> Kind {
    match std::error::Error::source(error).map(ToString::to_string).as_deref() {
        Some(NO_WRITES) => Kind::Standby,
        Some(NO_PASSWORD) => Kind::Refused(Refusal::Login),
        _ => Kind::Broken,
    }
}

fn may_write(client: &Client) -> Result<()> {
    match client.number(CLOSED)? {
        None | Some(0) => Ok(()),
        Some(count) => {
            let detail = format!("its user may not write {count} of the store's tables");
            Err(Error::new(Kind::Refused(Refusal::Rights), detail))
        }
    }
}

fn is_remote(host: &Host) -> bool {
    match host {
        Host::Tcp(name) => {
            name != "localhost" && !name.parse().is_ok_and(|address: std::net::IpAddr| address.is_loopback())
        }
        Host::Unix(_) => false,
    }
}

fn place(config: &Config) -> PathBuf {
    let ports = config.get_ports();
    let hosts = config.get_hosts().iter().enumerate().map(|(number, host)| {
        let port = ports.get(number).or(ports.first()).copied().unwrap_or(USUAL_PORT);
        match host {
            Host::Tcp(name) if port == USUAL_PORT => clean(name, 100),
            Host::Tcp(name) => format!("{}:{port}", clean(name, 100)),
            Host::Unix(path) => clean(&path.display().to_string(), 100),
        }
    });
    let hosts: Vec<String> = hosts.collect();
    format!("postgres://{}/{}", hosts.join(","), clean(config.get_dbname().unwrap_or_default(), 60)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_shown_without_user_and_password() {
        for (url, shown) in [
            ("postgres://u:secret@db.example/fleet?sslmode=disable", "postgres://db.example/fleet"),
            (
                "postgresql://u:secret@localhost:5433,127.0.0.1:5434/fleet?sslmode=disable",
                "postgres://localhost:5433,127.0.0.1:5434/fleet",
            ),
            ("postgres:///fleet?host=/run/postgresql&password=secret", "postgres:///run/postgresql/fleet"),
        ] {
            let server = Server::at(url, None).expect(shown);
            assert_eq!(server.place(), Path::new(shown));
            assert!(!format!("{server:?}").contains("secret"));
        }
    }

    #[test]
    fn a_bad_address_is_refused_without_its_password() {
        for url in [
            "mysql://u:secret@db/x",
            "postgres://u:secret@db:port/x",
            "postgres:///x?password=secret",
            "postgres://u:a@secret@db/x",
        ] {
            let error = Server::at(url, None).expect_err(url);
            assert!(!error.to_string().contains("secret"), "{error}");
        }
    }

    #[test]
    fn clocks_may_differ_by_two_minutes() {
        assert_eq!((apart(0), apart(120_000), apart(-120_000)), (None, None, None));
        assert_eq!(apart(121_000).as_deref(), Some("2 min ahead of"));
        assert_eq!(apart(-3_600_000).as_deref(), Some("60 min behind"));
    }

    #[test]
    fn tls_is_required_of_other_machines() {
        let mode = |url: &str| Server::at(url, None).map(|server| server.config.get_ssl_mode());
        assert_eq!(mode("postgres://u@127.0.0.1/x"), Ok(SslMode::Prefer));
        assert_eq!(mode("postgres://u@db.example/x?sslmode=disable"), Ok(SslMode::Disable));
        assert_eq!(mode("postgres://u@localhost,db.example/x"), Ok(SslMode::Require));
        assert_eq!(mode("postgres://u@localhost/x?hostaddr=192.0.2.7"), Ok(SslMode::Require));
    }
}
