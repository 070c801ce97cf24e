//! The ledger: one SQLite file with description, state and ciphertext of every record. One thread writes and groups
//! waiting work into one fsync; readers have their own connections.

mod append;
mod batches;
mod branches;
mod chain_proofs;
mod counts;
mod directory;
mod durability;
mod erasures;
mod feed;
mod forwarding;
mod incidents;
mod inspect;
mod lease;
mod quarantine;
mod query;
mod readers;
mod retention;
mod rows;
mod sightings;
#[cfg(test)]
pub(crate) mod tests;
mod transactions;
mod writer;

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::task::block_in_place;

pub use self::batches::{Anchors, BatchPlace, NewBatch, PlacedRecord, RootSighting, SignerTopic, WaitingBatch};
pub use self::chain_proofs::{HashedNode, KeptProof, KeptStamp, ProofCounts, StampCounts, UnprovenBatch};
pub use self::counts::{Coverage, CoveragePart, CoverageQuery, OwnerUsage, SealedQuery, StateCounts, TopicCounts};
pub use self::directory::{KeptEnvelope, KeptRight, RightEvent, RightKind, StandingRights, WaitingSigner};
pub use self::durability::Durability;
pub use self::erasures::{Erasure, ErasurePage, KeptErasure, StatedErasure, TakenErased, ToldErased, Unstated};
pub use self::feed::{FeedFilter, FeedPage, FeedPlace, FeedRow};
pub use self::forwarding::{BoundName, ForwardedPage, KeptBinding, KeptReceipt};
pub use self::incidents::{IncidentNote, IncidentRow, IncidentSpan, SpanCoverage};
pub use self::inspect::{AuditPage, AuditedBatch, AuditedPlace, AuditedRecord, Sequence};
pub use self::lease::{BEAT, Claim, LeaseState, Worker};
use self::lease::{Fence, Tenure};
pub use self::quarantine::{AlarmRow, GapRow, HeldMinute, HeldQuery, HeldRow, Hold, Loss, PinRow};
pub use self::query::{FilterChoice, Glance, LastSeen, NewestRecord, RecordPage, RecordQuery};
use self::readers::{Place, Readers};
pub use self::retention::{KeptTopic, OldRecord, Retained};
pub use self::rows::{Foreign, NewRecord, RecordRow, is_legal};
pub(crate) use self::rows::{time, unsigned};
pub use self::sightings::{KeptStanding, Sighting};
pub use self::transactions::{
    LaneCount, NewTransaction, OpenTransaction, Reissue, TransactionOutcome, TransactionRow, TransactionState,
};
pub(super) use self::writer::Session;

use crate::StoreError;
use crate::database::{self, Schema};
use crate::model::{RecorderPrefix, Timestamp};
use crate::notes::{self, CopiedAt, ForeignHistory, LastPlace, RestoredAt};
use crate::sql::postgres::{Server, Watermark};
use crate::sql::{self, Connection, Params, Row};

const SCHEMA: Schema = Schema {
    application: 0x4155_4c31,
    text: concat!(include_str!("ledger/schema.sql"), include_str!("ledger/indexes.sql")),
};

macro_rules! stores {
    ($($(#[$doc:meta])* $field:ident: $store:ident $(, $guard:ident)?;)*) => {
        $($(#[$doc])* #[derive(Debug, Clone)] pub struct $store(pub(crate) Database);)*

        /// The ledger of a home. Clones share one file, one writer thread and one pool of readers.
        #[derive(Debug, Clone)]
        pub struct Ledger {
            pub(super) database: Database,
            $($(#[$doc])* pub $field: $store,)*
        }

        impl From<Database> for Ledger {
            fn from(database: Database) -> Self {
                Self { $($field: $store(database.clone()$(.$guard())?),)* database }
            }
        }
    };
}

// What only the holder of the lease writes is `held`.
stores! {
    records: Records;
    batches: Batches, held;
    counts: Counts;
    /// Records whose ciphertext is deleted by a rule.
    retention: Retention, held;
    /// Records that somebody had erased, and what is stated of them.
    erasures: Erasures;
    /// What a gateway took over, and what it stated.
    forwarding: Forwarding;
    /// What pseudonyms of topics and types mean.
    names: Names;
    incidents: Incidents;
    lanes: Lanes, held;
    /// Who may do what: events of the contract, and envelopes.
    rights: Rights, held;
    quarantine: Quarantine;
    pins: Pins;
    losses: Losses;
    /// What the chain and time authorities prove of batches.
    proofs: Proofs, held;
    /// The blocks that the watcher has read.
    trail: Trail, held;
    bindings: Bindings;
    /// Records for readers, in the order they became readable.
    feed: Feed;
    audit: AuditLog;
    lease: Lease;
    inspection: Inspection;
    /// Facts beside the tables.
    notes: Notes;
}

/// Clones share the writer thread and the readers.
#[derive(Debug, Clone)]
pub(crate) struct Database {
    shared: Arc<Shared>,
    /// Its writes are the lease holder's alone.
    is_held: bool,
}

#[derive(Debug)]
struct Shared {
    place: Arc<Place>,
    recorder: RecorderPrefix,
    clean: bool,
    writer: writer::Writer,
    readers: Readers,
    tenure: Arc<Tenure>,
    /// Held while a note is read, changed and written.
    notes: Mutex<()>,
    held: AtomicUsize,
}

impl Ledger {
    /// Does not touch the file.
    pub fn check_version(path: &Path) -> Result<(), StoreError> {
        database::check_version(path, &SCHEMA)
    }

    /// Opens or creates the file. After an unclean end, checks everything but ciphertext (`quick_check`: about a second
    /// per million records).
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::open_at(Place::File(path.to_owned()))
    }

    /// Opens the store of a gateway's desk on a PostgreSQL server, and makes it in an empty database. `roots`: a PEM file of
    /// the authorities that TLS trusts.
    pub fn on_server(url: &str, roots: Option<&Path>) -> Result<Self, StoreError> {
        Self::open_at(Place::Server(Box::new(Server::at(url, roots)?)))
    }

    /// The same for a home, where `watermark` remembers how far it has seen the database: [`StoreError::ServerRestored`] if the
    /// database is behind that.
    pub fn on_server_of(url: &str, roots: Option<&Path>, watermark: &Path) -> Result<Self, StoreError> {
        Self::open_at(Place::Server(Box::new(Server::at(url, roots)?.remembered_by(Watermark::in_file(watermark)?))))
    }

    /// Goes on with a database that was restored to an earlier time, as with a restored file: with a new recorder and another
    /// feed, because the numbers since are given.
    pub fn renew_on_server(url: &str, roots: Option<&Path>, watermark: &Path) -> Result<(), StoreError> {
        let server = Server::at(url, roots)?.remembered_by(Watermark::in_file(watermark)?);
        let renewed = || {
            let connection = Connection::from(server.renewing()?);
            number_anew(&connection, server.place())?;
            Ok(connection.commit()?)
        };
        renewed().map_err(|error: StoreError| error.in_file(server.place()))
    }

    /// The database was restored to an earlier time since this was opened. Nothing is written to it: this process knows what
    /// is not there any more.
    pub fn restored_meanwhile(&self) -> Option<StoreError> {
        let place = &self.database.shared.place;
        place.is_restored().then(|| StoreError::ServerRestored { server: place.path().to_owned() })
    }

    fn open_at(place: Place) -> Result<Self, StoreError> {
        let place = Arc::new(place);
        let opened = place.writer().and_then(|connection| Ok((begin(&connection, place.path())?, connection)));
        let ((recorder, clean, is_new), connection) = opened.map_err(|error| error.in_file(place.path()))?;
        let tenure = Arc::new(Tenure::new(place.path(), place.file().is_some())?);
        let writer = writer::Writer::start(connection, Arc::clone(&place), Arc::clone(&tenure), clean && !is_new)?;
        let (readers, notes, held) = (Readers::default(), Mutex::default(), AtomicUsize::new(0));
        let shared = Shared { place, recorder, clean, writer, readers, tenure, notes, held };
        Ok(Self::from(Database { shared: Arc::new(shared), is_held: false }))
    }

    pub fn path(&self) -> &Path {
        self.database.path()
    }

    /// Finishes waiting work and marks the file as cleanly closed; later writes of clones fail with
    /// [`StoreError::Closed`].
    pub fn close(self) -> Result<(), StoreError> {
        self.database.shared.writer.close()
    }
}

impl Records {
    /// Random for each file; recorders of its own records begin with it.
    pub fn recorder(&self) -> RecorderPrefix {
        self.0.shared.recorder
    }

    /// Refuses new records until the guard is dropped: the space left on a full disk has another use.
    pub fn hold(&self) -> RecordsHeld {
        self.0.shared.held.fetch_add(1, Ordering::AcqRel);
        RecordsHeld(self.0.clone())
    }

    pub fn takes_records(&self) -> Result<(), StoreError> {
        self.0.takes_records()
    }
}

impl Database {
    /// For messages; a server's is no path of this machine.
    pub fn path(&self) -> &Path {
        self.shared.place.path()
    }

    /// `None` on a server.
    pub fn file(&self) -> Option<&Path> {
        self.shared.place.file()
    }

    pub fn takes_records(&self) -> Result<(), StoreError> {
        match self.shared.held.load(Ordering::Acquire) {
            0 => Ok(()),
            _ => Err(StoreError::DiskFull { file: self.path().to_owned() }),
        }
    }

    /// Guards reading, changing and writing a note.
    pub fn one_at_a_time(&self) -> MutexGuard<'_, ()> {
        self.shared.notes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `work` on the writer thread, in one transaction with other waiting work; returns after the fsync. On a server it
    /// runs again if another transaction was in its way, or the connection broke.
    pub fn write<T: Send + 'static>(
        &self,
        work: impl Fn(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.write_many(1, work)
    }

    /// For work on this many records; a large number starts a new transaction.
    pub fn write_many<T: Send + 'static>(
        &self,
        records: usize,
        work: impl Fn(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let fence = if self.is_held { self.shared.tenure.fence() } else { Ok(None) };
        let fenced = |fence: Option<Fence>| {
            relieved(|| {
                self.shared.writer.write(records, move |session| {
                    fence.map_or(Ok(()), |fence| fence.check(session.connection))?;
                    work(session)
                })
            })
        };
        fence.and_then(fenced).map_err(|error| error.in_file(self.path()))
    }

    /// The same for writes that are the lease holder's alone.
    pub fn held(&self) -> Self {
        Self { is_held: true, ..self.clone() }
    }

    /// Runs `work` on one snapshot.
    pub fn read<T>(&self, work: impl FnOnce(&Connection) -> Result<T, StoreError>) -> Result<T, StoreError> {
        let Shared { readers, place, .. } = &*self.shared;
        relieved(|| readers.read(place, work)).map_err(|error| error.in_file(place.path()))
    }

    pub fn one<T>(
        &self,
        sql: &str,
        values: impl Params,
        read: impl FnOnce(&Row<'_>) -> sql::Result<T>,
    ) -> Result<T, StoreError> {
        self.read(|connection| Ok(connection.one(sql, values, read)?))
    }

    pub fn find<T>(
        &self,
        sql: &str,
        values: impl Params,
        read: impl FnOnce(&Row<'_>) -> sql::Result<T>,
    ) -> Result<Option<T>, StoreError> {
        self.read(|connection| Ok(connection.find(sql, values, read)?))
    }

    pub fn list<T, All: FromIterator<T>>(
        &self,
        sql: &str,
        values: impl Params,
        read: impl FnMut(&Row<'_>) -> sql::Result<T>,
    ) -> Result<All, StoreError> {
        self.read(|connection| Ok(connection.list(sql, values, read)?))
    }

    pub fn has(&self, sql: &str, values: impl Params) -> Result<bool, StoreError> {
        self.read(|connection| Ok(connection.has(sql, values)?))
    }

    /// In one commit; returns the number of changed rows.
    pub fn run_each<P: Params + Send + 'static>(&self, sql: &'static str, each: Vec<P>) -> Result<u64, StoreError> {
        self.write_many(each.len(), move |session| Ok(session.connection.run_each(sql, &each)?))
    }

    /// Returns the number of changed rows.
    pub fn changed(&self, sql: &'static str, values: impl Params + Send + 'static) -> Result<u64, StoreError> {
        self.run_each(sql, vec![values])
    }

    pub fn run(&self, sql: &'static str, values: impl Params + Send + 'static) -> Result<(), StoreError> {
        self.changed(sql, values).map(drop)
    }
}

/// The only door to the file: a runtime's worker thread gives its other tasks away before it waits for the disk.
fn relieved<T>(work: impl FnOnce() -> T) -> T {
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => block_in_place(work),
        _ => work(),
    }
}

#[derive(Debug)]
pub struct RecordsHeld(Database);

impl Drop for RecordsHeld {
    fn drop(&mut self) {
        self.0.shared.held.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Its recorder, whether it was closed cleanly, and whether it is new. Reading never marks it as open.
fn begin(connection: &Connection, path: &Path) -> Result<(RecorderPrefix, bool, bool), StoreError> {
    match connection.find("SELECT clean FROM about", [], |row| row.get::<bool>(0))? {
        Some(clean) => {
            // A server recovers by itself, and others may use it now.
            let clean = clean || connection.server().is_some();
            let recorder = own_prefix(connection)?;
            if let Some(file) = connection.file().filter(|_| !clean) {
                // Readers check ciphertext, perhaps most of the file, by digest.
                database::check_all_but("quick_check", file, "ciphertext", path)?;
            }
            Ok((recorder, clean, false))
        }
        None => {
            let prefix = random_prefix(path)?;
            connection.begin()?;
            connection.run("INSERT INTO about VALUES (1, ?1, 0, 0) ON CONFLICT DO NOTHING", [prefix.as_bytes()])?;
            feed::begin(connection, 0)?;
            connection.commit()?;
            // Another process may have been first.
            Ok((own_prefix(connection)?, true, true))
        }
    }
}

pub(super) fn renew(path: &Path) -> Result<(), StoreError> {
    let file = database::open_writer(path, &SCHEMA)?;
    database::quick_check(&file, path)?;
    renew_in(&file.into(), path).map_err(|error| error.in_file(path))
}

fn renew_in(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    connection.begin()?;
    number_anew(connection, path)?;
    connection.commit()?;
    Ok(connection.script("PRAGMA wal_checkpoint(TRUNCATE)")?)
}

/// Inside a transaction.
fn number_anew(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    connection.run("UPDATE about SET recorder = ?1, clean = 1", [random_prefix(path)?.as_bytes()])?;
    connection.run("DELETE FROM feeds", [])?;
    feed::begin(connection, 0)?;
    // Followers of the original start over: it gave the same numbers since.
    // The first of several restores counts: another home may hold anything anchored since.
    if let Some((block, _)) = sightings::cursor_in(connection)?
        && notes::read_in(connection, &CopiedAt {})?.is_none()
    {
        notes::write_in(connection, &CopiedAt {}, &block)?;
    }
    notes::write_in(connection, &RestoredAt {}, &Timestamp::now())?;
    // Its location is new, and its accounts' anchors since are history.
    notes::forget_in(connection, &LastPlace {})?;
    notes::forget_in(connection, &ForeignHistory {})
}

fn random_prefix(path: &Path) -> Result<RecorderPrefix, StoreError> {
    let mut random = [0; RecorderPrefix::LENGTH - 1];
    getrandom::fill(&mut random)
        .map_err(|error| StoreError::Database { file: path.to_owned(), detail: error.to_string() })?;
    Ok(RecorderPrefix::ledger(random))
}

fn own_prefix(connection: &Connection) -> Result<RecorderPrefix, StoreError> {
    let prefix: Vec<u8> = connection.one("SELECT recorder FROM about", [], |row| row.get(0))?;
    Ok(RecorderPrefix::from_slice(&prefix).ok_or_else(|| rows::out_of_range(0))?)
}
