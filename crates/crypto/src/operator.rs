//! An operator of a profile: a pair of its own, and the owner's signed statement of its name, rights and time. The key's
//! file is in `file`, the list of statements in `list`; the owner's keys are in neither.

use zeroize::Zeroizing;

use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, OperatorName, OperatorRights, PublicKey, Signature, Timestamp};

use super::{CryptoError, Provider, SmKeyPair, SmSecret};

mod file;
mod list;

pub use list::{MOST_OPERATORS, OperatorList};

const WHAT: &str = "operator's statement";
/// Begins what the owner signs.
const STATEMENT: &[u8] = b"AuthROS/operator/1";
/// Begins what an operator signs to show that a connection is its own.
const PROOF: &[u8] = b"AuthROS/operator-connection/1";

/// What an owner states about an operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OperatorTerms {
    /// Its name at the profile.
    pub name: OperatorName,
    /// Its public key.
    pub key: PublicKey,
    /// What it may do.
    pub rights: OperatorRights,
    /// From when on.
    pub from: Timestamp,
    /// Before when; `None` = until it is removed.
    pub until: Option<Timestamp>,
}

impl OperatorTerms {
    /// Name with its length (2) before it, key (64), rights (1), from (8), until (8, 0 = no end).
    fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(128);
        put_text(&mut out, self.name.as_str());
        out.extend_from_slice(&self.key.0);
        out.push(self.rights.bits());
        out.extend_from_slice(&self.from.0.to_be_bytes());
        out.extend_from_slice(&self.until.map_or(0, |until| until.0).to_be_bytes());
        out
    }

    fn parse(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let name = reader.text("operator's name")?.parse().map_err(|_| WireError::Value("operator's name"))?;
        let key = PublicKey(reader.array("operator's key")?);
        let rights = OperatorRights::from_bits(reader.u8("rights")?).ok_or(WireError::Value("rights"))?;
        let (from, until) = (Timestamp(reader.u64("beginning")?), reader.u64("end")?);
        Ok(Self { name, key, rights, from, until: (until > 0).then_some(Timestamp(until)) })
    }

    /// Label, account, terms.
    fn signed(&self, account: &Address) -> Vec<u8> {
        [STATEMENT, &account.0, &self.encode()].concat()
    }
}

/// The terms with the signature of the owner's d_C.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OperatorStatement {
    /// What is stated.
    pub terms: OperatorTerms,
    /// By d_C over label, account and terms.
    pub signature: Signature,
}

impl OperatorStatement {
    /// Signed by the owner of `account`.
    ///
    /// # Errors
    /// [`CryptoError::PublicPoint`] if the operator's key is not a point, or errors of signing.
    pub fn sign(
        provider: &dyn Provider,
        signing: &SmKeyPair,
        account: &Address,
        terms: OperatorTerms,
    ) -> Result<Self, CryptoError> {
        provider.check_public_key(&terms.key)?;
        let signature = provider.sign(&signing.secret, &terms.signed(account))?;
        Ok(Self { terms, signature })
    }

    /// Whether the owner of `account` with this P_C signed it.
    ///
    /// # Errors
    /// [`CryptoError::NotAccepted`].
    pub fn check(&self, provider: &dyn Provider, signing: &PublicKey, account: &Address) -> Result<(), CryptoError> {
        let checked = provider.verify(signing, &self.terms.signed(account), &self.signature);
        checked.map_err(|_| CryptoError::NotAccepted { what: WHAT, field: "owner's signature" })
    }
}

/// What an operator signs: label, challenge, account, profile and name, each text with its length before it.
fn proven(challenge: &[u8; 32], account: &Address, profile: &str, name: &OperatorName) -> Vec<u8> {
    let mut out = [PROOF, challenge, &account.0[..]].concat();
    put_text(&mut out, profile);
    put_text(&mut out, name.as_str());
    out
}

/// Whether the holder of `key` signed the challenge of this connection.
///
/// # Errors
/// [`CryptoError::BadSignature`] or [`CryptoError::PublicPoint`].
pub fn check_operator(
    provider: &dyn Provider,
    terms: &OperatorTerms,
    (challenge, account, profile): (&[u8; 32], &Address, &str),
    proof: &Signature,
) -> Result<(), CryptoError> {
    provider.verify(&terms.key, &proven(challenge, account, profile, &terms.name), proof)
}

/// An operator's own key, with the name it was made for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OperatorKey {
    /// The name.
    pub name: OperatorName,
    /// The pair.
    pub pair: SmKeyPair,
}

impl OperatorKey {
    /// A fresh one.
    ///
    /// # Errors
    /// [`CryptoError::Random`].
    pub fn generate(provider: &dyn Provider, name: OperatorName) -> Result<Self, CryptoError> {
        Ok(Self { name, pair: SmKeyPair::generate(provider)? })
    }

    /// Signs the challenge of a connection to the site of `account`, for work at `profile`.
    ///
    /// # Errors
    /// Errors of signing.
    pub fn prove(
        &self,
        provider: &dyn Provider,
        (challenge, account, profile): (&[u8; 32], &Address, &str),
    ) -> Result<Signature, CryptoError> {
        provider.sign(&self.pair.secret, &proven(challenge, account, profile, &self.name))
    }

    /// Name with its length (2) before it, secret (32); room for a tag is reserved.
    fn encode(&self) -> Zeroizing<Vec<u8>> {
        let mut out = Zeroizing::new(Vec::with_capacity(2 + self.name.as_str().len() + 32 + 16));
        put_text(&mut out, self.name.as_str());
        out.extend_from_slice(self.pair.secret.expose());
        out
    }

    fn parse(provider: &dyn Provider, bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let name = reader.text("operator's name")?.parse().map_err(|_| WireError::Value("operator's name"))?;
        let secret = SmSecret::from_slice(reader.take(32, "operator's key")?);
        reader.end()?;
        let pair = secret.and_then(|secret| SmKeyPair::from_secret(provider, secret));
        Ok(Self { name, pair: pair.map_err(|_| WireError::Value("operator's key"))? })
    }
}

#[cfg(test)]
mod tests;
