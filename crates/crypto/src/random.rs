//! Random bytes from the operating system; the only source of randomness in this crate.

use super::CryptoError;

/// `N` fresh random bytes.
///
/// # Errors
/// [`CryptoError::Random`] if the operating system provides none.
pub fn random_bytes<const N: usize>() -> Result<[u8; N], CryptoError> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|_| CryptoError::Random)?;
    Ok(bytes)
}
