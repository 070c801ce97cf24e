//! An alternative provider: the `libsm` crate behind guards. libsm panics on malformed input, accepts private keys 0
//! and n and non-canonical points, and writes C1 || C2 || C3, so lengths, ranges and points are checked here first. It
//! is not constant-time and wipes no secret.

use std::sync::{LazyLock, Once};

use libsm::sm2::encrypt::{DecryptCtx, EncryptCtx};
use libsm::sm2::signature::{Pubkey, Seckey, SigCtx, Signature as RawSignature};
use libsm::sm3::hash::Sm3Hash;
use libsm::sm4::cipher::Sm4Cipher;
use zeroize::Zeroizing;

use crate::der::CipherParts;
use crate::gcm::{self, BlockCipher};
use crate::model::{PublicKey, Signature};
use crate::provider::{Provider, check_plain};
use crate::secret::{ORDER, uncompressed, unprefixed};
use crate::{CryptoError, SmSecret};

/// The guarded `libsm` provider.
#[derive(Debug, Clone, Copy)]
pub struct LibsmProvider;

static CONTEXT: LazyLock<SigCtx> = LazyLock::new(SigCtx::new);

/// The field's modulus p (GB/T 32918.5-2017, 4), big endian.
const MODULUS: [u8; 32] = [
    0xff, 0xff, 0xff, 0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
    0xff, 0, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
];

/// Starts a thread, once, that builds libsm's table of multiples of the generator.
pub(super) fn warm_up() {
    static STARTED: Once = Once::new();
    STARTED.call_once(|| {
        // If no thread can be started, the first call builds the table instead.
        let _ = std::thread::Builder::new().name("libsm-tables".into()).spawn(|| {
            let _ = CONTEXT.load_seckey(&[1; 32]).map(|one| CONTEXT.pk_from_sk(&one).is_ok());
        });
    });
}

/// One SM4 key.
pub(super) struct Sm4Block(Sm4Cipher);

impl Sm4Block {
    pub(super) fn new(key: &[u8; 16]) -> Result<Self, CryptoError> {
        Sm4Cipher::new(key).map(Self).map_err(|_| CryptoError::Internal("SM4"))
    }
}

impl BlockCipher for Sm4Block {
    fn encrypt_block(&self, block: &[u8; 16]) -> Result<[u8; 16], CryptoError> {
        self.0.encrypt(block).map_err(|_| CryptoError::Internal("SM4"))
    }
}

/// A point of the curve whose coordinates are below p; libsm must write it back unchanged.
fn point(public: &PublicKey) -> Result<Pubkey, CryptoError> {
    let bytes = uncompressed(public);
    let (x, y) = public.0.split_at(32);
    if x >= &MODULUS[..] || y >= &MODULUS[..] {
        return Err(CryptoError::PublicPoint);
    }
    let point = CONTEXT.load_pubkey(&bytes).map_err(|_| CryptoError::PublicPoint)?;
    match CONTEXT.serialize_pubkey(&point, false) {
        Ok(again) if again == bytes => Ok(point),
        _ => Err(CryptoError::PublicPoint),
    }
}

fn scalar(secret: &SmSecret) -> Result<Seckey, CryptoError> {
    CONTEXT.load_seckey(secret.expose()).map_err(|_| CryptoError::SecretRange("SM2"))
}

fn in_range(number: &[u8]) -> bool {
    number.iter().any(|byte| *byte != 0) && number < &ORDER[..]
}

/// A number of at most 32 bytes, padded with leading zeros.
fn padded(big_endian: &[u8]) -> Result<[u8; 32], CryptoError> {
    let mut out = [0; 32];
    let start = 32usize.checked_sub(big_endian.len()).ok_or(CryptoError::Internal("SM2 signature"))?;
    out[start..].copy_from_slice(big_endian);
    Ok(out)
}

/// SM3(ZA || message), the number that SM2 signs, as libsm computes it.
#[cfg(test)]
pub(super) fn signed_hash(public: &PublicKey, message: &[u8]) -> Result<[u8; 32], CryptoError> {
    CONTEXT
        .hash(crate::provider::DISTINGUISHED_ID, &point(public)?, message)
        .map_err(|_| CryptoError::Internal("SM2 hash"))
}

impl Provider for LibsmProvider {
    fn name(&self) -> &'static str {
        "libsm"
    }

    fn sm3(&self, parts: &[&[u8]]) -> [u8; 32] {
        match parts {
            [whole] => Sm3Hash::new(whole).get_hash(),
            _ => Sm3Hash::new(&Zeroizing::new(parts.concat())).get_hash(),
        }
    }

    fn sm3_many(&self, messages: &[&[u8]]) -> Vec<[u8; 32]> {
        messages.iter().map(|message| self.sm3(&[message])).collect()
    }

    fn gcm_seal_in_place(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        text: &mut [u8],
    ) -> Result<[u8; 16], CryptoError> {
        gcm::seal(&Sm4Block::new(key)?, nonce, aad, text)
    }

    fn gcm_open(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        sealed: &[u8],
    ) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        gcm::open(&Sm4Block::new(key)?, nonce, aad, sealed)
    }

    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature, CryptoError> {
        let public = point(secret.public_key(self)?)?;
        let signature =
            CONTEXT.sign(message, &scalar(secret)?, &public).map_err(|_| CryptoError::Internal("SM2 signature"))?;
        let mut raw = [0; 64];
        raw[..32].copy_from_slice(&padded(&signature.get_r().to_bytes_be())?);
        raw[32..].copy_from_slice(&padded(&signature.get_s().to_bytes_be())?);
        Ok(Signature(raw))
    }

    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
        let public = point(public)?;
        let (r, s) = signature.0.split_at(32);
        if !in_range(r) || !in_range(s) {
            return Err(CryptoError::BadSignature);
        }
        match CONTEXT.verify(message, &public, &RawSignature::new(r, s)) {
            Ok(true) => Ok(()),
            _ => Err(CryptoError::BadSignature),
        }
    }

    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>, CryptoError> {
        check_plain(plain)?;
        let raw = EncryptCtx::new(plain.len(), point(public)?)
            .encrypt(plain)
            .map_err(|_| CryptoError::Internal("SM2 encryption"))?;
        reordered(&raw, plain.len()).map(|parts| parts.encode()).ok_or(CryptoError::Internal("SM2 encryption"))
    }

    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        let CipherParts { x, y, check, text } = CipherParts::parse(der)?;
        point(&unprefixed(&x, &y))?;
        let raw = [&[4], &x[..], &y, &text, &check].concat();
        DecryptCtx::new(text.len(), scalar(secret)?)
            .decrypt(&raw)
            .map(Zeroizing::new)
            .map_err(|_| CryptoError::BadCiphertext)
    }

    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey, CryptoError> {
        let internal = |_| CryptoError::Internal("SM2");
        let point = CONTEXT.pk_from_sk(&scalar(secret)?).map_err(internal)?;
        let bytes = CONTEXT.serialize_pubkey(&point, false).map_err(internal)?;
        bytes.get(1..).and_then(PublicKey::from_slice).ok_or(CryptoError::Internal("SM2"))
    }

    fn check_public_key(&self, public: &PublicKey) -> Result<(), CryptoError> {
        point(public).map(|_| ())
    }
}

/// Splits libsm's 04 || x || y || C2 || C3.
fn reordered(raw: &[u8], length: usize) -> Option<CipherParts> {
    let (prefix, rest) = raw.split_first()?;
    let (x, rest) = rest.split_first_chunk::<32>()?;
    let (y, rest) = rest.split_first_chunk::<32>()?;
    let (text, check) = rest.split_at_checked(length)?;
    let parts = CipherParts { x: *x, y: *y, check: check.try_into().ok()?, text: text.to_vec() };
    (*prefix == 4).then_some(parts)
}
