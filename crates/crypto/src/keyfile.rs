//! Key files that users import and export: SM4 as bytes or hex, SM2 as PKCS#8 PEM or hex, EOA as hex or Ethereum
//! keystore. Files must not be accessible to others; errors say what was found instead.

use std::path::Path;

use sm2::elliptic_curve::sec1::ToSec1Point as _;
use sm2::pkcs8::{DecodePrivateKey as _, EncodePrivateKey as _, EncodePublicKey as _, LineEnding};
use zeroize::Zeroizing;

use crate::model::PublicKey;
use crate::model::bytes::hex;

use super::error::shown;
use super::private_file::read_private;
use super::{CryptoError, EoaSecret, Sm4Key, SmSecret, keystore, rustcrypto};

/// The longest key file read, bytes.
const LONGEST: usize = 64 * 1024;
const SM4_KEY: &str = "an SM4 key";
const SM2_KEY: &str = "an SM2 private key";
const EOA_KEY: &str = "the key of an Ethereum account";

/// What is wrong with the content of a key file: what was expected, what was found.
type Found = (&'static str, String);

/// Reads an SM4 key: exactly 16 raw bytes, or 32 hex characters.
///
/// # Errors
/// [`CryptoError::NotAKey`] saying what was found, or what [`read_private`] returns.
pub fn load_sm4(path: &Path) -> Result<Sm4Key, CryptoError> {
    parse_sm4(&read_private(path, LONGEST)?).map_err(not_a_key(path))
}

/// Reads an SM2 private key: PKCS#8 PEM, or 64 hex characters.
///
/// # Errors
/// [`CryptoError::NotAKey`] saying what was found, or what [`read_private`] returns.
pub fn load_sm2(path: &Path) -> Result<SmSecret, CryptoError> {
    parse_sm2(&read_private(path, LONGEST)?).map_err(not_a_key(path))
}

/// Reads an EOA key: 64 hex characters (0x is optional), or an Ethereum V3 keystore, which needs
/// its passphrase.
///
/// # Errors
/// [`CryptoError::NotAKey`], [`CryptoError::PassphraseNeeded`], [`CryptoError::WrongPassphrase`], or
/// what [`read_private`] returns.
pub fn load_eoa(path: &Path, passphrase: Option<&str>) -> Result<EoaSecret, CryptoError> {
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

/// Whether bytes look like a JSON keystore rather than hex.
fn is_keystore(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().first() == Some(&b'{')
}

fn not_a_key(path: &Path) -> impl Fn(Found) -> CryptoError {
    let path = shown(path);
    move |(wanted, found)| CryptoError::NotAKey { path: path.clone(), wanted, found }
}

fn parse_sm4(bytes: &[u8]) -> Result<Sm4Key, Found> {
    let line = line(bytes);
    if let Some(key) = hex_of::<16>(line) {
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
    let line = line(bytes);
    if let Some(key) = hex_of::<32>(line) {
        return SmSecret::from_slice(&*key)
            .map_err(|_| (SM2_KEY, "its value is outside the range 1 to n - 2".to_owned()));
    }
    let text = std::str::from_utf8(bytes).map_err(|_| (SM2_KEY, sm2_advice("it is binary")))?;
    if !text.contains("-----BEGIN") {
        return Err((SM2_KEY, sm2_advice(&format!("it holds {} characters that are not a key", text.trim().len()))));
    }
    let key = sm2::SecretKey::from_pkcs8_pem(text).map_err(|_| (SM2_KEY, sm2_advice(pem_kind(text))))?;
    let raw = Zeroizing::new(<[u8; 32]>::from(key.to_bytes()));
    SmSecret::from_slice(&*raw).map_err(|_| (SM2_KEY, "its value is outside the range 1 to n - 2".to_owned()))
}

fn pem_kind(text: &str) -> &'static str {
    match text {
        _ if text.contains("BEGIN ENCRYPTED") => "it is encrypted; decrypt it first with openssl pkcs8",
        _ if text.contains("BEGIN EC PRIVATE") => {
            "it is in the older SEC1 form; convert it with openssl pkcs8 -topk8 -nocrypt"
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
    let line = line(bytes);
    let digits = line.strip_prefix(b"0x").unwrap_or(line);
    let Some(key) = hex_of::<32>(digits) else {
        let found = format!("it holds {} bytes; give 64 hex characters or an Ethereum keystore (JSON)", bytes.len());
        return Err((EOA_KEY, found));
    };
    EoaSecret::from_slice(&*key).map_err(|_| (EOA_KEY, "its value is outside the range 1 to n - 1".to_owned()))
}

/// Without one trailing line break.
fn line(bytes: &[u8]) -> &[u8] {
    let line = bytes.strip_suffix(b"\n").unwrap_or(bytes);
    line.strip_suffix(b"\r").unwrap_or(line)
}

fn is_text(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_ok_and(|text| !text.chars().any(char::is_control))
}

/// Exactly `2 N` hex digits, without leaving a copy behind.
fn hex_of<const N: usize>(digits: &[u8]) -> Option<Zeroizing<[u8; N]>> {
    if digits.len() != 2 * N {
        return None;
    }
    let mut out = Zeroizing::new([0; N]);
    for (byte, pair) in out.iter_mut().zip(digits.chunks_exact(2)) {
        let nibble = |index: usize| char::from(pair[index]).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
        *byte = nibble(0)? << 4 | nibble(1)?;
    }
    Some(out)
}

/// An SM4 key as 32 hex characters and a line break.
pub fn sm4_hex(key: &Sm4Key) -> Zeroizing<String> {
    Zeroizing::new(hex(key.expose()) + "\n")
}

/// An SM2 private key as PKCS#8 PEM, as `openssl pkey` reads it.
///
/// # Errors
/// [`CryptoError::Internal`] if encoding fails.
pub fn sm2_pem(secret: &SmSecret) -> Result<Zeroizing<String>, CryptoError> {
    sm2::SecretKey::from_slice(secret.expose())
        .ok()
        .and_then(|key| key.to_pkcs8_pem(LineEnding::LF).ok())
        .ok_or(CryptoError::Internal("PKCS#8 encoding"))
}

/// An SM2 public key as SPKI PEM, as `openssl pkey -pubin` reads it.
///
/// # Errors
/// [`CryptoError::PublicPoint`] if it is not a point of the curve.
pub fn sm2_public_pem(public: &PublicKey) -> Result<String, CryptoError> {
    let point = rustcrypto::point(public)?;
    point.to_public_key_pem(LineEnding::LF).map_err(|_| CryptoError::Internal("SPKI encoding"))
}

/// An SM2 public key from SPKI PEM.
///
/// # Errors
/// [`CryptoError::PublicPoint`] if the text holds no such key.
pub fn sm2_public_from_pem(text: &str) -> Result<PublicKey, CryptoError> {
    let point = text.parse::<sm2::PublicKey>().map_err(|_| CryptoError::PublicPoint)?;
    point.to_sec1_point(false).as_bytes().get(1..).and_then(PublicKey::from_slice).ok_or(CryptoError::PublicPoint)
}

/// An EOA key as an Ethereum V3 keystore (JSON); derives a key from the passphrase (about 0.3 s).
///
/// # Errors
/// [`CryptoError::Random`] if the random source fails.
pub fn eoa_keystore(secret: &EoaSecret, passphrase: &str) -> Result<String, CryptoError> {
    keystore::seal(secret, passphrase)
}

#[cfg(test)]
mod tests;
