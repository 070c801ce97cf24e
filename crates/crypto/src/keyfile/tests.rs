use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;

use proptest::prelude::*;

use super::*;
use crate::model::ErrorKind;
use crate::private_file::write_private;

struct Directory(tempfile::TempDir);

impl Directory {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("directory"))
    }

    fn file(&self, content: &[u8]) -> PathBuf {
        let path = self.0.path().join("key");
        write_private(&path, content).expect("writes");
        path
    }
}

fn message<T: std::fmt::Debug>(result: Result<T>) -> String {
    let error = result.expect_err("refused");
    assert_eq!(error.kind(), ErrorKind::Input, "{error}");
    error.to_string()
}

#[test]
fn sm4_keys_raw_and_hex() {
    let directory = Directory::new();
    let raw: Vec<u8> = (200..216).collect();
    for content in
        [raw.clone(), hex(&raw).into_bytes(), (hex(&raw) + "\n").into_bytes(), (hex(&raw) + "\r\n").into_bytes()]
    {
        assert_eq!(load_sm4(&directory.file(&content)).expect("loads").expose()[..], raw[..]);
    }
    let key = Sm4Key::generate().expect("random");
    assert_eq!(load_sm4(&directory.file(sm4_hex(&key).as_bytes())).expect("loads"), key);
}

#[test]
fn what_is_no_sm4_key_is_named() {
    let directory = Directory::new();
    let refused = |content: &[u8]| message(load_sm4(&directory.file(content)));
    assert!(refused(&[200; 15]).contains("it holds 15 bytes"));
    assert!(refused(&[200; 17]).contains("it holds 17 bytes"));
    assert!(refused(b"").contains("it is empty"));
    assert!(refused(b"correct horse battery staple\n").contains("28 characters of text, possibly a passphrase"));
    assert!(refused(b"sixteen letters!").contains("16 characters of text"));
    assert!(refused(&b"ab".repeat(17)).contains("34 characters"));
}

#[test]
fn files_open_to_others_are_refused_with_advice() {
    let directory = Directory::new();
    let path = directory.file(&[200; 16]);
    fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).expect("chmod");
    for text in [message(load_sm4(&path)), message(load_sm2(&path)), message(load_eoa(&path, None))] {
        assert!(text.contains(&format!("chmod 600 {}", path.display())), "{text}");
    }
    message(load_sm4(&directory.0.path().join("none")));
    message(load_sm4(&directory.file(&vec![200; LONGEST + 1])));
}

#[test]
fn sm2_keys_as_pem_and_hex() {
    let directory = Directory::new();
    let secret = SmSecret::generate().expect("random");
    let pem = sm2_pem(&secret).expect("encodes");
    assert!(pem.starts_with("-----BEGIN PRIVATE KEY-----\n"));
    for content in [pem.as_bytes(), hex(secret.expose()).as_bytes(), (hex(secret.expose()) + "\n").as_bytes()] {
        assert_eq!(load_sm2(&directory.file(content)).expect("loads"), secret);
    }
    let refused = |content: &[u8]| message(load_sm2(&directory.file(content)));
    assert!(refused(&[0xff; 32]).contains("it is binary"));
    assert!(refused(b"hello").contains("5 characters"));
    assert!(refused("00".repeat(32).as_bytes()).contains("outside the range"));
    assert!(refused("ff".repeat(32).as_bytes()).contains("outside the range"));
    assert!(refused(b"-----BEGIN ENCRYPTED PRIVATE KEY-----").contains("encrypted"));
    assert!(refused(b"-----BEGIN EC PRIVATE KEY-----").contains("SEC1"));
    assert!(refused(b"-----BEGIN PUBLIC KEY-----").contains("public key"));
    assert!(refused(pem.replace('A', "B").as_bytes()).contains("no SM2 key"));
}

/// Files as OpenSSL 3 writes them, all of one key: `openssl ecparam -genkey -name SM2`, `openssl pkey -traditional`,
/// `openssl pkey -text`.
#[test]
fn sm2_keys_beside_what_else_openssl_and_editors_write() {
    let directory = Directory::new();
    let secret = SmSecret::generate().expect("random");
    let provider = crate::provider(crate::ProviderName::RustCrypto);
    let public = crate::Provider::public_key(provider, &secret).expect("point");
    let (pem, public) = (sm2_pem(&secret).expect("encodes"), sm2_public_pem(&public).expect("encodes"));
    let key = sm2::SecretKey::from_slice(secret.expose()).expect("a key");
    let sec1 = |label: &'static str, der: &[u8]| {
        Zeroizing::new(sm2::pkcs8::der::pem::encode_string(label, LineEnding::LF, der).expect("encodes"))
    };
    let whole = key.to_sec1_der().expect("encodes");
    // SEQUENCE { 1, the number }: no curve, no public key.
    let bare = [&[0x30, 0x25, 2, 1, 1, 4, 32][..], secret.expose()].concat();
    let parameters = "-----BEGIN SM2 PARAMETERS-----\nBggqgRzPVQGCLQ==\n-----END SM2 PARAMETERS-----\n";
    let digits = hex(secret.expose());
    let spaced: Vec<&str> = (0..32).map(|at| &digits[2 * at..2 * at + 2]).collect();
    for content in [
        format!("\u{feff}{}", *pem),
        format!("Private-Key: (256 bit)\npriv:\n    c8:cc\nASN1 OID: SM2\n{}", *pem),
        format!("{}Private-Key: (256 bit)\npriv:\n    c8:cc\n", *pem),
        format!("{public}{}", *pem),
        format!("{}{public}", *pem),
        format!("{parameters}{}", *pem),
        format!("{parameters}{}", *sec1(SEC1[0], &whole)),
        format!("{parameters}{}", *sec1(SEC1[0], &bare)),
        format!("{parameters}{}", *sec1(SEC1[1], &bare)),
        sec1(SEC1[0], &whole).to_string(),
        sec1(SEC1[0], &bare).to_string(),
        sec1(SEC1[1], &whole).to_string(),
        format!("0x{digits}\n"),
        format!(" 0X{}\r\n\r\n", digits.to_uppercase()),
        format!("\u{feff}{}\n", spaced.join(" ")),
        format!("{}\n{}\n", &digits[..32], &digits[32..]),
    ] {
        let loaded = load_sm2(&directory.file(content.as_bytes()));
        assert!(loaded.is_ok_and(|loaded| loaded == secret), "{content}");
    }
    let p256 = "-----BEGIN EC PARAMETERS-----\nBggqhkjOPQMBBw==\n-----END EC PARAMETERS-----\n";
    let refused = |content: &str| message(load_sm2(&directory.file(content.as_bytes())));
    for other in
        [format!("{p256}{}", *sec1(SEC1[1], &bare)), format!("{p256}{}", *pem), sec1(SEC1[1], &bare).to_string()]
    {
        assert!(refused(&other).contains("one of another curve"), "{other}");
    }
    // The number of a P-256 key in PKCS#8 may well be one of SM2's.
    let info = [
        &[
            0x30, 0x41, 2, 1, 0, 0x30, 0x13, 6, 7, 0x2a, 0x86, 0x48, 0xce, 0x3d, 2, 1, 6, 8, 0x2a, 0x86, 0x48, 0xce,
            0x3d,
        ][..],
        &[3, 1, 7, 4, 0x27],
        &bare,
    ]
    .concat();
    let refusal = refused(&sec1(PKCS8, &info));
    assert!(refusal.contains("one of another curve"), "{refusal}");
    assert!(refused(&format!("{}{}", *pem, *pem)).contains("several private keys"));
    let other = SmSecret::generate().expect("random");
    let mixed = [&whole[..7], other.expose(), &whole[39..]].concat();
    assert!(refused(&sec1(SEC1[0], &mixed)).contains("no SM2 key"), "its public key is another's");
    let locked = sec1(SEC1[1], &whole).replacen('\n', "\nProc-Type: 4,ENCRYPTED\n\n", 1);
    assert!(refused(&locked).contains("encrypted"));
    for short in ["0x", "0x1", &digits[1..], &format!("{digits}0"), &format!("{digits}\nmore")] {
        assert!(refused(short).contains("characters"), "{short}");
    }
    let sm4 = hex(&[7; 16]);
    for content in [format!("0x{sm4}"), format!("\u{feff}{sm4}\n"), format!("{} {}", &sm4[..16], &sm4[16..])] {
        assert_eq!(load_sm4(&directory.file(content.as_bytes())).expect("loads").expose()[..], [7; 16]);
    }
}

#[test]
fn public_keys_as_pem() {
    let secret = SmSecret::generate().expect("random");
    let provider = crate::provider(crate::ProviderName::RustCrypto);
    let public = crate::Provider::public_key(provider, &secret).expect("point");
    let pem = sm2_public_pem(&public).expect("encodes");
    assert_eq!(sm2_public_from_pem(&pem).expect("parses"), public);
    assert!(sm2_public_pem(&PublicKey([1; 64])).is_err());
    assert!(sm2_public_from_pem("hello").is_err());
}

#[test]
fn eoa_keys_as_hex_and_keystore() {
    let directory = Directory::new();
    let secret = EoaSecret::generate().expect("random");
    let digits = hex(secret.expose());
    for content in [digits.clone(), format!("0x{digits}\n"), digits.to_uppercase()] {
        assert_eq!(load_eoa(&directory.file(content.as_bytes()), None).expect("loads"), secret);
    }
    let store = directory.file(eoa_keystore(&secret, "short").expect("seals").as_bytes());
    assert_eq!(load_eoa(&store, Some("short")).expect("loads"), secret);
    assert!(matches!(load_eoa(&store, None), Err(CryptoError::PassphraseNeeded(_))));
    let refused = load_eoa(&store, Some("wrong")).expect_err("refused");
    assert!(matches!(refused, CryptoError::WrongPassphrase(_)) && refused.kind() == ErrorKind::Refused);
    let refused = |content: &[u8]| message(load_eoa(&directory.file(content), None));
    assert!(refused(b"0x1234").contains("it holds 6 bytes"));
    assert!(refused("00".repeat(32).as_bytes()).contains("outside the range"));
    assert!(message(load_eoa(&directory.file(b"{\"a\":1}"), Some("x"))).contains("not a keystore"));
}

proptest! {
    #[test]
    fn parsers_never_panic(noise in proptest::collection::vec(any::<u8>(), 0..200), text in ".{0,100}") {
        for bytes in [&noise[..], text.as_bytes()] {
            let _ = parse_sm2(bytes);
            let _ = parse_eoa_hex(bytes);
            let _ = keystore::open(bytes, "x");
            if let Ok(key) = parse_sm4(bytes) {
                let raw = bytes == key.expose();
                prop_assert!(raw || line(bytes).to_ascii_lowercase() == hex(key.expose()).into_bytes());
            }
        }
        let pem = format!("-----BEGIN PRIVATE KEY-----\n{text}\n-----END PRIVATE KEY-----\n");
        let _ = parse_sm2(pem.as_bytes());
    }

    #[test]
    fn every_sixteen_bytes_that_are_no_text_are_a_key(raw in any::<[u8; 16]>()) {
        prop_assume!(!is_text(line(&raw)));
        prop_assert_eq!(parse_sm4(&raw).expect("a key"), Sm4Key::new(raw));
    }
}
