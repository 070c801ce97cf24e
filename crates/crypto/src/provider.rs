//! The interface to the SM algorithms: three providers that agree on every byte. The setting `crypto.provider` selects
//! one.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use zeroize::Zeroizing;

use crate::model::{PublicKey, Signature, clean};

use super::authros_provider::AuthrosProvider;
use super::kernel::Available;
use super::libsm_provider::LibsmProvider;
use super::rustcrypto::RustCryptoProvider;
use super::{CryptoError, SmSecret, sm4_gcm};

/// SM2, SM3 and SM4-GCM as this program uses them. All providers accept and refuse the same inputs. SM3 and SM4-GCM
/// come from our own kernels unless a provider brings its own.
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
    ///
    /// # Errors
    /// [`CryptoError::Length`] if the text is longer than GCM allows.
    fn gcm_seal_in_place(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        text: &mut [u8],
    ) -> Result<[u8; 16], CryptoError> {
        sm4_gcm::seal(Available::decided(), key, nonce, aad, text)
    }

    /// SM4-GCM (RFC 8998, 96-bit nonce): encrypts `buffer` in place and appends the 16-byte tag.
    ///
    /// # Errors
    /// [`CryptoError::Length`] if the buffer is longer than GCM allows.
    fn gcm_seal(&self, key: &[u8; 16], nonce: &[u8; 12], aad: &[u8], buffer: &mut Vec<u8>) -> Result<(), CryptoError> {
        let tag = self.gcm_seal_in_place(key, nonce, aad, buffer)?;
        buffer.extend_from_slice(&tag);
        Ok(())
    }

    /// SM4-GCM: checks the tag in constant time, then decrypts.
    ///
    /// # Errors
    /// [`CryptoError::BadCiphertext`] if key, nonce, AAD or a byte differ; nothing is decrypted then.
    fn gcm_open(
        &self,
        key: &[u8; 16],
        nonce: &[u8; 12],
        aad: &[u8],
        sealed: &[u8],
    ) -> Result<Zeroizing<Vec<u8>>, CryptoError> {
        sm4_gcm::open(Available::decided(), key, nonce, aad, sealed)
    }

    /// SM2 signature (GB/T 32918.2-2016, 6.1) under the ID 1234567812345678, raw r || s.
    ///
    /// # Errors
    /// [`CryptoError`] if the random source or the algorithm fails.
    fn sign(&self, secret: &SmSecret, message: &[u8]) -> Result<Signature, CryptoError>;

    /// SM2 verification (GB/T 32918.2-2016, 7.1) under the ID 1234567812345678.
    ///
    /// # Errors
    /// [`CryptoError::PublicPoint`] or [`CryptoError::BadSignature`].
    fn verify(&self, public: &PublicKey, message: &[u8], signature: &Signature) -> Result<(), CryptoError>;

    /// SM2 encryption (GB/T 32918.4-2016, 6.1) as GM/T 0009 DER, order C1 || C3 || C2.
    ///
    /// # Errors
    /// [`CryptoError::PublicPoint`], or [`CryptoError::Length`] if `plain` is empty or over 1 MiB.
    fn encrypt(&self, public: &PublicKey, plain: &[u8]) -> Result<Vec<u8>, CryptoError>;

    /// SM2 decryption (GB/T 32918.4-2016, 7.1) of GM/T 0009 DER.
    ///
    /// # Errors
    /// [`CryptoError::Malformed`], [`CryptoError::PublicPoint`] or [`CryptoError::BadCiphertext`].
    fn decrypt(&self, secret: &SmSecret, der: &[u8]) -> Result<Zeroizing<Vec<u8>>, CryptoError>;

    /// The public key of `secret`.
    ///
    /// # Errors
    /// [`CryptoError::Internal`] if the algorithm fails.
    fn public_key(&self, secret: &SmSecret) -> Result<PublicKey, CryptoError>;

    /// Checks that `public` is a point of the curve in its canonical encoding.
    ///
    /// # Errors
    /// [`CryptoError::PublicPoint`] if it is not.
    fn check_public_key(&self, public: &PublicKey) -> Result<(), CryptoError>;
}

/// The most bytes that SM2 encrypts at once.
pub const LARGEST_SM2_PLAIN: usize = 1024 * 1024;

/// Refuses what SM2 encryption cannot or should not take: nothing at all, or more than it is meant for.
pub(super) fn check_plain(plain: &[u8]) -> Result<(), CryptoError> {
    if (1..=LARGEST_SM2_PLAIN).contains(&plain.len()) {
        return Ok(());
    }
    Err(CryptoError::Length { what: "text for SM2", found: plain.len(), allowed: "1 to 1,048,576" })
}

/// Which provider to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
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

impl FromStr for ProviderName {
    type Err = ProviderNameError;

    fn from_str(text: &str) -> Result<Self, ProviderNameError> {
        match text {
            "authros" => Ok(Self::Authros),
            "rustcrypto" => Ok(Self::RustCrypto),
            "libsm" => Ok(Self::Libsm),
            other => Err(ProviderNameError(clean(other, 40))),
        }
    }
}

impl fmt::Display for ProviderName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Authros => "authros",
            Self::RustCrypto => "rustcrypto",
            Self::Libsm => "libsm",
        })
    }
}

/// The provider of that name. Its first use starts a thread that builds its tables of the curve.
pub fn provider(name: ProviderName) -> &'static dyn Provider {
    match name {
        ProviderName::Authros => {
            super::sm2::warm_up();
            &AuthrosProvider
        }
        ProviderName::RustCrypto => {
            super::rustcrypto::warm_up();
            &RustCryptoProvider
        }
        ProviderName::Libsm => {
            super::libsm_provider::warm_up();
            &LibsmProvider
        }
    }
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
