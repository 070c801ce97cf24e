//! The ledger: one SQLite file with the description and state of every record.
//!
//! One thread writes and groups waiting work into one fsync ([`writer`]); readers have their own connections.
//! Everything acknowledged is in here; workers are functions of these tables, so a restart simply runs them again.
//! Ciphertext is kept permanently in the vault, not here.

mod append;
mod batches;
mod chain_proofs;
mod counts;
mod directory;
mod erasures;
mod feed;
mod forwarding;
mod incidents;
mod inspect;
mod quarantine;
mod query;
mod retention;
mod rows;
mod settings;
mod sightings;
#[cfg(test)]
mod tests;
mod transactions;
mod writer;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use rusqlite::{Connection, OptionalExtension as _, params};

pub use self::batches::{Anchors, BatchPlace, NewBatch, PlacedRecord, RootSighting, SignerTopic, WaitingBatch};
pub use self::chain_proofs::{HashedNode, KeptProof, KeptStamp, ProofCounts, StampCounts, UnprovenBatch};
pub use self::counts::{Coverage, CoveragePart, CoverageQuery, OwnerUsage, StateCounts, TopicCounts};
pub use self::directory::{KeptEnvelope, KeptRight, RightEvent, RightKind, StandingRights, WaitingSigner};
pub use self::erasures::{Erasure, ErasurePage, KeptErasure, StatedErasure, TakenErased, ToldErased, Unstated};
pub use self::feed::{Feed, FeedFilter, FeedPage, FeedPlace, FeedRow};
pub use self::forwarding::{ForwardedPage, KeptBinding, KeptReceipt};
pub use self::incidents::{IncidentNote, IncidentRow, IncidentSpan, SpanCoverage};
pub use self::inspect::{AuditPage, AuditedBatch, AuditedPlace, AuditedRecord, Sequence};
pub use self::quarantine::{AlarmRow, GapRow, HeldMinute, HeldQuery, HeldRow, Hold, Loss, PinRow};
pub use self::query::{Glance, LastSeen, NewestRecord, RecordPage, RecordQuery};
pub use self::retention::{KeptTopic, OldRecord, Retained};
pub use self::rows::{Foreign, NewRecord, RecordRow, is_legal};
pub use self::settings::FilterChoice;
pub use self::sightings::{KeptStanding, Sighting};
pub use self::transactions::{
    LaneCount, NewTransaction, OpenTransaction, Reissue, TransactionOutcome, TransactionRow, TransactionState,
};
pub(super) use self::writer::Session;

use crate::StoreError;
use crate::database::{self, Schema, Statements as _};
use crate::model::RecorderPrefix;

const SCHEMA: Schema = Schema { application: 0x4155_4c31, text: include_str!("ledger/schema.sql") };
const READERS_KEPT: usize = 8;
/// The setting that says up to which block a copied ledger's accounts may have anchored without it.
pub const HISTORY: &str = "foreign:history";

/// The ledger of a home. Clones share one file, one writer thread and one pool of readers.
#[derive(Clone)]
pub struct Ledger {
    shared: Arc<Shared>,
}

struct Shared {
    path: PathBuf,
    recorder: RecorderPrefix,
    /// Whether the previous process closed the file.
    clean: bool,
    writer: writer::Writer,
    readers: Mutex<Vec<Connection>>,
    /// Held while a setting is read, changed and written.
    settings: Mutex<()>,
    /// How many holders are holding records back.
    held: AtomicUsize,
    /// How often something was named at the word of an owner elsewhere.
    told: AtomicU64,
}

impl Ledger {
    /// Refuses a ledger written by a later version of this program, without touching it.
    ///
    /// # Errors
    /// [`StoreError::Newer`].
    pub fn check_version(path: &Path) -> Result<(), StoreError> {
        database::check_version(path, &SCHEMA)
    }

    /// Opens the ledger file, or makes it with a random prefix for its recorders. After an unclean end its contents
    /// are checked first (`quick_check`: about a second per million records).
    ///
    /// # Errors
    /// [`StoreError::Home`], [`StoreError::Mode`], [`StoreError::Corrupt`], [`StoreError::Newer`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let connection = database::open_writer(path, &SCHEMA)?;
        let (recorder, clean, is_new) = begin(&connection, path).map_err(|error| error.in_file(path))?;
        let writer = writer::Writer::start(connection, path, clean && !is_new)?;
        let readers = Mutex::default();
        Ok(Self {
            shared: Arc::new(Shared {
                path: path.to_owned(),
                recorder,
                clean,
                writer,
                readers,
                settings: Mutex::default(),
                held: AtomicUsize::new(0),
                told: AtomicU64::new(0),
            }),
        })
    }

    /// The random prefix created with this file, of the recorders of its own records: one for each key that signs here.
    pub fn recorder(&self) -> RecorderPrefix {
        self.shared.recorder
    }

    /// Holds new records back until the guard is dropped: the space left on a full disk is needed for something else.
    pub fn hold_records(&self) -> RecordsHeld {
        self.shared.held.fetch_add(1, Ordering::AcqRel);
        RecordsHeld(self.clone())
    }

    /// Whether new records are accepted now; checked before their bytes go into the vault.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] while they are held back.
    pub fn takes_records(&self) -> Result<(), StoreError> {
        match self.shared.held.load(Ordering::Acquire) {
            0 => Ok(()),
            _ => Err(StoreError::DiskFull { file: self.shared.path.clone() }),
        }
    }

    /// The file's path.
    pub fn path(&self) -> &Path {
        &self.shared.path
    }

    /// Ends the writer thread after all waiting work, and marks the file as cleanly closed. From then on, writes
    /// through other clones fail with [`StoreError::Closed`].
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] or [`StoreError::Database`]; the next open then checks the contents.
    pub fn close(self) -> Result<(), StoreError> {
        self.shared.writer.close()
    }

    /// Does `work` on the writer thread, in one transaction with whatever else is waiting; returns after fsync.
    pub(super) fn write<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.write_many(1, work)
    }

    /// Like [`Self::write`], for work that changes this many records one by one; a large number starts a new
    /// transaction.
    pub(super) fn write_many<T: Send + 'static>(
        &self,
        records: usize,
        work: impl FnOnce(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.shared.writer.write(records, work).map_err(|error| error.in_file(&self.shared.path))
    }

    /// Does `work` on one snapshot of the ledger.
    pub(super) fn read<T>(&self, work: impl FnOnce(&Connection) -> Result<T, StoreError>) -> Result<T, StoreError> {
        let connection = self.reader()?;
        let result = connection
            .unchecked_transaction()
            .map_err(StoreError::from)
            .and_then(|snapshot| work(&snapshot))
            .map_err(|error| error.in_file(&self.shared.path));
        let mut readers = self.shared.readers.lock().unwrap_or_else(PoisonError::into_inner);
        if readers.len() < READERS_KEPT {
            readers.push(connection);
        }
        result
    }

    fn reader(&self) -> Result<Connection, StoreError> {
        let kept = self.shared.readers.lock().unwrap_or_else(PoisonError::into_inner).pop();
        kept.map_or_else(|| database::open_reader(&self.shared.path), Ok)
    }
}

/// New records are held back while this lives.
#[derive(Debug)]
pub struct RecordsHeld(Ledger);

impl Drop for RecordsHeld {
    fn drop(&mut self) {
        self.0.shared.held.fetch_sub(1, Ordering::AcqRel);
    }
}

impl std::fmt::Debug for Ledger {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Ledger").field("path", &self.shared.path).finish_non_exhaustive()
    }
}

/// Its recorder, whether it was closed cleanly, and whether it is new. It is marked as open with the first change: a
/// process that only reads writes nothing.
fn begin(connection: &Connection, path: &Path) -> Result<(RecorderPrefix, bool, bool), StoreError> {
    match connection.query_row("SELECT clean FROM about", [], |row| row.get::<_, bool>(0)).optional()? {
        Some(clean) => {
            let recorder = own_prefix(connection)?;
            if !clean {
                database::quick_check(connection, path)?;
            }
            Ok((recorder, clean, false))
        }
        None => Ok((name_recorder(connection, path)?, true, true)),
    }
}

/// See [`super::snapshot::renew_ledger`].
pub(super) fn renew(path: &Path) -> Result<(), StoreError> {
    let connection = database::open_writer(path, &SCHEMA)?;
    renew_in(&connection, path).map_err(|error| error.in_file(path))
}

fn renew_in(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    database::quick_check(connection, path)?;
    let transaction = connection.unchecked_transaction()?;
    transaction.execute(
        "UPDATE about SET recorder = ?1, clean = 1, feed = randomblob(16)",
        [random_prefix(path)?.as_bytes()],
    )?;
    // Whoever followed the original reads anew: numbers that it gave since would be given again.
    // The first of several restores counts: anything anchored since may be in another home.
    transaction.execute(
        "INSERT OR IGNORE INTO settings SELECT ?1, max(block) FROM cursors HAVING max(block) IS NOT NULL",
        [inspect::COPIED_AT],
    )?;
    // Its location is new, and what its accounts anchored meanwhile is history.
    let forgotten = params![rows::PLACE, HISTORY];
    transaction.execute("DELETE FROM settings WHERE key IN (?1, ?2)", forgotten)?;
    transaction.commit()?;
    Ok(connection.execute_batch("PRAGMA wal_checkpoint(TRUNCATE)")?)
}

fn random_prefix(path: &Path) -> Result<RecorderPrefix, StoreError> {
    let mut random = [0; RecorderPrefix::LENGTH - 1];
    getrandom::fill(&mut random)
        .map_err(|error| StoreError::Database { file: path.to_owned(), detail: error.to_string() })?;
    Ok(RecorderPrefix::ledger(random))
}

/// The prefix of this ledger's own recorders.
fn own_prefix(connection: &Connection) -> Result<RecorderPrefix, StoreError> {
    let prefix: Vec<u8> = connection.one("SELECT recorder FROM about", [], |row| row.get(0))?;
    Ok(RecorderPrefix::from_slice(&prefix).ok_or_else(|| rows::out_of_range(0))?)
}

fn name_recorder(connection: &Connection, path: &Path) -> Result<RecorderPrefix, StoreError> {
    let prefix = random_prefix(path)?;
    connection.execute("INSERT INTO about VALUES (1, ?1, 0, randomblob(16), 0)", [prefix.as_bytes()])?;
    Ok(prefix)
}
