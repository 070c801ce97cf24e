//! The interface to the SM algorithms: three providers that agree on every byte. libsm panics on malformed input,
//! accepts private keys 0 and n and non-canonical points, and writes C1 || C2 || C3, so lengths, ranges and points are
//! checked here first. It is not constant-time and wipes no secret.

use std::sync::{LazyLock, Once};

use crate::der::CipherParts;
use crate::gcm::{self, BlockCipher};
use crate::kernel::Available;
use crate::model::{PublicKey, Signature, clean};
use crate::secret::{ORDER, joined, random_bytes, uncompressed};
use crate::{CryptoError, Result, SmSecret, sm2 as kernels, sm4_gcm};
use getrandom::SysRng;
use libsm::sm2::encrypt::{DecryptCtx, EncryptCtx};
use libsm::sm2::signature::{Pubkey, Seckey, SigCtx, Signature as RawSignature};
use libsm::sm3::hash::Sm3Hash;
use libsm::sm4::cipher::Sm4Cipher;
use serde::{Deserialize, Serialize};
use sm2::dsa::signature::{RandomizedSigner as _, Verifier as _};
use sm2::dsa::{Signature as DsaSignature, SigningKey, VerifyingKey};
use sm2::elliptic_curve::sec1::ToSec1Point as _;
use sm2::pke::{Cipher, DecryptingKey, EncryptingKey, Mode};
use zeroize::Zeroizing;

/// All providers accept and refuse the same inputs; SM3 and SM4-GCM are our own unless a provider brings its own.
pub trait Provider: Send + Sync {
    /// `authros`, `rustcrypto` or `libsm`.
    fn name(&self) -> &'static str;

    /// SM3 (GB/T 32905-2016) of the concatenation of `parts`.
    fn sm3(&self, parts: &[&[u8]]) -> [u8; 32] {
        super::sm3::sm3(parts)
    }

    /// SM3 of each message; many short ones at once if the processor can.
    fn sm3_many(&self, messages: &[&[u8]]) -> Vec<[u8; 32]> {
        super::sm3::sm3_many(messages)
    }

    /// SM4-GCM (RFC 8998, 96-bit nonce): encrypts `text` in place and returns the tag that follows it.
    /// # Errors
    /// [`CryptoError::Length`] if the text is longer than GCM allows.
    fn gcm_seal_in_place(&self, key: &[u8; 16], nonce: &[u8; 12], aad: &[u8], text: &mut [u8]) -> Result<[u8; 16]> {
        sm4_gcm::seal(Available::decided(), key, nonce, aad, text)
    }

    /// SM4-GCM (RFC 8998, 96-bit nonce): encrypts `buffer` in place and appends the 16-byte tag.
    /// # Errors
    /// [`CryptoError::Length`] if the buffer is longer than GCM allows.
    fn gcm_seal(&self, key: &[u8; 16], nonce: &[u8; 12], aad: &[u8], buffer: &mut Vec<u8>) -> Result<()> {
        let tag = self.gcm_seal_in_place(key, nonce, aad, buffer)?;
        buffer.extend_from_slice(&tag);
        Ok(())
    }

    /// SM4-GCM: checks the tag in constant time, then decrypts.
    /// # Errors
    /// [`CryptoError::BadCiphertext`] if key, nonce, AAD or a byte differ; nothing is decrypted then.
    fn gcm_open(&self, key: &[u8; 16], nonce: &[u8; 12], aad: &[u8], sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>> {
        sm4_gcm::open(Available::decided(), key, nonce, aad, sealed)
    }

    /// SM2 signature (GB/T 32918.2-2016, 6.1) under the ID 1234567812345678, raw r || s.
    /// # Errors
    /// [`CryptoError`] if the random source or the algorithm fails.
    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature>;

    /// SM2 verification (GB/T 32918.2-2016, 7.1) under the ID 1234567812345678.
    /// # Errors
    /// [`CryptoError::PublicPoint`] or [`CryptoError::BadSignature`].
    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<()>;

    /// SM2 encryption (GB/T 32918.4-2016, 6.1) as GM/T 0009 DER, order C1 || C3 || C2.
    /// # Errors
    /// [`CryptoError::PublicPoint`], or [`CryptoError::Length`] if `plain` is empty or over 1 MiB.
    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>>;

    /// SM2 decryption (GB/T 32918.4-2016, 7.1) of GM/T 0009 DER.
    /// # Errors
    /// [`CryptoError::Malformed`], [`CryptoError::PublicPoint`] or [`CryptoError::BadCiphertext`].
    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>>;

    /// The public key of `secret`.
    /// # Errors
    /// [`CryptoError::Internal`] if the algorithm fails.
    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey>;

    /// Checks that `public` is a point of the curve in its canonical encoding.
    /// # Errors
    /// [`CryptoError::PublicPoint`] if it is not.
    fn check_public_key(&self, public: &PublicKey) -> Result<()>;
}

/// The most bytes that SM2 encrypts at once.
pub const LARGEST_SM2_PLAIN: usize = 1024 * 1024;

fn check_plain(plain: &[u8]) -> Result<()> {
    if (1..=LARGEST_SM2_PLAIN).contains(&plain.len()) {
        return Ok(());
    }
    Err(CryptoError::Length { what: "text for SM2", found: plain.len(), allowed: "1 to 1,048,576" })
}

/// Which provider to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, strum::Display, strum::EnumString)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase", parse_err_ty = ProviderNameError, parse_err_fn = not_a_name)]
pub enum ProviderName {
    /// Our own kernels.
    #[default]
    Authros,
    /// The `RustCrypto` crate for SM2, our own kernels for SM3 and SM4.
    RustCrypto,
    /// The `libsm` crate behind guards.
    Libsm,
}

/// Not the name of a provider.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a crypto provider; set crypto.provider to authros, rustcrypto or libsm")]
pub struct ProviderNameError(String);

impl ProviderName {
    /// All providers, the default first.
    pub const ALL: [Self; 3] = [Self::Authros, Self::RustCrypto, Self::Libsm];
}

fn not_a_name(text: &str) -> ProviderNameError {
    ProviderNameError(clean(text, 40))
}

/// The provider of that name. Its first use starts a thread that builds its tables of the curve.
pub fn provider(name: ProviderName) -> &'static dyn Provider {
    match name {
        ProviderName::Authros => {
            static STARTED: Once = Once::new();
            warm_up(&STARTED, "sm2-tables", super::kernel::sm2::warm_up);
            &AuthrosProvider
        }
        ProviderName::RustCrypto => {
            static STARTED: Once = Once::new();
            warm_up(&STARTED, "sm2-tables", || drop(signing_key(&[1; 32])));
            &RustCryptoProvider
        }
        ProviderName::Libsm => {
            static STARTED: Once = Once::new();
            warm_up(&STARTED, "libsm-tables", || {
                drop(CONTEXT.load_seckey(&[1; 32]).map(|one| CONTEXT.pk_from_sk(&one)))
            });
            &LibsmProvider
        }
    }
}

// Nonces of the crate's signatures are hedged: derived (RFC 6979) from key, message and fresh random bytes.

/// The signer's distinguishing identifier (GM/T 0009-2012, 10).
pub(super) const DISTINGUISHED_ID: &str = "1234567812345678";

/// The provider with the crate's SM2.
#[derive(Debug, Clone, Copy)]
pub struct RustCryptoProvider;

/// Starts a thread, once, that builds tables of multiples of the generator.
fn warm_up(started: &'static Once, name: &str, build: impl FnOnce() + Send + 'static) {
    started.call_once(|| {
        // If no thread can be started, the first signature or verification builds them instead.
        let _ = std::thread::Builder::new().name(name.into()).spawn(build);
    });
}

pub(super) fn point(public: &PublicKey) -> Result<sm2::PublicKey> {
    sm2::PublicKey::from_sec1_bytes(&uncompressed(public)).map_err(|_| CryptoError::PublicPoint)
}

pub(super) fn signing_key(secret: &[u8; 32]) -> Result<SigningKey> {
    SigningKey::from_slice(DISTINGUISHED_ID, secret).map_err(|_| CryptoError::SecretRange("SM2"))
}

impl Provider for RustCryptoProvider {
    fn name(&self) -> &'static str {
        "rustcrypto"
    }

    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature> {
        let signature: DsaSignature =
            secret.signing_key()?.try_sign_with_rng(&mut SysRng, message).map_err(|_| CryptoError::Random)?;
        Ok(Signature(signature.to_bytes().into()))
    }

    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<()> {
        let key = VerifyingKey::new(DISTINGUISHED_ID, point(public)?).map_err(|_| CryptoError::PublicPoint)?;
        let signature = DsaSignature::from_slice(&signature.0).map_err(|_| CryptoError::BadSignature)?;
        key.verify(message, &signature).map_err(|_| CryptoError::BadSignature)
    }

    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>> {
        check_plain(plain)?;
        let key = EncryptingKey::new_with_mode(point(public)?, Mode::C1C3C2);
        let cipher: Cipher<'_> =
            key.encrypt_cipher::<_, sm3::Sm3>(&mut SysRng, plain).map_err(|_| CryptoError::Random)?;
        let c1 = cipher.c1().to_sec1_point(false);
        let (x, y) = c1.as_bytes().get(1..).and_then(halves).ok_or(CryptoError::Internal("SM2 encryption"))?;
        Ok(CipherParts { x, y, check: (*cipher.c3()).into(), text: cipher.c2().to_vec() }.encode())
    }

    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>> {
        let CipherParts { x, y, check, text } = CipherParts::parse(der)?;
        point(&PublicKey(joined(&x, &y)))?;
        let raw = [&[4], &x[..], &y, &check, &text].concat();
        let cipher = Cipher::from_slice(&raw, Mode::C1C3C2).map_err(|_| CryptoError::PublicPoint)?;
        let key = DecryptingKey::from_slice(secret.expose()).map_err(|_| CryptoError::SecretRange("SM2"))?;
        let mut plain = Zeroizing::new(vec![0; text.len()]);
        key.decrypt_cipher_with_buf::<sm3::Sm3>(&cipher, &mut plain).map_err(|_| CryptoError::BadCiphertext)?;
        // An all-zero mask (GB/T 32918.4, 7.1 B4) is an error; it shows as an unmasked text.
        if *plain == text { Err(CryptoError::BadCiphertext) } else { Ok(plain) }
    }

    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey> {
        let bytes = secret.signing_key()?.verifying_key().to_sec1_bytes();
        bytes.get(1..).and_then(PublicKey::from_slice).ok_or(CryptoError::Internal("SM2"))
    }

    fn check_public_key(&self, public: &PublicKey) -> Result<()> {
        point(public).map(|_| ())
    }
}

pub(super) fn halves(point: &[u8]) -> Option<([u8; 32], [u8; 32])> {
    let (x, y) = point.split_at_checked(32)?;
    Some((x.try_into().ok()?, y.try_into().ok()?))
}

/// The default provider.
#[derive(Debug, Clone, Copy)]
pub struct AuthrosProvider;

impl Provider for AuthrosProvider {
    fn name(&self) -> &'static str {
        "authros"
    }

    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature> {
        let random = Zeroizing::new(random_bytes()?);
        Ok(secret.kernel_key()?.sign(message, &random))
    }

    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<()> {
        kernels::verify(public, message, signature)
    }

    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>> {
        check_plain(plain)?;
        Ok(kernels::encrypt(public, plain)?.encode())
    }

    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>> {
        kernels::decrypt(secret.expose(), CipherParts::parse(der)?)
    }

    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey> {
        Ok(*secret.kernel_key()?.public())
    }

    fn check_public_key(&self, public: &PublicKey) -> Result<()> {
        kernels::point(public).map(|_| ())
    }
}

/// The guarded `libsm` provider.
#[derive(Debug, Clone, Copy)]
pub struct LibsmProvider;

static CONTEXT: LazyLock<SigCtx> = LazyLock::new(SigCtx::new);

/// The field's modulus p (GB/T 32918.5-2017, 4), big endian.
const MODULUS: [u8; 32] = [
    0xff, 0xff, 0xff, 0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
    0xff, 0, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
];

pub(super) struct Sm4Block(Sm4Cipher);

impl Sm4Block {
    pub(super) fn new(key: &[u8; 16]) -> Result<Self> {
        Sm4Cipher::new(key).map(Self).map_err(|_| CryptoError::Internal("SM4"))
    }
}

impl BlockCipher for Sm4Block {
    fn encrypt_block(&self, block: &[u8; 16]) -> Result<[u8; 16]> {
        self.0.encrypt(block).map_err(|_| CryptoError::Internal("SM4"))
    }
}

/// A point of the curve whose coordinates are below p; libsm must write it back unchanged.
fn libsm_point(public: &PublicKey) -> Result<Pubkey> {
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

fn scalar(secret: &SmSecret) -> Result<Seckey> {
    CONTEXT.load_seckey(secret.expose()).map_err(|_| CryptoError::SecretRange("SM2"))
}

fn in_range(number: &[u8]) -> bool {
    number.iter().any(|byte| *byte != 0) && number < &ORDER[..]
}

fn padded(big_endian: &[u8]) -> Result<[u8; 32]> {
    let mut out = [0; 32];
    let start = 32usize.checked_sub(big_endian.len()).ok_or(CryptoError::Internal("SM2 signature"))?;
    out[start..].copy_from_slice(big_endian);
    Ok(out)
}

/// SM3(ZA || message), the number that SM2 signs, as libsm computes it.
#[cfg(test)]
pub(super) fn signed_hash(public: &PublicKey, message: &[u8]) -> Result<[u8; 32]> {
    CONTEXT.hash(DISTINGUISHED_ID, &libsm_point(public)?, message).map_err(|_| CryptoError::Internal("SM2 hash"))
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

    fn gcm_seal_in_place(&self, key: &[u8; 16], nonce: &[u8; 12], aad: &[u8], text: &mut [u8]) -> Result<[u8; 16]> {
        gcm::seal(&Sm4Block::new(key)?, nonce, aad, text)
    }

    fn gcm_open(&self, key: &[u8; 16], nonce: &[u8; 12], aad: &[u8], sealed: &[u8]) -> Result<Zeroizing<Vec<u8>>> {
        gcm::open(&Sm4Block::new(key)?, nonce, aad, sealed)
    }

    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature> {
        let public = libsm_point(secret.public_key(self)?)?;
        let signature =
            CONTEXT.sign(message, &scalar(secret)?, &public).map_err(|_| CryptoError::Internal("SM2 signature"))?;
        let (r, s) = (signature.get_r().to_bytes_be(), signature.get_s().to_bytes_be());
        Ok(Signature(joined(&padded(&r)?, &padded(&s)?)))
    }

    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<()> {
        let public = libsm_point(public)?;
        let (r, s) = signature.0.split_at(32);
        if !in_range(r) || !in_range(s) {
            return Err(CryptoError::BadSignature);
        }
        match CONTEXT.verify(message, &public, &RawSignature::new(r, s)) {
            Ok(true) => Ok(()),
            _ => Err(CryptoError::BadSignature),
        }
    }

    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>> {
        check_plain(plain)?;
        let raw = EncryptCtx::new(plain.len(), libsm_point(public)?)
            .encrypt(plain)
            .map_err(|_| CryptoError::Internal("SM2 encryption"))?;
        reordered(&raw, plain.len()).map(|parts| parts.encode()).ok_or(CryptoError::Internal("SM2 encryption"))
    }

    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>> {
        let CipherParts { x, y, check, text } = CipherParts::parse(der)?;
        libsm_point(&PublicKey(joined(&x, &y)))?;
        let raw = [&[4], &x[..], &y, &text, &check].concat();
        DecryptCtx::new(text.len(), scalar(secret)?)
            .decrypt(&raw)
            .map(Zeroizing::new)
            .map_err(|_| CryptoError::BadCiphertext)
    }

    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey> {
        let internal = |_| CryptoError::Internal("SM2");
        let point = CONTEXT.pk_from_sk(&scalar(secret)?).map_err(internal)?;
        let bytes = CONTEXT.serialize_pubkey(&point, false).map_err(internal)?;
        bytes.get(1..).and_then(PublicKey::from_slice).ok_or(CryptoError::Internal("SM2"))
    }

    fn check_public_key(&self, public: &PublicKey) -> Result<()> {
        libsm_point(public).map(|_| ())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_unknown_ones_are_refused() {
        for name in ProviderName::ALL {
            assert_eq!(name.to_string().parse(), Ok(name));
            assert_eq!(provider(name).name(), name.to_string());
            assert_eq!(serde_json::to_string(&name).expect("json"), format!("\"{name}\""));
        }
        assert!("openssl".parse::<ProviderName>().is_err());
        assert_eq!(ProviderName::default(), ProviderName::Authros);
    }
}
