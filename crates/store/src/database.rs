//! Opens an SQLite file the way both ledger and vault need it: private, WAL, every commit fsynced, schema up to date,
//! contents checked after an unclean shutdown.

use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, OpenFlags, TransactionBehavior};

use super::{StoreError, files};

const BUSY: Duration = Duration::from_secs(10);
/// How long shutdown waits for readers.
const LAST_WAIT: Duration = Duration::from_millis(500);
const STATEMENTS_KEPT: usize = 64;
/// Pages of the write-ahead log after which it is checkpointed into the file; SQLite's default.
const SHORT_LOG: i64 = 1_000;
/// The same when the disk has plenty of room. When records of many topics alternate, the same pages change in every
/// commit: the later the checkpoint, the fewer are written twice.
const LONG_LOG: i64 = 4_000;
/// How much room counts as plenty, bytes: far more than both logs and the reserve for a full disk.
const PLENTY: u64 = 1024 * 1024 * 1024;

/// One SQLite file's shape: an application id and the steps from each schema version to the next.
pub(super) struct Schema {
    /// Written into the file, so that another program's database is not mistaken for ours.
    pub application: i64,
    /// Step `i` brings version `i` to `i + 1`.
    pub steps: &'static [&'static str],
}

/// Opens (or creates) the file for its only writer.
///
/// # Errors
/// [`StoreError::Home`], [`StoreError::Mode`], [`StoreError::Corrupt`], [`StoreError::Newer`].
pub(super) fn open_writer(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    files::private_directory(directory)?;
    drop(files::open_private(path)?);
    files::sync_directory(directory).map_err(|error| StoreError::home(path, &error))?;
    let mut connection = connect(path)?;
    migrate(&mut connection, path, schema).map_err(|error| error.in_file(path))?;
    Ok(connection)
}

/// Checkpoints the log into the file when a process ends: other connections may outlive this one, and then closing
/// would leave the log beside the file. If there are readers, or the disk is full, the log stays, and whoever opens the
/// file next checkpoints it.
pub(super) fn settle(connection: &Connection) {
    drop(connection.busy_timeout(LAST_WAIT));
    drop(connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(())));
}

/// How long a file's log may get; depends on the room on its disk.
#[derive(Debug)]
pub(super) struct Checkpoints {
    directory: PathBuf,
    pages: i64,
}

impl Checkpoints {
    /// For the file at this path, opened by [`open_writer`].
    pub fn new(path: &Path) -> Self {
        Self { directory: path.parent().unwrap_or(Path::new(".")).to_owned(), pages: SHORT_LOG }
    }

    /// To be called between transactions. When the room is gone, a long log is checkpointed at once, so that it starts
    /// again from the beginning instead of growing.
    pub fn adjust(&mut self, connection: &Connection) {
        let pages = log_pages(files::free_bytes(&self.directory).unwrap_or(0));
        if pages == self.pages {
            return;
        }
        self.pages = pages;
        // If it cannot be set or written now, the log is only longer than necessary.
        drop(connection.pragma_update(None, "wal_autocheckpoint", pages));
        if pages == SHORT_LOG {
            drop(connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(())));
        }
    }
}

fn log_pages(free: u64) -> i64 {
    if free < PLENTY { SHORT_LOG } else { LONG_LOG }
}

/// Opens the file for reading only.
///
/// # Errors
/// [`StoreError::Home`], [`StoreError::Corrupt`].
pub(super) fn open_reader(path: &Path) -> Result<Connection, StoreError> {
    let connection = connect(path)?;
    connection.pragma_update(None, "query_only", true).map_err(|error| StoreError::from(error).in_file(path))?;
    Ok(connection)
}

fn connect(path: &Path) -> Result<Connection, StoreError> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    Connection::open_with_flags(path, flags)
        .and_then(|connection| {
            connection.busy_timeout(BUSY)?;
            connection.set_prepared_statement_cache_capacity(STATEMENTS_KEPT);
            connection.pragma_update(None, "journal_mode", "WAL")?;
            connection.pragma_update(None, "synchronous", "FULL")?;
            connection.pragma_update(None, "cache_size", -8192)?;
            // Otherwise savepoints of more than 64 KiB, and sorting, use files outside the home.
            connection.pragma_update(None, "temp_store", "MEMORY")?;
            Ok(connection)
        })
        .map_err(|error| StoreError::from(error).in_file(path))
}

/// Whether the file is already of the newest version: then nothing is written.
fn is_newest(connection: &Connection, schema: &Schema) -> Result<bool, StoreError> {
    let pragma = |name| connection.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let newest = i64::try_from(schema.steps.len()).unwrap_or(i64::MAX);
    Ok((pragma("user_version")?, pragma("application_id")?) == (newest, schema.application))
}

fn migrate(connection: &mut Connection, path: &Path, schema: &Schema) -> Result<(), StoreError> {
    if is_newest(connection, schema)? {
        return Ok(());
    }
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let pragma = |name| transaction.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let (found, application) = (pragma("user_version")?, pragma("application_id")?);
    let known = i64::try_from(schema.steps.len()).unwrap_or(i64::MAX);
    if application != schema.application && (application, found) != (0, 0) {
        return Err(StoreError::Corrupt { file: path.to_owned(), detail: "another program's database".to_owned() });
    }
    if found > known {
        return Err(StoreError::Newer { file: path.to_owned(), found, known });
    }
    for step in schema.steps.iter().skip(usize::try_from(found).unwrap_or(0)) {
        transaction.execute_batch(step)?;
    }
    transaction.pragma_update(None, "application_id", schema.application)?;
    transaction.pragma_update(None, "user_version", known)?;
    transaction.commit()?;
    Ok(())
}

/// SQLite's `quick_check`: pages, records and indices are well-formed.
///
/// # Errors
/// [`StoreError::Corrupt`] with the first fault.
pub(super) fn quick_check(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    let found: String = connection
        .query_row("PRAGMA quick_check(1)", [], |row| row.get(0))
        .map_err(|error| StoreError::from(error).in_file(path))?;
    if found == "ok" {
        return Ok(());
    }
    Err(StoreError::Corrupt { file: path.to_owned(), detail: crate::model::clean(&found, 200) })
}

/// A number as SQLite keeps it.
///
/// # Errors
/// [`StoreError::TooBig`] above 2^63 - 1.
pub(super) fn whole(field: &'static str, value: u64) -> Result<i64, StoreError> {
    i64::try_from(value).map_err(|_| StoreError::TooBig { field, value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ErrorKind;

    const FIRST: Schema = Schema { application: 77, steps: &["CREATE TABLE a (x INTEGER);"] };
    const SECOND: Schema =
        Schema { application: 77, steps: &["CREATE TABLE a (x INTEGER);", "ALTER TABLE a ADD COLUMN y INTEGER;"] };

    #[test]
    fn schemas_go_forward_and_never_back() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("x.db");
        let connection = open_writer(&path, &FIRST).expect("new");
        connection.execute("INSERT INTO a VALUES (1)", []).expect("row");
        drop(connection);
        let connection = open_writer(&path, &SECOND).expect("migrated");
        let row: (i64, Option<i64>) =
            connection.query_row("SELECT x, y FROM a", [], |row| Ok((row.get(0)?, row.get(1)?))).expect("row");
        assert_eq!(row, (1, None));
        drop(connection);
        assert!(matches!(open_writer(&path, &FIRST), Err(StoreError::Newer { found: 2, known: 1, .. })));
        let foreign = Schema { application: 78, steps: FIRST.steps };
        assert!(matches!(open_writer(&path, &foreign), Err(StoreError::Corrupt { .. })));
    }

    #[test]
    fn the_log_is_short_where_there_is_little_room() {
        assert_eq!([0, 8 << 20, PLENTY - 1, PLENTY].map(log_pages), [SHORT_LOG, SHORT_LOG, SHORT_LOG, LONG_LOG]);
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("x.db");
        let connection = open_writer(&path, &FIRST).expect("new");
        let number = |sql: &str| connection.query_row(sql, [], |row| row.get::<_, i64>(0)).expect("asked");
        assert_eq!(number("PRAGMA wal_autocheckpoint"), SHORT_LOG);
        let log = home.path().join("x.db-wal");
        let length = || std::fs::metadata(&log).expect("a log").len();
        connection.execute_batch("PRAGMA wal_autocheckpoint = 4000").expect("set");
        connection.execute("INSERT INTO a VALUES (1)", []).expect("row");
        let filled = length();
        // The room ran out while the log was long.
        let mut checkpoints = Checkpoints { directory: home.path().join("gone"), pages: LONG_LOG };
        checkpoints.adjust(&connection);
        assert_eq!((checkpoints.pages, number("PRAGMA wal_autocheckpoint")), (SHORT_LOG, SHORT_LOG));
        connection.execute("INSERT INTO a VALUES (2)", []).expect("row");
        assert_eq!(length(), filled, "the log began again");
        Checkpoints::new(&path).adjust(&connection);
        assert!([SHORT_LOG, LONG_LOG].contains(&number("PRAGMA wal_autocheckpoint")));
    }

    #[test]
    fn garbage_is_no_database() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("x.db");
        files::atomic_write(&path, &[7; 5000]).expect("written");
        let error = open_writer(&path, &FIRST).expect_err("garbage");
        assert_eq!(error.kind(), ErrorKind::Tampered);
        assert!(error.to_string().contains("x.db"), "{error}");
    }
}
