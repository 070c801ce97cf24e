//! How a machine becomes a worker of a gateway: the join file, which brings it identity and settings, and the join key, under
//! which the database has the secrets that change later.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use zeroize::Zeroizing;

use crate::error::shown;
use crate::kdf::{Info, key_and_nonce};
use crate::keystore::{FileKey, of_version};
use crate::model::wire::{Wire as _, WireError};
use crate::model::{Domain, ProfileName, SignerId, body, layout};
use crate::private_file::{make_private_directory, read_private, write_private};
use crate::sealed_file::{FileKind, LARGEST};
use crate::{CryptoError, JoinSecret, Passphrase, Provider, Result, random_bytes};

/// The suite SM4-GCM, SM3, SM2, HKDF-SM3, by its name.
const SUITE: &str = "SM/1";
const KIND: FileKind = FileKind { magic: *b"\x89AuthJoi", label: "AuthROS/join/1", what: "join file" };

/// What a worker is made of.
#[derive(Clone, PartialEq, Eq)]
pub struct JoinFile {
    /// The name of the suite; a file of another one is refused.
    suite: String,
    /// The gateway's network.
    pub domain: Domain,
    /// Its chain id.
    pub chain_id: u64,
    /// SM3 of the gateway's identity key.
    pub gateway: SignerId,
    /// The profile that keeps the gateway.
    pub profile: ProfileName,
    /// The join key.
    pub join: JoinKey,
    /// The profile's keyring as it is on disk, under its own passphrase.
    pub keyring: Vec<u8>,
    /// The settings that workers share, TOML.
    pub settings: String,
}

layout!(JoinFile {
    suite: "suite",
    domain: "domain",
    chain_id: "chain id",
    gateway: "gateway",
    profile: "profile",
    join: "join key",
    keyring: "keyring",
    settings: "settings",
});
body!(JoinFile);

impl fmt::Debug for JoinFile {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("JoinFile")
            .field("domain", &self.domain)
            .field("join", &self.join)
            .finish_non_exhaustive()
    }
}

impl JoinFile {
    /// A worker of this gateway, without its keyring and settings.
    pub fn new(domain: Domain, chain_id: u64, gateway: SignerId, profile: ProfileName, join: JoinKey) -> Self {
        let (keyring, settings) = (Vec::new(), String::new());
        Self { suite: SUITE.to_owned(), domain, chain_id, gateway, profile, join, keyring, settings }
    }

    /// The bytes of the file; derives the passphrase's key (about 0.3 s).
    /// # Errors
    /// [`CryptoError::Length`] if it is too large, [`CryptoError::Random`].
    pub fn seal(&self, passphrase: &Passphrase) -> Result<Vec<u8>> {
        // Reserved in one piece, tag included: growing the buffer would leave unwiped copies behind.
        let mut content = Zeroizing::new(Vec::with_capacity(512 + self.keyring.len() + self.settings.len()));
        self.put(&mut content);
        KIND.seal(&FileKey::new(passphrase)?, content)
    }

    /// Reads and opens a file (about 0.3 s).
    /// # Errors
    /// [`CryptoError::NotAKey`], [`CryptoError::Version`], [`CryptoError::WrongPassphrase`], or as [`read_private`].
    pub fn open(path: &Path, passphrase: &Passphrase) -> Result<Self> {
        let bytes = read_private(path, LARGEST)?;
        let file = KIND.split(&bytes);
        let file = file.map_err(|why| match bytes.starts_with(&KIND.magic) {
            true => of_version(path, "a join file", &bytes, why).unwrap_or_else(|| damaged(path)),
            false => {
                let found = "it begins otherwise; give the file that `authros gateway join-file` wrote".to_owned();
                CryptoError::NotAKey { path: shown(path), wanted: "a join file", found }
            }
        })?;
        let key = FileKey::with(passphrase, file.head.work, file.head.salt)?;
        let keys = KIND.keys(&file, &key).ok_or_else(|| CryptoError::WrongPassphrase(shown(path)))?;
        let content = file.open(&keys).ok_or_else(|| damaged(path))?;
        let opened = Self::parse(&content).map_err(|_: WireError| damaged(path))?;
        if opened.suite != SUITE {
            let found = "it is of another suite; use the authros that wrote it".to_owned();
            return Err(CryptoError::NotAKey { path: shown(path), wanted: "a join file of the suite SM/1", found });
        }
        Ok(opened)
    }
}

fn damaged(path: &Path) -> CryptoError {
    let found =
        "bytes were altered or are missing; carry it again, or make another one with `authros gateway join-file`";
    CryptoError::NotAKey { path: shown(path), wanted: "an intact join file", found: found.to_owned() }
}

/// What the workers of one gateway seal under their join key.
#[derive(Debug, Clone, Copy)]
pub struct SharedUse<'a> {
    /// The network.
    pub domain: &'a Domain,
    /// The gateway's fingerprint.
    pub gateway: &'a SignerId,
    /// Authenticated, not sealed.
    pub beside: &'a [u8],
}

/// The key that all workers of a gateway have. Each renewal makes one with the next number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JoinKey {
    /// From 1.
    pub number: u64,
    /// The key itself.
    pub secret: JoinSecret,
}

layout!(JoinKey { number: "number of the join key", secret: "join key" });

impl JoinKey {
    /// A fresh one with this number.
    /// # Errors
    /// [`CryptoError::Random`].
    pub fn generate(number: u64) -> Result<Self> {
        Ok(Self { number, secret: JoinSecret::generate()? })
    }

    fn keys(&self, salt: &[u8], usage: SharedUse<'_>) -> (Zeroizing<[u8; 16]>, [u8; 12]) {
        let info = Info::new("AuthROS/shared/1").fixed(&usage.domain.0).fixed(&usage.gateway.0).number(self.number);
        key_and_nonce(self.secret.expose(), salt, &info)
    }

    /// Seals what workers share: salt (32) || SM4-GCM. The buffer has room for the tag.
    /// # Errors
    /// [`CryptoError::Random`].
    pub fn seal(
        &self,
        provider: &dyn Provider,
        usage: SharedUse<'_>,
        mut content: Zeroizing<Vec<u8>>,
    ) -> Result<Vec<u8>> {
        let salt: [u8; 32] = random_bytes()?;
        let (key, nonce) = self.keys(&salt, usage);
        provider.gcm_seal(&key, &nonce, usage.beside, &mut content)?;
        Ok([&salt[..], &content].concat())
    }

    /// Opens what [`Self::seal`] sealed for the same use.
    /// # Errors
    /// [`CryptoError::BadCiphertext`] if it was sealed for another use, under another key, or altered.
    pub fn open(&self, provider: &dyn Provider, usage: SharedUse<'_>, sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>> {
        let (salt, sealed) = sealed.split_first_chunk::<32>().ok_or(CryptoError::BadCiphertext)?;
        let (key, nonce) = self.keys(salt, usage);
        provider.gcm_open(&key, &nonce, usage.beside, sealed)
    }

    /// Keeps it in the folder of a home's gateway.
    /// # Errors
    /// [`CryptoError::Write`] or [`CryptoError::OpenToOthers`].
    pub fn save(&self, folder: &Path) -> Result<()> {
        make_private_directory(folder)?;
        write_private(&place(folder, self.number), self.secret.expose())
    }

    /// The one with this number, if the folder has it.
    /// # Errors
    /// [`CryptoError::NotAKey`], or as [`read_private`].
    pub fn load(folder: &Path, number: u64) -> Result<Option<Self>> {
        let path = place(folder, number);
        if !path.exists() {
            return Ok(None);
        }
        let secret = JoinSecret::from_slice(&read_private(&path, JoinSecret::LENGTH)?).ok_or_else(|| {
            let found = "it is damaged; join again with a file of `authros gateway join-file`".to_owned();
            CryptoError::NotAKey { path: shown(&path), wanted: "a join key of 32 bytes", found }
        })?;
        Ok(Some(Self { number, secret }))
    }

    /// Removes it from the folder.
    /// # Errors
    /// [`CryptoError::Write`].
    pub fn forget(&self, folder: &Path) -> Result<()> {
        let path = place(folder, self.number);
        fs::remove_file(&path).map_err(CryptoError::write(&path))
    }
}

fn place(folder: &Path, number: u64) -> PathBuf {
    folder.join(format!("join-{number}.key"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ProviderName, provider};

    fn sample() -> JoinFile {
        let join = JoinKey { number: 3, secret: JoinSecret::new([5; 32]) };
        let name = "keeper".parse().expect("a name");
        let file = JoinFile::new(Domain([1; 32]), 31_337, SignerId([2; 32]), name, join);
        let settings = "chain.url = \"http://node:8545\"\n".to_owned();
        JoinFile { keyring: b"\x89AuthKey as on disk".to_vec(), settings, ..file }
    }

    fn passphrase(text: &str) -> Passphrase {
        Passphrase::new(text.to_owned()).expect("long enough")
    }

    fn opened(bytes: &[u8], text: &str) -> Result<JoinFile> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("gate.join");
        write_private(&path, bytes).expect("writes");
        JoinFile::open(&path, &passphrase(text))
    }

    #[test]
    fn a_join_file_opens_with_its_passphrase_alone() {
        let whole = sample().seal(&passphrase("correct horse")).expect("seals");
        assert_eq!(opened(&whole, "correct horse").expect("opens"), sample());
        assert!(matches!(opened(&whole, "battery staple"), Err(CryptoError::WrongPassphrase(_))));
        assert!(!whole.windows(4).any(|window| window == [5; 4] || window == b"http"), "nothing in clear");
        assert!(!format!("{:?}", sample()).contains('5'), "no secret is shown");
        let mut later = whole.clone();
        later[8] = 2;
        assert!(matches!(opened(&later, "correct horse"), Err(CryptoError::Version { found: 2, .. })));
        let mut enrolment = whole;
        enrolment[..8].copy_from_slice(b"\x89AuthEnr");
        let error = opened(&enrolment, "correct horse").expect_err("no join file").to_string();
        assert!(error.contains("is not a join file") && error.contains("authros gateway join-file"), "{error}");
        let whole = sample().seal(&passphrase("correct horse")).expect("seals");
        let error = opened(&whole[..whole.len() - 1], "correct horse").expect_err("cut").to_string();
        assert!(error.contains("is not an intact join file"), "{error}");
        let error = opened(&vec![0; LARGEST + 1], "correct horse").expect_err("too long").to_string();
        assert!(error.contains("gate.join has 1048577 bytes, more than the 1048576"), "{error}");
    }

    #[test]
    fn no_byte_of_a_join_file_can_be_changed() {
        let whole = sample().seal(&passphrase("correct horse")).expect("seals");
        let head = KIND.split(&whole).expect("whole").head;
        let key = FileKey::with(&passphrase("correct horse"), head.work, head.salt).expect("derives");
        let opens = |bytes: &[u8]| {
            let file =
                KIND.split(bytes).ok().filter(|file| (file.head.work, file.head.salt) == (head.work, head.salt))?;
            JoinFile::parse(&file.open(&KIND.keys(&file, &key)?)?).ok()
        };
        assert_eq!(opens(&whole), Some(sample()));
        for at in 0..whole.len() {
            let mut altered = whole.clone();
            altered[at] ^= 1;
            assert_eq!(opens(&altered), None, "byte {at}");
            assert_eq!(opens(&whole[..at]), None, "cut at {at}");
        }
    }

    #[test]
    fn another_suite_is_refused_and_every_content_has_one_encoding() {
        let other = JoinFile { suite: "SM/2".to_owned(), ..sample() };
        let error = opened(&other.seal(&passphrase("correct horse")).expect("seals"), "correct horse");
        assert!(error.expect_err("refused").to_string().contains("another suite"));
        let bytes = sample().encode();
        assert_eq!(JoinFile::parse(&bytes), Ok(sample()));
        for cut in 0..bytes.len() {
            assert!(JoinFile::parse(&bytes[..cut]).is_err(), "{cut}");
        }
        assert!(JoinFile::parse(&[&bytes[..], &[0]].concat()).is_err(), "one byte more");
    }

    #[test]
    fn what_workers_share_opens_for_the_same_use_under_the_same_join_key_only() {
        let provider = provider(ProviderName::RustCrypto);
        let (domain, gateway, list) = (Domain([1; 32]), SignerId([2; 32]), b"the list".as_slice());
        let usage = SharedUse { domain: &domain, gateway: &gateway, beside: list };
        let join = JoinKey { number: 3, secret: JoinSecret::new([5; 32]) };
        let content = || Zeroizing::new(b"secrets".to_vec());
        let sealed = join.seal(provider, usage, content()).expect("seals");
        assert_eq!(**join.open(provider, usage, &sealed).expect("opens"), *content());
        assert_ne!(sealed, join.seal(provider, usage, content()).expect("seals"), "each under a key of its own");
        let (away, other) = (Domain([9; 32]), SignerId([9; 32]));
        let refused = |join: &JoinKey, usage| join.open(provider, usage, &sealed).is_err();
        assert!(refused(&join, SharedUse { domain: &away, ..usage }), "another domain");
        assert!(refused(&join, SharedUse { gateway: &other, ..usage }), "another gateway");
        assert!(refused(&join, SharedUse { beside: b"a list", ..usage }), "another list");
        assert!(refused(&JoinKey { number: 2, ..join.clone() }, usage), "another number");
        assert!(refused(&JoinKey { secret: JoinSecret::new([6; 32]), ..join.clone() }, usage), "another key");
        for at in 0..sealed.len() {
            let mut altered = sealed.clone();
            altered[at] ^= 1;
            assert!(join.open(provider, usage, &altered).is_err(), "byte {at}");
        }
    }

    #[test]
    fn a_home_has_its_join_key_by_number() {
        let home = tempfile::tempdir().expect("a folder");
        let folder = home.path().join("gateway");
        let [old, new] = [1, 2].map(|number| JoinKey::generate(number).expect("generates"));
        old.save(&folder).expect("writes");
        new.save(&folder).expect("writes");
        assert_eq!(JoinKey::load(&folder, 1).expect("reads").as_ref(), Some(&old));
        old.forget(&folder).expect("removes");
        assert_eq!(JoinKey::load(&folder, 1).expect("reads"), None);
        assert_eq!(JoinKey::load(&folder, 2).expect("reads"), Some(new));
        write_private(&place(&folder, 7), b"short").expect("writes");
        assert!(JoinKey::load(&folder, 7).expect_err("damaged").to_string().contains("gateway join-file"));
    }
}
