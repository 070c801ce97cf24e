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

use super::{Client, detail_of, drive, kind_of_state, wait};
use crate::StoreError;
use crate::model::clean;
use crate::sql::{Error, Kind, Result};

const PATIENCE: Duration = Duration::from_secs(5);
/// A silent peer is asked, and given up some seconds later.
const SILENCE: Duration = Duration::from_secs(10);
const USUAL_PORT: u16 = 5432;
const SCHEMES: [&str; 2] = ["postgres://", "postgresql://"];

/// What a user's or the database's own settings must not change: nothing ends a commit that waits for a standby.
const SESSION: &str = "SET statement_timeout = 0; SET idle_in_transaction_session_timeout = 0; SET lock_timeout = 0;
    SET client_min_messages = warning";

/// What a transaction has changed so far; `settle` adds it to the counts and empties them. ON COMMIT DELETE ROWS would lock
/// them, and each such lock is in the server's log.
const PENDING: &str = "CREATE TEMPORARY TABLE pending_counters (
        stream BIGINT NOT NULL, state BIGINT NOT NULL, records BIGINT NOT NULL, bytes BIGINT NOT NULL,
        taken_in BIGINT NOT NULL, PRIMARY KEY (stream, state)
    );
    CREATE TEMPORARY TABLE pending_epochs (
        stream BIGINT NOT NULL, epoch BIGINT NOT NULL, records BIGINT NOT NULL, first_at BIGINT, last_at BIGINT,
        PRIMARY KEY (stream, epoch)
    )";
/// Until the transaction's end.
const ALONE: &str = "SELECT pg_advisory_xact_lock(1096109105)";
const SCHEMA: &str = include_str!("../../ledger/postgres.sql");
const VERSION: i64 = 1;
const IS_MADE: &str = "SELECT 1 WHERE to_regclass('about') IS NOT NULL";
const VERSION_OF: &str = "SELECT version FROM about";

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
        let mut config: Config = url.parse().map_err(|_| refused("it is not an address of a database"))?;
        if config.get_hosts().is_empty() {
            return Err(refused("it names no host"));
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
        Ok(Self { driver, config, tls: tls.map(MakeRustlsConnect::new), place })
    }

    /// Scheme, hosts and database.
    pub fn place(&self) -> &Path {
        &self.place
    }

    /// Makes the tables in an empty database.
    pub fn writer(&self) -> std::result::Result<Client, StoreError> {
        let client = self.connect()?;
        client.script(PENDING)?;
        client.begin()?;
        client.script(ALONE)?;
        match client.number(IS_MADE)? {
            None => {
                client.script(SCHEMA)?;
                client.commit()?;
            }
            Some(_) => match client.number(VERSION_OF)? {
                // Nothing was written, so nothing waits for a standby.
                None | Some(VERSION) => client.undo()?,
                Some(found) => return Err(StoreError::Newer { file: self.place.clone(), found, known: VERSION }),
            },
        }
        Ok(client)
    }

    pub fn connect(&self) -> Result<Client> {
        let client = match self.tls.clone() {
            Some(tls) => self.connect_by(tls),
            None => self.connect_by(NoTls),
        }?;
        client.script(SESSION)?;
        Ok(client)
    }

    fn connect_by<T>(&self, tls: T) -> Result<Client>
    where
        T: MakeTlsConnect<Socket, Stream: Send + 'static> + Send + 'static,
        T::TlsConnect: TlsConnect<Socket, Future: Send> + Send,
    {
        let Some(runtime) = &self.driver.0 else { return Err(Error::new(Kind::Broken, "the store is closed")) };
        let (config, warnings) = (self.config.clone(), Arc::new(AtomicU64::new(0)));
        let opening = runtime.spawn(async move { config.connect(tls).await });
        let opened = wait(opening).map_err(|error| Error::new(Kind::Broken, clean(&error.to_string(), 200)))?;
        let (client, connection) = opened.map_err(|error| {
            let kind = error.code().map_or(Kind::Broken, kind_of_state);
            Error::new(kind, detail_of(&error))
        })?;
        runtime.spawn(drive(connection, Arc::clone(&warnings)));
        Ok(Client::new(client, warnings, Arc::clone(&self.driver)))
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
        for url in ["mysql://u:secret@db/x", "postgres://u:secret@db:port/x", "postgres:///x?password=secret"] {
            let error = Server::at(url, None).expect_err(url);
            assert!(!error.to_string().contains("secret"), "{error}");
        }
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
