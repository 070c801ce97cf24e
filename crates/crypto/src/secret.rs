//! Secret keys as types: range-checked on construction, wiped on drop, never printed. `derive` says how keys are
//! derived from each other, `keyring` how they are stored on disk.

use std::fmt;

use subtle::ConstantTimeEq as _;
use zeroize::{Zeroize, ZeroizeOnDrop};

use super::CryptoError;
use super::random::random_bytes;

mod eoa;
mod sm2_secret;

pub use eoa::EoaSecret;
pub use sm2_secret::{Fingerprint, FingerprintError, SmKeyPair, SmSecret};
pub(super) use sm2_secret::{ORDER, uncompressed, unprefixed};

macro_rules! secret_bytes {
    ($($(#[$doc:meta])* $name:ident($size:literal);)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Zeroize, ZeroizeOnDrop)]
        pub struct $name([u8; $size]);

        impl $name {
            /// Length in bytes.
            pub const LENGTH: usize = $size;

            /// From its bytes.
            pub fn new(bytes: [u8; $size]) -> Self {
                Self(bytes)
            }

            /// Fresh, from the operating system's random source.
            ///
            /// # Errors
            /// [`CryptoError::Random`] if that fails.
            pub fn generate() -> Result<Self, CryptoError> {
                random_bytes().map(Self)
            }

            /// From a slice of exactly [`Self::LENGTH`] bytes.
            pub fn from_slice(bytes: &[u8]) -> Option<Self> {
                bytes.try_into().ok().map(Self)
            }

            /// The secret bytes; do not copy them anywhere that outlives their use.
            pub fn expose(&self) -> &[u8; $size] {
                &self.0
            }
        }

        /// In constant time.
        impl PartialEq for $name {
            fn eq(&self, other: &Self) -> bool {
                self.0.ct_eq(&other.0).into()
            }
        }

        impl Eq for $name {}

        impl fmt::Debug for $name {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str(concat!(stringify!($name), "(secret)"))
            }
        }
    )*};
}

secret_bytes! {
    /// K_C: the SM4 key of a profile. Input to epoch keys, never a working key.
    Sm4Key(16);
    /// EK: the key from which an epoch's topic keys are derived.
    EpochKey(32);
    /// The key that seals the records of one topic in one epoch.
    TopicKey(32);
    /// IK: turns topic names and tags into pseudonyms; stable across epochs.
    IndexKey(32);
    /// Turns the types and tags of one topic's records into pseudonyms; derived from IK, which cannot be derived from
    /// it.
    FilterKey(32);
    /// K_T: the key a client and its gateway mix into every session; it opens no record.
    TransportKey(32);
    /// r: the secret random salt of an epoch, drawn when it begins and not kept.
    EpochSalt(32);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_compared_but_never_shown() {
        let key = Sm4Key::generate().expect("random");
        assert_eq!(key, Sm4Key::from_slice(key.expose()).expect("16 bytes"));
        assert_ne!(key, Sm4Key::generate().expect("random"));
        assert_eq!(format!("{key:?}"), "Sm4Key(secret)");
        assert!(Sm4Key::from_slice(&[0; 15]).is_none());
    }
}
