//! An owner's new SM2 pairs, handed to the holder of its earlier keys: an old backup of the keyring still leads to the
//! newest. Salt (32) || SM4-GCM(d_C || d_E) (80), under a key that only the account's own key gives, all of it encrypted
//! to the P_E that the pairs replace. So d_E alone, exposed, opens no later pair.

use zeroize::Zeroizing;

use super::kdf::{Info, derived};
use super::{CryptoError, EoaSecret, Provider, SmKeyPair, SmSecret, random_bytes};
use crate::model::wire::{Reader, WireError};
use crate::model::{Domain, Identity, PublicKey};

const HAND_OVER: &str = "hand-over of SM2 keys";
const SECRETS: usize = 2 * 32;

fn sealing_key(eoa: &EoaSecret, salt: &[u8; 32], domain: &Domain) -> (Zeroizing<[u8; 16]>, [u8; 12]) {
    let info = Info::new("AuthROS/handover/1").fixed(&domain.0).fixed(&eoa.address().0);
    let bytes = Zeroizing::new(derived::<28>(eoa.expose(), salt, &info));
    let key = Zeroizing::new(std::array::from_fn(|index| bytes[index]));
    (key, std::array::from_fn(|index| bytes[16 + index]))
}

/// What the pairs are bound to: the network, the account, and the public keys in the event that carries them.
fn context(domain: &Domain, eoa: &EoaSecret, signing: &PublicKey, envelope: &PublicKey) -> Vec<u8> {
    [&b"AuthROS/handover/1"[..], &domain.0, &eoa.address().0, &signing.0, &envelope.0].concat()
}

/// Wraps the new (d_C, P_C) and (d_E, P_E) for the P_E that they replace.
///
/// # Errors
/// [`CryptoError::Random`], or [`CryptoError::PublicPoint`] if `former` is not a valid key.
pub fn hand_over(
    provider: &dyn Provider,
    domain: &Domain,
    eoa: &EoaSecret,
    (signing, envelope): (&SmKeyPair, &SmKeyPair),
    former: &PublicKey,
) -> Result<Vec<u8>, CryptoError> {
    let salt: [u8; 32] = random_bytes()?;
    let (key, nonce) = sealing_key(eoa, &salt, domain);
    // Reserved in one piece, tag included: growing the buffer would leave an unwiped copy behind.
    let mut sealed = Zeroizing::new(Vec::with_capacity(SECRETS + 16));
    sealed.extend_from_slice(signing.secret.expose());
    sealed.extend_from_slice(envelope.secret.expose());
    provider.gcm_seal(&key, &nonce, &context(domain, eoa, &signing.public, &envelope.public), &mut sealed)?;
    provider.encrypt(former, &[&salt[..], &sealed].concat())
}

/// The pairs of `identity`, from the envelope in its event: (d_C, P_C) and (d_E, P_E).
///
/// # Errors
/// [`CryptoError::BadCiphertext`] if `former` or `eoa` is not the key it was wrapped for, [`CryptoError::Malformed`], or
/// [`CryptoError::NotAccepted`] if the pairs are not those of `identity`.
pub fn take_over(
    provider: &dyn Provider,
    domain: &Domain,
    eoa: &EoaSecret,
    identity: &Identity,
    envelope: &[u8],
    former: &SmSecret,
) -> Result<(SmKeyPair, SmKeyPair), CryptoError> {
    let opened = provider.decrypt(former, envelope)?;
    let mut reader = Reader::new(&opened);
    let salt = reader.array("salt").map_err(CryptoError::malformed(HAND_OVER))?;
    let (key, nonce) = sealing_key(eoa, &salt, domain);
    let bound = context(domain, eoa, &identity.signing, &identity.envelope);
    let plain = provider.gcm_open(&key, &nonce, &bound, reader.rest())?;
    let (first, second) = plain
        .split_at_checked(32)
        .filter(|(_, second)| second.len() == 32)
        .ok_or(WireError::Value("secrets"))
        .map_err(CryptoError::malformed(HAND_OVER))?;
    let signing = SmKeyPair::from_secret(provider, SmSecret::from_slice(first)?)?;
    let pair = SmKeyPair::from_secret(provider, SmSecret::from_slice(second)?)?;
    if (signing.public, pair.public) == (identity.signing, identity.envelope) {
        Ok((signing, pair))
    } else {
        Err(CryptoError::NotAccepted { what: HAND_OVER, field: "keys" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Signature, Token};
    use crate::{ProviderName, provider};

    struct Change {
        eoa: EoaSecret,
        former: SmKeyPair,
        new: (SmKeyPair, SmKeyPair),
        identity: Identity,
        envelope: Vec<u8>,
    }

    const HOME: Domain = Domain([7; 32]);

    fn change() -> Change {
        let sm2 = provider(ProviderName::RustCrypto);
        let pair = || SmKeyPair::generate(sm2).expect("a pair");
        let (eoa, former, new) = (EoaSecret::generate().expect("a key"), pair(), (pair(), pair()));
        let envelope = hand_over(sm2, &HOME, &eoa, (&new.0, &new.1), &former.public).expect("wrapped");
        let (signing, public) = (new.0.public, new.1.public);
        let identity = Identity { token: Token([1; 32]), signing, envelope: public, proof: Signature([0; 64]) };
        Change { eoa, former, new, identity, envelope }
    }

    #[test]
    fn new_pairs_open_with_the_keys_before_them_and_with_nothing_else() {
        let sm2 = provider(ProviderName::RustCrypto);
        let Change { eoa, former, new, identity, envelope } = change();
        let open = |domain: &Domain, eoa: &EoaSecret, identity: &Identity, secret: &SmSecret| {
            take_over(sm2, domain, eoa, identity, &envelope, secret)
        };
        assert_eq!(open(&HOME, &eoa, &identity, &former.secret).expect("opens"), new);
        let stranger = EoaSecret::generate().expect("a key");
        assert!(open(&HOME, &stranger, &identity, &former.secret).is_err(), "d_E alone is not enough");
        assert!(open(&HOME, &eoa, &identity, &new.1.secret).is_err(), "another d_E");
        assert!(open(&Domain([8; 32]), &eoa, &identity, &former.secret).is_err(), "another network");
        let other = Identity { signing: former.public, ..identity };
        assert!(open(&HOME, &eoa, &other, &former.secret).is_err(), "another identity");
        for length in 0..envelope.len() {
            let cut = take_over(sm2, &HOME, &eoa, &identity, &envelope[..length], &former.secret);
            assert!(cut.is_err(), "{length} bytes");
        }
    }
}
