//! A gateway's transport keys at rest, sealed under a key derived from its keeper's d_E, which no grant gives away.

use super::derive::kept_key;
use super::random::random_bytes;
use super::{CryptoError, Provider, SmSecret, TransportKey};

/// Bytes of the nonce in front of the ciphertext.
const NONCE: usize = 12;

/// Seals the transport key of a name: nonce (12) || SM4-GCM (32 + 16), with the name as AAD.
///
/// # Errors
/// From the random source.
pub fn seal_transport_key(
    provider: &dyn Provider,
    keeper: &SmSecret,
    name: &str,
    key: &TransportKey,
) -> Result<Vec<u8>, CryptoError> {
    let nonce: [u8; NONCE] = random_bytes()?;
    // Reserved in one piece, tag included: growing the buffer would leave an unwiped copy behind.
    let mut buffer = Vec::with_capacity(TransportKey::LENGTH + 16);
    buffer.extend_from_slice(key.expose());
    provider.gcm_seal(&kept_key(keeper), &nonce, name.as_bytes(), &mut buffer)?;
    Ok([&nonce[..], &buffer].concat())
}

/// Opens what [`seal_transport_key`] sealed for this name.
///
/// # Errors
/// [`CryptoError::BadCiphertext`] if it was sealed for another name, by another keeper, or altered.
pub fn open_transport_key(
    provider: &dyn Provider,
    keeper: &SmSecret,
    name: &str,
    sealed: &[u8],
) -> Result<TransportKey, CryptoError> {
    let (nonce, rest) = sealed.split_first_chunk::<NONCE>().ok_or(CryptoError::BadCiphertext)?;
    let plain = provider.gcm_open(&kept_key(keeper), nonce, name.as_bytes(), rest)?;
    let bytes: &[u8; 32] = plain.as_slice().try_into().map_err(|_| CryptoError::BadCiphertext)?;
    Ok(TransportKey::new(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};

    #[test]
    fn only_the_same_keeper_and_name_open_it() {
        let provider = provider(ProviderName::RustCrypto);
        let [keeper, other] = [1, 2].map(|byte| SmSecret::from_slice(&[byte; 32]).expect("in range"));
        let key = TransportKey::new([3; 32]);
        let sealed = seal_transport_key(provider, &keeper, "robot-1", &key).expect("seals");
        assert_eq!(open_transport_key(provider, &keeper, "robot-1", &sealed).expect("opens").expose(), key.expose());
        assert!(open_transport_key(provider, &keeper, "robot-2", &sealed).is_err());
        assert!(open_transport_key(provider, &other, "robot-1", &sealed).is_err());
        for place in 0..sealed.len() {
            let mut changed = sealed.clone();
            changed[place] ^= 1;
            assert!(open_transport_key(provider, &keeper, "robot-1", &changed).is_err());
            assert!(open_transport_key(provider, &keeper, "robot-1", &sealed[..place]).is_err());
        }
        assert!(!crate::model::bytes::hex(&sealed).contains(&crate::model::bytes::hex(key.expose())));
    }
}
