use std::sync::LazyLock;

use proptest::prelude::*;

use super::*;
use crate::model::{Address, Timestamp};
use crate::{ProviderName, provider};

static PAIRS: LazyLock<[SmKeyPair; 2]> = LazyLock::new(|| {
    let provider = provider(ProviderName::RustCrypto);
    [(); 2].map(|()| SmKeyPair::generate(provider).expect("pair"))
});

const DOMAIN: Domain = Domain([1; 32]);

fn terms(scope: Scope) -> GrantTerms {
    let expiry = Some(Timestamp(5_000_000_000));
    GrantTerms { owner: Address([2; 20]), grantee: Address([3; 20]), epoch: 4, expiry, scope }
}

fn all() -> WrappedKeys {
    let epochs = vec![(3, EpochKey::new([7; 32])), (4, EpochKey::new([8; 32]))];
    WrappedKeys { terms: terms(Scope::All), keys: GrantedKeys::All { epochs, index_key: IndexKey::new([9; 32]) } }
}

fn scoped(topics: u8, epochs: u64) -> WrappedKeys {
    let ids: Vec<TopicId> = (0..topics).map(|number| TopicId([number; 16])).collect();
    let entry = |epoch, number: u8| (epoch, format!("/t{number}"), TopicId([number; 16]), TopicKey::new([number; 32]));
    let keys = (0..epochs).flat_map(|back| (0..topics).map(move |number| entry(4 - back, number))).collect();
    WrappedKeys { terms: terms(Scope::Topics(ids)), keys: GrantedKeys::Topics { keys } }
}

fn wrap_with(name: ProviderName, wrapped: &WrappedKeys) -> Vec<u8> {
    let [owner, grantee] = &*PAIRS;
    wrap(provider(name), &DOMAIN, wrapped, owner, &grantee.public).expect("wraps")
}

fn unwrap_with(name: ProviderName, envelope: &[u8], expected: &GrantTerms) -> Result<WrappedKeys> {
    let [owner, grantee] = &*PAIRS;
    unwrap(provider(name), &DOMAIN, envelope, expected, &owner.public, &grantee.secret)
}

#[test]
fn wrapped_by_one_provider_unwrapped_by_the_other() {
    let [one, second, third] = ProviderName::ALL;
    for [sender, receiver] in [[one, second], [second, one], [one, third], [third, one]] {
        for wrapped in [all(), scoped(1, 1), scoped(32, 4)] {
            let envelope = wrap_with(sender, &wrapped);
            assert!(envelope.len() <= LARGEST_ENVELOPE);
            assert_eq!(unwrap_with(receiver, &envelope, &wrapped.terms).expect("unwraps"), wrapped);
        }
    }
}

#[test]
fn another_version_is_refused() {
    for version in [0, 2, 255] {
        let mut envelope = wrap_with(ProviderName::RustCrypto, &all());
        envelope[0] = version;
        assert!(matches!(parts(&envelope), Err(WireError::Value("version"))), "{version}");
    }
}

#[test]
fn an_open_end_is_kept() {
    let mut wrapped = all();
    wrapped.terms.expiry = None;
    let envelope = wrap_with(ProviderName::RustCrypto, &wrapped);
    assert_eq!(unwrap_with(ProviderName::RustCrypto, &envelope, &wrapped.terms).expect("unwraps"), wrapped);
}

#[test]
fn every_term_must_be_what_the_chain_says() {
    let wrapped = all();
    let envelope = wrap_with(ProviderName::RustCrypto, &wrapped);
    let base = || wrapped.terms.clone();
    for (expected, field) in [
        (GrantTerms { owner: Address([0; 20]), ..base() }, "owner"),
        (GrantTerms { grantee: Address([0; 20]), ..base() }, "grantee"),
        (GrantTerms { epoch: 5, ..base() }, "epoch"),
        (GrantTerms { expiry: None, ..base() }, "expiry"),
        (GrantTerms { scope: Scope::Topics(vec![]), ..base() }, "scope"),
    ] {
        let refused = unwrap_with(ProviderName::RustCrypto, &envelope, &expected);
        assert!(matches!(refused, Err(CryptoError::NotAccepted { field: found, .. }) if found == field), "{field}");
    }
}

#[test]
fn other_networks_signers_and_readers_are_refused() {
    let wrapped = all();
    let envelope = wrap_with(ProviderName::RustCrypto, &wrapped);
    let [owner, grantee] = &*PAIRS;
    let provider = provider(ProviderName::RustCrypto);
    let attempt = |domain, owner: &SmKeyPair, grantee: &SmKeyPair| {
        unwrap(provider, &domain, &envelope, &wrapped.terms, &owner.public, &grantee.secret)
    };
    assert!(attempt(DOMAIN, owner, grantee).is_ok());
    assert!(matches!(attempt(Domain([0; 32]), owner, grantee), Err(CryptoError::BadSignature)));
    assert!(matches!(attempt(DOMAIN, grantee, grantee), Err(CryptoError::BadSignature)));
    assert!(matches!(attempt(DOMAIN, owner, owner), Err(CryptoError::BadCiphertext)));
}

/// The chain shows every envelope to everyone: copying one into a grant of one's own shares nothing.
#[test]
fn an_envelope_copied_into_another_grant_opens_for_nobody() {
    let wrapped = all();
    let envelope = wrap_with(ProviderName::RustCrypto, &wrapped);
    let [owner, grantee] = &*PAIRS;
    let provider = provider(ProviderName::RustCrypto);
    let [thief, friend] = [(); 2].map(|()| SmKeyPair::generate(provider).expect("pair"));
    let (theirs, stranger) = (Address([0x70; 20]), Address([0x71; 20]));
    let terms = |owner, grantee| GrantTerms { owner, grantee, ..wrapped.terms.clone() };
    let read = |terms: &GrantTerms, signer: &SmKeyPair, reader: &SmKeyPair| {
        unwrap(provider, &DOMAIN, &envelope, terms, &signer.public, &reader.secret)
    };
    assert!(read(&wrapped.terms, owner, grantee).is_ok());
    // In the thief's own grant the chain names the thief, whose key signed nothing. He tries a friend, himself, and the
    // very reader it was wrapped for.
    for (reader, address) in [(&friend, stranger), (&thief, theirs), (grantee, wrapped.terms.grantee)] {
        assert!(matches!(read(&terms(theirs, address), &thief, reader), Err(CryptoError::BadSignature)));
    }
    // In another grant of the same owner: others lack d_E, and the reader sees another grant's terms.
    assert!(matches!(read(&terms(wrapped.terms.owner, stranger), owner, &friend), Err(CryptoError::BadCiphertext)));
    let other_terms = [
        terms(wrapped.terms.owner, stranger),
        GrantTerms { epoch: 5, ..wrapped.terms.clone() },
        GrantTerms { expiry: None, ..wrapped.terms.clone() },
    ];
    for terms in other_terms {
        assert!(matches!(read(&terms, owner, grantee), Err(CryptoError::NotAccepted { .. })), "{terms:?}");
    }
    // Re-signed by the thief, the terms inside still name the owner.
    let mut resigned = envelope[..envelope.len() - 64].to_vec();
    let signature = provider.sign(&thief.secret, &signed_bytes(&DOMAIN, &resigned)).expect("signs");
    resigned.extend_from_slice(&signature.0);
    let outcome = |reader: &SmKeyPair, terms: &GrantTerms| {
        unwrap(provider, &DOMAIN, &resigned, terms, &thief.public, &reader.secret)
    };
    let to_reader = outcome(grantee, &terms(theirs, wrapped.terms.grantee));
    assert!(matches!(to_reader, Err(CryptoError::NotAccepted { field: "owner", .. })));
    assert!(matches!(outcome(&friend, &terms(theirs, stranger)), Err(CryptoError::BadCiphertext)));
}

#[test]
fn keys_that_do_not_fit_their_terms_are_not_wrapped() {
    let [owner, grantee] = &*PAIRS;
    let provider = provider(ProviderName::RustCrypto);
    let index_key = IndexKey::new([9; 32]);
    let key = || EpochKey::new([7; 32]);
    let epochs = |numbers: &[u64]| GrantedKeys::All {
        epochs: numbers.iter().map(|number| (*number, key())).collect(),
        index_key: index_key.clone(),
    };
    let topic = |name: &str, id| GrantedKeys::Topics {
        keys: vec![(4, name.into(), TopicId([id; 16]), TopicKey::new([1; 32]))],
    };
    let one = || Scope::Topics(vec![TopicId([1; 16])]);
    for (scope, keys) in [
        (Scope::All, epochs(&[])),
        (Scope::All, epochs(&[3])),
        (Scope::All, epochs(&[4, 5])),
        (Scope::All, epochs(&[4, 4])),
        (Scope::All, epochs(&[0, 4])),
        (one(), epochs(&[4])),
        (Scope::All, topic("/a", 1)),
        (one(), topic("/a", 2)),
        (one(), topic("not a name", 1)),
        (Scope::Topics(vec![TopicId([1; 16]); 33]), topic("/a", 1)),
    ] {
        let wrapped = WrappedKeys { terms: terms(scope), keys };
        let refused = wrap(provider, &DOMAIN, &wrapped, owner, &grantee.public);
        assert!(matches!(refused, Err(CryptoError::Inconsistent(_))), "{wrapped:?}");
    }
}

#[test]
fn too_many_keys_are_refused_with_the_limit() {
    let mut wrapped = all();
    let epochs = (1..=3000).map(|number| (number, EpochKey::new([7; 32]))).collect();
    wrapped.terms.epoch = 3000;
    wrapped.keys = GrantedKeys::All { epochs, index_key: IndexKey::new([9; 32]) };
    let [owner, grantee] = &*PAIRS;
    let refused = wrap(provider(ProviderName::RustCrypto), &DOMAIN, &wrapped, owner, &grantee.public);
    assert!(matches!(refused, Err(CryptoError::Length { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_flipped_bit_any_cut_and_any_extension_is_refused(at in any::<prop::sample::Index>(), bit in 0u8..8) {
        let wrapped = all();
        let envelope = wrap_with(ProviderName::RustCrypto, &wrapped);
        let attempt = |bytes: &[u8]| unwrap_with(ProviderName::RustCrypto, bytes, &wrapped.terms);
        let mut altered = envelope.clone();
        altered[at.index(envelope.len())] ^= 1 << bit;
        prop_assert!(attempt(&altered).is_err());
        prop_assert!(attempt(&envelope[..at.index(envelope.len())]).is_err());
        prop_assert!(attempt(&[&envelope[..], &[bit]].concat()).is_err());
    }

    /// Even a signed and sealed body is parsed as untrusted input.
    #[test]
    fn noise_and_altered_bodies_never_panic(noise in proptest::collection::vec(any::<u8>(), 0..400),
                                            at in any::<prop::sample::Index>(), bit in 0u8..8) {
        prop_assert!(parse(&noise).is_err());
        prop_assert!(unwrap_with(ProviderName::RustCrypto, &noise, &all().terms).is_err());
        let mut plain = encode(&DOMAIN, &scoped(3, 2));
        let at = at.index(plain.len());
        plain[at] ^= 1 << bit;
        if let Ok((domain, wrapped)) = parse(&plain) {
            prop_assert_eq!(&*encode(&domain, &wrapped), &*plain);
        }
    }
}
