//! Encryption (GB/T 32918.4-2016, 6.1 and 7.1) with points already checked.

use subtle::ConstantTimeEq as _;
use zeroize::{Zeroize as _, Zeroizing};

use crate::crypto::CryptoError;
use crate::crypto::der::CipherParts;
use crate::crypto::kernel::sm2::{Affine, Scalar, multiply, multiply_both};
use crate::crypto::random::random_bytes;
use crate::crypto::secret::unprefixed;
use crate::crypto::sm3::{Sm3Hasher, sm3};
use crate::model::PublicKey;

use super::point;

/// Encrypts to a public key.
pub(crate) fn encrypt(public: &PublicKey, plain: &[u8]) -> Result<CipherParts, CryptoError> {
    let point = point(public)?;
    loop {
        let random = Zeroizing::new(random_bytes()?);
        let parts = Scalar::from_bytes(&random).and_then(|k| encrypt_with(&Zeroizing::new(k), &point, plain));
        if let Some(parts) = parts {
            return Ok(parts);
        }
    }
}

/// A2 to A8 with a number from 1 to n - 1; nothing if the mask is all zeros.
pub(super) fn encrypt_with(k: &Scalar, point: &Affine, plain: &[u8]) -> Option<CipherParts> {
    let [own, mut shared] = multiply_both(k, point);
    let coordinates = Zeroizing::new(shared.to_bytes());
    shared.zeroize();
    let mut text = plain.to_vec();
    let masked = mask(&coordinates, &mut text);
    if !masked {
        text.zeroize();
        return None;
    }
    let check = check_value(&coordinates, plain);
    let own = own.to_bytes();
    let (x, y) = halves(&own);
    Some(CipherParts { x, y, check, text })
}

/// Decrypts with a secret number; constant-time in it.
pub(crate) fn decrypt(secret: &[u8; 32], parts: CipherParts) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
    let point = point(&unprefixed(&parts.x, &parts.y))?;
    let number = Zeroizing::new(Scalar::from_bytes(secret).ok_or(CryptoError::SecretRange("SM2"))?);
    let mut shared = multiply(&number, &point);
    let coordinates = Zeroizing::new(shared.to_bytes());
    shared.zeroize();
    let mut plain = Zeroizing::new(parts.text);
    let masked = mask(&coordinates, &mut plain);
    let same = bool::from(check_value(&coordinates, &plain).ct_eq(&parts.check));
    if masked && same { Ok(plain) } else { Err(CryptoError::BadCiphertext) }
}

/// The x coordinate of a secret number times a public key; constant-time in the number.
pub(crate) fn shared_x(secret: &[u8; 32], public: &PublicKey) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
    let point = point(public)?;
    let number = Zeroizing::new(Scalar::from_bytes(secret).ok_or(CryptoError::SecretRange("SM2"))?);
    let mut shared = multiply(&number, &point);
    let x = Zeroizing::new(shared.x_bytes());
    shared.zeroize();
    Ok(x)
}

/// XORs the stream derived from x2 || y2 (5.4.3) into the text; returns whether any byte of the stream was not zero.
fn mask(coordinates: &[u8; 64], text: &mut [u8]) -> bool {
    let mut start = Sm3Hasher::new();
    start.update(coordinates);
    let mut any = 0;
    for (number, piece) in (1u32..).zip(text.chunks_mut(32)) {
        let mut hasher = start.clone();
        hasher.update(&number.to_be_bytes());
        let stream = Zeroizing::new(hasher.finish());
        for (byte, mask) in piece.iter_mut().zip(*stream) {
            *byte ^= mask;
            any |= mask;
        }
    }
    any != 0
}

/// C3 = SM3(x2 || M || y2).
fn check_value(coordinates: &[u8; 64], plain: &[u8]) -> [u8; 32] {
    let (x, y) = coordinates.split_at(32);
    sm3(&[x, plain, y])
}

fn halves(point: &[u8; 64]) -> ([u8; 32], [u8; 32]) {
    let (mut x, mut y) = ([0; 32], [0; 32]);
    x.copy_from_slice(&point[..32]);
    y.copy_from_slice(&point[32..]);
    (x, y)
}
