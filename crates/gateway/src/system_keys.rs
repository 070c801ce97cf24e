//! k_s: the system keys for key allocation, published as a signed, versioned, dated list that expires. One key is
//! current, one is next. `cabinet` stores and rotates the gateway's own.

use crate::crypto::{CryptoError, Provider, SmKeyPair, signer_id};
use crate::model::wire::{Reader, WireError};
use crate::model::{Digest, Domain, PublicKey, Signature, SignerId, Timestamp};

use super::error::GatewayError;
use super::hello::{Agreed, ListSummary};

pub mod cabinet;

/// First bytes of a list.
const MAGIC: [u8; 8] = *b"\x89AuthSys";
const VERSION: u8 = 1;
/// The most keys in a list.
const MOST_KEYS: usize = 2;

/// One P_S and its period of use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SystemKey {
    /// P_S.
    pub public: PublicKey,
    /// Start of use.
    pub not_before: Timestamp,
    /// End of use.
    pub not_after: Timestamp,
}

impl SystemKey {
    /// SM3 of P_S: its id.
    pub fn id(&self) -> SignerId {
        signer_id(&self.public)
    }

    /// Whether it is in use at `now`.
    pub fn is_in_use(&self, now: Timestamp) -> bool {
        self.not_before <= now && now < self.not_after
    }
}

/// The published list: magic (8) format (1) domain (32) gateway (32) version (8) issued (8) expires (8)
/// count (1) keys (id 32, P_S 64, not before 8, not after 8) signature (64).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SystemKeyList {
    /// The network.
    pub domain: Domain,
    /// The gateway: SM3 of its identity key.
    pub gateway: SignerId,
    /// Higher with every list of this gateway.
    pub version: u64,
    /// When it was signed.
    pub issued_at: Timestamp,
    /// When it expires.
    pub expires_at: Timestamp,
    /// The current key, then the next.
    pub keys: Vec<SystemKey>,
    /// Signature by the gateway's identity key.
    pub signature: Signature,
}

impl SystemKeyList {
    /// Signs a list.
    ///
    /// # Errors
    /// [`CryptoError::Random`].
    pub fn sign(
        provider: &dyn Provider,
        domain: Domain,
        identity: &SmKeyPair,
        version: u64,
        (issued_at, expires_at): (Timestamp, Timestamp),
        keys: Vec<SystemKey>,
    ) -> Result<Self, CryptoError> {
        let gateway = signer_id(&identity.public);
        let mut list = Self { domain, gateway, version, issued_at, expires_at, keys, signature: Signature([0; 64]) };
        list.signature = provider.sign(&identity.secret, &list.signed_bytes())?;
        Ok(list)
    }

    fn unsigned(&self) -> Vec<u8> {
        let keys = &self.keys[..self.keys.len().min(MOST_KEYS)];
        let mut out = Vec::with_capacity(500);
        out.extend_from_slice(&MAGIC);
        out.push(VERSION);
        out.extend_from_slice(&self.domain.0);
        out.extend_from_slice(&self.gateway.0);
        for number in [self.version, self.issued_at.0, self.expires_at.0] {
            out.extend_from_slice(&number.to_be_bytes());
        }
        out.push(u8::try_from(keys.len()).unwrap_or(0));
        for key in keys {
            out.extend_from_slice(&key.id().0);
            out.extend_from_slice(&key.public.0);
            out.extend_from_slice(&key.not_before.0.to_be_bytes());
            out.extend_from_slice(&key.not_after.0.to_be_bytes());
        }
        out
    }

    fn signed_bytes(&self) -> Vec<u8> {
        [&b"AuthROS/systemkeys/1"[..], &self.domain.0, &self.unsigned()].concat()
    }

    /// Its encoding.
    pub fn encode(&self) -> Vec<u8> {
        [&self.unsigned()[..], &self.signature.0].concat()
    }

    /// From its encoding; only the form is checked.
    ///
    /// # Errors
    /// [`WireError`] if it is not a list of this version.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        expect(reader.array("magic")? == MAGIC, "magic")?;
        expect(reader.u8("format")? == VERSION, "format")?;
        let list = Self {
            domain: Domain(reader.array("domain")?),
            gateway: SignerId(reader.array("gateway")?),
            version: reader.u64("version")?,
            issued_at: Timestamp(reader.u64("time of issue")?),
            expires_at: Timestamp(reader.u64("expiry")?),
            keys: read_keys(&mut reader)?,
            signature: Signature(reader.array("signature")?),
        };
        reader.end()?;
        Ok(list)
    }

    /// The hello's reference to it.
    pub fn summary(&self, provider: &dyn Provider) -> ListSummary {
        ListSummary { version: self.version, digest: Digest(provider.sm3(&[&self.encode()])) }
    }

    /// Checks that it is the list named in the hello, signed by that gateway for this network, and not expired; returns
    /// the key in use.
    ///
    /// # Errors
    /// [`GatewayError::List`] or [`GatewayError::Crypto`].
    pub fn check(
        &self,
        provider: &dyn Provider,
        domain: &Domain,
        agreed: &Agreed,
        now: Timestamp,
    ) -> Result<SystemKey, GatewayError> {
        let refuse = |why| Err(GatewayError::List(why));
        if self.domain != *domain {
            return refuse("it is of another network");
        }
        if self.gateway != agreed.gateway {
            return refuse("it is of another gateway");
        }
        if self.summary(provider) != agreed.list {
            return refuse("it is not the one the gateway announced");
        }
        provider.verify(&agreed.gateway_key, &self.signed_bytes(), &self.signature)?;
        if now >= self.expires_at {
            return refuse("it has expired, or this machine's clock is wrong");
        }
        let key = self.keys.iter().find(|key| key.is_in_use(now));
        let Some(key) = key else {
            return refuse("none of its keys is currently valid, or this machine's clock is wrong");
        };
        provider.check_public_key(&key.public)?;
        Ok(*key)
    }
}

fn read_keys(reader: &mut Reader<'_>) -> Result<Vec<SystemKey>, WireError> {
    let count = usize::from(reader.u8("key count")?);
    expect((1..=MOST_KEYS).contains(&count), "key count")?;
    (0..count).map(|_| read_key(reader)).collect()
}

fn read_key(reader: &mut Reader<'_>) -> Result<SystemKey, WireError> {
    let id = SignerId(reader.array("key id")?);
    let key = SystemKey {
        public: PublicKey(reader.array("system key")?),
        not_before: Timestamp(reader.u64("not before")?),
        not_after: Timestamp(reader.u64("not after")?),
    };
    expect(key.id() == id, "key id")?;
    Ok(key)
}

fn expect(condition: bool, field: &'static str) -> Result<(), WireError> {
    if condition { Ok(()) } else { Err(WireError::Value(field)) }
}

#[cfg(test)]
mod tests;
