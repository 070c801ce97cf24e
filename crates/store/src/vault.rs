//! The vault: stores ciphertext, addressed by its digest.
//!
//! Embedded (one SQLite file) or Redis. The vault trusts nobody and checks nothing: readers compare SM3 of the bytes
//! with the chain.

mod embedded;
mod redis;
#[cfg(test)]
mod tests;

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

pub use self::embedded::EmbeddedVault;
pub use self::redis::RedisVault;

use crate::StoreError;
use crate::model::{Digest, clean};

/// How much a vault holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Usage {
    /// Number of records.
    pub entries: u64,
    /// Their stored bytes.
    pub bytes: u64,
}

/// Which of some records a vault accepted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Stored {
    /// Those stored.
    pub stored: Vec<Digest>,
    /// Why others were not.
    pub failure: Option<StoreError>,
}

/// A place for sealed records. All calls are idempotent and may come from many threads at once.
pub trait Vault: Send + Sync {
    /// Its name on screen, without secrets.
    fn name(&self) -> &str;

    /// Whether [`Vault::put`] returns only when the bytes would survive a loss of power.
    fn durable(&self) -> bool;

    /// Stores records; existing bytes under the same digest are replaced.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::VaultFull`], [`StoreError::Unreachable`] and the like; then some may be
    /// stored and some not: put all of them again.
    fn put(&self, entries: &[(Digest, &[u8])]) -> Result<(), StoreError>;

    /// Stores what can be stored now, if parts of the vault may be down and others not.
    fn put_each(&self, entries: &[(Digest, &[u8])]) -> Stored {
        match self.put(entries) {
            Ok(()) => Stored { stored: entries.iter().map(|(digest, _)| *digest).collect(), failure: None },
            Err(error) => Stored { stored: Vec::new(), failure: Some(error) },
        }
    }

    /// Whether the part of the vault that holds a record answered the last time; sends no request.
    fn answers(&self, _digest: Digest) -> bool {
        true
    }

    /// The bytes under a digest. They may have been altered since they were stored: check them.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`], [`StoreError::Corrupt`] and the like.
    fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError>;

    /// The bytes under several digests, in order; in one request if the vault can.
    ///
    /// # Errors
    /// See [`Vault::get`].
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        digests.iter().map(|digest| self.get(*digest)).collect()
    }

    /// The first `length` bytes, at most, under several digests, in order: enough to read headers cheaply.
    ///
    /// # Errors
    /// See [`Vault::get`].
    fn fronts(&self, digests: &[Digest], length: usize) -> Result<Vec<Option<Vec<u8>>>, StoreError> {
        let mut found = self.get_many(digests)?;
        found.iter_mut().flatten().for_each(|bytes| bytes.truncate(length));
        Ok(found)
    }

    /// Deletes a record; returns whether it was there.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn delete(&self, digest: Digest) -> Result<bool, StoreError>;

    /// Deletes several records.
    ///
    /// # Errors
    /// See [`Vault::delete`]; then some may be deleted and some not.
    fn discard(&self, digests: &[Digest]) -> Result<(), StoreError> {
        digests.iter().try_for_each(|digest| self.delete(*digest).map(|_| ()))
    }

    /// Deletes several records so that their bytes are overwritten as far as this program reaches: a server may have
    /// them in its own files for a while.
    ///
    /// # Errors
    /// See [`Vault::delete`]; then it is to be done again.
    fn scour(&self, digests: &[Digest]) -> Result<(), StoreError> {
        self.discard(digests)
    }

    /// The process is ending: what waits beside a file is written into it, so that the next process finds it at rest.
    fn close(&self) {}

    /// Whether something is stored under a digest.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn contains(&self, digest: Digest) -> Result<bool, StoreError>;

    /// Whether something is stored under each of several digests, in order; in one request if the vault can.
    ///
    /// # Errors
    /// See [`Vault::contains`].
    fn contains_many(&self, digests: &[Digest]) -> Result<Vec<bool>, StoreError> {
        digests.iter().map(|digest| self.contains(*digest)).collect()
    }

    /// How much it holds. Redis has to walk all its keys for this.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn usage(&self) -> Result<Usage, StoreError>;

    /// What the operator should know about this vault's configuration.
    fn policy_warnings(&self) -> Vec<String>;

    /// Passes every record to `each`, for audits and tests.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like; then `each` has seen only some.
    fn dump(&self, each: &mut dyn FnMut(Digest, &[u8])) -> Result<(), StoreError>;

    /// Plays the attacker, for the demo and tests: overwrites the bytes under a digest; returns whether there was
    /// anything to overwrite. Nothing else may call this.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`] and the like.
    fn replace(&self, digest: Digest, bytes: &[u8]) -> Result<bool, StoreError>;

    /// Identifies the current contents of its servers (their runs, their evictions, a mark that a FLUSHALL deletes): if
    /// the text changes, records may have been lost. Constant for a vault that is durable by itself.
    ///
    /// # Errors
    /// [`StoreError::Unreachable`], [`StoreError::Policy`], [`StoreError::VaultFull`] and the like.
    fn runs(&self) -> Result<String, StoreError> {
        Ok(String::new())
    }

    /// Why a part of it was not reachable the last time; sends no request.
    fn ailing(&self) -> Option<StoreError> {
        None
    }

    /// Whether it answers as a whole or not at all.
    fn is_one(&self) -> bool {
        true
    }
}

/// Refuses an embedded vault (`vault.db` in `directory`) written by a later version, without touching it.
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

// A vault's configuration, and which parts of it could lose records: reported at the start, and when a home is
// examined.

/// The severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Gravity {
    /// The vault is used; it can lose records, which are restored from their local copies.
    Warning,
    /// The vault is refused: it would evict records while it runs.
    Refused,
}

/// One thing that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Its severity.
    pub gravity: Gravity,
    /// The server, without secrets.
    pub server: String,
    /// The finding, as a sentence without the server's name in front: "keeps no append-only file …".
    pub text: String,
    /// What to do about it.
    pub advice: String,
}

impl Finding {
    /// Finding and advice in one line.
    pub fn line(&self) -> String {
        format!("Redis at {} {}; {}", self.server, self.text, self.advice)
    }
}

/// Examines the present configuration of the vault at `url`; the embedded one has no findings.
///
/// # Errors
/// [`StoreError::VaultUrl`], [`StoreError::Unreachable`], [`StoreError::VaultRefused`].
pub fn examine(url: Option<&str>) -> Result<Vec<Finding>, StoreError> {
    url.map_or_else(|| Ok(Vec::new()), RedisVault::examine)
}

/// What one server reports about itself; `None` if it does not say.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
struct Setup {
    /// `maxmemory-policy`.
    pub eviction: Option<String>,
    /// `appendonly`.
    pub appends: Option<String>,
    /// `appendfsync`.
    pub syncs: Option<String>,
    /// `cluster-require-full-coverage`, in a cluster only.
    pub coverage: Option<String>,
}

impl Setup {
    /// Its problems.
    fn findings(&self, server: &str) -> Vec<Finding> {
        let found = |gravity, text: &str, advice: &str| Finding {
            gravity,
            server: server.to_owned(),
            text: text.to_owned(),
            advice: advice.to_owned(),
        };
        let mut findings = Vec::new();
        match self.eviction.as_deref() {
            Some("noeviction") => {}
            Some(policy) => findings.push(found(
                Gravity::Refused,
                &format!("has maxmemory-policy {} and would evict records", clean(policy, 40)),
                "run `CONFIG SET maxmemory-policy noeviction` and set it in redis.conf",
            )),
            None => findings.push(found(
                Gravity::Warning,
                "does not show its configuration",
                "make sure that maxmemory-policy is noeviction and appendonly is yes",
            )),
        }
        if self.appends.as_deref() == Some("no") {
            findings.push(found(
                Gravity::Warning,
                "has no append-only file, so it loses what it stored if it is killed",
                "run `CONFIG SET appendonly yes` and set it in redis.conf",
            ));
        } else if self.syncs.as_deref() == Some("no") {
            findings.push(found(
                Gravity::Warning,
                "lets the operating system decide when its append-only file is written to disk",
                "run `CONFIG SET appendfsync everysec` and set it in redis.conf",
            ));
        }
        if self.coverage.as_deref() == Some("yes") {
            findings.push(found(
                Gravity::Warning,
                "stops the whole cluster when one node fails",
                "run `CONFIG SET cluster-require-full-coverage no` on every node and set it in redis.conf",
            ));
        }
        findings
    }
}

#[cfg(test)]
mod policy_tests {
    use super::*;

    #[test]
    fn every_policy_but_noeviction_is_refused_and_all_is_said_with_a_way_out() {
        let setup = |eviction: Option<&str>, appends: &str, syncs: &str| Setup {
            eviction: eviction.map(str::to_owned),
            appends: Some(appends.to_owned()),
            syncs: Some(syncs.to_owned()),
            coverage: None,
        };
        assert_eq!(setup(Some("noeviction"), "yes", "everysec").findings("r"), Vec::new());
        for policy in ["allkeys-lru", "allkeys-lfu", "allkeys-random", "volatile-lru", "volatile-ttl", "\u{1b}[2J"] {
            let findings = setup(Some(policy), "yes", "always").findings("r");
            assert_eq!(findings.iter().map(|one| one.gravity).collect::<Vec<_>>(), [Gravity::Refused], "{policy}");
            assert!(findings[0].line().contains("CONFIG SET maxmemory-policy noeviction"));
            assert!(!findings[0].line().contains('\u{1b}'));
        }
        let warned = |setup: Setup| setup.findings("r").iter().map(Finding::line).collect::<String>();
        assert!(warned(setup(Some("noeviction"), "no", "everysec")).contains("CONFIG SET appendonly yes"));
        assert!(warned(setup(Some("noeviction"), "yes", "no")).contains("appendfsync everysec"));
        assert!(warned(Setup::default()).contains("does not show"));
        let covered = Setup { coverage: Some("yes".to_owned()), ..setup(Some("noeviction"), "yes", "always") };
        assert!(warned(covered).contains("cluster-require-full-coverage no"));
    }
}
