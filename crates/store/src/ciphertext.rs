//! Ciphertext of a home: in the file of the rows, and written in the commit of its row. It is addressed by digest, and
//! checked when it is read: nothing here says that bytes are what was anchored.

use std::path::PathBuf;
use std::sync::Arc;

use rusqlite::{Connection, ErrorCode, OptionalExtension as _};

use crate::cache::{Cache, CacheSettings, CacheState};
use crate::database::{self, Statements as _};
use crate::ledger::Database;
use crate::model::Digest;
use crate::{Ledger, StoreError};

const GET: &str = "SELECT bytes FROM ciphertext WHERE record = (SELECT n FROM records WHERE digest = ?1)";
const DELETE: &str = "DELETE FROM ciphertext WHERE record = (SELECT n FROM records WHERE digest = ?1)";

/// How much ciphertext there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Usage {
    pub entries: u64,
    pub bytes: u64,
}

/// The ciphertext of a home, and the cache in front of it, if there is one. Clones share both.
#[derive(Clone)]
pub struct Ciphertext {
    database: Database,
    cache: Option<Arc<Cache>>,
}

impl Ciphertext {
    /// That of a ledger, with no cache in front of it.
    pub fn of(ledger: &Ledger) -> Self {
        Self { database: ledger.database.clone(), cache: None }
    }

    /// That of a ledger, with a cache in front of it, which is not waited for.
    pub fn cached(ledger: &Ledger, settings: &CacheSettings) -> Result<Self, StoreError> {
        let store = Self::of(ledger);
        let cache = Cache::begin(settings, store.clone())?;
        Ok(Self { cache: Some(Arc::new(cache)), ..store })
    }

    /// Whether a cache is in front of it.
    pub fn is_cached(&self) -> bool {
        self.cache.is_some()
    }

    /// The stored bytes under a digest. They may have been altered since: check them.
    pub fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError> {
        self.database.find(GET, [digest.0], |row| row.get(0))
    }

    /// The stored bytes under several digests, in order.
    pub fn get_many(&self, digests: &[Digest]) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        self.database.read(|connection| {
            let mut statement = connection.prepare_cached(GET)?;
            digests.iter().map(|digest| Ok(statement.query_row([digest.0], |row| row.get(0)).optional()?)).collect()
        })
    }

    /// The first `length` bytes, at most, under several digests, in order: enough to read headers cheaply.
    pub fn fronts(&self, digests: &[Digest], length: usize) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        self.database.read(|connection| digests.iter().map(|digest| front(connection, *digest, length)).collect())
    }

    /// The bytes under a digest for a reader: from the cache where it has them right, and from the store otherwise. For
    /// opening and serving alone; a proof of what lies on the disk needs [`Self::get`].
    pub fn through_cache(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(cache) = &self.cache else { return self.get(digest) };
        if let Some(bytes) = cache.get(digest) {
            return Ok(Some(bytes));
        }
        let found = self.get(digest)?;
        if found.is_some() {
            cache.fill([digest]);
        }
        Ok(found)
    }

    /// Offers to the cache what was committed just now.
    pub fn written(&self, digests: impl IntoIterator<Item = Digest>) {
        if let Some(cache) = &self.cache {
            cache.fill(digests);
        }
    }

    /// Deletes the bytes of these records, in the cache too.
    pub fn discard(&self, digests: &[Digest]) -> Result<(), StoreError> {
        if digests.is_empty() {
            return Ok(());
        }
        let all = digests.to_vec();
        self.database.write_many(all.len(), move |session| delete(session.connection, &all))?;
        self.forget(digests);
        Ok(())
    }

    /// Overwrites the bytes of these records, in the file and in its log, and deletes them in the cache.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; [`StoreError::Database`] while somebody reads an earlier state. It is to be
    /// done again then.
    pub fn scour(&self, digests: &[Digest]) -> Result<(), StoreError> {
        if digests.is_empty() {
            return Ok(());
        }
        let all = digests.to_vec();
        self.database.write_many(all.len(), move |session| {
            database::overwriting(session.connection, |connection| delete(connection, &all))
        })?;
        self.forget(digests);
        // Also when nothing was left to delete: an earlier attempt may have failed at the log.
        database::empty_log(self.database.path())
    }

    fn forget(&self, digests: &[Digest]) {
        if let Some(cache) = &self.cache {
            cache.forget(digests);
        }
    }

    /// How much ciphertext there is; reads through all of it.
    pub fn usage(&self) -> Result<Usage, StoreError> {
        let sql = "SELECT count(*), coalesce(sum(length(bytes)), 0) FROM ciphertext";
        self.database.one(sql, [], |row| {
            let number = |column| row.get(column).map(i64::cast_unsigned);
            Ok(Usage { entries: number(0)?, bytes: number(1)? })
        })
    }

    /// How the cache does, if there is one; asks it nothing.
    pub fn cache(&self) -> Option<CacheState> {
        self.cache.as_ref().map(|cache| cache.state())
    }

    /// The process is ending: what was deleted is deleted in the cache, if it answers.
    pub fn close(&self) {
        if let Some(cache) = &self.cache {
            cache.close();
        }
    }

    /// Plays the attacker, for the demo and tests: overwrites the bytes under a digest; returns whether there was
    /// anything to overwrite. Nothing else may call this.
    pub fn replace(&self, digest: Digest, bytes: &[u8]) -> Result<bool, StoreError> {
        let bytes = bytes.to_vec();
        let sql = "UPDATE ciphertext SET bytes = ?2 WHERE record = (SELECT n FROM records WHERE digest = ?1)";
        Ok(self.database.changed(sql, (digest.0, bytes))? > 0)
    }
}

fn delete(connection: &Connection, digests: &[Digest]) -> Result<(), StoreError> {
    connection.run_each(DELETE, digests.iter().map(|digest| [digest.0]))?;
    Ok(())
}

/// Opened as a blob, so that not all pages of a long one are read.
fn front(connection: &Connection, digest: Digest, length: usize) -> Result<Option<Vec<u8>>, StoreError> {
    let sql = "SELECT record FROM ciphertext WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    let Some(n) = connection.find(sql, [digest.0], |row| row.get(0))? else { return Ok(None) };
    let blob = connection.blob_open("main", "ciphertext", "bytes", n, true).map_err(|error| torn(n, error))?;
    let mut bytes = vec![0; length.min(blob.len())];
    blob.read_at_exact(&mut bytes, 0)?;
    Ok(Some(bytes))
}

/// A blob cannot be opened that was found in this same moment: pages of the file were altered.
fn torn(row: i64, error: rusqlite::Error) -> StoreError {
    match error.sqlite_error_code() {
        Some(ErrorCode::Unknown) => {
            let detail = format!("its index names row {row}, which is not there");
            StoreError::Corrupt { file: PathBuf::new(), detail }
        }
        _ => error.into(),
    }
}
