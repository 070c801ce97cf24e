//! Signatures of an externally owned account over typed data (EIP-712), and the address that signed.

use k256::ecdsa::{RecoveryId, Signature, SigningKey, VerifyingKey};
use sha3::{Digest as _, Keccak256};

use crate::model::{Address, Domain};

use super::{CryptoError, EoaSecret};

/// Keccak-256 of the concatenation of `parts`.
pub fn keccak256(parts: &[&[u8]]) -> [u8; 32] {
    let mut hasher = Keccak256::new();
    for part in parts {
        hasher.update(part);
    }
    hasher.finalize().into()
}

/// r || s || v of secp256k1, v 27 or 28, as Ethereum writes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AccountSignature(pub [u8; 65]);

impl AccountSignature {
    /// Length in bytes.
    pub const LENGTH: usize = 65;
}

/// The hash of a structure of EIP-712: its type, then its members, each encoded in 32 bytes.
#[derive(Debug, Clone)]
pub struct TypedStructure(Vec<u8>);

impl TypedStructure {
    /// Begins with the hash of the type, written as `Name(type member,...)`.
    pub fn new(kind: &str) -> Self {
        Self(keccak256(&[kind.as_bytes()]).to_vec())
    }

    /// A `bytes32`.
    #[must_use]
    pub fn word(mut self, word: &[u8; 32]) -> Self {
        self.0.extend_from_slice(word);
        self
    }

    /// A `bytes` or a `string`, as its hash.
    #[must_use]
    pub fn bytes(self, bytes: &[u8]) -> Self {
        let hash = keccak256(&[bytes]);
        self.word(&hash)
    }

    /// An `address`.
    #[must_use]
    pub fn address(self, address: &Address) -> Self {
        let mut word = [0; 32];
        word[12..].copy_from_slice(&address.0);
        self.word(&word)
    }

    /// A `uint64` or smaller.
    #[must_use]
    pub fn number(self, number: u64) -> Self {
        let mut word = [0; 32];
        word[24..].copy_from_slice(&number.to_be_bytes());
        self.word(&word)
    }

    /// What the account signs: keccak256(0x19 0x01 || domain separator || structure). The separator is that
    /// of `EIP712Domain(string name,string version,bytes32 salt)`: AuthROS, 1, the network's domain.
    pub fn signing_hash(&self, domain: &Domain) -> [u8; 32] {
        let separator = Self::new("EIP712Domain(string name,string version,bytes32 salt)")
            .bytes(b"AuthROS")
            .bytes(b"1")
            .word(&domain.0);
        keccak256(&[&[0x19, 0x01], &keccak256(&[&separator.0]), &keccak256(&[&self.0])])
    }
}

/// Signs a 32-byte hash; s is in the lower half, as Ethereum demands.
///
/// # Errors
/// [`CryptoError::Internal`] if the algorithm fails.
pub fn sign_hash(secret: &EoaSecret, hash: &[u8; 32]) -> Result<AccountSignature, CryptoError> {
    let failed = |_| CryptoError::Internal("secp256k1");
    let key = SigningKey::from_slice(secret.expose()).map_err(failed)?;
    let (signature, parity) = key.sign_prehash_recoverable(hash).map_err(failed)?;
    let mut bytes = [0; 65];
    bytes[..64].copy_from_slice(&signature.to_bytes());
    bytes[64] = 27 + u8::from(parity.is_y_odd());
    Ok(AccountSignature(bytes))
}

/// The account whose key signed `hash`.
///
/// # Errors
/// [`CryptoError::BadAccountSignature`] if this is not a signature: r or s out of range, s in the upper half (anyone
/// could flip it), or v neither 27 nor 28.
pub fn recover_account(hash: &[u8; 32], signature: &AccountSignature) -> Result<Address, CryptoError> {
    recovered(hash, signature).ok_or(CryptoError::BadAccountSignature)
}

fn recovered(hash: &[u8; 32], signature: &AccountSignature) -> Option<Address> {
    let parity = match signature.0[64] {
        27 => RecoveryId::new(false, false),
        28 => RecoveryId::new(true, false),
        _ => return None,
    };
    let signature = Signature::from_slice(&signature.0[..64]).ok()?;
    if signature.normalize_s().is_some() {
        return None;
    }
    let key = VerifyingKey::recover_from_prehash(hash, &signature, parity).ok()?;
    let point = key.to_encoded_point(false);
    point.as_bytes().get(1..)?.try_into().ok().map(Address::from_public_key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ethers::types::transaction::eip712::{Eip712, TypedData};
    use proptest::prelude::*;

    fn secret(byte: u8) -> EoaSecret {
        EoaSecret::from_slice(&[byte; 32]).expect("in range")
    }

    #[test]
    fn typed_data_hashes_as_another_implementation_hashes_it() {
        let domain = Domain([7; 32]);
        let json = serde_json::json!({
            "types": {
                "EIP712Domain": [
                    {"name": "name", "type": "string"}, {"name": "version", "type": "string"},
                    {"name": "salt", "type": "bytes32"}],
                "Example": [
                    {"name": "id", "type": "bytes32"}, {"name": "text", "type": "string"},
                    {"name": "data", "type": "bytes"}, {"name": "account", "type": "address"},
                    {"name": "count", "type": "uint8"}],
            },
            "primaryType": "Example",
            "domain": {"name": "AuthROS", "version": "1", "salt": domain.0},
            "message": {
                "id": format!("0x{}", "05".repeat(32)), "text": "robot-1", "data": "0x010203",
                "account": Address([9; 20]).to_string(), "count": 2},
        });
        let other: TypedData = serde_json::from_value(json).expect("typed data");
        let ours = TypedStructure::new("Example(bytes32 id,string text,bytes data,address account,uint8 count)")
            .word(&[5; 32])
            .bytes(b"robot-1")
            .bytes(&[1, 2, 3])
            .address(&Address([9; 20]))
            .number(2);
        assert_eq!(ours.signing_hash(&domain), other.encode_eip712().expect("hashes"));
    }

    #[test]
    fn the_other_half_of_s_and_other_parities_are_refused() {
        let hash = [3; 32];
        let signature = sign_hash(&secret(5), &hash).expect("signs");
        assert_eq!(recover_account(&hash, &signature).expect("recovers"), secret(5).address());
        let high = Signature::from_slice(&signature.0[..64]).expect("valid");
        let (r, s) = high.split_scalars();
        let turned = Signature::from_scalars(r.to_bytes(), (-s).to_bytes()).expect("valid");
        let mut other = signature;
        other.0[..64].copy_from_slice(&turned.to_bytes());
        other.0[64] = 55 - other.0[64];
        assert!(matches!(recover_account(&hash, &other), Err(CryptoError::BadAccountSignature)));
        for parity in [0, 1, 26, 29, 255] {
            let mut other = signature;
            other.0[64] = parity;
            assert!(recover_account(&hash, &other).is_err());
        }
        for bad in [[0; 65], [0xff; 65]] {
            assert!(recover_account(&hash, &AccountSignature(bad)).is_err());
        }
    }

    proptest! {
        #[test]
        fn a_flipped_bit_never_recovers_the_signer(hash: [u8; 32], at in 0usize..65, bit in 0u8..8) {
            let mut signature = sign_hash(&secret(5), &hash).expect("signs");
            signature.0[at] ^= 1 << bit;
            prop_assert_ne!(recover_account(&hash, &signature).ok(), Some(secret(5).address()));
        }
    }
}
