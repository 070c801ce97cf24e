//! The vault: where ciphertext lies, addressed by its digest.
//!
//! Embedded (one SQLite file) or Redis. The vault trusts nobody and checks nothing: whoever reads
//! compares SM3 of the bytes with the chain.

mod embedded;
pub mod policy;
mod redis;
#[cfg(test)]
mod tests;

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::StoreError;
use crate::model::Digest;

pub use embedded::EmbeddedVault;
pub use redis::RedisVault;

/// How much a vault holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Usage {
    /// Number of records.
    pub entries: u64,
    /// Their stored bytes.
    pub bytes: u64,
}

/// What of some records a vault took.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Stored {
    /// Those that are in.
    pub stored: Vec<Digest>,
    /// Why others are not.
    pub failure: Option<StoreError>,
}

/// A place for sealed records. All calls are idempotent and may come from many threads at once.
pub trait Vault: Send + Sync {
    /// What to call it on screen; no secrets in it.
    fn name(&self) -> &str;

    /// Whether [`Vault::put`] returns only when the bytes survive a loss of power.
    fn durable(&self) -> bool;

    /// Puts records in; bytes that are there under the same digest are replaced.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::VaultFull`], [`StoreError::Unreachable`] and the like:
    /// then some may be in and some not; put all of them again.
    fn put(&self, entries: &[(Digest, &[u8])]) -> Result<(), StoreError>;

    /// Puts in what can be put in now, where parts of the vault may be gone and others not.
    fn put_each(&self, entries: &[(Digest, &[u8])]) -> Stored {
        match self.put(entries) {
            Ok(()) => Stored { stored: entries.iter().map(|(digest, _)| *digest).collect(), failure: None },
            Err(error) => Stored { stored: Vec::new(), failure: Some(error) },
        }
    }

    /// Whether the part of the vault where a record lies answered when it was last asked; asks nobody.
    fn answers(&self, _digest: Digest) -> bool {
        true
    }

    /// The bytes under a digest. They are what was put in or what somebody made of it: check them.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`], [`StoreError::Corrupt`] and the like.
    fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError>;

    /// The bytes under several digests, in their order; where the vault can, in one go.
    ///
    /// # Errors
    /// As [`Vault::get`].
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        digests.iter().map(|digest| self.get(*digest)).collect()
    }

    /// The first `length` bytes, at most, under several digests, in their order: what a look at a header costs.
    ///
    /// # Errors
    /// As [`Vault::get`].
    fn fronts(&self, digests: &[Digest], length: usize) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        let mut found = self.get_many(digests)?;
        found.iter_mut().flatten().for_each(|bytes| bytes.truncate(length));
        Ok(found)
    }

    /// Takes a record out; whether it was there.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn delete(&self, digest: Digest) -> Result<bool, StoreError>;

    /// Takes many records out.
    ///
    /// # Errors
    /// As [`Vault::delete`]: then some may be out and some not.
    fn discard(&self, digests: &[Digest]) -> Result<(), StoreError> {
        digests.iter().try_for_each(|digest| self.delete(*digest).map(|_| ()))
    }

    /// The process ends: what waits beside a file goes into it, so that the next one finds it at rest.
    fn close(&self) {}

    /// Whether something is stored under a digest.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn contains(&self, digest: Digest) -> Result<bool, StoreError>;

    /// Whether something is stored under each of several digests, in their order; where the vault can, in one go.
    ///
    /// # Errors
    /// As [`Vault::contains`].
    fn contains_many(&self, digests: &[Digest]) -> Result<Vec<bool>, StoreError> {
        digests.iter().map(|digest| self.contains(*digest)).collect()
    }

    /// How much it holds. Redis has to walk all its keys for this.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn usage(&self) -> Result<Usage, StoreError>;

    /// What the operator should know about how this vault is set up.
    fn policy_warnings(&self) -> Vec<String>;

    /// Shows every record to `each`, for audits and tests.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like: then `each` has seen only some.
    fn dump(&self, each: &mut dyn FnMut(Digest, &[u8])) -> Result<(), StoreError>;

    /// Plays the attacker, for the demo and tests: overwrites what is stored under a digest by any bytes;
    /// whether something was there to overwrite. Nothing else may call this.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn replace(&self, digest: Digest, bytes: &[u8]) -> Result<bool, StoreError>;

    /// Names what its servers hold now (their runs, what they threw away, a mark that a FLUSHALL takes along): where it
    /// is another text than before, what was held may be lost. Always the same for a vault that is durable by itself.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`], [`StoreError::Policy`], [`StoreError::VaultFull`] and the like.
    fn runs(&self) -> Result<String, StoreError> {
        Ok(String::new())
    }

    /// Why a part of it is not reached, as it was when it was last tried; asks nobody.
    fn ailing(&self) -> Option<StoreError> {
        None
    }

    /// Whether it answers as a whole or not at all.
    fn is_one(&self) -> bool {
        true
    }
}

/// Refuses an embedded vault (`vault.db` in `directory`) that a later version has written, without touching it.
///
/// # Errors
/// [`StoreError::Newer`].
pub fn check_version(directory: &Path) -> Result<(), StoreError> {
    EmbeddedVault::check_version(&directory.join("vault.db"))
}

/// Opens the vault at `url`, or the embedded one (`vault.db` in `directory`) where there is no URL.
///
/// # Errors
/// [`StoreError::VaultUrl`], [`StoreError::Unreachable`], [`StoreError::Policy`] for Redis;
/// [`StoreError::Home`], [`StoreError::Mode`], [`StoreError::Corrupt`] for the embedded one.
pub fn open_vault(url: Option<&str>, directory: &Path) -> Result<Arc<dyn Vault>, StoreError> {
    match url {
        Some(url) => Ok(Arc::new(RedisVault::open(url)?)),
        None => Ok(Arc::new(EmbeddedVault::open(&directory.join("vault.db"))?)),
    }
}
