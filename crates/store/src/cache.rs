//! Redis as a cache: written after the commit, filled on a miss, believed only where SM3 is the digest. Its thread
//! takes digests and reads bytes from the store, so deleted ones do not return to the cache.

mod address;
mod connection;
mod servers;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use self::servers::{Answer, Servers};
use crate::StoreError;
use crate::ciphertext::Ciphertext;
use crate::crypto::sm3::sm3;
use crate::model::{Digest, Timestamp, counted};

/// Further records are not written to the cache.
const MOST_WAITING: usize = 16 * 1024;
/// Deletions that wait for absent servers; the oldest are left to [`KEPT`].
const MOST_FORGOTTEN: usize = 256 * 1024;
/// Bytes of a write; a larger record is written alone.
const PIECE: usize = 1 << 20;
const ROUND: usize = 64;
/// How long only the writing thread asks a failed server.
const REST: Duration = Duration::from_secs(1);
/// Time between pings, so that its state is current while unused.
const LOOK: Duration = Duration::from_secs(5);
/// Seconds a server keeps a record, so that a missed deletion ends.
const KEPT: u32 = 24 * 60 * 60;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CacheSettings {
    /// `redis://[USER:PASSWORD@]HOST:PORT/DB`, `rediss://` for TLS, `redis+unix:///PATH[?db=N]`,
    /// `redis+cluster://[USER:PASSWORD@]HOST:PORT,HOST:PORT`, or
    /// `redis+sentinel://[USER:PASSWORD@]HOST:PORT,HOST:PORT/MASTER[/DB]`; the last two with `rediss` for TLS, too.
    pub url: String,
    /// PEM file with the authorities to accept for TLS; `None` = those of this machine.
    pub roots: Option<PathBuf>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CacheState {
    /// Without secrets.
    pub url: String,
    pub hits: u64,
    /// Also of a cache that was away.
    pub misses: u64,
    /// Answers that were another record; also misses.
    pub wrong: u64,
    /// Not written: too many waited, or the cache was away or full.
    pub skipped: u64,
    /// Set while any part of it does not answer.
    pub away: Option<Away>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Away {
    pub since: Timestamp,
    pub why: String,
}

impl CacheState {
    pub fn line(&self) -> String {
        let Self { url, hits, misses, wrong, .. } = self;
        let mut line = format!("{url}: {}, {}", counted(*hits, "hit"), counted(*misses, "miss"));
        if *wrong > 0 {
            line.push_str(&format!(", {}", counted(*wrong, "wrong answer")));
        }
        if let Some(away) = &self.away {
            line.push_str(&format!("; away since {}: {}", away.since, away.why));
        }
        line
    }
}

/// Returns the URL without secrets, if the cache answers.
pub fn examine(settings: &CacheSettings) -> Result<String, StoreError> {
    let servers = Servers::new(settings)?;
    servers.probe();
    match servers.away() {
        None => Ok(servers.shown().to_owned()),
        Some(away) => Err(StoreError::CacheAway { url: servers.shown().to_owned(), detail: away.why }),
    }
}

pub(crate) struct Cache {
    shared: Arc<Shared>,
    writer: Mutex<Option<JoinHandle<()>>>,
}

struct Shared {
    servers: Servers,
    hits: AtomicU64,
    misses: AtomicU64,
    wrong: AtomicU64,
    skipped: AtomicU64,
    waiting: Mutex<Waiting>,
    woken: Condvar,
}

#[derive(Default)]
struct Waiting {
    fill: VecDeque<Digest>,
    forget: VecDeque<Digest>,
    is_ending: bool,
}

impl Shared {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn skip(&self, records: usize) {
        self.skipped.fetch_add(u64::try_from(records).unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}

impl Cache {
    /// Does not wait for the cache.
    pub(crate) fn begin(settings: &CacheSettings, store: Ciphertext) -> Result<Self, StoreError> {
        let zero = AtomicU64::default;
        let (hits, misses, wrong, skipped) = (zero(), zero(), zero(), zero());
        let (servers, waiting, woken) = (Servers::new(settings)?, Mutex::default(), Condvar::new());
        let shared = Arc::new(Shared { servers, hits, misses, wrong, skipped, waiting, woken });
        let of_thread = Arc::clone(&shared);
        let writer = std::thread::Builder::new()
            .name("cache".to_owned())
            .spawn(move || Writer { shared: &of_thread, store: &store, left: Vec::new() }.run())
            .map_err(|error| StoreError::home(Path::new("a thread for the cache"), &error))?;
        Ok(Self { shared, writer: Mutex::new(Some(writer)) })
    }

    pub(crate) fn get(&self, digest: Digest) -> Option<Vec<u8>> {
        let shared = &self.shared;
        match shared.servers.get(digest) {
            Answer::Bytes(bytes) if sm3(&[&bytes]) == digest.0 => {
                shared.hits.fetch_add(1, Ordering::Relaxed);
                return Some(bytes);
            }
            Answer::Bytes(_) | Answer::Nonsense => {
                shared.wrong.fetch_add(1, Ordering::Relaxed);
            }
            Answer::Nothing => {}
        }
        shared.misses.fetch_add(1, Ordering::Relaxed);
        None
    }

    /// Queues records for writing, without waiting.
    pub(crate) fn fill(&self, digests: impl IntoIterator<Item = Digest>) {
        let is_away = self.shared.servers.is_gone();
        let mut waiting = self.shared.waiting();
        let mut skipped = 0;
        for digest in digests {
            if is_away || waiting.fill.len() >= MOST_WAITING {
                skipped += 1;
            } else {
                waiting.fill.push_back(digest);
            }
        }
        drop(waiting);
        self.shared.skip(skipped);
        self.shared.woken.notify_one();
    }

    /// Queues deletions, until the cache is back if it is away.
    pub(crate) fn forget(&self, digests: &[Digest]) {
        self.shared.waiting().forget.extend(digests);
        self.shared.woken.notify_one();
    }

    pub(crate) fn state(&self) -> CacheState {
        let shared = &self.shared;
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        CacheState {
            url: shared.servers.shown().to_owned(),
            hits: of(&shared.hits),
            misses: of(&shared.misses),
            wrong: of(&shared.wrong),
            skipped: of(&shared.skipped),
            away: shared.servers.away(),
        }
    }

    /// Ends the writing thread after the deletions.
    pub(crate) fn close(&self) {
        self.shared.waiting().is_ending = true;
        self.shared.woken.notify_one();
        let writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(writer) = writer {
            // A panic there affects only the cache.
            drop(writer.join());
        }
    }
}

impl Drop for Cache {
    fn drop(&mut self) {
        self.close();
    }
}

struct Writer<'a> {
    shared: &'a Shared,
    store: &'a Ciphertext,
    /// Deletions that absent servers have not made.
    left: Vec<Digest>,
}

impl Writer<'_> {
    fn run(&mut self) {
        self.shared.servers.probe();
        let mut probed = Instant::now();
        loop {
            let (fill, forget, is_ending) = self.next();
            if probed.elapsed() >= self.pause() {
                self.shared.servers.probe();
                probed = Instant::now();
            }
            // Before the deletions: a fill may still contain a record deleted meanwhile.
            self.fill(&fill);
            self.left.extend(forget);
            self.forget();
            if is_ending {
                return;
            }
        }
    }

    fn pause(&self) -> Duration {
        if self.shared.servers.away().is_some() { REST } else { LOOK }
    }

    fn next(&self) -> (Vec<Digest>, VecDeque<Digest>, bool) {
        let idle = |waiting: &mut Waiting| waiting.fill.is_empty() && waiting.forget.is_empty() && !waiting.is_ending;
        let waiting = self.shared.woken.wait_timeout_while(self.shared.waiting(), self.pause(), idle);
        let (mut waiting, _) = waiting.unwrap_or_else(PoisonError::into_inner);
        let round = waiting.fill.len().min(ROUND);
        (waiting.fill.drain(..round).collect(), std::mem::take(&mut waiting.forget), waiting.is_ending)
    }

    fn fill(&self, digests: &[Digest]) {
        let (mut piece, mut bytes) = (Vec::new(), 0);
        for digest in digests {
            // An altered record is not passed on.
            let found = self.store.get(*digest).ok().flatten().filter(|blob| sm3(&[blob]) == digest.0);
            let Some(blob) = found else { continue };
            if bytes + blob.len() > PIECE {
                self.put(&std::mem::take(&mut piece));
                bytes = 0;
            }
            bytes += blob.len();
            piece.push((*digest, blob));
        }
        self.put(&piece);
    }

    fn put(&self, piece: &[(Digest, Vec<u8>)]) {
        let put = self.shared.servers.put(piece);
        self.shared.skip(piece.len().saturating_sub(put));
    }

    fn forget(&mut self) {
        if !self.left.is_empty() {
            self.left = self.shared.servers.delete(&self.left);
            let excess = self.left.len().saturating_sub(MOST_FORGOTTEN);
            self.left.drain(..excess);
        }
    }
}
