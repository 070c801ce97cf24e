//! Nonces of signatures, hedged: from key, hash and fresh random bytes by HMAC-SM3 (RFC 6979, 3.2, with the additional
//! data of 3.6). A random source that fails or repeats itself does not give a nonce away.

use zeroize::Zeroizing;

use crate::crypto::kernel::sm2::Scalar;
use crate::crypto::sm3::Sm3Hasher;

/// A key of HMAC-SM3, with its two pads already hashed.
struct Keyed {
    inner: Sm3Hasher,
    outer: Sm3Hasher,
}

impl Keyed {
    fn new(key: &[u8; 32]) -> Self {
        let padded = |pad: u8| {
            let mut block = Zeroizing::new([pad; 64]);
            block.iter_mut().zip(key).for_each(|(byte, key)| *byte ^= key);
            let mut hasher = Sm3Hasher::new();
            hasher.update(&*block);
            hasher
        };
        Self { inner: padded(0x36), outer: padded(0x5c) }
    }

    fn code(&self, parts: &[&[u8]]) -> Zeroizing<[u8; 32]> {
        let (mut inner, mut outer) = (self.inner.clone(), self.outer.clone());
        for part in parts {
            inner.update(part);
        }
        outer.update(&*Zeroizing::new(inner.finish()));
        Zeroizing::new(outer.finish())
    }
}

/// The nonces for one signature, one after the other until one fits.
pub(super) struct Nonces {
    key: Keyed,
    value: Zeroizing<[u8; 32]>,
    used: bool,
}

impl Nonces {
    /// From the secret number, the hash modulo n, and fresh random bytes.
    pub fn new(secret: &[u8; 32], hash: &[u8; 32], random: &[u8; 32]) -> Self {
        let (mut key, mut value) = (Keyed::new(&[0; 32]), Zeroizing::new([1; 32]));
        for round in [0u8, 1] {
            let next = key.code(&[&value[..], &[round], secret, hash, random]);
            key = Keyed::new(&next);
            value = key.code(&[&value[..]]);
        }
        Self { key, value, used: false }
    }

    /// The next number from 1 to n - 1.
    pub fn next(&mut self) -> Zeroizing<Scalar> {
        loop {
            if self.used {
                let next = self.key.code(&[&self.value[..], &[0]]);
                self.key = Keyed::new(&next);
                self.value = self.key.code(&[&self.value[..]]);
            }
            self.used = true;
            self.value = self.key.code(&[&self.value[..]]);
            if let Some(number) = Scalar::from_bytes(&self.value) {
                return Zeroizing::new(number);
            }
        }
    }
}
