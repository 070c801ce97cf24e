//! A vault's configuration, and which parts of it could lose records: reported at the start, and when a home is
//! examined.

use super::redis::RedisVault;
use crate::model::clean;
use crate::store::StoreError;

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
pub(super) struct Setup {
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
    pub(super) fn findings(&self, server: &str) -> Vec<Finding> {
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
mod tests {
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
