//! The notice that an owner's signing key has changed. The notice is signed by the old key, and its content by the
//! owner's account, so a thief who has only one of them cannot take a robot over.

use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Domain, PublicKey};

use super::{AccountSignature, CryptoError, EoaSecret, Provider, TypedStructure, recover_account, sign_hash};

/// The EIP-712 type that the account signs.
const TYPE: &str = "OwnerKey(address owner,bytes oldKey,bytes newKey)";
const WHAT: &str = "owner's new key";

/// A change from one P_C to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OwnerKeyChange {
    /// The P_C until now, which signs the notice.
    pub old: PublicKey,
    /// The P_C from now on.
    pub new: PublicKey,
    /// The owner's EOA signature over both.
    pub account_signature: AccountSignature,
}

impl OwnerKeyChange {
    /// Length of the encoding, bytes.
    pub const LENGTH: usize = 193;

    /// The owner's change from `old` to `new`, signed by the account.
    ///
    /// # Errors
    /// [`CryptoError::Internal`].
    pub fn sign(domain: &Domain, account: &EoaSecret, old: PublicKey, new: PublicKey) -> Result<Self, CryptoError> {
        let hash = signed_hash(domain, &account.address(), &old, &new);
        Ok(Self { old, new, account_signature: sign_hash(account, &hash)? })
    }

    /// Whether the owner may change the `known` key to this one. The signer of the notice was checked with the record.
    ///
    /// # Errors
    /// [`CryptoError::NotAccepted`] if it replaces a key other than the known one, or the account did not sign it;
    /// [`CryptoError::PublicPoint`].
    pub fn check(
        &self,
        provider: &dyn Provider,
        domain: &Domain,
        owner: &Address,
        known: &PublicKey,
    ) -> Result<(), CryptoError> {
        if self.old != *known || self.new == self.old {
            return Err(CryptoError::NotAccepted { what: WHAT, field: "old key" });
        }
        provider.check_public_key(&self.new)?;
        let signed = recover_account(&signed_hash(domain, owner, &self.old, &self.new), &self.account_signature);
        if signed.is_ok_and(|account| account == *owner) {
            return Ok(());
        }
        Err(CryptoError::NotAccepted { what: WHAT, field: "account's signature" })
    }

    /// Old P_C (64) || new P_C (64) || signature of the account (65).
    pub fn encode(&self) -> Vec<u8> {
        [&self.old.0[..], &self.new.0, &self.account_signature.0].concat()
    }

    /// From its encoding; only the form is checked.
    ///
    /// # Errors
    /// [`WireError`] if it is not exactly [`Self::LENGTH`] bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let change = Self {
            old: PublicKey(reader.array("old key")?),
            new: PublicKey(reader.array("new key")?),
            account_signature: AccountSignature(reader.array("account's signature")?),
        };
        reader.end()?;
        Ok(change)
    }
}

fn signed_hash(domain: &Domain, owner: &Address, old: &PublicKey, new: &PublicKey) -> [u8; 32] {
    TypedStructure::new(TYPE).address(owner).bytes(&old.0).bytes(&new.0).signing_hash(domain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, SmKeyPair, provider};

    #[test]
    fn only_the_owners_account_and_only_from_the_known_key() {
        let provider = provider(ProviderName::RustCrypto);
        let [old, new, other] = [(); 3].map(|()| SmKeyPair::generate(provider).expect("generates").public);
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let (domain, owner) = (Domain([1; 32]), account.address());
        let change = OwnerKeyChange::sign(&domain, &account, old, new).expect("signs");
        assert!(change.check(provider, &domain, &owner, &old).is_ok());
        assert!(change.check(provider, &domain, &owner, &other).is_err(), "a key that is not known");
        assert!(change.check(provider, &domain, &owner, &new).is_err(), "a second time");
        assert!(change.check(provider, &Domain([2; 32]), &owner, &old).is_err(), "of another network");
        assert!(change.check(provider, &domain, &thief.address(), &old).is_err(), "of another owner");
        assert!(OwnerKeyChange { new: other, ..change }.check(provider, &domain, &owner, &old).is_err());
        let forged = OwnerKeyChange::sign(&domain, &thief, old, other).expect("signs");
        assert!(forged.check(provider, &domain, &owner, &old).is_err(), "by another account");
        let nowhere = OwnerKeyChange::sign(&domain, &account, old, PublicKey([7; 64])).expect("signs");
        assert!(nowhere.check(provider, &domain, &owner, &old).is_err(), "no point of the curve");

        let bytes = change.encode();
        assert_eq!((bytes.len(), OwnerKeyChange::parse(&bytes)), (OwnerKeyChange::LENGTH, Ok(change)));
        assert!(OwnerKeyChange::parse(&bytes[1..]).is_err());
        for at in 0..bytes.len() {
            let mut altered = bytes.clone();
            altered[at] ^= 1;
            let altered = OwnerKeyChange::parse(&altered).expect("the form is right");
            assert!(altered.check(provider, &domain, &owner, &old).is_err(), "byte {at}");
        }
    }
}
