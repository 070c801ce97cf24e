//! Copies of SQLite files as of one moment, while others write: SQLite's online backup inside a read transaction.

use std::ffi::c_int;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::Connection;
use rusqlite::backup::Backup;

use super::{Ledger, StoreError, database, files};

pub struct Snapshot {
    path: PathBuf,
    connection: Connection,
}

impl Snapshot {
    /// The file must exist.
    pub fn begin(path: &Path) -> Result<Self, StoreError> {
        let connection = database::open_reader(path)?;
        connection
            .execute_batch("BEGIN; SELECT count(*) FROM sqlite_schema;")
            .map_err(|error| StoreError::from(error).in_file(path))?;
        Ok(Self { path: path.to_owned(), connection })
    }

    /// Runs `also` while the ledger is not written: a snapshot there of a file written first (the chain) has everything
    /// that this one names.
    pub fn of<T: Send + 'static>(
        ledger: &Ledger,
        also: impl Fn() -> Result<T, StoreError> + Send + 'static,
    ) -> Result<(Self, T), StoreError> {
        let path = ledger.path().to_owned();
        ledger.database.write(move |_| Ok((Self::begin(&path)?, also()?)))
    }

    /// To a new private file.
    pub fn copy_to(&self, file: &Path) -> Result<(), StoreError> {
        copy(&self.connection, file).map_err(|error| error.in_file(&self.path))
    }
}

/// To a new private file.
pub fn copy(from: &Connection, file: &Path) -> Result<(), StoreError> {
    drop(files::open_private(file)?);
    let mut to = Connection::open(file)?;
    Backup::new(from, &mut to)?.run_to_completion(c_int::MAX, Duration::from_millis(20), None)?;
    to.close().map_err(|(_, error)| error)?;
    files::open_private(file)?.sync_all().map_err(|error| StoreError::home(file, &error))
}

/// Refuses another version, and runs `quick_check`; returns the size in bytes.
pub fn examine(path: &Path) -> Result<u64, StoreError> {
    Ledger::check_version(path)?;
    database::quick_check(&database::open_reader(path)?, path)?;
    let about = std::fs::metadata(path).map_err(|error| StoreError::home(path, &error))?;
    Ok(about.len())
}

/// Gives a copied ledger a new recorder, so that no number is used twice, and notes how far the chain was known.
pub fn renew_ledger(path: &Path) -> Result<(), StoreError> {
    super::ledger::renew(path)
}
