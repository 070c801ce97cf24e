//! Identities on the chain with the proof of their keys: the contract cannot verify SM2, so every client does.

use std::fmt;

use k256::ecdsa::{RecoveryId, Signature, SigningKey, VerifyingKey};
use sha3::{Digest as _, Keccak256};
use zeroize::Zeroizing;

use crate::model::{Address, Domain, Identity, PublicKey, Token};
use crate::{CryptoError, EoaSecret, Provider, Result, SmKeyPair, SmSecret, sm2};

/// An identity with its proof: an SM2 signature by d_C over label, domain, address, P_C, P_E and token.
/// # Errors
/// [`CryptoError::PublicPoint`] if P_E is not a point, [`CryptoError::Random`].
pub fn prove(
    provider: &dyn Provider,
    domain: &Domain,
    address: &Address,
    signing: &SmKeyPair,
    envelope: &PublicKey,
    token: Token,
) -> Result<Identity> {
    provider.check_public_key(envelope)?;
    let message = signed_bytes(domain, address, &signing.public, envelope, &token);
    let proof = provider.sign(&signing.secret, &message)?;
    Ok(Identity { token, signing: signing.public, envelope: *envelope, proof })
}

/// Checks an identity read from the chain: both keys are points, they differ, and the proof is valid.
/// # Errors
/// `PublicPoint`, `BadSignature`, or [`CryptoError::NotAccepted`] if one key is used for both purposes.
pub fn check_identity(provider: &dyn Provider, domain: &Domain, address: &Address, identity: &Identity) -> Result<()> {
    provider.check_public_key(&identity.signing)?;
    provider.check_public_key(&identity.envelope)?;
    if identity.signing == identity.envelope {
        return Err(CryptoError::NotAccepted { what: "identity", field: "envelope key" });
    }
    let message = signed_bytes(domain, address, &identity.signing, &identity.envelope, &identity.token);
    provider.verify(&identity.signing, &message, &identity.proof)
}

fn signed_bytes(
    domain: &Domain,
    address: &Address,
    signing: &PublicKey,
    envelope: &PublicKey,
    token: &Token,
) -> Vec<u8> {
    [&b"AuthROS/identity/1"[..], &domain.0, &address.0, &signing.0, &envelope.0, &token.0].concat()
}

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

crate::model::layout!(AccountSignature(0));

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
/// # Errors
/// [`CryptoError::Internal`] if the algorithm fails.
pub fn sign_hash(secret: &EoaSecret, hash: &[u8; 32]) -> Result<AccountSignature> {
    let failed = |_| CryptoError::Internal("secp256k1");
    let key = SigningKey::from_slice(secret.expose()).map_err(failed)?;
    let (signature, parity) = key.sign_prehash_recoverable(hash).map_err(failed)?;
    let mut bytes = [0; 65];
    bytes[..64].copy_from_slice(&signature.to_bytes());
    bytes[64] = 27 + u8::from(parity.is_y_odd());
    Ok(AccountSignature(bytes))
}

/// The account whose key signed `hash`.
/// # Errors
/// [`CryptoError::BadAccountSignature`]: r or s out of range, s in the upper half (malleable), or v not 27 or 28.
pub fn recover_account(hash: &[u8; 32], signature: &AccountSignature) -> Result<Address> {
    recovered(hash, signature).ok_or(CryptoError::BadAccountSignature)
}

pub(crate) fn check_account(
    hash: &[u8; 32],
    signature: &AccountSignature,
    account: &Address,
    what: &'static str,
) -> Result<()> {
    let is_signed = recovered(hash, signature) == Some(*account);
    if is_signed { Ok(()) } else { Err(CryptoError::NotAccepted { what, field: "account's signature" }) }
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

// Diffie-Hellman on the SM2 curve with keys of one session. GB/T 32918.3 uses long-lived ones; we sign the transcript.

/// A private key for one session, wiped when it is used or dropped.
pub struct Ephemeral(SmKeyPair);

impl Ephemeral {
    /// Fresh, from the operating system's random source.
    /// # Errors
    /// [`CryptoError::Random`] if that fails.
    pub fn generate(provider: &dyn Provider) -> Result<Self> {
        SmKeyPair::generate(provider).map(Self)
    }

    /// From a secret drawn elsewhere; only test vectors need this.
    /// # Errors
    /// [`CryptoError::Internal`] if the algorithm fails.
    pub fn from_secret(provider: &dyn Provider, secret: SmSecret) -> Result<Self> {
        SmKeyPair::from_secret(provider, secret).map(Self)
    }

    /// The point to send, x || y.
    pub fn public(&self) -> PublicKey {
        self.0.public
    }

    /// The x coordinate of `[d]peer`, 32 bytes big endian, in constant time. Consumes the secret.
    /// # Errors
    /// [`CryptoError::PublicPoint`] if `peer` is not a point of the curve in its canonical encoding.
    pub fn agree(self, peer: &PublicKey) -> Result<Zeroizing<[u8; 32]>> {
        sm2::shared_x(self.0.secret.expose(), peer)
    }
}

impl fmt::Debug for Ephemeral {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Ephemeral({})", self.public())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ProviderName, provider};
    use proptest::prelude::*;

    fn proven(name: ProviderName) -> (Domain, Address, Identity) {
        let provider = provider(name);
        let pairs = [(); 2].map(|()| SmKeyPair::generate(provider).expect("pair"));
        let (domain, address) = (Domain([1; 32]), Address([2; 20]));
        let token = Token([3; 32]);
        let identity = prove(provider, &domain, &address, &pairs[0], &pairs[1].public, token).expect("proves");
        (domain, address, identity)
    }

    #[test]
    fn a_proof_holds_for_its_address_and_network_only() {
        for name in ProviderName::ALL {
            let provider = provider(name);
            let (domain, address, identity) = proven(name);
            check_identity(provider, &domain, &address, &identity).expect("valid");
            assert!(check_identity(provider, &Domain([9; 32]), &address, &identity).is_err());
            assert!(check_identity(provider, &domain, &Address([9; 20]), &identity).is_err());
            let same = Identity { envelope: identity.signing, ..identity };
            assert!(matches!(
                check_identity(provider, &domain, &address, &same),
                Err(CryptoError::NotAccepted { field: "envelope key", .. })
            ));
            let off = Identity { envelope: PublicKey([1; 64]), ..identity };
            assert!(matches!(check_identity(provider, &domain, &address, &off), Err(CryptoError::PublicPoint)));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]
        #[test]
        fn any_flipped_bit_is_refused(at in 0usize..Identity::LENGTH, bit in 0u8..8) {
            let (domain, address, identity) = proven(ProviderName::RustCrypto);
            let mut bytes = identity.encode();
            bytes[at] ^= 1 << bit;
            let altered = Identity::parse(&bytes).expect("any 224 bytes parse");
            prop_assert!(check_identity(provider(ProviderName::RustCrypto), &domain, &address, &altered).is_err());
        }
    }
}

#[cfg(test)]
mod account_tests {
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

#[cfg(test)]
mod agreement_tests {
    use super::*;
    use crate::model::bytes::hex;
    use crate::{ProviderName, provider};

    /// From GB/T 32918.5-2017, annex C: the key pair of the encryption example is as good as any other.
    const STANDARD_SECRET: &str = "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8";

    #[test]
    fn both_sides_agree_and_others_do_not() {
        for name in ProviderName::ALL {
            let provider = provider(name);
            let [one, other, third] = [(); 3].map(|()| Ephemeral::generate(provider).expect("random"));
            let (first, second, stranger) = (one.public(), other.public(), third.public());
            assert_ne!(first, second);
            let secret = one.agree(&second).expect("agrees");
            assert_eq!(secret, other.agree(&first).expect("agrees"));
            assert_ne!(secret, third.agree(&first).expect("agrees"));
            assert_ne!(first, stranger);
        }
    }

    #[test]
    fn the_secret_is_the_x_coordinate_of_the_product() {
        let provider = provider(ProviderName::default());
        let mut one = [0; 32];
        one[31] = 1;
        let one = Ephemeral::from_secret(provider, SmSecret::from_slice(&one).expect("1")).expect("G");
        let bytes = crate::model::bytes::unhex(STANDARD_SECRET).expect("hex");
        let pair = Ephemeral::from_secret(provider, SmSecret::from_slice(&bytes).expect("in range")).expect("pair");
        let point = pair.public();
        assert_eq!(hex(&point.0[..32]), "09f9df311e5421a150dd7d161e4bc5c672179fad1833fc076bb08ff356f35020");
        assert_eq!(one.agree(&point).expect("agrees")[..], point.0[..32]);
    }

    #[test]
    fn what_is_no_point_is_refused() {
        let provider = provider(ProviderName::default());
        let valid = Ephemeral::generate(provider).expect("random").public();
        let mut off = valid;
        off.0[63] ^= 1;
        // x + p encodes the same residue whenever it fits in 32 bytes; it is not canonical and not accepted.
        for bad in [off, PublicKey([0; 64]), PublicKey([0xff; 64])] {
            let ephemeral = Ephemeral::generate(provider).expect("random");
            assert!(matches!(ephemeral.agree(&bad), Err(CryptoError::PublicPoint)), "{bad}");
        }
        assert!(!format!("{:?}", Ephemeral::generate(provider)).contains("secret"));
    }
}
