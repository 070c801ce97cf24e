//! How secret files are sealed at rest: the passphrase's key is derived once (scrypt); each save draws a salt and, as
//! for records, derives its own key, nonce and commitment. The commitment tells a wrong passphrase from damage.

use zeroize::Zeroizing;

use crate::model::wire::{Reader, WireError};

use super::kdf::{Info, derived};
use super::passphrase::{Work, stretch};
use super::{CryptoError, Passphrase, random_bytes};

/// The key derived from a passphrase, and how it was derived.
#[derive(Clone)]
pub(super) struct FileKey {
    pub work: Work,
    pub salt: [u8; 32],
    pub key: Zeroizing<[u8; 32]>,
}

impl FileKey {
    /// For a new file.
    pub fn new(passphrase: &Passphrase) -> Result<Self, CryptoError> {
        Self::with(passphrase, Work::WRITTEN, random_bytes()?)
    }

    /// For a file whose header gives salt and work.
    pub fn with(passphrase: &Passphrase, work: Work, salt: [u8; 32]) -> Result<Self, CryptoError> {
        Ok(Self { work, salt, key: stretch(passphrase.expose(), &salt, work)? })
    }
}

/// The work as stored in headers: log2 n (1), r (4), p (4).
pub(super) fn put_work(out: &mut Vec<u8>, work: Work) {
    out.push(work.log_n);
    out.extend_from_slice(&work.r.to_be_bytes());
    out.extend_from_slice(&work.p.to_be_bytes());
}

/// Reads the work and refuses unreasonable values.
pub(super) fn read_work(reader: &mut Reader<'_>) -> Result<Work, WireError> {
    let work = Work { log_n: reader.u8("work")?, r: reader.u32("work")?, p: reader.u32("work")? };
    if work.is_bearable() { Ok(work) } else { Err(WireError::Value("work")) }
}

/// Key, nonce and commitment of one save.
pub(super) struct SaveKeys {
    pub key: Zeroizing<[u8; 16]>,
    pub nonce: [u8; 12],
    pub commit: [u8; 32],
}

impl SaveKeys {
    /// For a save with this salt, in a file of the kind that `label` names.
    pub fn derive(key: &FileKey, save_salt: &[u8; 24], label: &str) -> Self {
        let bytes = Zeroizing::new(derived::<60>(&*key.key, save_salt, &Info::new(label)));
        Self {
            key: Zeroizing::new(std::array::from_fn(|index| bytes[index])),
            nonce: std::array::from_fn(|index| bytes[16 + index]),
            commit: std::array::from_fn(|index| bytes[28 + index]),
        }
    }
}
