//! An enrolment on disk: magic (8), version (1), work (9), salt (32), salt of this save (24), commitment (32) and
//! length (4), then the enrolment under SM4-GCM with all of that as AAD. `file_key` says how the passphrase becomes the
//! key.

use std::path::{Path, PathBuf};

use subtle::ConstantTimeEq as _;

use crate::crypto::error::shown;
use crate::crypto::file_key::{FileKey, SaveKeys, put_work, read_work};
use crate::crypto::passphrase::Work;
use crate::crypto::private_file::{create_private, read_private, write_private};
use crate::crypto::{CryptoError, Passphrase, ProviderName, provider, random_bytes};
use crate::model::wire::{Reader, WireError};

use super::Enrolment;

const MAGIC: [u8; 8] = *b"\x89AuthEnr";
const VERSION: u8 = 1;
const LABEL: &str = "AuthROS/enrolment/1";
/// The largest file accepted, bytes.
const LARGEST: usize = 1024 * 1024;
/// Length of the header, bytes.
const HEADER: usize = 110;

fn header(key: &FileKey, save_salt: &[u8; 24], commit: &[u8; 32], length: usize) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    out.push(VERSION);
    put_work(&mut out, key.work);
    out.extend_from_slice(&key.salt);
    out.extend_from_slice(save_salt);
    out.extend_from_slice(commit);
    out.extend_from_slice(&u32::try_from(length).unwrap_or(u32::MAX).to_be_bytes());
    out
}

struct Parts<'a> {
    work: Work,
    salt: [u8; 32],
    save_salt: [u8; 24],
    commit: [u8; 32],
    aad: &'a [u8],
    sealed: &'a [u8],
}

/// The parts of a file's bytes; `path` is only for the words of an error.
fn split<'a>(path: &Path, bytes: &'a [u8]) -> Result<Parts<'a>, CryptoError> {
    let damaged = |_: WireError| damaged(path);
    let mut reader = Reader::new(bytes);
    if reader.array("magic").map_err(damaged)? != MAGIC {
        return Err(self::damaged(path));
    }
    match reader.u8("version").map_err(damaged)? {
        VERSION => read_parts(bytes, &mut reader).map_err(damaged),
        found => Err(CryptoError::Version { path: shown(path), what: "an enrolment", found }),
    }
}

fn read_parts<'a>(bytes: &'a [u8], reader: &mut Reader<'a>) -> Result<Parts<'a>, WireError> {
    let work = read_work(reader)?;
    let (salt, save_salt, commit) =
        (reader.array("salt")?, reader.array("salt of the save")?, reader.array("commitment")?);
    let length = usize::try_from(reader.u32("length")?).map_err(|_| WireError::Value("length"))?;
    let sealed = reader.take(length, "sealed enrolment")?;
    reader.end()?;
    Ok(Parts { work, salt, save_salt, commit, aad: bytes.get(..HEADER).unwrap_or_default(), sealed })
}

fn seal(enrolment: &Enrolment, key: &FileKey) -> Result<Vec<u8>, CryptoError> {
    let mut sealed = enrolment.encode();
    let save_salt = random_bytes()?;
    let keys = SaveKeys::derive(key, &save_salt, LABEL);
    let header = header(key, &save_salt, &keys.commit, sealed.len() + 16);
    if header.len() + sealed.len() + 16 > LARGEST {
        return Err(CryptoError::Length { what: "enrolment", found: sealed.len(), allowed: "at most 1 MiB" });
    }
    provider(ProviderName::RustCrypto).gcm_seal(&keys.key, &keys.nonce, &header, &mut sealed)?;
    Ok([&header[..], &sealed].concat())
}

fn damaged(path: &Path) -> CryptoError {
    let found = "it is damaged or not an enrolment; ask its owner to enrol the robot again".to_owned();
    CryptoError::NotAKey { path: shown(path), wanted: "an enrolment", found }
}

/// An enrolment in memory with its file's key, so that later saves need no derivation.
pub struct SealedEnrolment {
    /// The enrolment; call [`Self::save`] after changing it.
    pub enrolment: Enrolment,
    key: FileKey,
}

impl SealedEnrolment {
    /// A new enrolment; derives the passphrase's key (about 0.3 s).
    ///
    /// # Errors
    /// [`CryptoError::Random`].
    pub fn new(enrolment: Enrolment, passphrase: &Passphrase) -> Result<Self, CryptoError> {
        Ok(Self { enrolment, key: FileKey::new(passphrase)? })
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// [`CryptoError::Length`] if it is too large, [`CryptoError::Random`].
    pub fn seal(&self) -> Result<Vec<u8>, CryptoError> {
        seal(&self.enrolment, &self.key)
    }

    /// Reads and opens a file (about 0.3 s).
    ///
    /// # Errors
    /// [`CryptoError::Read`], [`CryptoError::OpenToOthers`], [`CryptoError::NotAKey`], [`CryptoError::Version`] or
    /// [`CryptoError::WrongPassphrase`].
    pub fn open(path: &Path, passphrase: &Passphrase) -> Result<Self, CryptoError> {
        let bytes = read_private(path, LARGEST)?;
        let parts = split(path, &bytes)?;
        let key = FileKey::with(passphrase, parts.work, parts.salt)?;
        let keys = SaveKeys::derive(&key, &parts.save_salt, LABEL);
        if !bool::from(keys.commit.ct_eq(&parts.commit)) {
            return Err(CryptoError::WrongPassphrase(shown(path)));
        }
        let opened = provider(ProviderName::RustCrypto).gcm_open(&keys.key, &keys.nonce, parts.aad, parts.sealed);
        let plain = opened.map_err(|_| damaged(path))?;
        let enrolment = Enrolment::parse(&plain).map_err(|_| damaged(path))?;
        Ok(Self { enrolment, key })
    }

    /// Takes over what a later save of the same enrolment holds, if there is one; needs no derivation. A file of
    /// another enrolment changes nothing.
    ///
    /// # Errors
    /// [`CryptoError::Read`], [`CryptoError::OpenToOthers`].
    pub fn catch_up(&mut self, path: &Path) -> Result<(), CryptoError> {
        if !path.exists() {
            return Ok(());
        }
        let bytes = read_private(path, LARGEST)?;
        let Ok(parts) = split(path, &bytes) else { return Ok(()) };
        let keys = SaveKeys::derive(&self.key, &parts.save_salt, LABEL);
        if parts.salt != self.key.salt || !bool::from(keys.commit.ct_eq(&parts.commit)) {
            return Ok(());
        }
        let opened = provider(ProviderName::RustCrypto).gcm_open(&keys.key, &keys.nonce, parts.aad, parts.sealed);
        if let Some(later) = opened.ok().and_then(|plain| Enrolment::parse(&plain).ok())
            && later.device_id() == self.enrolment.device_id()
            && later.keys.now.epoch >= self.enrolment.keys.now.epoch
        {
            self.enrolment = later;
        }
        Ok(())
    }

    /// Writes a new file, never over one that is there.
    ///
    /// # Errors
    /// [`CryptoError::Write`], also if the file exists.
    pub fn create(&self, path: &Path) -> Result<(), CryptoError> {
        create_private(path, &self.seal()?)
    }

    /// Replaces the file in one step.
    ///
    /// # Errors
    /// [`CryptoError::Write`]; the old file is then still intact.
    pub fn save(&self, path: &Path) -> Result<(), CryptoError> {
        write_private(path, &self.seal()?)
    }

    /// The file in the robot's directory that keeps what it has learnt since enrolment.
    pub fn kept_in(directory: &Path) -> PathBuf {
        directory.join("enrolment")
    }
}
