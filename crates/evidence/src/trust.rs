//! What the reader of a bundle knows from another source than the bundle: pinned in `trust.toml`.

use std::collections::BTreeSet;

use authros_crypto::domain;
use authros_model::{Address, Domain, Hash, SignerId, clean};
use serde::{Deserialize, Serialize};

use crate::{committed::two_thirds, time::Certificate};

/// The longest file, bytes.
pub const LONGEST_TRUST: usize = 64 * 1024;
const MOST_AUTHORITIES: usize = 16;

/// A trust file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the trust file cannot be used: {0}; docs/reader.md has an example")]
pub struct TrustError(String);

/// The pins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trust {
    /// The chain.
    pub chain: PinnedChain,
    /// The owners of accounts and keys.
    #[serde(default, rename = "person", skip_serializing_if = "Vec::is_empty")]
    pub persons: Vec<Person>,
    /// The authorities whose time stamps count.
    #[serde(default, rename = "authority", skip_serializing_if = "Vec::is_empty")]
    pub authorities: Vec<PinnedAuthority>,
}

/// A time stamp authority.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PinnedAuthority {
    /// Its name.
    pub name: String,
    /// Its certificate, or that of its issuer, PEM.
    pub certificate: String,
}

/// A chain and its contract.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PinnedChain {
    /// Its id (EIP-155).
    pub id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    /// The contract.
    pub contract: Address,
    /// Keccak-256 of the contract's code.
    pub code_hash: Hash,
    /// Who may seal blocks.
    pub signers: Vec<Address>,
    /// How many must have sealed a block or built on it; default: more than half, or in one header two thirds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quorum: Option<usize>,
    /// Whether the exporter also seals this chain: its word then proves nothing against the exporter.
    pub sealed_by_exporter: bool,
}

/// A party by name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// The account.
    pub account: Address,
    /// Its name.
    pub name: String,
    /// The key's SM3, if the key was compared, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<SignerId>,
}

impl Trust {
    /// From the text of a trust file.
    /// # Errors
    /// [`TrustError`] if it is not one, or demands what no chain can give.
    pub fn parse(text: &[u8]) -> Result<Self, TrustError> {
        let text = std::str::from_utf8(text).ok().filter(|text| text.len() <= LONGEST_TRUST);
        let text = text.ok_or_else(|| TrustError("it is not text, or too long".into()))?;
        // A later version begins with this line, which version 1 does not have.
        if text.parse::<toml::Table>().is_ok_and(|told| told.contains_key("version")) {
            return Err(TrustError("it is of a later version than this program reads; use a newer authros".into()));
        }
        let trust: Self = crate::manifest::from_toml(text).map_err(|error| TrustError(clean(&error, 300)))?;
        let signers = &trust.chain.signers;
        if signers.iter().enumerate().any(|(at, signer)| signers.iter().skip(at + 1).any(|other| other == signer)) {
            return Err(TrustError("a signer is named twice".into()));
        }
        let accounts: BTreeSet<Address> = trust.persons.iter().map(|person| person.account).collect();
        if accounts.len() != trust.persons.len() {
            return Err(TrustError("an account is given to two people".into()));
        }
        for authority in &trust.authorities {
            if let Err(error) = Certificate::from_pem(&authority.certificate) {
                return Err(TrustError(format!("the authority '{}': {error}", clean(&authority.name, 80))));
            }
        }
        if trust.authorities.len() > MOST_AUTHORITIES {
            return Err(TrustError(format!("it names more than {MOST_AUTHORITIES} authorities")));
        }
        if trust.chain.quorum.is_some_and(|quorum| quorum == 0 || quorum > signers.len()) {
            return Err(TrustError("its quorum is zero, or more than the number of signers".into()));
        }
        Ok(trust)
    }

    /// As text.
    /// # Errors
    /// [`TrustError`] if it cannot be written.
    pub fn to_text(&self) -> Result<String, TrustError> {
        toml::to_string(self).map_err(|error| TrustError(clean(&error.to_string(), 300)))
    }

    /// The required number of signers, of whom each seals a block of its own (Clique).
    pub fn quorum(&self) -> usize {
        self.chain.quorum.unwrap_or(self.chain.signers.len() / 2 + 1)
    }

    /// The required number of signers in one header (QBFT, IBFT 2.0).
    pub fn commit_quorum(&self) -> usize {
        self.chain.quorum.unwrap_or_else(|| two_thirds(self.chain.signers.len()).max(1))
    }

    /// The domain of records of this chain and contract.
    pub fn domain(&self) -> Domain {
        domain(self.chain.id, &self.chain.genesis, &self.chain.contract)
    }

    /// The name of an account, if it is pinned.
    pub fn person(&self, account: Address) -> Option<&Person> {
        self.persons.iter().find(|person| person.account == account)
    }
}
