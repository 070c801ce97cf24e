//! Ciphertext, committed with its row and addressed by digest. Readers must check it.

use std::sync::Arc;

use crate::cache::{Cache, CacheSettings, CacheState};
use crate::database;
use crate::ledger::Database;
use crate::model::Digest;
use crate::sql::Connection;
use crate::{Ledger, StoreError};

const GET: &str = "SELECT bytes FROM ciphertext WHERE record = (SELECT n FROM records WHERE digest = ?1)";
const DELETE: &str = "DELETE FROM ciphertext WHERE record = (SELECT n FROM records WHERE digest = ?1)";

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Usage {
    pub entries: u64,
    pub bytes: u64,
}

/// Clones share the cache.
#[derive(Clone)]
pub struct Ciphertext {
    database: Database,
    cache: Option<Arc<Cache>>,
}

impl Ciphertext {
    pub fn of(ledger: &Ledger) -> Self {
        Self { database: ledger.database.clone(), cache: None }
    }

    /// Does not wait for the cache.
    pub fn cached(ledger: &Ledger, settings: &CacheSettings) -> Result<Self, StoreError> {
        let store = Self::of(ledger);
        let cache = Cache::begin(settings, store.clone())?;
        Ok(Self { cache: Some(Arc::new(cache)), ..store })
    }

    pub fn is_cached(&self) -> bool {
        self.cache.is_some()
    }

    /// May have been altered: check it.
    pub fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError> {
        self.database.find(GET, [digest.0], |row| row.get(0))
    }

    pub fn get_many(&self, digests: &[Digest]) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        self.database.read(|connection| {
            let mut statement = connection.prepared(GET)?;
            digests.iter().map(|digest| Ok(statement.find([digest.0], |row| row.get(0))?)).collect()
        })
    }

    /// At most `length` bytes of each, in order: enough to read headers cheaply.
    pub fn fronts(&self, digests: &[Digest], length: usize) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        self.database.read(|connection| digests.iter().map(|digest| front(connection, *digest, length)).collect())
    }

    /// For opening and serving; a proof of what is on the disk needs [`Self::get`].
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

    /// Offers committed records to the cache.
    pub fn written(&self, digests: impl IntoIterator<Item = Digest>) {
        if let Some(cache) = &self.cache {
            cache.fill(digests);
        }
    }

    pub fn discard(&self, digests: &[Digest]) -> Result<(), StoreError> {
        if digests.is_empty() {
            return Ok(());
        }
        let all = digests.to_vec();
        self.database.write_many(all.len(), move |session| delete(session.connection, &all))?;
        self.forget(digests);
        Ok(())
    }

    /// Overwrites the bytes in the file and its log. Fails while anyone reads an earlier state: try again.
    pub fn scour(&self, digests: &[Digest]) -> Result<(), StoreError> {
        if digests.is_empty() {
            return Ok(());
        }
        let all = digests.to_vec();
        self.database.write_many(all.len(), move |session| match session.connection.file() {
            Some(file) => database::overwriting(file, || delete(session.connection, &all)),
            // What a server keeps of it is its operator's to end: dead rows, its log, standbys, archives.
            None => delete(session.connection, &all),
        })?;
        self.forget(digests);
        // Also when nothing was left to delete: an earlier attempt may have failed at the log.
        self.database.file().map_or(Ok(()), database::empty_log)
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

fn front(connection: &Connection, digest: Digest, length: usize) -> Result<Option<Vec<u8>>, StoreError> {
    let sql = "SELECT record FROM ciphertext WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    let Some(n) = connection.find(sql, [digest.0], |row| row.get(0))? else { return Ok(None) };
    Ok(Some(connection.front(n, length)?))
}
