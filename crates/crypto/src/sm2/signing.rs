//! Signatures (GB/T 32918.2-2016, 6.1 and 7.1) under the ID 1234567812345678.

use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use crate::crypto::CryptoError;
use crate::crypto::kernel::sm2::{Scalar, Signer, multiply_generator, verifies};
use crate::crypto::rustcrypto::DISTINGUISHED_ID;
use crate::crypto::sm3::{Sm3Hasher, sm3};
use crate::model::{PublicKey, Signature};

use super::nonce::Nonces;
use super::point;
use super::signers::{self, Signers};

/// a, b, and the coordinates of G (GB/T 32918.5-2017, 4), as hashed into ZA.
const CURVE: [u8; 128] = curve();

const fn curve() -> [u8; 128] {
    let numbers: [u128; 8] = [
        0xffff_fffe_ffff_ffff_ffff_ffff_ffff_ffff,
        0xffff_ffff_0000_0000_ffff_ffff_ffff_fffc,
        0x28e9_fa9e_9d9f_5e34_4d5a_9e4b_cf65_09a7,
        0xf397_89f5_15ab_8f92_ddbc_bd41_4d94_0e93,
        0x32c4_ae2c_1f19_8119_5f99_0446_6a39_c994,
        0x8fe3_0bbf_f266_0be1_715a_4589_334c_74c7,
        0xbc37_36a2_f4f6_779c_59bd_cee3_6b69_2153,
        0xd0a9_877c_c62a_4740_02df_32e5_2139_f0a0,
    ];
    let (mut bytes, mut at) = ([0; 128], 0);
    while at < 128 {
        bytes[at] = numbers[at / 16].to_be_bytes()[at % 16];
        at += 1;
    }
    bytes
}

/// ZA (GB/T 32918.2-2016, 5.5): what a signature binds about the signer, besides the message.
pub(super) fn za(public: &PublicKey) -> [u8; 32] {
    sm3(&[&[0, 0x80], DISTINGUISHED_ID.as_bytes(), &CURVE, &public.0])
}

/// e: the hash of ZA and the message, modulo n.
pub(super) fn hash(za: &[u8; 32], message: &[u8]) -> Scalar {
    let mut hasher = Sm3Hasher::new();
    hasher.update(za);
    hasher.update(message);
    Scalar::reduced(&hasher.finish())
}

/// What signing needs from a secret key, computed once: 1 / (1 + d), the public key, ZA.
#[derive(Zeroize, ZeroizeOnDrop)]
pub(crate) struct SigningKey {
    secret: [u8; 32],
    inverse: Scalar,
    #[zeroize(skip)]
    public: PublicKey,
    #[zeroize(skip)]
    za: [u8; 32],
}

impl SigningKey {
    /// For d, 1 to n - 2.
    pub fn new(secret: &[u8; 32]) -> Result<Self, CryptoError> {
        let range = || CryptoError::SecretRange("SM2");
        let number = Zeroizing::new(Scalar::from_bytes(secret).ok_or_else(range)?);
        let one_more = Zeroizing::new(number.plus(&Scalar::ONE));
        if one_more.is_zero() {
            return Err(range());
        }
        let public = PublicKey(multiply_generator(&number).to_bytes());
        Ok(Self { secret: *secret, inverse: one_more.invert(), public, za: za(&public) })
    }

    /// The public key.
    pub fn public(&self) -> &PublicKey {
        &self.public
    }

    /// A signature whose nonce is derived from key, message and `random`.
    pub fn sign(&self, message: &[u8], random: &[u8; 32]) -> Signature {
        let e = hash(&self.za, message);
        let mut nonces = Nonces::new(&self.secret, &e.to_bytes(), random);
        loop {
            if let Some(signature) = self.sign_with(&e, &nonces.next()) {
                return signature;
            }
        }
    }

    /// A4 to A7; nothing if the nonce does not fit, which never happens in practice.
    pub(super) fn sign_with(&self, e: &Scalar, nonce: &Scalar) -> Option<Signature> {
        let x = multiply_generator(nonce).x_bytes();
        let r = e.plus(&Scalar::reduced(&x));
        let both = Zeroizing::new(r.plus(nonce));
        // (k - r d) / (1 + d) is (k + r) / (1 + d) - r.
        let s = both.times(&self.inverse).minus(&r);
        if r.is_zero() || both.is_zero() || s.is_zero() {
            return None;
        }
        let mut bytes = [0; 64];
        bytes[..32].copy_from_slice(&r.to_bytes());
        bytes[32..].copy_from_slice(&s.to_bytes());
        Some(Signature(bytes))
    }
}

/// Checks a signature in full, using the signer's table if there is one.
pub(crate) fn verify(public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
    let (signers, now) = signers::of_process();
    verify_among(signers, now, public, message, signature)
}

/// As [`verify`], with the tables of `signers` at the time `now`.
pub(super) fn verify_among(
    signers: &Signers,
    now: u64,
    public: &PublicKey,
    message: &[u8],
    signature: &Signature,
) -> Result<(), CryptoError> {
    if let Some(known) = signers.known(public) {
        check(&known.table, &known.za, message, signature)?;
        known.used(now);
        return Ok(());
    }
    let (point, za) = (point(public)?, za(public));
    check(&point, &za, message, signature)?;
    signers.seen(public, &point, &za, now);
    Ok(())
}

/// Checks a signature in full, as for an unknown signer; only for measurements.
///
/// # Errors
/// [`CryptoError::PublicPoint`] or [`CryptoError::BadSignature`].
pub fn verify_as_stranger(public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
    check(&point(public)?, &za(public), message, signature)
}

fn check(signer: &impl Signer, za: &[u8; 32], message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
    let (halves, _) = signature.0.as_chunks::<32>();
    let number = |at: usize| halves.get(at).and_then(Scalar::from_bytes).ok_or(CryptoError::BadSignature);
    let (r, s) = (number(0)?, number(1)?);
    if verifies(signer, &hash(za, message), &r, &s) { Ok(()) } else { Err(CryptoError::BadSignature) }
}
