//! HKDF-SM3 (RFC 5869 over SM3) and HMAC-SM3 (GM/T 0042-2015), and the encoding of their infos: a label, fixed-width
//! parts raw, variable parts with a two-byte big-endian length before them.

use hkdf::Hkdf;
use hmac::{Hmac, KeyInit as _, Mac as _};
use sm3::Sm3;
use zeroize::Zeroizing;

use super::CryptoError;
use super::sm3::sm3;

/// Fills `out` from input key material, salt and info (RFC 5869, extract and expand).
///
/// # Errors
/// [`CryptoError::Length`] if `out` is longer than 255 hashes (8,160 bytes).
pub fn hkdf_sm3(key_material: &[u8], salt: &[u8], info: &[u8], out: &mut [u8]) -> Result<(), CryptoError> {
    let found = out.len();
    Hkdf::<Sm3>::new(Some(salt), key_material).expand(info, out).map_err(|_| CryptoError::Length {
        what: "derived key",
        found,
        allowed: "at most 8,160",
    })
}

/// `N` bytes of HKDF-SM3; that `N` is allowed is checked at compile time.
///
/// # Panics
/// Cannot happen: a length that HKDF refuses does not compile.
pub fn derived<const N: usize>(key_material: &[u8], salt: &[u8], info: &Info) -> [u8; N] {
    const { assert!(N <= 255 * 32, "HKDF-SM3 gives at most 8,160 bytes") };
    let mut out = [0; N];
    if hkdf_sm3(key_material, salt, info.as_bytes(), &mut out).is_err() {
        unreachable!("the length was checked at compile time");
    }
    out
}

/// Like [`derived`], from key material and salt already extracted (RFC 5869, expand only).
///
/// # Panics
/// Cannot happen: a length that HKDF refuses does not compile.
pub fn expanded<const N: usize>(extracted: &[u8; 32], info: &Info) -> [u8; N] {
    const { assert!(N <= 255 * 32, "HKDF-SM3 gives at most 8,160 bytes") };
    let mut out = [0; N];
    let expanded = Hkdf::<Sm3>::from_prk(extracted).is_ok_and(|hkdf| hkdf.expand(info.as_bytes(), &mut out).is_ok());
    if !expanded {
        unreachable!("both lengths were checked at compile time");
    }
    out
}

/// HMAC-SM3 of the concatenation of `parts`.
pub fn hmac_sm3(key: &[u8], parts: &[&[u8]]) -> [u8; 32] {
    let mut block = Zeroizing::new([0; 64]);
    if key.len() > block.len() {
        block[..32].copy_from_slice(&sm3(&[key]));
    } else {
        block[..key.len()].copy_from_slice(key);
    }
    let mut mac = Hmac::<Sm3>::new(&(*block).into());
    for part in parts {
        mac.update(part);
    }
    mac.finalize().into_bytes().into()
}

/// The info of a derivation: a label, then its parts in order.
#[derive(Debug, Clone)]
pub struct Info(Vec<u8>);

impl Info {
    /// Begins with `label`.
    pub fn new(label: &str) -> Self {
        Self(label.as_bytes().to_vec())
    }

    /// A part of fixed width.
    #[must_use]
    pub fn fixed(mut self, part: &[u8]) -> Self {
        self.0.extend_from_slice(part);
        self
    }

    /// A number, eight bytes big endian.
    #[must_use]
    pub fn number(self, number: u64) -> Self {
        self.fixed(&number.to_be_bytes())
    }

    /// A text of any length up to 65,535 bytes.
    #[must_use]
    pub fn text(mut self, text: &str) -> Self {
        crate::model::wire::put_text(&mut self.0, text);
        self
    }

    /// The bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn hmac_by_definition(key: &[u8], data: &[u8]) -> [u8; 32] {
        let mut block = [0; 64];
        let hashed = sm3(&[key]);
        let key = if key.len() > 64 { &hashed[..] } else { key };
        block[..key.len()].copy_from_slice(key);
        let inner = sm3(&[&block.map(|b| b ^ 0x36), data]);
        sm3(&[&block.map(|b| b ^ 0x5c), &inner])
    }

    proptest! {
        #[test]
        fn hmac_and_hkdf_follow_their_definitions(
            key in proptest::collection::vec(any::<u8>(), 0..100),
            salt in proptest::collection::vec(any::<u8>(), 0..100),
            info in proptest::collection::vec(any::<u8>(), 0..100),
        ) {
            prop_assert_eq!(hmac_sm3(&key, &[&info]), hmac_by_definition(&key, &info));
            let extracted = hmac_by_definition(&salt, &key);
            let first = hmac_by_definition(&extracted, &[&info[..], &[1]].concat());
            let second = hmac_by_definition(&extracted, &[&first[..], &info, &[2]].concat());
            let mut out = [0; 50];
            hkdf_sm3(&key, &salt, &info, &mut out).expect("derives");
            prop_assert_eq!(&out[..32], &first[..]);
            prop_assert_eq!(&out[32..], &second[..18]);
        }
    }

    #[test]
    fn infos_cannot_run_into_each_other() {
        let one = Info::new("x").text("ab").text("c");
        let other = Info::new("x").text("a").text("bc");
        assert_ne!(one.as_bytes(), other.as_bytes());
        assert_eq!(Info::new("l").fixed(&[9]).number(1).text("t").as_bytes(), b"l\x09\0\0\0\0\0\0\0\x01\0\x01t");
        assert!(hkdf_sm3(b"k", b"", b"", &mut vec![0; 8161]).is_err());
    }
}
