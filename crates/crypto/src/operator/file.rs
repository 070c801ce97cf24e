//! An operator's key on disk, 0600: magic (8), version (1), work (9), salt (32), salt of this save (24), commitment (32),
//! then name and secret under SM4-GCM with all of that as AAD. `file_key` says how the passphrase becomes the key.

use std::path::Path;

use subtle::ConstantTimeEq as _;

use crate::crypto::error::shown;
use crate::crypto::file_key::{FileKey, SaveKeys, put_work, read_work};
use crate::crypto::private_file::{create_private, read_private};
use crate::crypto::{CryptoError, Passphrase, Provider, random_bytes};
use crate::model::wire::{Reader, WireError};

use super::OperatorKey;

const MAGIC: [u8; 8] = *b"\x89AuthOpr";
const VERSION: u8 = 1;
/// Length of the header, bytes.
const HEADER: usize = 106;
/// The largest file accepted, bytes.
const LARGEST: usize = 1024;
/// Keys of a file are derived under this label.
const LABEL: &str = "AuthROS/operator-key/1";

fn damaged(path: &Path) -> CryptoError {
    let found = "it is damaged or something else; ask the profile's owner to add you again".to_owned();
    CryptoError::NotAKey { path: shown(path), wanted: "an operator's key", found }
}

impl OperatorKey {
    /// Writes a new file, sealed under a passphrase (about 0.3 s); never over one that is there.
    ///
    /// # Errors
    /// [`CryptoError::Write`], also if the file exists, and [`CryptoError::Random`].
    pub fn create(&self, provider: &dyn Provider, path: &Path, passphrase: &Passphrase) -> Result<(), CryptoError> {
        let key = FileKey::new(passphrase)?;
        let save_salt = random_bytes()?;
        let keys = SaveKeys::derive(&key, &save_salt, LABEL);
        let mut header = MAGIC.to_vec();
        header.push(VERSION);
        put_work(&mut header, key.work);
        header.extend_from_slice(&key.salt);
        header.extend_from_slice(&save_salt);
        header.extend_from_slice(&keys.commit);
        let mut sealed = self.encode();
        provider.gcm_seal(&keys.key, &keys.nonce, &header, &mut sealed)?;
        create_private(path, &[&header[..], &sealed].concat())
    }

    /// Reads and opens a file that nobody else may read (about 0.3 s).
    ///
    /// # Errors
    /// [`CryptoError::Read`], [`CryptoError::OpenToOthers`], [`CryptoError::NotAKey`] or
    /// [`CryptoError::WrongPassphrase`].
    pub fn open(provider: &dyn Provider, path: &Path, passphrase: &Passphrase) -> Result<Self, CryptoError> {
        let bytes = read_private(path, LARGEST)?;
        let parts = split(&bytes).map_err(|_| damaged(path))?;
        let key = FileKey::with(passphrase, parts.work, parts.salt)?;
        let keys = SaveKeys::derive(&key, &parts.save_salt, LABEL);
        if !bool::from(keys.commit.ct_eq(&parts.commit)) {
            return Err(CryptoError::WrongPassphrase(shown(path)));
        }
        let (header, sealed) = bytes.split_at_checked(HEADER).ok_or_else(|| damaged(path))?;
        let plain = provider.gcm_open(&keys.key, &keys.nonce, header, sealed).map_err(|_| damaged(path))?;
        Self::parse(provider, &plain).map_err(|_| damaged(path))
    }
}

struct Parts {
    work: crate::crypto::passphrase::Work,
    salt: [u8; 32],
    save_salt: [u8; 24],
    commit: [u8; 32],
}

fn split(bytes: &[u8]) -> Result<Parts, WireError> {
    let mut reader = Reader::new(bytes);
    if reader.array("magic")? != MAGIC {
        return Err(WireError::Value("magic"));
    }
    if reader.u8("version")? != VERSION {
        return Err(WireError::Value("version"));
    }
    Ok(Parts {
        work: read_work(&mut reader)?,
        salt: reader.array("salt")?,
        save_salt: reader.array("salt of the save")?,
        commit: reader.array("commitment")?,
    })
}
