//! Key files that users import and export: SM4 as bytes or hex, SM2 as PEM (PKCS#8 or SEC1) or hex, EOA as hex or
//! Ethereum keystore. A byte order mark, white space or a public key beside the one key are passed over.

use std::path::Path;

use sm2::elliptic_curve::sec1::ToSec1Point as _;
use sm2::pkcs8::der::{SecretDocument, pem};
use sm2::pkcs8::{DecodePrivateKey as _, EncodePrivateKey as _, EncodePublicKey as _, LineEnding};
use zeroize::Zeroizing;

use crate::error::shown;
use crate::model::PublicKey;
use crate::model::bytes::hex;
use crate::private_file::read_private;
use crate::{CryptoError, EoaSecret, Result, Sm4Key, SmSecret, keystore, provider};

const LONGEST: usize = 64 * 1024;
const SM4_KEY: &str = "an SM4 key";
const SM2_KEY: &str = "an SM2 private key";
const EOA_KEY: &str = "the key of an Ethereum account";
const PKCS8: &str = "PRIVATE KEY";
const SEC1: [&str; 2] = ["SM2 PRIVATE KEY", "EC PRIVATE KEY"];
/// The labels of the curve that OpenSSL writes before a key in SEC1.
const PARAMETERS: [&str; 2] = ["SM2 PARAMETERS", "EC PARAMETERS"];
/// SM2's curve, 1.2.156.10197.1.301, as DER.
const CURVE: [u8; 10] = [0x06, 0x08, 0x2a, 0x81, 0x1c, 0xcf, 0x55, 0x01, 0x82, 0x2d];
/// Keys on any curve, 1.2.840.10045.2.1, as DER.
const ANY_CURVE: [u8; 9] = [0x06, 0x07, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01];
const MARK: &[u8] = b"\xef\xbb\xbf";

/// What is wrong with the content of a key file: what was expected, what was found.
type Found = (&'static str, String);

/// Reads an SM4 key: exactly 16 raw bytes, or 32 hex characters (0x and white space are optional).
/// # Errors
/// [`CryptoError::NotAKey`] saying what was found, or what [`read_private`] returns.
pub fn load_sm4(path: &Path) -> Result<Sm4Key> {
    parse_sm4(&read_private(path, LONGEST)?).map_err(not_a_key(path))
}

/// Reads an SM2 private key: the one in PEM (PKCS#8 or SEC1), or 64 hex characters (0x and white space are optional).
/// # Errors
/// [`CryptoError::NotAKey`] saying what was found, or what [`read_private`] returns.
pub fn load_sm2(path: &Path) -> Result<SmSecret> {
    parse_sm2(&read_private(path, LONGEST)?).map_err(not_a_key(path))
}

/// Reads an EOA key: 64 hex characters (0x and white space are optional), or a V3 keystore, which needs its passphrase.
/// # Errors
/// `NotAKey`, `PassphraseNeeded`, [`CryptoError::WrongPassphrase`], or what [`read_private`] returns.
pub fn load_eoa(path: &Path, passphrase: Option<&str>) -> Result<EoaSecret> {
    let bytes = read_private(path, LONGEST)?;
    if !is_keystore(&bytes) {
        return parse_eoa_hex(&bytes).map_err(not_a_key(path));
    }
    let passphrase = passphrase.ok_or_else(|| CryptoError::PassphraseNeeded(shown(path)))?;
    keystore::open(&bytes, passphrase).map_err(|refusal| match refusal {
        keystore::Refusal::Passphrase => CryptoError::WrongPassphrase(shown(path)),
        keystore::Refusal::Content(found) => not_a_key(path)((EOA_KEY, found)),
    })
}

/// Whether a file is a V3 keystore, which needs its passphrase.
/// # Errors
/// What [`read_private`] returns.
pub fn is_keystore_file(path: &Path) -> Result<bool> {
    Ok(is_keystore(&read_private(path, LONGEST)?))
}

fn is_keystore(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().first() == Some(&b'{')
}

fn not_a_key(path: &Path) -> impl Fn(Found) -> CryptoError {
    let path = shown(path);
    move |(wanted, found)| CryptoError::NotAKey { path: path.clone(), wanted, found }
}

fn parse_sm4(bytes: &[u8]) -> Result<Sm4Key, Found> {
    let line = line(bytes);
    if let Some(key) = hex_of::<16>(bytes) {
        return Ok(Sm4Key::new(*key));
    }
    let found = match bytes {
        [] => "it is empty".to_owned(),
        _ if is_text(line) => format!("it holds {} characters of text, possibly a passphrase", line.len()),
        _ => match Sm4Key::from_slice(bytes) {
            Some(key) => return Ok(key),
            None => format!("it holds {} bytes", bytes.len()),
        },
    };
    Err((SM4_KEY, format!("{found}; a key is 16 random bytes, raw or as 32 hex characters")))
}

fn parse_sm2(bytes: &[u8]) -> Result<SmSecret, Found> {
    let out_of_range = |_| (SM2_KEY, "its value is outside the range 1 to n - 2".to_owned());
    if let Some(key) = hex_of::<32>(bytes) {
        return SmSecret::from_slice(&*key).map_err(out_of_range);
    }
    let wrong = |found: &str| (SM2_KEY, sm2_advice(found));
    let text = std::str::from_utf8(bytes).map_err(|_| wrong("it is binary"))?;
    if !text.contains("-----BEGIN") {
        return Err(wrong(&format!("it holds {} characters that are not a key", text.trim().len())));
    }
    let key = sm2_of_pem(text).map_err(wrong)?;
    let raw = Zeroizing::new(<[u8; 32]>::from(key.to_bytes()));
    SmSecret::from_slice(&*raw).map_err(out_of_range)
}

/// The one private key in a text with PEM; its curve is compared, wherever the file names it.
fn sm2_of_pem(text: &str) -> Result<sm2::SecretKey, &'static str> {
    let blocks = pem_blocks(text);
    let labelled = |labels: &[&str]| -> Vec<(&str, &str)> {
        blocks.iter().filter(|(label, _)| labels.contains(label)).copied().collect()
    };
    let (label, block) = match labelled(&[PKCS8, SEC1[0], SEC1[1]])[..] {
        [] => return Err(pem_kind(text)),
        [one] => one,
        _ => {
            return Err(
                "it holds several private keys, so it is not clear which one is meant; leave one of them in it",
            );
        }
    };
    if block.contains("ENCRYPTED") {
        return Err(ENCRYPTED);
    }
    let named = labelled(&PARAMETERS);
    for (_, parameters) in &named {
        // A curve's OID alone: not a document, which is a sequence.
        let (_, curve) = pem::decode_vec(parameters.as_bytes()).map_err(|_| "its PEM is broken")?;
        if curve != CURVE {
            return Err(OTHER_CURVE);
        }
    }
    let (_, document) = SecretDocument::from_pem(block).map_err(|_| "its PEM contains no SM2 key")?;
    let has = |part: &[u8]| document.as_bytes().windows(part.len()).any(|window| window == part);
    if label == PKCS8 {
        let other = if has(&ANY_CURVE) && !has(&CURVE) { OTHER_CURVE } else { "its PEM contains no SM2 key" };
        return sm2::SecretKey::from_pkcs8_der(document.as_bytes()).map_err(|_| other);
    }
    // A key in SEC1 may leave its curve to what stands beside it.
    if label == SEC1[1] && named.is_empty() && !has(&CURVE) {
        return Err(OTHER_CURVE);
    }
    sm2::SecretKey::from_sec1_der(document.as_bytes()).map_err(|_| "its SEC1 PEM contains no SM2 key")
}

const ENCRYPTED: &str = "it is encrypted; decrypt it first with openssl pkcs8";
const OTHER_CURVE: &str = "its PEM contains no SM2 key, but one of another curve";

fn pem_blocks(text: &str) -> Vec<(&str, &str)> {
    const BEGIN: &str = "-----BEGIN ";
    let (mut found, mut rest) = (Vec::new(), text);
    while let Some(block) = rest.find(BEGIN).and_then(|at| rest.get(at..)) {
        let after = block.get(BEGIN.len()..).unwrap_or_default();
        rest = after;
        let Some((label, _)) = after.split_once("-----") else { continue };
        let end = format!("-----END {label}-----");
        let Some(length) = block.find(&end).map(|at| at + end.len()) else { continue };
        found.extend(block.get(..length).map(|whole| (label, whole)));
        rest = block.get(length..).unwrap_or_default();
    }
    found
}

fn pem_kind(text: &str) -> &'static str {
    match text {
        _ if text.contains("BEGIN ENCRYPTED") => ENCRYPTED,
        _ if text.contains("BEGIN EC PRIVATE") || text.contains("BEGIN SM2 PRIVATE") => {
            "it is in the older SEC1 form and cut off; convert it with openssl pkcs8 -topk8 -nocrypt"
        }
        _ if text.contains("BEGIN PUBLIC") => "it is a public key",
        _ if text.contains("BEGIN CERTIFICATE") => "it is a certificate",
        _ => "its PEM contains no SM2 key",
    }
}

fn sm2_advice(found: &str) -> String {
    format!("{found}; give PKCS#8 PEM (openssl genpkey -algorithm SM2) or 64 hex characters")
}

fn parse_eoa_hex(bytes: &[u8]) -> Result<EoaSecret, Found> {
    let Some(key) = hex_of::<32>(bytes) else {
        let found = format!("it holds {} bytes; give 64 hex characters or an Ethereum keystore (JSON)", bytes.len());
        return Err((EOA_KEY, found));
    };
    EoaSecret::from_slice(&*key).map_err(|_| (EOA_KEY, "its value is outside the range 1 to n - 1".to_owned()))
}

fn line(bytes: &[u8]) -> &[u8] {
    let line = bytes.strip_suffix(b"\n").unwrap_or(bytes);
    line.strip_suffix(b"\r").unwrap_or(line)
}

fn is_text(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_ok_and(|text| !text.chars().any(char::is_control))
}

/// Exactly `2 N` hex digits, without leaving a copy behind; 0x, white space and a byte order mark are passed over.
fn hex_of<const N: usize>(text: &[u8]) -> Option<Zeroizing<[u8; N]>> {
    let text = text.strip_prefix(MARK).unwrap_or(text).trim_ascii();
    let text = text.strip_prefix(b"0x").or_else(|| text.strip_prefix(b"0X")).unwrap_or(text);
    let mut digits = text.iter().filter(|byte| !byte.is_ascii_whitespace());
    let mut nibble = || char::from(*digits.next()?).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
    let mut out = Zeroizing::new([0; N]);
    for byte in out.iter_mut() {
        *byte = nibble()? << 4 | nibble()?;
    }
    digits.next().is_none().then_some(out)
}

/// An SM4 key as 32 hex characters and a line break.
pub fn sm4_hex(key: &Sm4Key) -> Zeroizing<String> {
    Zeroizing::new(hex(key.expose()) + "\n")
}

/// An SM2 private key as PKCS#8 PEM, as `openssl pkey` reads it.
/// # Errors
/// [`CryptoError::Internal`] if encoding fails.
pub fn sm2_pem(secret: &SmSecret) -> Result<Zeroizing<String>> {
    sm2::SecretKey::from_slice(secret.expose())
        .ok()
        .and_then(|key| key.to_pkcs8_pem(LineEnding::LF).ok())
        .ok_or(CryptoError::Internal("PKCS#8 encoding"))
}

/// An SM2 public key as SPKI PEM, as `openssl pkey -pubin` reads it.
/// # Errors
/// [`CryptoError::PublicPoint`] if it is not a point of the curve.
pub fn sm2_public_pem(public: &PublicKey) -> Result<String> {
    let point = provider::point(public)?;
    point.to_public_key_pem(LineEnding::LF).map_err(|_| CryptoError::Internal("SPKI encoding"))
}

/// An SM2 public key from SPKI PEM.
/// # Errors
/// [`CryptoError::PublicPoint`] if the text holds no such key.
pub fn sm2_public_from_pem(text: &str) -> Result<PublicKey> {
    let point = text.parse::<sm2::PublicKey>().map_err(|_| CryptoError::PublicPoint)?;
    point.to_sec1_point(false).as_bytes().get(1..).and_then(PublicKey::from_slice).ok_or(CryptoError::PublicPoint)
}

/// An EOA key as an Ethereum V3 keystore (JSON); derives a key from the passphrase (about 0.3 s).
/// # Errors
/// [`CryptoError::Random`] if the random source fails.
pub fn eoa_keystore(secret: &EoaSecret, passphrase: &str) -> Result<String> {
    keystore::seal(secret, passphrase)
}

#[cfg(test)]
mod tests;
