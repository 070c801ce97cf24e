//! SM2 (GB/T 32918-2016) by our own kernels: signatures, their verification, encryption. The arithmetic is in
//! `kernel::sm2`; here are the steps of the standard, nonces, and the tables kept for known signers.

mod encryption;
mod nonce;
mod signers;
mod signing;

#[cfg(test)]
mod tests;

pub(super) use encryption::{decrypt, encrypt, shared_x};
pub use signing::verify_as_stranger;
pub(super) use signing::{SigningKey, verify};

use crate::model::PublicKey;

use super::kernel::sm2::Affine;
use super::{CryptoError, kernel};

/// The point of a public key, checked to be on the curve and canonically encoded.
pub(super) fn point(public: &PublicKey) -> Result<Affine, CryptoError> {
    Affine::from_bytes(&public.0).ok_or(CryptoError::PublicPoint)
}

/// Starts a thread, once, that builds the tables of the generator's multiples.
pub(super) fn warm_up() {
    static STARTED: std::sync::Once = std::sync::Once::new();
    STARTED.call_once(|| {
        // If no thread can be started, the first signature and verification build the tables instead.
        let _ = std::thread::Builder::new().name("sm2-tables".into()).spawn(kernel::sm2::warm_up);
    });
}
