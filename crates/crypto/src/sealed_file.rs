//! A small file under a passphrase: head, length (4), and its content under SM4-GCM with all of that as AAD.

use zeroize::Zeroizing;

use crate::keystore::{FileKey, SaveKeys, SealedHead};
use crate::model::wire::{Reader, WireError};
use crate::{CryptoError, ProviderName, Result, provider};

/// The largest file accepted, bytes.
pub(super) const LARGEST: usize = 1024 * 1024;
const HEADER: usize = SealedHead::LENGTH + 4;

/// One kind of such files.
pub(super) struct FileKind {
    pub magic: [u8; 8],
    /// Of the keys' derivation.
    pub label: &'static str,
    /// For people.
    pub what: &'static str,
}

/// A file taken apart, not opened yet.
pub(super) struct SealedFile<'a> {
    pub head: SealedHead,
    aad: &'a [u8],
    sealed: &'a [u8],
}

impl FileKind {
    pub fn seal(&self, key: &FileKey, mut content: Zeroizing<Vec<u8>>) -> Result<Vec<u8>> {
        let (head, keys) = SealedHead::new(key, self.label)?;
        let length = content.len() + 16;
        if HEADER + length > LARGEST {
            return Err(CryptoError::Length { what: self.what, found: content.len(), allowed: "at most 1 MiB" });
        }
        let mut out = head.encode(&self.magic);
        out.extend_from_slice(&u32::try_from(length).unwrap_or(u32::MAX).to_be_bytes());
        provider(ProviderName::RustCrypto).gcm_seal(&keys.key, &keys.nonce, &out, &mut content)?;
        out.extend_from_slice(&content);
        Ok(out)
    }

    pub fn split<'a>(&self, bytes: &'a [u8]) -> Result<SealedFile<'a>, WireError> {
        let mut reader = Reader::new(bytes);
        let head = SealedHead::read(&mut reader, &self.magic)?;
        let length = usize::try_from(reader.u32("length")?).map_err(|_| WireError::Value("length"))?;
        let sealed = reader.take(length, "sealed content")?;
        reader.end()?;
        Ok(SealedFile { head, aad: bytes.get(..HEADER).unwrap_or_default(), sealed })
    }

    /// `None` if the passphrase is another one.
    pub fn keys(&self, file: &SealedFile<'_>, key: &FileKey) -> Option<SaveKeys> {
        file.head.keys(key, self.label)
    }
}

impl SealedFile<'_> {
    /// `None` if a byte was altered.
    pub fn open(&self, keys: &SaveKeys) -> Option<Zeroizing<Vec<u8>>> {
        provider(ProviderName::RustCrypto).gcm_open(&keys.key, &keys.nonce, self.aad, self.sealed).ok()
    }
}
