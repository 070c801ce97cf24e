//! Signatures and encryption compared with the standard's examples, the crate and libsm, and the tables kept for
//! signers.

mod signers;
mod timing;

use sm2::dsa::signature::hazmat::RandomizedPrehashSigner as _;
use sm2::dsa::signature::rand_core::{TryCryptoRng, TryRng};

use super::{encrypt_with, hash, za, *};
use crate::der::CipherParts;
use crate::kernel::sm2::{Scalar, multiply_generator};
use crate::kernel::tests::Noise;
use crate::model::Signature;
use crate::model::bytes::unhex;
use crate::{Provider, ProviderName, SmSecret, provider};

const D: &str = "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8";
const K: &str = "59276e27d506861a16680f3ad9c02dccef3cc1fa3cdbe4ce6d54b80deac1bc21";
const ZA: &str = "b2e14c5c79c6df5b85f4fe7ed8db7a262b9da7e07ccb0ea9f4747b8ccda8a4f3";
const E: &str = "f0b43e94ba45accaace692ed534382eb17e6ab5a19ce7b31f4486fdfc0d28640";
const SIGNATURE: &str = "f5a03b0648d2c4630eeac513e1bb81a15944da3827d5b74143ac7eaceee720b3\
                         b1b6aa29df212fd8763182bc0d421ca1bb9038fd1f7f42d4840b69c485bbc1aa";
const C1: &str = "04ebfc718e8d1798620432268e77feb6415e2ede0e073c0f4f640ecd2e149a73\
                  e858f9d81e5430a57b36daab8f950a3c64e6ee6a63094d99283aff767e124df0";
const C2: &str = "21886ca989ca9c7d58087307ca93092d651efa";
const C3: &str = "59983c18f809e262923c53aec295d30383b54e39d609d160afcb1908d0bd8766";
const N: &str = "fffffffeffffffffffffffffffffffff7203df6b21c6052b53bbf40939d54123";

fn bytes<const SIZE: usize>(text: &str) -> [u8; SIZE] {
    unhex(text).expect("hex").try_into().expect("length")
}

fn long() -> bool {
    std::env::var_os("AUTHROS_LONG").is_some()
}

fn key(noise: &mut Noise) -> ([u8; 32], SigningKey) {
    loop {
        let secret = noise.array();
        if let Ok(key) = SigningKey::new(&secret) {
            return (secret, key);
        }
    }
}

fn scalar(text: &str) -> Scalar {
    Scalar::from_bytes(&bytes(text)).expect("in range")
}

#[test]
fn the_standards_signature_comes_of_its_nonce() {
    let key = SigningKey::new(&bytes(D)).expect("in range");
    assert_eq!(za(key.public()), bytes(ZA));
    let e = hash(&za(key.public()), b"message digest");
    assert_eq!(e.to_bytes(), bytes(E));
    assert_eq!(key.sign_with(&e, &scalar(K)), Some(Signature(bytes(SIGNATURE))));
    verify_as_stranger(key.public(), b"message digest", &Signature(bytes(SIGNATURE))).expect("valid");
}

#[test]
fn the_standards_ciphertext_comes_of_its_number() {
    let public = *SigningKey::new(&bytes(D)).expect("in range").public();
    let parts = encrypt_with(&scalar(K), &point(&public).expect("a point"), b"encryption standard").expect("masked");
    let (x, y) = (bytes(&C1[..64]), bytes(&C1[64..]));
    assert_eq!(parts, CipherParts { x, y, check: bytes(C3), text: unhex(C2).expect("hex") });
    assert_eq!(&**decrypt(&bytes(D), parts).expect("opens"), b"encryption standard");
}

/// Returns the same bytes every time.
struct Fixed([u8; 32]);

impl TryRng for Fixed {
    type Error = std::convert::Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
        unreachable!("only bytes are asked for")
    }

    fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
        unreachable!("only bytes are asked for")
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Self::Error> {
        bytes.copy_from_slice(&self.0[..bytes.len()]);
        Ok(())
    }
}

impl TryCryptoRng for Fixed {}

/// The same key, message and random bytes give the same nonce, and so the same signature, as the crate.
#[test]
fn nonces_are_those_of_the_crate() {
    let mut noise = Noise(31);
    for case in 0..if long() { 100_000 } else { 500 } {
        let (secret, key) = key(&mut noise);
        let random = noise.array();
        let length = noise.below(200);
        let message = noise.bytes(length);
        let theirs = provider::signing_key(&secret).expect("in range");
        let prehash = crate::sm3::sm3(&[&za(key.public()), &message]);
        let expected = theirs.sign_prehash_with_rng(&mut Fixed(random), &prehash).expect("signs");
        assert_eq!(key.sign(&message, &random).0, <[u8; 64]>::from(expected.to_bytes()), "case {case}");
    }
}

fn others() -> [&'static dyn Provider; 2] {
    [provider(ProviderName::RustCrypto), provider(ProviderName::Libsm)]
}

#[test]
fn each_verifies_what_the_other_signs_and_nothing_altered() {
    let mut noise = Noise(32);
    let (cases, [fast, slow]) = (if long() { 1_000_000 } else { 1_500 }, others());
    for case in 0..cases {
        let (secret, key) = key(&mut noise);
        let length = noise.below(200);
        let message = noise.bytes(length);
        let theirs = SmSecret::from_slice(&secret).expect("in range");
        let other = if case % 16 == 0 { slow } else { fast };
        let own = key.sign(&message, &noise.array());
        other.verify(key.public(), &message, &own).expect("ours is valid");
        let mut signature = other.sign(&theirs, &message).expect("signs");
        verify(key.public(), &message, &signature).expect("theirs is valid");
        signature.0[noise.below(64)] ^= 1 << noise.below(8);
        assert!(verify(key.public(), &message, &signature).is_err(), "case {case}");
    }
}

/// Every bit of key, message and signature; as an unknown signer and with the signer's table.
#[test]
fn every_bit_counts() {
    let mut noise = Noise(33);
    let (_, key) = key(&mut noise);
    let (public, message) = (*key.public(), noise.bytes(24));
    let signature = key.sign(&message, &noise.array());
    let both = |public: &PublicKey, message: &[u8], signature: &Signature| {
        let verdicts = [verify(public, message, signature), verify_as_stranger(public, message, signature)];
        let verdicts = verdicts.map(|verdict| verdict.is_ok());
        assert_eq!(verdicts[0], verdicts[1]);
        verdicts[0]
    };
    for _ in 0..4 {
        assert!(both(&public, &message, &signature));
    }
    for bit in 0..512 {
        let mut other = signature;
        other.0[bit / 8] ^= 1 << (bit % 8);
        assert!(!both(&public, &message, &other), "bit {bit} of the signature");
        let mut other = public;
        other.0[bit / 8] ^= 1 << (bit % 8);
        assert!(!both(&other, &message, &signature), "bit {bit} of the key");
    }
    for bit in 0..8 * message.len() {
        let mut other = message.clone();
        other[bit / 8] ^= 1 << (bit % 8);
        assert!(!both(&public, &other, &signature), "bit {bit} of the message");
    }
}

/// 0, 1, 2, n - 2 to n + 1, and the largest; the parts of a valid signature, and values that make r + s = n.
#[test]
fn edges_are_judged_as_by_the_others() {
    let number = |text: &str| bytes::<32>(text);
    let small = |last: u8| {
        let mut number = [0; 32];
        number[31] = last;
        number
    };
    let near = |last: u8| {
        let mut number = number(N);
        number[31] = last;
        number
    };
    let (r, s) = (number(&SIGNATURE[..64]), number(&SIGNATURE[64..]));
    let rest = number("0a5fc4f8b72d3b9cf1153aec1e447e5e18bf0532f9f04dea100f755c4aee2070");
    let edges = [small(0), small(1), small(2), near(0x21), near(0x22), near(0x23), near(0x24), [0xff; 32], r, s, rest];
    let public = *SigningKey::new(&bytes(D)).expect("in range").public();
    let mut valid = 0;
    for one in edges {
        for other in edges {
            let signature = Signature([one, other].concat().try_into().expect("64"));
            let ours = verify(&public, b"message digest", &signature).is_ok();
            for provider in others() {
                assert_eq!(provider.verify(&public, b"message digest", &signature).is_ok(), ours, "{signature:?}");
            }
            valid += usize::from(ours);
        }
    }
    assert_eq!(valid, 1);
}

#[test]
fn secrets_at_the_edges_sign_and_decrypt() {
    let secret = |last: u8, bytes: [u8; 32]| {
        let mut bytes = bytes;
        bytes[31] = last;
        bytes
    };
    for secret in [secret(1, [0; 32]), secret(2, [0; 32]), secret(0x21, bytes(N)), secret(0x20, bytes(N))] {
        let key = SigningKey::new(&secret).expect("in range");
        let signature = key.sign(b"x", &[1; 32]);
        let theirs = SmSecret::from_slice(&secret).expect("in range");
        for provider in others() {
            provider.verify(key.public(), b"x", &signature).expect("valid");
            let sealed = provider.encrypt(key.public(), b"text").expect("encrypts");
            let parts = CipherParts::parse(&sealed).expect("parses");
            assert_eq!(&**decrypt(&secret, parts).expect("opens"), b"text");
            let sealed = encrypt(key.public(), b"text").expect("encrypts").encode();
            assert_eq!(&**provider.decrypt(&theirs, &sealed).expect("opens"), b"text");
        }
    }
    for secret in [[0; 32], secret(0x22, bytes(N)), secret(0x23, bytes(N)), [0xff; 32]] {
        assert!(SigningKey::new(&secret).is_err());
    }
}

#[test]
fn each_opens_what_the_other_encrypts() {
    let mut noise = Noise(34);
    let (cases, [fast, slow]) = (if long() { 100_000 } else { 300 }, others());
    for case in 0..cases {
        let (secret, key) = key(&mut noise);
        let theirs = SmSecret::from_slice(&secret).expect("in range");
        let length = 1 + noise.below(300);
        let plain = noise.bytes(length);
        let other = if case % 16 == 0 { slow } else { fast };
        let ours = encrypt(key.public(), &plain).expect("encrypts");
        assert_eq!(**other.decrypt(&theirs, &ours.encode()).expect("opens"), plain[..], "case {case}");
        let mut parts = CipherParts::parse(&other.encrypt(key.public(), &plain).expect("encrypts")).expect("parses");
        assert_eq!(**decrypt(&secret, parts.clone()).expect("opens"), plain[..], "case {case}");
        match noise.below(4) {
            0 => parts.x[noise.below(32)] ^= 1 << noise.below(8),
            1 => parts.y[noise.below(32)] ^= 1 << noise.below(8),
            2 => parts.check[noise.below(32)] ^= 1 << noise.below(8),
            _ => parts.text[noise.below(length)] ^= 1 << noise.below(8),
        }
        assert!(decrypt(&secret, parts).is_err(), "case {case}");
    }
}

#[test]
fn what_two_agree_upon_is_what_the_crate_makes_of_it() {
    use sm2::elliptic_curve::point::AffineCoordinates as _;
    let mut noise = Noise(35);
    for _ in 0..100 {
        let ((one, first), (other, second)) = (key(&mut noise), key(&mut noise));
        let shared = shared_x(&one, second.public()).expect("agrees");
        assert_eq!(shared, shared_x(&other, first.public()).expect("agrees"));
        let number = sm2::NonZeroScalar::try_from(&one[..]).expect("in range");
        let theirs = provider::point(second.public()).expect("a point").to_projective() * *number;
        assert_eq!(shared[..], theirs.to_affine().x()[..]);
    }
    let off = PublicKey(multiply_generator(&Scalar::ONE).to_bytes().map(|byte| byte ^ 1));
    assert!(matches!(shared_x(&[1; 32], &off), Err(CryptoError::PublicPoint)));
}
