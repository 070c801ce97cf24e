//! SQLite files: private, WAL, every commit fsynced, checked after an unclean shutdown.

use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::config::DbConfig;
use rusqlite::functions::FunctionFlags;
use rusqlite::{Connection, OpenFlags, TransactionBehavior};

use super::{StoreError, files};
use crate::model::TopicPattern;

const BUSY: Duration = Duration::from_secs(10);
const GLANCE: Duration = Duration::from_millis(100);
const LAST_WAIT: Duration = Duration::from_millis(500);
const STATEMENTS_KEPT: usize = 64;
/// The writer's page cache; negative is KiB, as in SQLite.
const WRITERS_CACHE: i64 = -8 * 1024;
/// The same for each of several readers.
const READERS_CACHE: i64 = -2 * 1024;
/// Log pages before a checkpoint: SQLite's default.
const SHORT_LOG: i64 = 1_000;
/// With plenty of room: later checkpoints write fewer pages twice when records of many topics alternate.
const LONG_LOG: i64 = 4_000;
/// Overwrites deleted cells, not freed pages.
const CELLS: &str = "FAST";
/// Far more than both logs and the reserve.
const PLENTY: u64 = 1024 * 1024 * 1024;

const VERSION: i64 = 1;

pub(super) struct Schema {
    /// Distinguishes our files from other programs'.
    pub application: i64,
    pub text: &'static str,
}

pub(super) fn open_writer(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    files::private_directory(directory)?;
    drop(files::open_private(path)?);
    files::sync_directory(directory).map_err(|error| StoreError::home(path, &error))?;
    check_version(path, schema)?;
    let mut connection = connect(path)?;
    // Overwriting in a page that is written anyway costs nothing.
    connection.pragma_update(None, "secure_delete", CELLS).map_err(|error| StoreError::from(error).in_file(path))?;
    prepare(&mut connection, path, schema).map_err(|error| error.in_file(path))?;
    Ok(connection)
}

/// Leaves file and log of another version as they are: closing must not merge the log.
pub(super) fn check_version(path: &Path, schema: &Schema) -> Result<(), StoreError> {
    if !path.exists() {
        return Ok(());
    }
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    let log_waits = std::fs::metadata(log).is_ok_and(|log| log.len() > 0);
    let look = || -> rusqlite::Result<(i64, i64)> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags)?;
        connection.busy_timeout(BUSY)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, log_waits)?;
        identity(&connection)
    };
    look().map_or(Ok(()), |found| is_known(found, path, schema))
}

fn is_known((application, found): (i64, i64), path: &Path, schema: &Schema) -> Result<(), StoreError> {
    if application != schema.application || found == VERSION {
        return Ok(());
    }
    let file = path.to_owned();
    Err(match found > VERSION {
        true => StoreError::Newer { file, found, known: VERSION },
        false => StoreError::Corrupt { file, detail: format!("its version is {found}, which no authros writes") },
    })
}

/// Checkpoints before the end: another connection may outlive this one and leave the log. A failure waits for the next
/// opening.
pub(super) fn settle(connection: &Connection) {
    drop(connection.busy_timeout(LAST_WAIT));
    drop(connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(())));
}

/// Overwrites what `work` deletes with zeros.
pub(super) fn overwriting<T>(
    connection: &Connection,
    work: impl FnOnce() -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    connection.pragma_update(None, "secure_delete", "ON")?;
    let done = work();
    connection.pragma_update(None, "secure_delete", CELLS)?;
    done
}

/// Checkpoints and truncates the log, so that no deleted data remains there.
pub(super) fn empty_log(path: &Path) -> Result<(), StoreError> {
    let busy = || StoreError::Database {
        file: path.to_owned(),
        detail: "its log is being read, so erased data is still in it; retrying".to_owned(),
    };
    let left: i64 = connect(path)?
        .query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get(0))
        .map_err(|error| StoreError::from(error).in_file(path))?;
    if left == 0 { Ok(()) } else { Err(busy()) }
}

/// The log's length follows the room on its disk.
#[derive(Debug)]
pub(super) struct Checkpoints {
    directory: PathBuf,
    pages: i64,
}

impl Checkpoints {
    pub fn new(path: &Path) -> Self {
        Self { directory: path.parent().unwrap_or(Path::new(".")).to_owned(), pages: SHORT_LOG }
    }

    /// Call between transactions. Checkpoints a long log when the room is gone, so that it restarts.
    pub fn adjust(&mut self, connection: &Connection) {
        let pages = log_pages(files::free_bytes(&self.directory).unwrap_or(0));
        if pages == self.pages {
            return;
        }
        self.pages = pages;
        // If this fails the log is only longer.
        drop(connection.pragma_update(None, "wal_autocheckpoint", pages));
        if pages == SHORT_LOG {
            drop(connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(())));
        }
    }
}

fn log_pages(free: u64) -> i64 {
    if free < PLENTY { SHORT_LOG } else { LONG_LOG }
}

pub(super) fn open_reader(path: &Path) -> Result<Connection, StoreError> {
    let connection = connect(path)?;
    connection
        .pragma_update(None, "query_only", true)
        .and_then(|()| connection.pragma_update(None, "cache_size", READERS_CACHE))
        .map_err(|error| StoreError::from(error).in_file(path))?;
    Ok(connection)
}

/// Of an existing file that may be in use: writes nothing beside it and does not wait.
pub(super) fn open_glance(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    // Without a log nobody has it open, and SQLite would create one to read it.
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    let rest = if Path::new(&log).exists() { "" } else { "?immutable=1" };
    let uri = format!("file:{}{rest}", escaped(path));
    let open = || {
        let connection = Connection::open_with_flags(uri, flags)?;
        connection.busy_timeout(GLANCE)?;
        Ok((identity(&connection)?, connection))
    };
    let (found, connection) = open().map_err(|error: rusqlite::Error| StoreError::from(error).in_file(path))?;
    is_known(found, path, schema)?;
    Ok(connection)
}

fn escaped(path: &Path) -> String {
    use std::fmt::Write as _;
    use std::os::unix::ffi::OsStrExt as _;
    let mut text = String::new();
    for byte in path.as_os_str().as_bytes() {
        if byte.is_ascii_alphanumeric() || b"/-_.".contains(byte) {
            text.push(char::from(*byte));
        } else {
            // Writing to a string cannot fail.
            let _ = write!(text, "%{byte:02X}");
        }
    }
    text
}

fn connect(path: &Path) -> Result<Connection, StoreError> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    Connection::open_with_flags(path, flags)
        .and_then(|connection| {
            connection.busy_timeout(BUSY)?;
            // Else every new value replans statements near a partial index.
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
            connection.set_prepared_statement_cache_capacity(STATEMENTS_KEPT);
            connection.pragma_update(None, "journal_mode", "WAL")?;
            connection.pragma_update(None, "synchronous", "FULL")?;
            connection.pragma_update(None, "cache_size", WRITERS_CACHE)?;
            // Else large savepoints and sorts use files outside the home.
            connection.pragma_update(None, "temp_store", "MEMORY")?;
            add_functions(&connection)?;
            Ok(connection)
        })
        .map_err(|error| StoreError::from(error).in_file(path))
}

/// `topic_matches(pattern, name)`, as [`TopicPattern`] says; a server has it in its schema.
fn add_functions(connection: &Connection) -> rusqlite::Result<()> {
    let flags = FunctionFlags::SQLITE_UTF8 | FunctionFlags::SQLITE_DETERMINISTIC;
    connection.create_scalar_function("topic_matches", 2, flags, |context| {
        let (Some(pattern), Some(name)) = (context.get::<Option<String>>(0)?, context.get::<Option<String>>(1)?) else {
            return Ok(false);
        };
        Ok(pattern == name || pattern.parse::<TopicPattern>().is_ok_and(|pattern| pattern.matches(&name)))
    })
}

/// Both 0 in a new file.
fn identity(connection: &Connection) -> rusqlite::Result<(i64, i64)> {
    let pragma = |name| connection.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    Ok((pragma("application_id")?, pragma("user_version")?))
}

/// Writes only into new files.
fn prepare(connection: &mut Connection, path: &Path, schema: &Schema) -> Result<(), StoreError> {
    let ours = (schema.application, VERSION);
    if identity(connection)? == ours {
        return Ok(());
    }
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    match identity(&transaction)? {
        (0, 0) => {}
        found if found == ours => return Ok(()),
        _ => {
            return Err(StoreError::Corrupt { file: path.to_owned(), detail: "another program's database".to_owned() });
        }
    }
    transaction.execute_batch(schema.text)?;
    transaction.pragma_update(None, "application_id", schema.application)?;
    transaction.pragma_update(None, "user_version", VERSION)?;
    transaction.commit()?;
    Ok(())
}

pub(super) fn quick_check(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    check(connection, "PRAGMA quick_check(1)", path)
}

/// Skips one table.
pub(super) fn check_all_but(pragma: &str, connection: &Connection, table: &str, path: &Path) -> Result<(), StoreError> {
    let others = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name <> ?1 AND name NOT LIKE 'sqlite_%'";
    let mut others = connection.prepare(others)?;
    let others: Vec<String> = others.query_map([table], |row| row.get(0))?.collect::<Result<_, _>>()?;
    others.iter().try_for_each(|name| check(connection, &format!("PRAGMA {pragma}('{name}')"), path))
}

fn check(connection: &Connection, sql: &str, path: &Path) -> Result<(), StoreError> {
    let found: String =
        connection.query_row(sql, [], |row| row.get(0)).map_err(|error| StoreError::from(error).in_file(path))?;
    if found == "ok" {
        return Ok(());
    }
    Err(StoreError::Corrupt { file: path.to_owned(), detail: crate::model::clean(&found, 200) })
}

pub(super) fn whole(field: &'static str, value: u64) -> Result<i64, StoreError> {
    i64::try_from(value).map_err(|_| StoreError::TooBig { field, value })
}

/// For bounds and limits: larger values mean the largest.
pub(super) fn capped(value: impl TryInto<i64>) -> i64 {
    value.try_into().unwrap_or(i64::MAX)
}

pub(super) fn count(rows: usize) -> u64 {
    u64::try_from(rows).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ErrorKind;

    const FIRST: Schema = Schema { application: 77, text: "CREATE TABLE a (x INTEGER);" };

    #[test]
    fn another_programs_file_is_refused() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("x.db");
        open_writer(&path, &FIRST).expect("new").execute("INSERT INTO a VALUES (1)", []).expect("row");
        let again = open_writer(&path, &FIRST).expect("ours");
        assert_eq!(again.query_row("SELECT x FROM a", [], |row| row.get::<_, i64>(0)), Ok(1));
        drop(again);
        let foreign = Schema { application: 78, text: FIRST.text };
        assert!(matches!(open_writer(&path, &foreign), Err(StoreError::Corrupt { .. })));
    }

    /// Everything in a directory, byte by byte; except the index that SQLite keeps of a log.
    fn bytes_in(directory: &Path) -> Vec<(PathBuf, Vec<u8>)> {
        let entries = std::fs::read_dir(directory).expect("readable").flatten().map(|entry| entry.path());
        let mut files: Vec<_> = entries
            .filter(|path| !path.to_string_lossy().ends_with("-shm"))
            .map(|path| (path.clone(), std::fs::read(&path).expect("read")))
            .collect();
        files.sort();
        files
    }

    #[test]
    fn a_later_version_is_refused_and_neither_file_nor_log_is_touched() {
        let home = tempfile::tempdir().expect("temporary directory");
        let written = home.path().join("x.db");
        let connection = open_writer(&written, &FIRST).expect("new");
        connection.execute_batch("INSERT INTO a VALUES (1); PRAGMA user_version = 2").expect("a later version's");
        // As after a crash: all of it is in the log.
        let left = tempfile::tempdir().expect("temporary directory");
        for name in ["x.db", "x.db-wal"] {
            std::fs::copy(home.path().join(name), left.path().join(name)).expect("copied");
        }
        drop(connection);
        for place in [&left, &home] {
            let (path, before) = (place.path().join("x.db"), bytes_in(place.path()));
            for open in [open_glance, open_writer] {
                let error = open(&path, &FIRST).expect_err("a later version");
                assert!(matches!(error, StoreError::Newer { found: 2, known: 1, .. }), "{error}");
                assert!(error.to_string().contains("use a newer authros"), "{error}");
            }
            assert!(bytes_in(place.path()) == before, "something was written");
            let connection = connect(&path).expect("as it was");
            let rows: i64 = connection.query_row("SELECT count(*) FROM a", [], |row| row.get(0)).expect("rows");
            assert_eq!(rows, 1);
        }
    }

    #[test]
    fn each_number_but_the_own_version_is_refused_in_words() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("x.db");
        drop(open_writer(&path, &FIRST).expect("new"));
        for (version, kind, words) in [
            (0, ErrorKind::Tampered, "its version is 0, which no authros writes"),
            (2, ErrorKind::Input, "has schema 2, but this program supports only 1"),
            (255, ErrorKind::Input, "has schema 255, but this program supports only 1"),
        ] {
            connect(&path).expect("opens").pragma_update(None, "user_version", version).expect("another version's");
            for open in [open_glance, open_writer] {
                let error = open(&path, &FIRST).expect_err("another version");
                assert_eq!(error.kind(), kind, "{error}");
                assert!(error.to_string().contains(words), "{error}");
            }
        }
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
