//! Disclosure of one record: the 32 bytes from which its keys, and no others, are derived.
//!
//! They are HKDF's extract of topic key and salt, so nothing leads from them to the topic key or to another record. The
//! record's commitment is expanded from the same bytes, so neither a wrong secret nor another message can be passed
//! off.

use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use super::opening::open_by_keys;
use super::{RecordKeys, record_info};
use crate::crypto::kdf::{expanded, hmac_sm3};
use crate::crypto::{CryptoError, Provider, TopicKey};
use crate::model::{Digest, Domain, Head, Header};

/// The secret from which the keys of one record are derived.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct RecordSecret([u8; 32]);

impl std::fmt::Debug for RecordSecret {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("RecordSecret(secret)")
    }
}

impl RecordSecret {
    /// For the record with this header, sealed under this topic key.
    pub fn of(key: &TopicKey, header: &Header) -> Self {
        Self(hmac_sm3(&header.salt.0, &[key.expose()]))
    }

    /// From exactly 32 bytes: with other lengths, HMAC would take different texts for the same key.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }

    /// The bytes. Anyone who has them can read this record, forever, and no other.
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
    /// What was sealed along with the message.
    pub head: Head,
    /// The message.
    pub body: Vec<u8>,
}

/// Opens a stored record with its own secret. Digest, signature and anchor are checked elsewhere.
///
/// # Errors
/// [`CryptoError::WrongKey`] if the record does not commit to this secret, otherwise as for opening.
pub fn open_revealed(provider: &dyn Provider, blob: &[u8], secret: &RecordSecret) -> Result<Revealed, CryptoError> {
    let mut budget = u64::MAX;
    open_revealed_within(provider, blob, secret, &mut budget)?.ok_or(CryptoError::Tampered("plain length"))
}

/// Like [`open_revealed`], for many untrusted records: the length of each message is subtracted from `budget`, in
/// bytes, before the message is allocated; `None` if the budget is too small.
///
/// # Errors
/// See [`open_revealed`].
pub fn open_revealed_within(
    provider: &dyn Provider,
    blob: &[u8],
    secret: &RecordSecret,
    budget: &mut u64,
) -> Result<Option<Revealed>, CryptoError> {
    let opened = open_by_keys(provider, blob, |header| secret.keys(header), budget)?;
    Ok(opened.map(|(header, head, body)| Revealed { header, head, body }))
}

/// The bytes an owner signs to disclose a record: label, domain, digest, secret.
pub fn reveal_bytes(domain: &Domain, digest: &Digest, secret: &RecordSecret) -> Zeroizing<Vec<u8>> {
    Zeroizing::new([&b"AuthROS/reveal/1"[..], &domain.0, &digest.0, secret.expose()].concat())
}
