//! The official vectors of SM2, SM3 and SM4, and the malformed inputs that libsm cannot take, with all providers.

use sm2::Scalar;
use sm2::dsa::signature::hazmat::PrehashVerifier as _;
use sm2::elliptic_curve::ops::Reduce as _;
use sm2::elliptic_curve::point::AffineCoordinates as _;
use sm2::elliptic_curve::{Group as _, PrimeField as _, ProjectivePoint};

use crate::der::{CipherParts, signature_der, signature_from_der};
use crate::gcm::BlockCipher;
use crate::kernel::tests::Sm4Block;
use crate::model::bytes::{hex, unhex};
use crate::model::{PublicKey, Signature};
use crate::{CryptoError, Provider, ProviderName, SmSecret, provider, sm3};

const KEY: &str = "0123456789abcdeffedcba9876543210";
const BLOCKS: &str = "aaaaaaaaaaaaaaaabbbbbbbbbbbbbbbbccccccccccccccccdddddddddddddddd\
                      eeeeeeeeeeeeeeeeffffffffffffffffeeeeeeeeeeeeeeeeaaaaaaaaaaaaaaaa";
const D: &str = "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8";
const P: &str = "09f9df311e5421a150dd7d161e4bc5c672179fad1833fc076bb08ff356f35020\
                 ccea490ce26775a52dc6ea718cc1aa600aed05fbf35e084a6632f6072da9ad13";
const ZA: &str = "b2e14c5c79c6df5b85f4fe7ed8db7a262b9da7e07ccb0ea9f4747b8ccda8a4f3";
const E: &str = "f0b43e94ba45accaace692ed534382eb17e6ab5a19ce7b31f4486fdfc0d28640";
const K: &str = "59276e27d506861a16680f3ad9c02dccef3cc1fa3cdbe4ce6d54b80deac1bc21";
const SIGNATURE: &str = "f5a03b0648d2c4630eeac513e1bb81a15944da3827d5b74143ac7eaceee720b3\
                         b1b6aa29df212fd8763182bc0d421ca1bb9038fd1f7f42d4840b69c485bbc1aa";
const C1: &str = "04ebfc718e8d1798620432268e77feb6415e2ede0e073c0f4f640ecd2e149a73\
                  e858f9d81e5430a57b36daab8f950a3c64e6ee6a63094d99283aff767e124df0";
const CIPHER: &str = "307c022004ebfc718e8d1798620432268e77feb6415e2ede0e073c0f4f640ecd2e149a73\
                      022100e858f9d81e5430a57b36daab8f950a3c64e6ee6a63094d99283aff767e124df0\
                      042059983c18f809e262923c53aec295d30383b54e39d609d160afcb1908d0bd8766\
                      041321886ca989ca9c7d58087307ca93092d651efa";
const N: &str = "fffffffeffffffffffffffffffffffff7203df6b21c6052b53bbf40939d54123";
const FIELD: &str = "fffffffeffffffffffffffffffffffffffffffff00000000ffffffffffffffff";

fn bytes<const SIZE: usize>(text: &str) -> [u8; SIZE] {
    unhex(text).expect("hex").try_into().expect("length")
}

fn all() -> [&'static dyn Provider; 3] {
    ProviderName::ALL.map(provider)
}

fn blocks() -> [Box<dyn BlockCipher>; 2] {
    let key = bytes(KEY);
    [Box::new(Sm4Block::new(&key)), Box::new(provider::Sm4Block::new(&key).expect("key"))]
}

fn secret() -> SmSecret {
    SmSecret::from_slice(&bytes::<32>(D)).expect("in range")
}

#[test]
fn sm3_annex_a() {
    for provider in all() {
        let hash = |text: &[u8]| hex(&provider.sm3(&[text]));
        assert_eq!(hash(b"abc"), "66c7f0f462eeedd9d1f2d46bdc10e4e24167c4875cf2f7a2297da02b8f4ba8e0");
        assert_eq!(hash(&b"abcd".repeat(16)), "debe9ff92275b8a138604889c18e5a4d6fdb70e5387e5765293dcba39c0c5732");
        assert_eq!(hash(b""), "1ab21d8355cfa17f8e61194831e81a8f22bec8c728fefb747ed035eb5082aa2b");
        assert_eq!(provider.sm3(&[b"a", b"", b"bc"]), provider.sm3(&[b"abc"]));
    }
}

#[test]
fn sm4_block_once_and_a_million_times() {
    for cipher in blocks() {
        let mut block: [u8; 16] = bytes(KEY);
        block = cipher.encrypt_block(&block).expect("encrypts");
        assert_eq!(hex(&block), "681edf34d206965e86b3e94f536e4246");
        for _ in 1..1_000_000 {
            block = cipher.encrypt_block(&block).expect("encrypts");
        }
        assert_eq!(hex(&block), "595298c7c6fd271f0402f804c33d3f66");
    }
}

#[test]
fn sm4_counter_and_output_feedback_modes() {
    for cipher in blocks() {
        let mut text = unhex(BLOCKS).expect("hex");
        cipher.apply_counter(bytes(KEY), &mut text).expect("applies");
        assert_eq!(
            hex(&text),
            "c2b4759e78ac3cf43d0852f4e8d5f9fd7256e8a5fcb65a350ee00630912e4449\
             2a0b17e1b85b060d0fba612d8a95831638b361fd5ffacd942f081485a83ca35d"
        );
        let first = cipher.encrypt_block(&bytes(KEY)).expect("encrypts");
        let second = cipher.encrypt_block(&first).expect("encrypts");
        let key: [u8; 16] = bytes(KEY);
        let feedback: Vec<u8> = [first, second].concat().iter().zip(key.repeat(2)).map(|(a, b)| a ^ b).collect();
        assert_eq!(hex(&feedback), "693d9a535bad5bb1786f53d7253a7056f2075d28b5235f58d50027e4177d2bce");
    }
}

#[test]
fn sm4_gcm_of_rfc_8998() {
    let (key, nonce) = (bytes(KEY), bytes("00001234567800000000abcd"));
    let aad = unhex("feedfacedeadbeeffeedfacedeadbeefabaddad2").expect("hex");
    for provider in all() {
        let mut text = unhex(BLOCKS).expect("hex");
        provider.gcm_seal(&key, &nonce, &aad, &mut text).expect("seals");
        assert_eq!(
            hex(&text),
            "17f399f08c67d5ee19d0dc9969c4bb7d5fd46fd3756489069157b282bb200735\
             d82710ca5c22f0ccfa7cbf93d496ac15a56834cbcf98c397b4024a2691233b8d\
             83de3541e4c2b58177e065a9bf7b62ec"
        );
        assert_eq!(hex(&provider.gcm_open(&key, &nonce, &aad, &text).expect("opens")), BLOCKS);
        for length in 0..16 {
            assert!(provider.gcm_open(&key, &nonce, &aad, &text[..length]).is_err(), "{length} bytes");
        }
    }
}

#[test]
fn sm2_signature_of_annex_a() {
    let (public, signature) = (PublicKey(bytes(P)), Signature(bytes(SIGNATURE)));
    for provider in all() {
        assert_eq!(provider.public_key(&secret()).expect("point"), public);
        provider.verify(&public, b"message digest", &signature).expect("valid");
        assert!(provider.verify(&public, b"message digest.", &signature).is_err());
        let own = provider.sign(&secret(), b"message digest").expect("signs");
        provider.verify(&public, b"message digest", &own).expect("valid");
    }
    let der = signature_der(&signature);
    assert_eq!(hex(&der), format!("3046022100{}022100{}", &SIGNATURE[..64], &SIGNATURE[64..]));
    assert_eq!(signature_from_der(&der).expect("parses"), signature);
}

#[test]
fn sm2_za_and_e_of_annex_a() {
    let curve = "fffffffeffffffffffffffffffffffffffffffff00000000fffffffffffffffc\
                 28e9fa9e9d9f5e344d5a9e4bcf6509a7f39789f515ab8f92ddbcbd414d940e93\
                 32c4ae2c1f1981195f9904466a39c9948fe30bbff2660be1715a4589334c74c7\
                 bc3736a2f4f6779c59bdcee36b692153d0a9877cc62a474002df32e52139f0a0";
    let public = PublicKey(bytes(P));
    let id = provider::DISTINGUISHED_ID.as_bytes();
    let za = sm3::sm3(&[&[0, 0x80], id, &unhex(curve).expect("hex"), &public.0]);
    assert_eq!(hex(&za), ZA);
    assert_eq!(hex(&sm3::sm3(&[&za, b"message digest"])), E);
    assert_eq!(hex(&provider::signed_hash(&public, b"message digest").expect("hash")), E);
    let key = provider::signing_key(&bytes(D)).expect("key");
    let signature = sm2::dsa::Signature::from_slice(&bytes::<64>(SIGNATURE)).expect("in range");
    key.verifying_key().verify_prehash(&bytes::<32>(E), &signature).expect("valid");
}

#[test]
fn sm2_signature_and_point_for_the_annex_k() {
    let number = |text| Option::<Scalar>::from(Scalar::from_repr(bytes::<32>(text).into())).expect("in range");
    let point = ProjectivePoint::<sm2::Sm2>::mul_by_generator(&number(K)).to_affine();
    assert_eq!(hex(&point.x()), C1[..64]);
    assert_eq!(hex(&point.y()), C1[64..]);
    let r = Scalar::reduce(&sm2::FieldBytes::from(bytes::<32>(E))) + Scalar::reduce(&point.x());
    let inverse = Option::<Scalar>::from((Scalar::ONE + number(D)).invert()).expect("not zero");
    let s = inverse * (number(K) - r * number(D));
    assert_eq!(hex(&[r.to_bytes(), s.to_bytes()].concat()), SIGNATURE);
}

#[test]
fn sm2_ciphertext_of_annex_c() {
    let der = unhex(CIPHER).expect("hex");
    let parts = CipherParts::parse(&der).expect("parses");
    assert_eq!(hex(&[parts.x, parts.y].concat()), C1);
    assert_eq!(hex(&parts.text), "21886ca989ca9c7d58087307ca93092d651efa");
    assert_eq!(parts.encode(), der);
    for provider in all() {
        assert_eq!(&**provider.decrypt(&secret(), &der).expect("decrypts"), b"encryption standard");
    }
}

#[test]
fn malformed_ciphertexts_are_errors() {
    let good = CipherParts::parse(&unhex(CIPHER).expect("hex")).expect("parses");
    let with = |change: &dyn Fn(&mut CipherParts)| {
        let mut parts = good.clone();
        change(&mut parts);
        parts.encode()
    };
    let whole = unhex(CIPHER).expect("hex");
    let beyond = [&whole[..], &[0]].concat();
    let mut cases: Vec<Vec<u8>> = (0..whole.len()).map(|cut| whole[..cut].to_vec()).collect();
    cases.extend([
        beyond,
        with(&|parts| parts.text.clear()),
        with(&|parts| parts.text.truncate(18)),
        with(&|parts| parts.text.push(0)),
        with(&|parts| parts.check[0] ^= 1),
        with(&|parts| parts.y[31] ^= 1),
        with(&|parts| parts.x = [0; 32]),
        with(&|parts| (parts.x, parts.y) = ([0; 32], [0; 32])),
        with(&|parts| parts.x = bytes(FIELD)),
    ]);
    for provider in all() {
        for der in &cases {
            assert!(provider.decrypt(&secret(), der).is_err(), "{} {}", provider.name(), hex(der));
        }
    }
}

#[test]
fn empty_and_huge_texts_are_not_encrypted() {
    for provider in all() {
        let public = PublicKey(bytes(P));
        for plain in [vec![], vec![0; 1024 * 1024 + 1]] {
            assert!(matches!(provider.encrypt(&public, &plain), Err(CryptoError::Length { .. })));
        }
    }
}

#[test]
fn signatures_out_of_range_are_errors() {
    let (n, zero) = (bytes::<32>(N), [0; 32]);
    let (r, s) = (bytes::<32>(&SIGNATURE[..64]), bytes::<32>(&SIGNATURE[64..]));
    for provider in all() {
        for (r, s) in [(zero, s), (r, zero), (n, s), (r, n), ([0xff; 32], s), (r, [0xff; 32]), (zero, zero)] {
            let signature = Signature([r, s].concat().try_into().expect("64"));
            let verdict = provider.verify(&PublicKey(bytes(P)), b"message digest", &signature);
            assert!(matches!(verdict, Err(CryptoError::BadSignature)), "{}", provider.name());
        }
        // r + s = n makes t zero.
        let rest: [u8; 32] = bytes("0a5fc4f8b72d3b9cf1153aec1e447e5e18bf0532f9f04dea100f755c4aee2070");
        let sum = Signature([r, rest].concat().try_into().expect("64"));
        assert!(provider.verify(&PublicKey(bytes(P)), b"message digest", &sum).is_err());
    }
}

#[test]
fn points_off_the_curve_or_not_canonical_are_errors() {
    let p = bytes::<64>(P);
    let mut off = p;
    off[63] ^= 1;
    // The point with x = 0 exists; x = p is the same number, written beyond the modulus.
    let y: [u8; 32] = bytes("fd4511e81736a60f07e88a83d6cf5a167fae6d1a9c9330e76e232e00f5cdc154");
    let [zero, past, swapped] = [[[0; 32], y].concat(), [bytes(FIELD), y].concat(), [&p[32..], &p[..32]].concat()]
        .map(|point| bytes(&hex(&point)));
    let cases = [off, [0; 64], [0xff; 64], past, swapped];
    for provider in all() {
        provider.check_public_key(&PublicKey(p)).expect("on the curve");
        provider.check_public_key(&PublicKey(zero)).expect("on the curve");
        for point in cases.map(PublicKey) {
            assert!(matches!(provider.check_public_key(&point), Err(CryptoError::PublicPoint)), "{point}");
            assert!(matches!(provider.encrypt(&point, b"x"), Err(CryptoError::PublicPoint)));
            let verdict = provider.verify(&point, b"message digest", &Signature(bytes(SIGNATURE)));
            assert!(matches!(verdict, Err(CryptoError::PublicPoint)));
        }
    }
}
