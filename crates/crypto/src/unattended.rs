//! The credential of unattended capture: a lent signing pair, the keys of its topics, the key that opens its owner's
//! notices, and the account that anchors. It never holds d_C, d_E, K_C, IK or the owner's EOA key. The file is 0600 and
//! not encrypted: `systemd-creds` encrypts it.

use std::path::Path;

use subtle::ConstantTimeEq as _;
use zeroize::Zeroizing;

use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Domain, PublicKey, SignerId, Timestamp, Token, TopicId};

use super::error::shown;
use super::private_file::read_private;
use super::sm3::sm3;
use super::{GatewayAccess, TransportKey};
use super::{
    CryptoError, Enrolment, EoaSecret, EpochIssue, IssuedKeys, ProviderName, SealingKey, SmKeyPair, SmSecret, TopicKey,
    provider,
};

const MAGIC: [u8; 8] = *b"\x89AuthUna";
/// The version written.
const VERSION: u8 = 1;
/// The largest file accepted, bytes.
const LARGEST: usize = 1024 * 1024;
/// Bytes of SM3 at the end, over everything before.
const SUM: usize = 32;

/// Everything that captures without its owner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnattendedCredential {
    /// What a robot gets, too: the device's own pair and the keys of its topics. It names no gateway, and its name is the
    /// profile's.
    pub enrolment: Enrolment,
    /// When the loan ends, as of the day when it was made.
    pub until: Timestamp,
    /// The account that anchors.
    pub witness: EoaSecret,
}

impl UnattendedCredential {
    /// The bytes of its file: magic (8), version (1), domain (32), chain id (8), profile with its length (2) before it,
    /// owner (20), P_C (64), device secret (32), topic id of the notices (16), notice key (32), token (32), end of the
    /// loan (8), secret of the account (32), the issued keys, SM3 of all of that (32).
    pub fn encode(&self) -> Zeroizing<Vec<u8>> {
        let (enrolment, keys) = (&self.enrolment, self.enrolment.keys.encode());
        // The exact room: growing would leave unwiped copies behind.
        let mut out = Zeroizing::new(Vec::with_capacity(512 + enrolment.name.as_str().len() + keys.len()));
        out.extend_from_slice(&MAGIC);
        out.push(VERSION);
        out.extend_from_slice(&enrolment.domain.0);
        out.extend_from_slice(&enrolment.chain_id.to_be_bytes());
        put_text(&mut out, enrolment.name.as_str());
        out.extend_from_slice(&enrolment.owner.0);
        out.extend_from_slice(&enrolment.owner_key.0);
        out.extend_from_slice(enrolment.device.secret.expose());
        out.extend_from_slice(&enrolment.notice_id.0);
        out.extend_from_slice(enrolment.notice_key.expose());
        out.extend_from_slice(&enrolment.token.0);
        out.extend_from_slice(&self.until.0.to_be_bytes());
        out.extend_from_slice(self.witness.expose());
        out.extend_from_slice(&keys);
        let sum = sm3(&[&out]);
        out.extend_from_slice(&sum);
        out
    }

    /// From the bytes of a file.
    ///
    /// # Errors
    /// [`WireError`] if it is damaged, of another version, or covers more than named topics.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let body = bytes.len().checked_sub(SUM).and_then(|length| bytes.split_at_checked(length));
        let (body, sum) = body.ok_or(WireError::Value("length"))?;
        let mut reader = Reader::new(body);
        if reader.array("magic")? != MAGIC {
            return Err(WireError::Value("magic"));
        }
        if reader.u8("version")? != VERSION {
            return Err(WireError::Value("version"));
        }
        if !bool::from(sm3(&[body]).as_slice().ct_eq(sum)) {
            return Err(WireError::Value("checksum"));
        }
        let (domain, chain_id) = (Domain(reader.array("domain")?), reader.u64("chain id")?);
        let name = reader.text("profile")?.parse().map_err(|_| WireError::Value("profile"))?;
        let (owner, owner_key) = (Address(reader.array("owner")?), PublicKey(reader.array("owner key")?));
        let device = SmSecret::from_slice(reader.take(32, "device key")?)
            .and_then(|secret| SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret))
            .map_err(|_| WireError::Value("device key"))?;
        let notice_id = TopicId(reader.array("notice id")?);
        let notice_key = TopicKey::new(reader.array("notice key")?);
        let token = Token(reader.array("token")?);
        let until = Timestamp(reader.u64("end")?);
        let witness = EoaSecret::from_slice(reader.take(32, "account")?).map_err(|_| WireError::Value("account"))?;
        let keys = IssuedKeys::parse(reader.rest())?;
        let issues = std::iter::once(&keys.now).chain(keys.next.as_ref().map(|(_, next)| next));
        if !issues.into_iter().all(is_limited) {
            return Err(WireError::Value("keys"));
        }
        let enrolment = Enrolment {
            domain,
            chain_id,
            gateway: GatewayAccess {
                addresses: Vec::new(),
                fingerprint: SignerId([0; 32]),
                transport: TransportKey::new([0; 32]),
            },
            name,
            owner,
            owner_key,
            device,
            index: None,
            notice_id,
            notice_key,
            token,
            noticed: None,
            keys,
            version: Enrolment::NEWEST,
        };
        Ok(Self { enrolment, until, witness })
    }

    /// Reads a file that nobody else may read.
    ///
    /// # Errors
    /// Errors of reading, and [`CryptoError::NotAKey`] if it is not such a file.
    pub fn read(path: &Path) -> Result<Self, CryptoError> {
        let bytes = read_private(path, LARGEST)?;
        Self::parse(&bytes).map_err(|why| {
            let found =
                format!("it is damaged or something else ({why}); write it again with authros unattended prepare");
            CryptoError::NotAKey { path: shown(path), wanted: "a credential of unattended capture", found }
        })
    }
}

/// Whether these keys are those of named topics, with their pseudonyms, and not the epoch's own.
fn is_limited(issue: &EpochIssue) -> bool {
    match &issue.key {
        SealingKey::Epoch(_) => false,
        SealingKey::Topics(topics) => topics.values().all(|issued| issued.pseudonyms.is_some()),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::crypto::{EpochKey, FilterKey, IssuedTopic, Pseudonyms};

    fn sample(key: SealingKey) -> UnattendedCredential {
        let now = EpochIssue { epoch: 3, token: Token([7; 32]), ends: Some(Timestamp(9)), key };
        let enrolment = Enrolment {
            domain: Domain([1; 32]),
            chain_id: 77,
            gateway: GatewayAccess {
                addresses: Vec::new(),
                fingerprint: SignerId([0; 32]),
                transport: TransportKey::new([0; 32]),
            },
            name: "alice".parse().expect("a name"),
            owner: Address([3; 20]),
            owner_key: PublicKey([4; 64]),
            device: SmKeyPair::generate(provider(ProviderName::RustCrypto)).expect("a pair"),
            index: None,
            notice_id: TopicId([10; 16]),
            notice_key: TopicKey::new([7; 32]),
            token: Token([8; 32]),
            noticed: None,
            keys: IssuedKeys { now, next: None },
            version: Enrolment::NEWEST,
        };
        let witness = EoaSecret::from_slice(&[0x21; 32]).expect("a key");
        UnattendedCredential { enrolment, until: Timestamp(5), witness }
    }

    fn topics(pseudonyms: bool) -> SealingKey {
        let given = Pseudonyms { id: TopicId([11; 16]), filters: FilterKey::new([12; 32]) };
        let issued = IssuedTopic { key: TopicKey::new([9; 32]), pseudonyms: pseudonyms.then_some(given) };
        SealingKey::Topics([("/odom".to_owned(), issued)].into())
    }

    #[test]
    fn it_comes_back_and_neither_a_cut_nor_a_flipped_bit_does() {
        let credential = sample(topics(true));
        let bytes = credential.encode();
        assert_eq!(UnattendedCredential::parse(&bytes), Ok(credential.clone()));
        for at in 0..bytes.len() {
            assert!(UnattendedCredential::parse(&bytes[..at]).is_err(), "cut at {at}");
            let mut altered = bytes.to_vec();
            altered[at] ^= 1;
            assert!(UnattendedCredential::parse(&altered).is_err(), "altered at {at}");
        }
        let shown = format!("{credential:?}");
        assert!(!shown.contains("33, 33, 33") && !shown.contains("09, 09"), "no secret is shown: {shown}");
    }

    #[test]
    fn the_key_of_an_epoch_and_topics_without_pseudonyms_are_refused() {
        for key in [SealingKey::Epoch(EpochKey::new([8; 32])), topics(false)] {
            assert_eq!(UnattendedCredential::parse(&sample(key).encode()), Err(WireError::Value("keys")));
        }
    }

    #[test]
    fn a_file_that_others_read_is_refused_and_one_of_another_kind_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("authros");
        crate::crypto::private_file::create_private(&path, &sample(topics(true)).encode()).expect("written");
        assert!(UnattendedCredential::read(&path).is_ok());
        std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o644)).expect("set");
        assert!(matches!(UnattendedCredential::read(&path), Err(CryptoError::OpenToOthers { .. })));
        let other = folder.path().join("other");
        crate::crypto::private_file::create_private(&other, b"something").expect("written");
        let error = UnattendedCredential::read(&other).expect_err("no credential");
        assert!(error.to_string().contains("unattended prepare"), "{error}");
    }

    proptest! {
        #[test]
        fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..600)) {
            prop_assert!(UnattendedCredential::parse(&noise).is_err());
        }
    }
}
