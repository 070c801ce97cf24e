//! Disclosure of one record: the 32 bytes that its keys alone follow from.
//!
//! They are HKDF's extract of topic key and salt, so nothing leads from them to the topic key or to another record. The
//! record's commitment is expanded from the same bytes: a wrong secret, or another message, cannot be passed off.

use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use super::opening::open_by_keys;
use super::{RecordKeys, record_info};
use crate::crypto::kdf::{expanded, hmac_sm3};
use crate::crypto::{CryptoError, Provider, TopicKey};
use crate::model::{Digest, Domain, Head, Header};

/// What the keys of one record follow from.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct RecordSecret([u8; 32]);

impl std::fmt::Debug for RecordSecret {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("RecordSecret(secret)")
    }
}

impl RecordSecret {
    /// Of the record with this header, sealed under this topic key.
    pub fn of(key: &TopicKey, header: &Header) -> Self {
        Self(hmac_sm3(&header.salt.0, &[key.expose()]))
    }

    /// From exactly 32 bytes: of another length, HMAC would take different texts for one key.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }

    /// The bytes. Whoever has them reads this record, for ever, and no other.
    pub fn expose(&self) -> &[u8; 32] {
        &self.0
    }

    fn keys(&self, header: &Header) -> RecordKeys {
        RecordKeys::of(&Zeroizing::new(expanded(&self.0, &record_info(header))))
    }
}

/// A record that its owner disclosed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Revealed {
    /// The public header.
    pub header: Header,
    /// What was sealed beside the message.
    pub head: Head,
    /// The message.
    pub body: Vec<u8>,
}

/// Opens a stored record by its own secret. Digest, signature and anchor are checked elsewhere.
///
/// # Errors
/// [`CryptoError::WrongKey`] where the record is not committed to this secret, else as of an opening.
pub fn open_revealed(provider: &dyn Provider, blob: &[u8], secret: &RecordSecret) -> Result<Revealed, CryptoError> {
    let mut budget = u64::MAX;
    open_revealed_within(provider, blob, secret, &mut budget)?.ok_or(CryptoError::Tampered("plain length"))
}

/// As [`open_revealed`], for many records of a stranger: the length of each message is taken off `budget`, in bytes, before
/// the message is made; `None` where that has less.
///
/// # Errors
/// As [`open_revealed`].
pub fn open_revealed_within(
    provider: &dyn Provider,
    blob: &[u8],
    secret: &RecordSecret,
    budget: &mut u64,
) -> Result<Option<Revealed>, CryptoError> {
    let opened = open_by_keys(provider, blob, |header| secret.keys(header), budget)?;
    Ok(opened.map(|(header, head, body)| Revealed { header, head, body }))
}

/// What the owner signs who discloses a record: label, domain, digest, secret.
pub fn reveal_bytes(domain: &Domain, digest: &Digest, secret: &RecordSecret) -> Zeroizing<Vec<u8>> {
    Zeroizing::new([&b"AuthROS/reveal/1"[..], &domain.0, &digest.0, secret.expose()].concat())
}
