//! The default provider: SM2, SM3 and SM4-GCM by our own kernels. The crate's SM2 (`rustcrypto`) and libsm remain
//! available, as alternatives and for comparison.

use zeroize::Zeroizing;

use crate::model::{PublicKey, Signature};

use super::der::CipherParts;
use super::provider::{Provider, check_plain};
use super::random::random_bytes;
use super::{CryptoError, SmSecret, sm2};

/// The default provider.
#[derive(Debug, Clone, Copy)]
pub struct AuthrosProvider;

impl Provider for AuthrosProvider {
    fn name(&self) -> &'static str {
        "authros"
    }

    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature, CryptoError> {
        let random = Zeroizing::new(random_bytes()?);
        Ok(secret.kernel_key()?.sign(message, &random))
    }

    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError> {
        sm2::verify(public, message, signature)
    }

    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>, CryptoError> {
        check_plain(plain)?;
        Ok(sm2::encrypt(public, plain)?.encode())
    }

    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        sm2::decrypt(secret.expose(), CipherParts::parse(der)?)
    }

    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey, CryptoError> {
        Ok(*secret.kernel_key()?.public())
    }

    fn check_public_key(&self, public: &PublicKey) -> Result<(), CryptoError> {
        sm2::point(public).map(|_| ())
    }
}
