//! Compares the providers with each other on random inputs.

use proptest::collection::vec;
use proptest::prelude::*;

use crate::model::{PublicKey, Signature};

use super::der::CipherParts;
use super::{Provider, ProviderName, SmSecret, provider};

fn all() -> [&'static dyn Provider; 3] {
    ProviderName::ALL.map(provider)
}

/// Every provider with every other.
fn pairs() -> Vec<(&'static dyn Provider, &'static dyn Provider)> {
    let others = |one: usize| (1..3).map(move |step| (all()[one], all()[(one + step) % 3]));
    (0..3).flat_map(others).collect()
}

fn secret(bytes: [u8; 32]) -> Option<SmSecret> {
    SmSecret::from_slice(&bytes).ok()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn public_keys_are_equal(bytes in any::<[u8; 32]>()) {
        prop_assume!(secret(bytes).is_some());
        // A secret caches its public key, so each provider gets its own copy.
        let [ours, one, other] = all().map(|provider| {
            let secret = secret(bytes).expect("in range");
            provider.public_key(&secret).expect("point")
        });
        prop_assert_eq!(one, other);
        prop_assert_eq!(ours, other);
    }

    #[test]
    fn each_verifies_what_the_other_signs(bytes in any::<[u8; 32]>(), message in vec(any::<u8>(), 0..200),
                                          at in 0usize..64, bit in 0u8..8) {
        prop_assume!(secret(bytes).is_some());
        for (signer, verifier) in pairs() {
            let secret = secret(bytes).expect("in range");
            let public = signer.public_key(&secret).expect("point");
            let mut signature = signer.sign(&secret, &message).expect("signs");
            prop_assert!(verifier.verify(&public, &message, &signature).is_ok());
            signature.0[at] ^= 1 << bit;
            prop_assert!(verifier.verify(&public, &message, &signature).is_err());
            prop_assert!(signer.verify(&public, &message, &signature).is_err());
        }
    }

    #[test]
    fn each_decrypts_what_the_other_encrypts(bytes in any::<[u8; 32]>(), plain in vec(any::<u8>(), 1..300),
                                             at in any::<prop::sample::Index>(), bit in 0u8..8) {
        prop_assume!(secret(bytes).is_some());
        for (sender, receiver) in pairs() {
            let secret = secret(bytes).expect("in range");
            let public = sender.public_key(&secret).expect("point");
            let mut der = sender.encrypt(&public, &plain).expect("encrypts");
            prop_assert_eq!(&**receiver.decrypt(&secret, &der).expect("decrypts"), &plain[..]);
            prop_assert_eq!(CipherParts::parse(&der).expect("parses").encode(), der.clone());
            let at = at.index(der.len());
            der[at] ^= 1 << bit;
            prop_assert!(receiver.decrypt(&secret, &der).is_err());
            prop_assert!(sender.decrypt(&secret, &der).is_err());
        }
    }

    #[test]
    fn noise_is_refused_alike(der in vec(any::<u8>(), 0..200), point in any::<[[u8; 32]; 2]>(),
                              raw in any::<[[u8; 32]; 2]>()) {
        let secret = secret([7; 32]).expect("in range");
        let public = PublicKey(point.concat().try_into().expect("64"));
        let signature = Signature(raw.concat().try_into().expect("64"));
        for provider in all() {
            prop_assert!(provider.decrypt(&secret, &der).is_err());
            prop_assert!(provider.check_public_key(&public).is_err());
            prop_assert!(provider.verify(&public, b"x", &signature).is_err());
            let own = provider.public_key(&secret).expect("point");
            prop_assert!(provider.verify(&own, b"x", &signature).is_err());
        }
    }
}

proptest! {
    #[test]
    fn hashes_are_equal(parts in vec(vec(any::<u8>(), 0..150), 0..4)) {
        let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
        let [ours, one, other] = all().map(|provider| provider.sm3(&parts));
        prop_assert_eq!((ours, one), (other, other));
        prop_assert_eq!(ours, all()[0].sm3(&[&parts.concat()]));
    }

    #[test]
    fn sealed_bytes_are_equal_and_any_change_is_refused(
        key in any::<[u8; 16]>(), nonce in any::<[u8; 12]>(), aad in vec(any::<u8>(), 0..70),
        plain in vec(any::<u8>(), 0..200), at in any::<prop::sample::Index>(), bit in 0u8..8,
    ) {
        let [one, second, other] = all().map(|provider| {
            let mut sealed = plain.clone();
            provider.gcm_seal(&key, &nonce, &aad, &mut sealed).expect("seals");
            sealed
        });
        prop_assert_eq!((&one, &second), (&other, &other));
        prop_assert_eq!(one.len(), plain.len() + 16);
        let mut altered = one.clone();
        altered[at.index(one.len())] ^= 1 << bit;
        let mut other_nonce = nonce;
        other_nonce[at.index(12)] ^= 1 << bit;
        for provider in all() {
            prop_assert_eq!(&**provider.gcm_open(&key, &nonce, &aad, &one).expect("opens"), &plain[..]);
            prop_assert!(provider.gcm_open(&key, &nonce, &aad, &altered).is_err());
            prop_assert!(provider.gcm_open(&key, &other_nonce, &aad, &one).is_err());
            prop_assert!(provider.gcm_open(&key, &nonce, &[&aad[..], &[0]].concat(), &one).is_err());
            prop_assert!(provider.gcm_open(&key, &nonce, &aad, &one[..one.len() - 1]).is_err());
        }
    }
}

#[test]
fn every_length_to_two_hundred_round_trips_across() {
    let [one, _, other] = all();
    for length in 0..=200u8 {
        let plain: Vec<u8> = (0..length).collect();
        let mut sealed = plain.clone();
        one.gcm_seal(&[length; 16], &[1; 12], b"aad", &mut sealed).expect("seals");
        assert_eq!(&**other.gcm_open(&[length; 16], &[1; 12], b"aad", &sealed).expect("opens"), &plain[..]);
    }
}

#[test]
fn texts_of_many_kilobytes_are_wrapped_alike() {
    let secret = SmSecret::from_slice(&[7; 32]).expect("in range");
    let plain: Vec<u8> = (0..60_000u32).map(|number| number.to_be_bytes()[3]).collect();
    for (sender, receiver) in pairs() {
        let public = sender.public_key(&secret).expect("point");
        let der = sender.encrypt(&public, &plain).expect("encrypts");
        assert_eq!(&**receiver.decrypt(&secret, &der).expect("decrypts"), &plain[..]);
    }
}
