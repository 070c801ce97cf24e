//! The proof that an identity registered on the chain was made by the holder of its keys. The contract cannot verify
//! SM2, so every client does, and treats an identity without a valid proof as unregistered.

use crate::model::{Address, Domain, Identity, PublicKey, Token};

use super::{CryptoError, Provider, SmKeyPair};

/// An identity with its proof: an SM2 signature by d_C over label, domain, address, P_C, P_E and token.
///
/// # Errors
/// [`CryptoError::PublicPoint`] if P_E is not a point, [`CryptoError::Random`].
pub fn prove(
    provider: &dyn Provider,
    domain: &Domain,
    address: &Address,
    signing: &SmKeyPair,
    envelope: &PublicKey,
    token: Token,
) -> Result<Identity, CryptoError> {
    provider.check_public_key(envelope)?;
    let message = signed_bytes(domain, address, &signing.public, envelope, &token);
    let proof = provider.sign(&signing.secret, &message)?;
    Ok(Identity { token, signing: signing.public, envelope: *envelope, proof })
}

/// Checks an identity read from the chain: both keys are points, they differ, and the proof is valid.
///
/// # Errors
/// [`CryptoError::PublicPoint`], [`CryptoError::BadSignature`], or [`CryptoError::NotAccepted`] if one key is used for
/// both purposes.
pub fn check_identity(
    provider: &dyn Provider,
    domain: &Domain,
    address: &Address,
    identity: &Identity,
) -> Result<(), CryptoError> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};
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
