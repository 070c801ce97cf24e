//! The lease: of several processes over one database, its holder alone does what one does for all. Its row ends by the
//! server's clock. A write that only the holder may make locks the row in its own transaction, and is refused if the row
//! names another. A file belongs to one process, which always holds it.

use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::feed;
use super::rows::{time, unsigned};
use super::writer::head;
use super::{Lease, Session};
use crate::StoreError;
use crate::database::capped;
use crate::model::{Timestamp, bytes::hex, clean};
use crate::sql::{self, Connection, Row, params};

/// How long it lasts without a beat.
const LEASE: Duration = Duration::from_secs(6);
/// Between a worker's signs of life.
pub const BEAT: Duration = Duration::from_secs(2);
/// A worker that is silent for longer is not counted, and forgotten later.
const SILENT: Duration = Duration::from_secs(10);
const FORGOTTEN: Duration = Duration::from_secs(3_600);
/// Bytes of a worker's id that are shown.
const SHOWN: usize = 4;

/// The lease under which a write is made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fence {
    worker: [u8; 16],
    number: i64,
}

impl Fence {
    /// The lease cannot change before this transaction ends.
    pub fn check(&self, connection: &Connection) -> Result<(), StoreError> {
        let sql = "SELECT 1 FROM standing_lease WHERE holder = ?1 AND number = ?2";
        match connection.has(sql, params![self.worker, self.number])? {
            true => Ok(()),
            false => Err(not_holder()),
        }
    }
}

fn not_holder() -> StoreError {
    StoreError::NotHolder { server: std::path::PathBuf::new() }
}

/// What a worker may do about the lease at a sign of life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Claim {
    Nothing,
    Renew,
    /// Or take it, if it is free.
    Take,
}

#[derive(Debug, Clone, Copy)]
struct Held {
    number: i64,
    /// By the server's clock, milliseconds: an earlier one is of a database that was restored.
    until: i64,
    /// When it ends at the earliest.
    ends: Instant,
}

/// What a process knows of its own lease without asking.
#[derive(Debug)]
pub(super) struct Tenure {
    /// Random for each opening of the store.
    worker: [u8; 16],
    is_file: bool,
    held: Mutex<Option<Held>>,
}

impl Tenure {
    pub fn new(path: &Path, is_file: bool) -> Result<Self, StoreError> {
        let mut worker = [0; 16];
        getrandom::fill(&mut worker)
            .map_err(|error| StoreError::Database { file: path.to_owned(), detail: error.to_string() })?;
        Ok(Self { worker, is_file, held: Mutex::default() })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Held>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn number(&self) -> Option<i64> {
        self.lock().filter(|held| Instant::now() < held.ends).map(|held| held.number)
    }

    /// `None` where nobody else writes.
    pub fn fence(&self) -> Result<Option<Fence>, StoreError> {
        match (self.is_file, self.number()) {
            (true, _) => Ok(None),
            (false, Some(number)) => Ok(Some(Fence { worker: self.worker, number })),
            (false, None) => Err(not_holder()),
        }
    }

    /// Gives the feed's next numbers to what others left for the holder.
    pub fn number_waiting(&self, connection: &Connection) -> Result<(), StoreError> {
        let Ok(Some(Fence { worker, number })) = self.fence() else { return Ok(()) };
        let sql = "SELECT number_waiting(?1, ?2)";
        Ok(connection.one(sql, params![worker, number], |row| row.get::<i64>(0)).map(drop)?)
    }

    /// In a transaction of its own.
    pub fn release(&self, connection: &Connection) -> Result<(), StoreError> {
        if self.is_file {
            return Ok(());
        }
        connection.begin()?;
        connection.run("UPDATE lease SET until = 0 WHERE holder = ?1", [self.worker])?;
        connection.run("DELETE FROM workers WHERE id = ?1", [self.worker])?;
        Ok(connection.commit()?)
    }

    /// Number and end of the lease, if the process holds it now.
    fn beat(&self, connection: &Connection, (name, claim): (&str, Claim)) -> Result<Option<(i64, i64)>, StoreError> {
        let sql = "INSERT INTO workers VALUES (?1, ?2, now_ms())
            ON CONFLICT (id) DO UPDATE SET name = excluded.name, seen = excluded.seen";
        connection.run(sql, params![self.worker, name])?;
        connection.run("DELETE FROM workers WHERE seen < now_ms() - ?1", [milliseconds(FORGOTTEN)])?;
        let (known, lease) = (*self.lock(), milliseconds(LEASE));
        if let Some(Held { number, until, .. }) = known.filter(|_| claim != Claim::Nothing) {
            let sql = "UPDATE lease SET until = now_ms() + ?3 WHERE holder = ?1 AND number = ?2 AND until >= ?4
                RETURNING number, until";
            let renewed = connection.find(sql, params![self.worker, number, lease, until], number_and_end)?;
            if renewed.is_some() {
                return Ok(renewed);
            }
        }
        if claim != Claim::Take {
            return Ok(None);
        }
        // One of its own that it does not know was taken by a commit without an answer.
        let sql = "UPDATE lease SET holder = ?1, number = number + 1, since = now_ms(), until = now_ms() + ?2
            WHERE until < now_ms() OR holder = ?1 RETURNING number, until";
        let taken = connection.find(sql, params![self.worker, lease], number_and_end)?;
        if taken.is_some() {
            feed::begin(connection, head(connection)?)?;
        }
        Ok(taken)
    }
}

fn number_and_end(row: &Row<'_>) -> sql::Result<(i64, i64)> {
    Ok((row.get(0)?, row.get(1)?))
}

fn milliseconds(length: Duration) -> i64 {
    capped(length.as_millis())
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Worker {
    /// The name that it gave, with the beginning of its id.
    pub name: String,
    pub is_own: bool,
    /// Seconds since its last sign of life.
    pub silent: u64,
}

/// As the server says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeaseState {
    /// How often it was taken so far.
    pub number: u64,
    pub holder: Option<Worker>,
    pub since: Timestamp,
    /// Seen lately, by name.
    pub workers: Vec<Worker>,
}

impl Lease {
    /// The number of the lease, if this process holds it as far as it knows; always 0 on a file.
    pub fn held(&self) -> Option<u64> {
        let tenure = &self.0.shared.tenure;
        if tenure.is_file { Some(0) } else { tenure.number().map(i64::cast_unsigned) }
    }

    /// Refuses what only the holder may do.
    pub fn require(&self) -> Result<(), StoreError> {
        self.0.shared.tenure.fence().map(drop).map_err(|error| error.in_file(self.0.path()))
    }

    /// Whether other processes may work on the same store.
    pub fn is_shared(&self) -> bool {
        !self.0.shared.tenure.is_file
    }

    /// A sign of life of this worker, with its claim. Begins the feed anew with each lease: what it numbers under the new id,
    /// nobody numbered before.
    pub fn beat(&self, name: &str, claim: Claim) -> Result<(), StoreError> {
        let tenure = std::sync::Arc::clone(&self.0.shared.tenure);
        if tenure.is_file {
            return Ok(());
        }
        let (begun, name) = (Instant::now(), clean(name, 100));
        let held = self.0.write(move |Session { connection, .. }| tenure.beat(connection, (&name, claim)))?;
        let held = held.map(|(number, until)| Held { number, until, ends: begun + LEASE });
        // Without a claim the lease is what it was.
        if claim != Claim::Nothing {
            *self.0.shared.tenure.lock() = held;
        }
        Ok(())
    }

    /// `None` on a file.
    pub fn state(&self) -> Result<Option<LeaseState>, StoreError> {
        self.0.read(|connection| state(connection, &self.0.shared.tenure.worker))
    }

    /// Even if another has it: the test's processes are one.
    #[cfg(test)]
    pub(crate) fn take(&self) {
        if self.is_shared() {
            self.0.write(|session| session.connection.run("UPDATE lease SET until = 0", [])).expect("free");
            self.beat("test", Claim::Take).expect("taken");
            self.lasts();
        }
    }

    /// However slow the machine is, as far as this process knows.
    #[cfg(test)]
    pub(crate) fn lasts(&self) {
        if let Some(held) = self.0.shared.tenure.lock().as_mut() {
            held.ends += FORGOTTEN;
        }
    }
}

/// `own`: the id of the worker that looks.
pub(super) fn state(connection: &Connection, own: &[u8]) -> Result<Option<LeaseState>, StoreError> {
    if connection.server().is_none() {
        return Ok(None);
    }
    let worker = |id: &[u8], name: &str, silent: i64| Worker {
        name: format!("{} ({})", clean(name, 100), hex(id.get(..SHOWN).unwrap_or_default())),
        is_own: id == own,
        silent: silent.max(0).cast_unsigned() / 1_000,
    };
    let sql = "SELECT id, name, now_ms() - seen FROM workers WHERE seen >= now_ms() - ?1 ORDER BY name, id";
    let workers = connection.list(sql, [milliseconds(SILENT)], |row| {
        Ok(worker(&row.get::<Vec<u8>>(0)?, &row.get::<String>(1)?, row.get(2)?))
    })?;
    let sql = "SELECT number, since * 1000000, until >= now_ms(), holder, coalesce(name, ''),
            coalesce(now_ms() - seen, 0) FROM lease LEFT JOIN workers ON id = holder";
    Ok(Some(connection.one(sql, [], |row| {
        let holder = worker(&row.get::<Vec<u8>>(3)?, &row.get::<String>(4)?, row.get(5)?);
        let holder = row.get::<bool>(2)?.then_some(holder);
        Ok(LeaseState { number: unsigned(row, 0)?, since: time(row, 1)?, holder, workers })
    })?))
}
