//! The embedded vault: one SQLite file of content-addressed blobs, each put one fsynced commit.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rusqlite::{Connection, ErrorCode, OptionalExtension as _, params};

use super::{Usage, Vault};
use crate::StoreError;
use crate::database::Statements as _;
use crate::database::{self, Schema};
use crate::model::Digest;

const SCHEMA: Schema = Schema { application: 0x4155_5631, text: include_str!("schema.sql") };

/// A vault in a file of the home.
pub struct EmbeddedVault {
    path: PathBuf,
    writer: Mutex<Connection>,
    reader: Mutex<Connection>,
    /// Its file cannot be written.
    is_read_only: bool,
}

fn reader_of(path: &Path, is_read_only: bool) -> Result<Connection, StoreError> {
    if is_read_only { database::open_immutable(path) } else { database::open_reader(path) }
}

impl EmbeddedVault {
    /// Opens the file, or creates it.
    ///
    /// # Errors
    /// [`StoreError::Home`], [`StoreError::Mode`], [`StoreError::Corrupt`], [`StoreError::Newer`].
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let is_read_only = database::is_read_only(path);
        let writer = match is_read_only {
            // Whatever is to be written fails.
            true => database::open_immutable(path)?,
            false => database::open_writer(path, &SCHEMA)?,
        };
        let (writer, reader) = (Mutex::new(writer), Mutex::new(reader_of(path, is_read_only)?));
        Ok(Self { path: path.to_owned(), writer, reader, is_read_only })
    }

    /// Refuses the file of a later version, without touching it.
    ///
    /// # Errors
    /// [`StoreError::Newer`].
    pub fn check_version(path: &Path) -> Result<(), StoreError> {
        database::check_version(path, &SCHEMA)
    }

    fn on<T>(
        &self,
        connection: &Mutex<Connection>,
        work: impl FnOnce(&mut MutexGuard<'_, Connection>) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let mut connection = connection.lock().unwrap_or_else(PoisonError::into_inner);
        work(&mut connection).map_err(|error| error.in_file(&self.path))
    }
}

/// A blob cannot be opened that the index of this same moment names: pages of the file were altered.
fn torn(row: i64, error: rusqlite::Error) -> StoreError {
    match error.sqlite_error_code() {
        Some(ErrorCode::Unknown) => {
            let detail = format!("its index names row {row}, which is not there");
            StoreError::Corrupt { file: PathBuf::new(), detail }
        }
        _ => error.into(),
    }
}

impl Vault for EmbeddedVault {
    fn name(&self) -> &'static str {
        "embedded"
    }

    fn durable(&self) -> bool {
        true
    }

    fn put(&self, entries: &[(Digest, &[u8])]) -> Result<(), StoreError> {
        if entries.is_empty() {
            return Ok(());
        }
        self.on(&self.writer, |connection| {
            let transaction = connection.transaction()?;
            {
                let mut statement = transaction.prepare_cached(
                    "INSERT INTO blobs (digest, bytes) VALUES (?1, ?2) ON CONFLICT (digest)
                     DO UPDATE SET bytes = excluded.bytes WHERE bytes <> excluded.bytes",
                )?;
                for (digest, bytes) in entries {
                    statement.execute(params![digest.0, bytes])?;
                }
            }
            Ok(transaction.commit()?)
        })
    }

    fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError> {
        self.on(&self.reader, |connection| {
            Ok(connection.find("SELECT bytes FROM blobs WHERE digest = ?1", [digest.0], |row| row.get(0))?)
        })
    }

    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        self.on(&self.reader, |connection| {
            let page = connection.transaction()?;
            let mut statement = page.prepare_cached("SELECT bytes FROM blobs WHERE digest = ?1")?;
            digests.iter().map(|digest| Ok(statement.query_row([digest.0], |row| row.get(0)).optional()?)).collect()
        })
    }

    fn fronts(&self, digests: &[Digest], length: usize) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        self.on(&self.reader, |connection| {
            let page = connection.transaction()?;
            let mut statement = page.prepare_cached("SELECT n FROM blobs WHERE digest = ?1")?;
            let front = |digest: &Digest| {
                let found = statement.query_row([digest.0], |row| row.get(0)).optional()?;
                let Some(n) = found else { return Ok(None) };
                // Opened as a blob, so that not all pages of a long one are read.
                let blob = page.blob_open("main", "blobs", "bytes", n, true).map_err(|error| torn(n, error))?;
                let mut bytes = vec![0; length.min(blob.len())];
                blob.read_at_exact(&mut bytes, 0)?;
                Ok(Some(bytes))
            };
            digests.iter().map(front).collect()
        })
    }

    fn delete(&self, digest: Digest) -> Result<bool, StoreError> {
        self.on(&self.writer, |connection| Ok(connection.run("DELETE FROM blobs WHERE digest = ?1", [digest.0])? > 0))
    }

    fn discard(&self, digests: &[Digest]) -> Result<(), StoreError> {
        if digests.is_empty() {
            return Ok(());
        }
        self.on(&self.writer, |connection| {
            let transaction = connection.transaction()?;
            {
                let mut statement = transaction.prepare_cached("DELETE FROM blobs WHERE digest = ?1")?;
                for digest in digests {
                    statement.execute([digest.0])?;
                }
            }
            Ok(transaction.commit()?)
        })
    }

    fn scour(&self, digests: &[Digest]) -> Result<(), StoreError> {
        if digests.is_empty() {
            return Ok(());
        }
        self.on(&self.writer, |connection| {
            database::overwriting(connection, |connection| {
                let transaction = connection.unchecked_transaction()?;
                for digest in digests {
                    let mut statement = transaction.prepare_cached("DELETE FROM blobs WHERE digest = ?1")?;
                    statement.execute([digest.0])?;
                }
                Ok(transaction.commit()?)
            })
        })?;
        // Nobody reads through this vault meanwhile.
        let _still = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
        database::empty_log(&self.path)
    }

    fn close(&self) {
        database::settle(&self.writer.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn contains(&self, digest: Digest) -> Result<bool, StoreError> {
        self.on(&self.reader, |connection| Ok(connection.has("SELECT 1 FROM blobs WHERE digest = ?1", [digest.0])?))
    }

    fn usage(&self) -> Result<Usage, StoreError> {
        self.on(&self.reader, |connection| {
            let found = connection.query_row("SELECT entries, bytes FROM used", [], |row| {
                let number = |column| row.get(column).map(i64::cast_unsigned);
                Ok(Usage { entries: number(0)?, bytes: number(1)? })
            })?;
            Ok(found)
        })
    }

    fn policy_warnings(&self) -> Vec<String> {
        Vec::new()
    }

    fn dump(&self, each: &mut dyn FnMut(Digest, &[u8])) -> Result<(), StoreError> {
        let connection = reader_of(&self.path, self.is_read_only)?;
        let mut show = || -> Result<(), StoreError> {
            let mut statement = connection.prepare("SELECT digest, bytes FROM blobs ORDER BY n")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let bytes = row.get_ref(1)?.as_blob().map_err(rusqlite::Error::from)?;
                each(Digest(row.get(0)?), bytes);
            }
            Ok(())
        };
        show().map_err(|error| error.in_file(&self.path))
    }

    fn replace(&self, digest: Digest, bytes: &[u8]) -> Result<bool, StoreError> {
        self.on(&self.writer, |connection| {
            Ok(connection.run("UPDATE blobs SET bytes = ?2 WHERE digest = ?1", params![digest.0, bytes])? > 0)
        })
    }
}
