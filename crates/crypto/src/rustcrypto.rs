//! The `RustCrypto` crate sm2 with our own kernels for SM3 and SM4-GCM. Nonces of signatures are hedged: derived
//! (RFC 6979) from key, message and fresh random bytes.

use std::sync::Once;

use getrandom::SysRng;
use sm2::dsa::signature::{RandomizedSigner as _, Verifier as _};
use sm2::dsa::{Signature as DsaSignature, SigningKey, VerifyingKey};
use sm2::elliptic_curve::sec1::ToSec1Point as _;
use sm2::pke::{Cipher, DecryptingKey, EncryptingKey, Mode};
use zeroize::Zeroizing;

use crate::model::{PublicKey, Signature};

use super::der::CipherParts;
use super::provider::{Provider, check_plain};
use super::secret::{uncompressed, unprefixed};
use super::{CryptoError, SmSecret};

/// The signer's distinguishing identifier (GM/T 0009-2012, 10).
pub(super) const DISTINGUISHED_ID: &str = "1234567812345678";

/// The provider with the crate's SM2.
#[derive(Debug, Clone, Copy)]
pub struct RustCryptoProvider;

/// Starts a thread, once, that builds the crate's table of multiples of the generator.
pub(super) fn warm_up() {
    static STARTED: Once = Once::new();
    STARTED.call_once(|| {
        // If no thread can be started, the first signature builds the table instead.
        let _ = std::thread::Builder::new().name("sm2-tables".into()).spawn(|| signing_key(&[1; 32]).is_ok());
    });
}

/// The point of a public key, checked to be on the curve.
pub(super) fn point(public: &PublicKey) -> Result<sm2::PublicKey, CryptoError> {
    sm2::PublicKey::from_sec1_bytes(&uncompressed(public)).map_err(|_| CryptoError::PublicPoint)
}

/// The signing key of a secret, with its public point and ZA.
pub(super) fn signing_key(secret: &[u8; 32]) -> Result<SigningKey, CryptoError> {
    SigningKey::from_slice(DISTINGUISHED_ID, secret).map_err(|_| CryptoError::SecretRange("SM2"))
}

impl Provider for RustCryptoProvider {
    fn name(&self) -> &'static str {
        "rustcrypto"
    }

    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature, CryptoError> {
        let signature: DsaSignature =
            secret.signing_key()?.try_sign_with_rng(&mut SysRng, message).map_err(|_| CryptoError::Random)?;
        Ok(Signature(signature.to_bytes().into()))
    }

    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
        let key = VerifyingKey::new(DISTINGUISHED_ID, point(public)?).map_err(|_| CryptoError::PublicPoint)?;
        let signature = DsaSignature::from_slice(&signature.0).map_err(|_| CryptoError::BadSignature)?;
        key.verify(message, &signature).map_err(|_| CryptoError::BadSignature)
    }

    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>, CryptoError> {
        check_plain(plain)?;
        let key = EncryptingKey::new_with_mode(point(public)?, Mode::C1C3C2);
        let cipher: Cipher<'_> =
            key.encrypt_cipher::<_, sm3::Sm3>(&mut SysRng, plain).map_err(|_| CryptoError::Random)?;
        let (x, y) = cipher
            .c1()
            .to_sec1_point(false)
            .as_bytes()
            .get(1..)
            .and_then(halves)
            .ok_or(CryptoError::Internal("SM2 encryption"))?;
        Ok(CipherParts { x, y, check: (*cipher.c3()).into(), text: cipher.c2().to_vec() }.encode())
    }

    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        let CipherParts { x, y, check, text } = CipherParts::parse(der)?;
        point(&unprefixed(&x, &y))?;
        let raw = [&[4], &x[..], &y, &check, &text].concat();
        let cipher = Cipher::from_slice(&raw, Mode::C1C3C2).map_err(|_| CryptoError::PublicPoint)?;
        let key = DecryptingKey::from_slice(secret.expose()).map_err(|_| CryptoError::SecretRange("SM2"))?;
        let mut plain = Zeroizing::new(vec![0; text.len()]);
        key.decrypt_cipher_with_buf::<sm3::Sm3>(&cipher, &mut plain).map_err(|_| CryptoError::BadCiphertext)?;
        // An all-zero mask (GB/T 32918.4, 7.1 B4) is an error; it shows as an unmasked text.
        if *plain == text { Err(CryptoError::BadCiphertext) } else { Ok(plain) }
    }

    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey, CryptoError> {
        let bytes = secret.signing_key()?.verifying_key().to_sec1_bytes();
        bytes.get(1..).and_then(PublicKey::from_slice).ok_or(CryptoError::Internal("SM2"))
    }

    fn check_public_key(&self, public: &PublicKey) -> Result<(), CryptoError> {
        point(public).map(|_| ())
    }
}

fn halves(point: &[u8]) -> Option<([u8; 32], [u8; 32])> {
    let (x, y) = point.split_at_checked(32)?;
    Some((x.try_into().ok()?, y.try_into().ok()?))
}
