//! Errors of this crate; each message says what to do next.

use std::path::{Path, PathBuf};

use crate::model::{Digest, Domain, ErrorKind, RecordState};
use crate::sql::{self, Kind, Refusal};

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum StoreError {
    #[error("{} cannot be used: {detail}; make it writable for this user, or choose another home with \
             --home", path.display())]
    Home { path: PathBuf, detail: String },
    #[error(
        "{} has mode {mode:04o}, so others can access it; run `chmod {advised:o} {}`", path.display(), path.display()
    )]
    Mode { path: PathBuf, mode: u32, advised: u32 },
    #[error(
        "{} belongs to user {owner}, not to you (user {user}), who could read what you type and write here; run this as that \
         user, for example with `sudo -u`, or choose another home with --home", path.display()
    )]
    Foreign { path: PathBuf, owner: u32, user: u32 },
    #[error(
        "others can write to {} and could put a keyring or a socket of their own there; run `chmod go-w {}`, check what is in \
         it, then try again", path.display(), path.display()
    )]
    Open { path: PathBuf },
    #[error("the disk that holds {} is full; free some space", file.display())]
    DiskFull { file: PathBuf },
    #[error("{} is damaged ({detail}); keep a copy of it and restore the last backup", file.display())]
    Corrupt { file: PathBuf, detail: String },
    #[error(
        "the note about {what}{about} in {} is damaged ({detail}); keep a copy of the home and restore the last backup",
        file.display()
    )]
    Note { file: PathBuf, what: &'static str, about: String, detail: String },
    #[error("{} has schema {found}, but this program supports only {known}; use a newer authros", file.display())]
    Newer { file: PathBuf, found: i64, known: i64 },
    /// Of another chain or contract.
    #[error(
        "the ledger is bound to domain {bound}, but the chain and contract in use have domain {domain}; a home keeps its \
         chain: set `chain.url` and `chain.contract` to those of this home, or begin a new home for the other chain"
    )]
    Bound { bound: Domain, domain: Domain },
    #[error("{} failed: {detail}; check the disk and the system log, then start again", file.display())]
    Database { file: PathBuf, detail: String },
    #[error("store.url cannot be used: {detail}; write postgres://USER:PASSWORD@HOST/DATABASE")]
    ServerUrl { detail: String },
    #[error("the password of store.url is read from the file in PGPASSFILE: {0}")]
    Password(String),
    #[error("{} cannot be reached: {detail}; start it, or correct store.url", server.display())]
    ServerAway { server: PathBuf, detail: String },
    #[error("{} refuses this program: {detail}; {remedy}", server.display())]
    ServerRefused { server: PathBuf, detail: String, remedy: &'static str },
    #[error(
        "{} has no connection left for this program: {detail}; end other clients, or raise max_connections or the limit \
         of its user: a gateway uses up to 9", server.display()
    )]
    ServerCrowded { server: PathBuf, detail: String },
    #[error(
        "{} takes no writes: {detail}; name the primary in store.url, or all servers with commas between", server.display()
    )]
    ServerReadOnly { server: PathBuf, detail: String },
    #[error(
        "the clock of {} is {apart} this machine's; correct the wrong one (`timedatectl set-ntp true`), then start again",
        server.display()
    )]
    ServerClock { server: PathBuf, apart: String },
    #[error(
        "{} lacks what this home had committed there, so it was restored to an earlier time, or a standby was promoted that \
         lacked it; run `authros gateway serve`, which continues from what is there", server.display()
    )]
    ServerRestored { server: PathBuf },
    #[error(
        "{} is empty, but this home has seen commit {commits} in it; correct store.url, or restore that database from its \
         backup", server.display()
    )]
    ServerEmpty { server: PathBuf, commits: i64 },
    #[error(
        "whether {} committed a change is not known: {detail}; what is not acknowledged is sent again", server.display()
    )]
    Unknown { server: PathBuf, detail: String },
    #[error(
        "this worker does not hold the lease of {}, and another does this for all; run the command where `authros gateway \
         status` shows the holder, or again in 10 s if it is gone", server.display()
    )]
    NotHolder { server: PathBuf },
    #[error("another process changed the same in {} at this moment; run the command again", file.display())]
    Raced { file: PathBuf },
    #[error("{} cannot store {detail}; leave that character out", server.display())]
    Nul { server: PathBuf, detail: String },
    #[error("the ledger is closed, so nothing more can be written; start the site again")]
    Closed,
    #[error("{field} {value} does not fit into the ledger; the limit is 2^63 - 1")]
    TooBig { field: &'static str, value: u64 },
    #[error("record {digest} contradicts the ledger: {detail}; keep a copy of the home and report this")]
    Conflict { digest: Digest, detail: String },
    #[error("a record cannot go from {} to {} this way; this is a bug, please report it", from.word(), to.word())]
    IllegalEdge { from: RecordState, to: RecordState },
    #[error(
        "record {digest} is anchored in block {block}, which is not (or no longer) on the chain here; it is requested \
         again; if this persists, compare the nodes"
    )]
    Replaced { digest: Digest, block: u64 },
    /// `found`: its state's name, or `unknown`.
    #[error("record {digest} is {found}, not ready to be submitted; read the stored records again")]
    NotReady { digest: Digest, found: &'static str },
    /// Unknown or closed.
    #[error("transaction {hash} {detail}; read the open transactions again")]
    Transaction { hash: String, detail: String },
    #[error(
        "'{0}' is not a record id; give at least the first 4 of its hex characters, as `authros records list` shows \
         them"
    )]
    Id(String),
    #[error("more than one record starts with {0}; give more characters of the digest")]
    Ambiguous(String),
    #[error("'{0}' is not a cursor; use the `next` of the page before")]
    Cursor(String),
    #[error(
        "cache.url {url} cannot be used: {detail}; use redis://HOST:PORT/DB, redis+unix:///PATH, \
         redis+cluster://HOST:PORT,HOST:PORT or redis+sentinel://HOST:PORT,HOST:PORT/MASTER, with rediss for TLS, or \
         leave it empty"
    )]
    CacheUrl { url: String, detail: String },
    #[error("the cache {url} does not answer: {detail}; start it, correct cache.url, or leave that empty")]
    CacheAway { url: String, detail: String },
}

impl StoreError {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Home { .. } | Self::DiskFull { .. } => ErrorKind::Home,
            Self::Mode { .. }
            | Self::Newer { .. }
            | Self::Id(_)
            | Self::Ambiguous(_)
            | Self::Cursor(_)
            | Self::Nul { .. }
            | Self::ServerUrl { .. }
            | Self::Password(_)
            | Self::CacheUrl { .. } => ErrorKind::Input,
            Self::Corrupt { .. } | Self::Note { .. } => ErrorKind::Tampered,
            Self::CacheAway { .. } | Self::ServerAway { .. } | Self::ServerCrowded { .. } | Self::Unknown { .. } => {
                ErrorKind::Unreachable
            }
            Self::Bound { .. }
            | Self::Foreign { .. }
            | Self::Open { .. }
            | Self::ServerRefused { .. }
            | Self::ServerReadOnly { .. }
            | Self::ServerRestored { .. }
            | Self::ServerEmpty { .. }
            | Self::NotHolder { .. }
            | Self::Raced { .. }
            | Self::ServerClock { .. } => ErrorKind::Refused,
            Self::Database { .. }
            | Self::Closed
            | Self::TooBig { .. }
            | Self::Conflict { .. }
            | Self::IllegalEdge { .. }
            | Self::NotReady { .. }
            | Self::Replaced { .. }
            | Self::Transaction { .. } => ErrorKind::Internal,
        }
    }

    pub(super) fn home(path: &Path, error: &std::io::Error) -> Self {
        if error.kind() == std::io::ErrorKind::StorageFull {
            return Self::DiskFull { file: path.to_owned() };
        }
        Self::Home { path: path.to_owned(), detail: error.to_string() }
    }

    /// Adds the file's or server's name to an error without one.
    pub(super) fn in_file(mut self, path: &Path) -> Self {
        match &mut self {
            Self::Home { path: file, .. }
            | Self::DiskFull { file }
            | Self::Corrupt { file, .. }
            | Self::Note { file, .. }
            | Self::Database { file, .. }
            | Self::ServerAway { server: file, .. }
            | Self::ServerRefused { server: file, .. }
            | Self::ServerCrowded { server: file, .. }
            | Self::ServerReadOnly { server: file, .. }
            | Self::ServerClock { server: file, .. }
            | Self::Unknown { server: file, .. }
            | Self::NotHolder { server: file }
            | Self::Nul { server: file, .. }
                if file.as_os_str().is_empty() =>
            {
                path.clone_into(file);
            }
            _ => {}
        }
        self
    }
}

fn remedy(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::Login => {
            "correct user and password in store.url (or PGPASSWORD, or PGPASSFILE), or what the server's pg_hba.conf allows"
        }
        Refusal::Database => "create the database there, or correct store.url",
        Refusal::Taken => "name a database of its own in store.url",
        Refusal::Rights => "make the user of store.url the owner of its database",
    }
}

impl From<sql::Error> for StoreError {
    fn from(error: sql::Error) -> Self {
        let sql::Error { kind, detail } = error;
        let (file, server) = (PathBuf::new(), PathBuf::new());
        match kind {
            Kind::Altered | Kind::Damaged => Self::Corrupt { file, detail },
            Kind::Full => Self::DiskFull { file },
            Kind::Denied => Self::Home { path: file, detail },
            Kind::Nul => Self::Nul { server, detail },
            Kind::Broken => Self::ServerAway { server, detail },
            Kind::Standby => Self::ServerReadOnly { server, detail },
            Kind::Refused(refusal) => Self::ServerRefused { server, detail, remedy: remedy(refusal) },
            Kind::Crowded => Self::ServerCrowded { server, detail },
            Kind::Unknown => Self::Unknown { server, detail },
            Kind::Conflict | Kind::Other => Self::Database { file, detail },
        }
    }
}

impl From<rusqlite::Error> for StoreError {
    fn from(error: rusqlite::Error) -> Self {
        sql::Error::from(error).into()
    }
}
