//! The Ethereum V3 keystore: an EOA key under scrypt or PBKDF2 and AES-128-CTR with a Keccak MAC, as JSON. Written with
//! scrypt n = 2^17; foreign files are read within bounds.

use aes::Aes128;
use ctr_legacy::Ctr128BE;
use ctr_legacy::cipher::{KeyIvInit as _, StreamCipher as _};
use hmac::{Hmac, KeyInit as _, Mac as _};
use serde::{Deserialize, Serialize};
use sha2::Sha256;
use sha3::{Digest as _, Keccak256};
use subtle::ConstantTimeEq as _;
use zeroize::Zeroizing;

use crate::model::bytes::{hex, unhex};
use crate::model::clean;

use super::passphrase::{Work, stretch};
use super::{CryptoError, EoaSecret, random_bytes};

#[derive(Serialize, Deserialize)]
struct Keystore {
    #[serde(default)]
    address: String,
    #[serde(alias = "Crypto")]
    crypto: Sealed,
    #[serde(default)]
    id: String,
    version: u32,
}

#[derive(Serialize, Deserialize)]
struct Sealed {
    cipher: String,
    cipherparams: CipherParams,
    ciphertext: String,
    kdf: String,
    kdfparams: serde_json::Value,
    mac: String,
}

#[derive(Serialize, Deserialize)]
struct CipherParams {
    iv: String,
}

#[derive(Serialize, Deserialize)]
struct ScryptParams {
    dklen: u32,
    n: u64,
    p: u32,
    r: u32,
    salt: String,
}

#[derive(Deserialize)]
struct Pbkdf2Params {
    c: u32,
    dklen: u32,
    prf: String,
    salt: String,
}

/// The most iterations of PBKDF2 that a foreign file may ask for: some seconds.
const MOST_ITERATIONS: u32 = 4_000_000;

/// Why a keystore did not open.
#[derive(Debug)]
pub(super) enum Refusal {
    /// The MAC does not match.
    Passphrase,
    /// The file is not a valid keystore.
    Content(String),
}

fn content(found: &str) -> Refusal {
    Refusal::Content(format!("{found}; export it again as a V3 keystore with scrypt"))
}

/// Opens a keystore.
pub(super) fn open(bytes: &[u8], passphrase: &str) -> Result<EoaSecret, Refusal> {
    let store: Keystore = serde_json::from_slice(bytes).map_err(|_| content("its JSON is not a keystore"))?;
    let sealed = &store.crypto;
    if store.version != 3 || sealed.cipher != "aes-128-ctr" || !["scrypt", "pbkdf2"].contains(&&*sealed.kdf) {
        let kind = format!("it is version {}, {}, {}", store.version, sealed.cipher, sealed.kdf);
        return Err(content(&clean(&kind, 80)));
    }
    let iv: [u8; 16] = exactly(&sealed.cipherparams.iv).ok_or_else(|| content("its iv is not 16 bytes"))?;
    let masked: [u8; 32] = exactly(&sealed.ciphertext).ok_or_else(|| content("its ciphertext is not 32 bytes"))?;
    let mac: [u8; 32] = exactly(&sealed.mac).ok_or_else(|| content("its mac is not 32 bytes"))?;
    let key = derived(sealed, passphrase)?;
    if !bool::from(keccak_mac(&key, &masked).ct_eq(&mac)) {
        return Err(Refusal::Passphrase);
    }
    let secret = unmasked(&key, &iv, &masked).ok_or_else(|| content("it holds no valid key"))?;
    same_address(&store.address, &secret)?;
    Ok(secret)
}

/// The key under which the file is sealed, by the derivation that it names.
fn derived(sealed: &Sealed, passphrase: &str) -> Result<Zeroizing<[u8; 32]>, Refusal> {
    let incomplete = |_| content("its kdfparams are incomplete");
    let salt = |text: &str| unhex(text).ok_or_else(|| content("its salt is not hex"));
    if sealed.kdf == "scrypt" {
        let out_of_range = || content("its scrypt parameters are out of range");
        let params = ScryptParams::deserialize(&sealed.kdfparams).map_err(incomplete)?;
        let work = work(&params).ok_or_else(out_of_range)?;
        return stretch::<32>(passphrase, &salt(&params.salt)?, work).map_err(|_| out_of_range());
    }
    let params = Pbkdf2Params::deserialize(&sealed.kdfparams).map_err(incomplete)?;
    if params.prf != "hmac-sha256" || params.dklen != 32 || !(1..=MOST_ITERATIONS).contains(&params.c) {
        return Err(content("its pbkdf2 parameters are out of range"));
    }
    pbkdf2(passphrase, &salt(&params.salt)?, params.c).ok_or_else(|| content("its pbkdf2 parameters are out of range"))
}

/// PBKDF2 (RFC 8018) with HMAC-SHA256, one block.
fn pbkdf2(passphrase: &str, salt: &[u8], iterations: u32) -> Option<Zeroizing<[u8; 32]>> {
    let keyed = Hmac::<Sha256>::new_from_slice(passphrase.as_bytes()).ok()?;
    let mut block = Zeroizing::new(<[u8; 32]>::from(
        keyed.clone().chain_update(salt).chain_update(1u32.to_be_bytes()).finalize().into_bytes(),
    ));
    let mut out = block.clone();
    for _ in 1..iterations {
        *block = keyed.clone().chain_update(*block).finalize().into_bytes().into();
        out.iter_mut().zip(block.iter()).for_each(|(out, byte)| *out ^= byte);
    }
    Some(out)
}

fn same_address(stated: &str, secret: &EoaSecret) -> Result<(), Refusal> {
    let stated = unhex(stated).unwrap_or_default();
    if stated.is_empty() || stated == secret.address().0 {
        Ok(())
    } else {
        Err(content("its address does not match its key"))
    }
}

fn work(params: &ScryptParams) -> Option<Work> {
    let log_n = u8::try_from(params.n.checked_ilog2()?).ok()?;
    let work = Work { log_n, r: params.r, p: params.p };
    (params.n.is_power_of_two() && log_n > 0 && params.dklen == 32 && work.is_bearable()).then_some(work)
}

fn exactly<const N: usize>(text: &str) -> Option<[u8; N]> {
    unhex(text)?.try_into().ok()
}

fn keccak_mac(key: &[u8; 32], masked: &[u8; 32]) -> [u8; 32] {
    Keccak256::new().chain_update(&key[16..]).chain_update(masked).finalize().into()
}

fn mask(key: &[u8; 32], iv: &[u8; 16], data: &mut [u8; 32]) {
    let mut half = Zeroizing::new([0; 16]);
    half.copy_from_slice(&key[..16]);
    Ctr128BE::<Aes128>::new(&(*half).into(), &(*iv).into()).apply_keystream(data);
}

fn unmasked(key: &[u8; 32], iv: &[u8; 16], masked: &[u8; 32]) -> Option<EoaSecret> {
    let mut secret = Zeroizing::new(*masked);
    mask(key, iv, &mut secret);
    EoaSecret::from_slice(&*secret).ok()
}

/// Seals a key.
pub(super) fn seal(secret: &EoaSecret, passphrase: &str) -> Result<String, CryptoError> {
    let (salt, iv) = (random_bytes::<32>()?, random_bytes::<16>()?);
    let key = stretch::<32>(passphrase, &salt, Work::WRITTEN)?;
    let mut masked = *secret.expose();
    mask(&key, &iv, &mut masked);
    let Work { log_n, r, p } = Work::WRITTEN;
    let params = ScryptParams { dklen: 32, n: 1 << log_n, p, r, salt: hex(&salt) };
    let internal = |_| CryptoError::Internal("keystore encoding");
    let store = Keystore {
        address: hex(&secret.address().0),
        crypto: Sealed {
            cipher: "aes-128-ctr".into(),
            cipherparams: CipherParams { iv: hex(&iv) },
            ciphertext: hex(&masked),
            kdf: "scrypt".into(),
            kdfparams: serde_json::to_value(params).map_err(internal)?,
            mac: hex(&keccak_mac(&key, &masked)),
        },
        id: uuid(random_bytes()?),
        version: 3,
    };
    serde_json::to_string_pretty(&store).map_err(internal)
}

/// A random UUID (RFC 9562, version 4).
fn uuid(mut bytes: [u8; 16]) -> String {
    bytes[6] = bytes[6] & 0x0f | 0x40;
    bytes[8] = bytes[8] & 0x3f | 0x80;
    let text = hex(&bytes);
    [&text[..8], &text[8..12], &text[12..16], &text[16..20], &text[20..]].join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The scrypt vector of the Web3 Secret Storage definition.
    const OFFICIAL: &str = r#"{"crypto":{"cipher":"aes-128-ctr",
        "cipherparams":{"iv":"83dbcc02d8ccb40e466191a123791e0e"},
        "ciphertext":"d172bf743a674da9cdad04534d56926ef8358534d458fffccd4e6ad2fbde479c",
        "kdf":"scrypt","kdfparams":{"dklen":32,"n":262144,"r":1,"p":8,
        "salt":"ab0c7876052600dd703518d6fc3fe8984592145b591fc8fb5c6d43190334ba19"},
        "mac":"2103ac29920d71da29f15d75b4a16dbe95cfd7ff8faea1056c33131d846e3097"},
        "id":"3198bc9c-6672-5ab3-d995-4942343ae5b6","version":3}"#;

    #[test]
    fn the_official_vector_opens() {
        let secret = open(OFFICIAL.as_bytes(), "testpassword").expect("opens");
        assert_eq!(hex(secret.expose()), "7a28b5ba57c53603b0b07b56bba752f7784bf506fa95edc395f5cf6c7514fe9d");
        assert!(matches!(open(OFFICIAL.as_bytes(), "wrong"), Err(Refusal::Passphrase)));
    }

    /// The PBKDF2 vector of the Web3 Secret Storage definition, of the same key.
    const PBKDF2: &str = r#"{"crypto":{"cipher":"aes-128-ctr",
        "cipherparams":{"iv":"6087dab2f9fdbbfaddc31a909735c1e6"},
        "ciphertext":"5318b4d5bcd28de64ee5559e671353e16f075ecae9f99c7a79a38af5f869aa46",
        "kdf":"pbkdf2","kdfparams":{"c":262144,"dklen":32,"prf":"hmac-sha256",
        "salt":"ae3cd4e7013836a3df6bd7241b12db061dbe2c6785853cce422d148a624ce0bd"},
        "mac":"517ead924a9d0dc3124507e3393d175ce3ff7c1e96529c6c555ce9e51205e9b2"},
        "id":"3198bc9c-6672-5ab3-d995-4942343ae5b6","version":3}"#;

    #[test]
    fn the_official_vector_of_pbkdf2_opens_and_its_iterations_are_bounded() {
        let secret = open(PBKDF2.as_bytes(), "testpassword").expect("opens");
        assert_eq!(hex(secret.expose()), "7a28b5ba57c53603b0b07b56bba752f7784bf506fa95edc395f5cf6c7514fe9d");
        assert!(matches!(open(PBKDF2.as_bytes(), "wrong"), Err(Refusal::Passphrase)));
        for (from, to) in [
            ("262144", "0"),
            ("262144", "4000001"),
            ("262144", "4294967296"),
            ("\"dklen\":32", "\"dklen\":64"),
            ("hmac-sha256", "hmac-sha1"),
            ("\"salt\":\"ae", "\"salt\":\"zz"),
        ] {
            let text = PBKDF2.replace(from, to);
            assert!(matches!(open(text.as_bytes(), "testpassword"), Err(Refusal::Content(_))), "{to}");
        }
    }

    #[test]
    fn sealed_ones_open_and_altered_ones_do_not() {
        let secret = EoaSecret::generate().expect("random");
        let text = seal(&secret, "correct horse").expect("seals");
        assert_eq!(open(text.as_bytes(), "correct horse").expect("opens").expose(), secret.expose());
        assert!(text.contains("\"n\": 131072"), "{text}");
        assert!(!text.contains(&hex(secret.expose())));
        let swapped = text.replace(&hex(&secret.address().0), &"11".repeat(20));
        assert!(matches!(open(swapped.as_bytes(), "correct horse"), Err(Refusal::Content(_))));
    }

    #[test]
    fn foreign_and_unbearable_files_are_refused_before_any_work() {
        for (from, to) in [
            ("\"n\":262144", "\"n\":1099511627776"),
            ("\"n\":262144", "\"n\":262143"),
            ("\"r\":1", "\"r\":4294967295"),
            ("\"dklen\":32", "\"dklen\":16"),
            ("\"version\":3", "\"version\":1"),
            ("\"kdf\":\"scrypt\"", "\"kdf\":\"pbkdf2\""),
            ("\"iv\":\"83", "\"iv\":\""),
            ("\"mac\":\"21", "\"mac\":\"zz"),
        ] {
            let text = OFFICIAL.replace(from, to);
            assert_ne!(text, OFFICIAL, "{from}");
            assert!(matches!(open(text.as_bytes(), "testpassword"), Err(Refusal::Content(_))), "{to}");
        }
        assert!(matches!(open(b"{}", "x"), Err(Refusal::Content(_))));
    }
}
