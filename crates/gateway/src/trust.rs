//! A client's pinned gateway and the highest system-key list seen, in a file: a restart accepts no other and none
//! older.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::crypto::private_file::{change_private, read_private};
use crate::hello::{Agreed, ListSummary};
use crate::model::{Digest, SignerId};
use crate::{crypto::CryptoError, crypto::error::shown, error::GatewayError};

const LONGEST: usize = 4096;

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Trust {
    /// SM3 of the identity key.
    pub pinned: Option<SignerId>,
    /// Pin the first gateway that answers; only at the user's explicit request.
    pub first_use: bool,
    pub seen: Option<ListSummary>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    gateway: SignerId,
    list_version: u64,
    list_digest: Digest,
}

impl File {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, CryptoError> {
        serde_json::from_slice(bytes).map_err(|_| CryptoError::NotAKey {
            path: shown(path),
            wanted: "a note of a gateway",
            found: "it is damaged; confirm the gateway's fingerprint and pin it again".to_owned(),
        })
    }
}

impl Trust {
    pub fn pinned(gateway: SignerId) -> Self {
        Self { pinned: Some(gateway), ..Self::default() }
    }

    pub fn on_first_use() -> Self {
        Self { first_use: true, ..Self::default() }
    }

    pub fn load(path: &Path) -> Result<Self, CryptoError> {
        let bytes = read_private(path, LONGEST)?;
        let file = File::parse(path, &bytes)?;
        let seen = ListSummary { version: file.list_version, digest: file.list_digest };
        Ok(Self { pinned: Some(file.gateway), first_use: false, seen: Some(seen) })
    }

    /// Writes nothing before a gateway was met; keeps a newer list that another connection has seen.
    pub fn save(&self, path: &Path) -> Result<(), CryptoError> {
        let (Some(gateway), Some(seen)) = (self.pinned, self.seen) else { return Ok(()) };
        let file = File { gateway, list_version: seen.version, list_digest: seen.digest };
        let text = serde_json::to_vec_pretty(&file).map_err(|_| CryptoError::Internal("JSON"))?;
        change_private(path, LONGEST, |there| {
            let there = there.map(|there| File::parse(path, there)).transpose()?;
            let known = there.filter(|there| there.gateway == gateway && there.list_version >= seen.version);
            Ok(known.is_none().then_some(text))
        })
    }

    /// Checks a gateway that has proven its identity key, and remembers it if it passes.
    pub fn judge(&mut self, agreed: &Agreed) -> Result<(), GatewayError> {
        match self.pinned {
            Some(pinned) if pinned != agreed.gateway => {
                return Err(GatewayError::NotTheGateway { pinned, found: agreed.gateway });
            }
            None if !self.first_use => return Err(GatewayError::NotPinned(agreed.gateway)),
            _ => {}
        }
        if let Some(seen) = self.seen {
            if agreed.list.version < seen.version {
                return Err(GatewayError::RolledBack { seen: seen.version, found: agreed.list.version });
            }
            if agreed.list.version == seen.version && agreed.list.digest != seen.digest {
                return Err(GatewayError::TwoLists(seen.version));
            }
        }
        self.pinned = Some(agreed.gateway);
        self.seen = Some(agreed.list);
        Ok(())
    }
}

/// Shared by all connections to one gateway.
#[derive(Debug)]
pub struct KeptTrust {
    path: PathBuf,
    trust: Mutex<Trust>,
}

impl KeptTrust {
    /// Reads the file, or starts from the request. [`GatewayError::NotTheGateway`] if the file pins another gateway.
    pub fn open(path: PathBuf, pinned: Option<SignerId>, first_use: bool) -> Result<Self, GatewayError> {
        let trust = match path.exists() {
            false => Trust { pinned, first_use: first_use && pinned.is_none(), seen: None },
            true => Trust::load(&path)?,
        };
        match (trust.pinned, pinned) {
            (Some(found), Some(pinned)) if found != pinned => Err(GatewayError::NotTheGateway { pinned, found }),
            _ => Ok(Self { path, trust: Mutex::new(trust) }),
        }
    }

    pub fn current(&self) -> Trust {
        self.trust.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Also writes the file.
    pub fn learn(&self, learnt: &Trust) -> Result<(), GatewayError> {
        let mut trust = self.trust.lock().unwrap_or_else(PoisonError::into_inner);
        if let (Some(pinned), Some(found)) = (trust.pinned, learnt.pinned)
            && pinned != found
        {
            return Err(GatewayError::NotTheGateway { pinned, found });
        }
        let version = |trust: &Trust| trust.seen.map_or(0, |seen| seen.version);
        let first = trust.pinned.is_none() || trust.seen.is_none();
        if first || version(learnt) > version(&trust) {
            *trust = Trust { first_use: false, ..learnt.clone() };
            trust.save(&self.path)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::private_file::write_private;
    use crate::gateway::session::SessionId;
    use crate::model::PublicKey;

    fn agreed(gateway: u8, version: u64, digest: u8) -> Agreed {
        Agreed {
            gateway: SignerId([gateway; 32]),
            gateway_key: PublicKey([0; 64]),
            client_nonce: [0; 32],
            gateway_nonce: [0; 32],
            session: SessionId([0; 16]),
            list: ListSummary { version, digest: Digest([digest; 32]) },
        }
    }

    #[test]
    fn only_the_pinned_gateway_and_never_an_older_list() {
        let mut trust = Trust::default();
        assert!(matches!(trust.judge(&agreed(1, 5, 5)), Err(GatewayError::NotPinned(_))));
        let mut trust = Trust::on_first_use();
        trust.judge(&agreed(1, 5, 5)).expect("first use");
        trust.judge(&agreed(1, 5, 5)).expect("the same again");
        assert!(matches!(trust.judge(&agreed(2, 9, 9)), Err(GatewayError::NotTheGateway { .. })));
        assert!(matches!(trust.judge(&agreed(1, 4, 4)), Err(GatewayError::RolledBack { seen: 5, found: 4 })));
        assert!(matches!(trust.judge(&agreed(1, 5, 6)), Err(GatewayError::TwoLists(5))));
        trust.judge(&agreed(1, 6, 6)).expect("a newer list");
        assert_eq!(trust.seen.map(|seen| seen.version), Some(6));
    }

    #[test]
    fn what_was_seen_survives_a_restart() {
        let home = tempfile::tempdir().expect("directory");
        let path = home.path().join("gateway.json");
        let mut trust = Trust::on_first_use();
        trust.save(&path).expect("nothing to write");
        assert!(!path.exists());
        trust.judge(&agreed(1, 5, 5)).expect("first use");
        trust.save(&path).expect("writes");
        let mut again = Trust::load(&path).expect("reads");
        assert!(!again.first_use, "first use is over");
        assert!(matches!(again.judge(&agreed(2, 5, 5)), Err(GatewayError::NotTheGateway { .. })));
        assert!(matches!(again.judge(&agreed(1, 4, 5)), Err(GatewayError::RolledBack { .. })));
        let newer =
            Trust { seen: trust.seen.map(|seen| ListSummary { version: seen.version + 1, ..seen }), ..trust.clone() };
        newer.save(&path).expect("writes");
        trust.save(&path).expect("keeps what another connection has seen");
        assert_eq!(Trust::load(&path).expect("reads").seen, newer.seen);
        write_private(&path, b"{}").expect("writes");
        assert!(Trust::load(&path).is_err());
        let refused = newer.save(&path).expect_err("what a damaged note knew is not known");
        assert!(refused.to_string().contains("pin it again"), "{refused}");
    }

    #[test]
    fn connections_share_what_they_learn() {
        let home = tempfile::tempdir().expect("directory");
        let path = home.path().join("gateway.json");
        let open = |pinned, first_use| KeptTrust::open(path.clone(), pinned, first_use);
        let kept = open(None, true).expect("opens");
        let (mut one, mut two) = (kept.current(), kept.current());
        one.judge(&agreed(1, 5, 5)).expect("first use");
        two.judge(&agreed(2, 5, 5)).expect("first use, of another one");
        kept.learn(&one).expect("the first counts");
        assert!(matches!(kept.learn(&two), Err(GatewayError::NotTheGateway { .. })));
        let mut newer = kept.current();
        newer.judge(&agreed(1, 7, 7)).expect("newer");
        kept.learn(&newer).expect("learns");
        kept.learn(&one).expect("older news change nothing");
        assert_eq!(kept.current().seen.map(|seen| seen.version), Some(7));
        let again = open(None, false).expect("opens").current();
        assert_eq!((again.pinned, again.first_use), (Some(SignerId([1; 32])), false));
        assert!(open(Some(SignerId([1; 32])), false).is_ok());
        assert!(matches!(open(Some(SignerId([2; 32])), false), Err(GatewayError::NotTheGateway { .. })));
    }
}
