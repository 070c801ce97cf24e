//! A robot's policy. The notice is signed by d_C, and its content by the owner's account: a thief with only one of them
//! cannot tell a robot what not to capture.

use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Domain, SignerId};

use super::identity::check_account;
use super::{AccountSignature, CryptoError, EoaSecret, Result, TypedStructure, sign_hash};

/// The EIP-712 type that the account signs.
const TYPE: &str = "Policy(address owner,bytes32 device,uint64 version,bytes policy)";
const WHAT: &str = "policy of a robot";

/// The longest policy, bytes.
pub const LONGEST_POLICY: usize = 64 * 1024;

/// A policy with its version.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedPolicy {
    /// Counts up, from 1.
    pub version: u64,
    /// The owner's EOA signature over it and the device.
    pub account_signature: AccountSignature,
    /// The policy, as TOML; empty = the robot's own settings alone. What is in it is for the robot to check.
    pub text: Vec<u8>,
}

impl SignedPolicy {
    /// The owner's policy for a device, signed by the account.
    /// # Errors
    /// [`CryptoError::Length`] if it is too long, [`CryptoError::Internal`].
    pub fn sign(domain: &Domain, account: &EoaSecret, device: SignerId, version: u64, text: &str) -> Result<Self> {
        if text.len() > LONGEST_POLICY {
            return Err(CryptoError::Length { what: WHAT, found: text.len(), allowed: "at most 65,536 bytes" });
        }
        let hash = signed_hash(domain, &account.address(), &device, (version, text.as_bytes()));
        Ok(Self { version, account_signature: sign_hash(account, &hash)?, text: text.as_bytes().to_vec() })
    }

    /// Whether the owner's account signed it for this device.
    /// # Errors
    /// [`CryptoError::NotAccepted`].
    pub fn check(&self, domain: &Domain, owner: &Address, device: &SignerId) -> Result<()> {
        let hash = signed_hash(domain, owner, device, (self.version, &self.text));
        check_account(&hash, &self.account_signature, owner, WHAT)
    }

    /// Version (8) || account's signature (65) || text.
    pub fn encode(&self) -> Vec<u8> {
        [&self.version.to_be_bytes()[..], &self.account_signature.0, &self.text].concat()
    }

    /// From its encoding; only the form is checked.
    /// # Errors
    /// [`WireError`] if it is malformed.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let version = reader.u64("version")?;
        let account_signature = AccountSignature(reader.array("account's signature")?);
        Ok(Self { version, account_signature, text: reader.rest().to_vec() })
    }
}

fn signed_hash(domain: &Domain, owner: &Address, device: &SignerId, (version, text): (u64, &[u8])) -> [u8; 32] {
    TypedStructure::new(TYPE).address(owner).word(&device.0).number(version).bytes(text).signing_hash(domain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_owners_account_sets_the_policy_of_a_robot() {
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let (domain, owner, device) = (Domain([1; 32]), account.address(), SignerId([9; 32]));
        let text = "[[watch]]\ntopic = \"/odom\"\n";
        let policy = SignedPolicy::sign(&domain, &account, device, 3, text).expect("signs");
        assert!(policy.check(&domain, &owner, &device).is_ok());
        assert!(policy.check(&Domain([2; 32]), &owner, &device).is_err(), "of another network");
        assert!(policy.check(&domain, &owner, &SignerId([8; 32])).is_err(), "for another robot");
        let forged = SignedPolicy::sign(&domain, &thief, device, 3, text).expect("signs");
        assert!(forged.check(&domain, &owner, &device).is_err(), "by another account");
        assert!(SignedPolicy { version: 4, ..policy.clone() }.check(&domain, &owner, &device).is_err(), "renumbered");
        assert!(SignedPolicy::sign(&domain, &account, device, 3, &"#".repeat(LONGEST_POLICY + 1)).is_err());

        let bytes = policy.encode();
        assert_eq!(SignedPolicy::parse(&bytes), Ok(policy));
        assert!((0..73).all(|cut| SignedPolicy::parse(&bytes[..cut]).is_err()));
        for at in 0..bytes.len() {
            let mut altered = bytes.clone();
            altered[at] ^= 1;
            let altered = SignedPolicy::parse(&altered).expect("the form is right");
            assert!(altered.check(&domain, &owner, &device).is_err(), "byte {at}");
        }
    }
}
