//! The secp256k1 key of an Ethereum account.

use std::fmt;

use k256::ecdsa::SigningKey;
use subtle::ConstantTimeEq as _;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use crate::crypto::CryptoError;
use crate::crypto::random::random_bytes;
use crate::model::Address;

/// The private key of an externally owned account.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct EoaSecret {
    secret: [u8; 32],
    /// Public, and asked for far oftener than anything is signed.
    #[zeroize(skip)]
    address: Address,
}

impl EoaSecret {
    /// Fresh, from the operating system's random source.
    ///
    /// # Errors
    /// [`CryptoError::Random`] if that fails.
    pub fn generate() -> Result<Self, CryptoError> {
        loop {
            let bytes = Zeroizing::new(random_bytes::<32>()?);
            if let Ok(secret) = Self::from_slice(&*bytes) {
                return Ok(secret);
            }
        }
    }

    /// From 32 bytes, big endian, 1 to n - 1 of secp256k1.
    ///
    /// # Errors
    /// [`CryptoError::SecretRange`] if it is out of range or of another length.
    pub fn from_slice(bytes: &[u8]) -> Result<Self, CryptoError> {
        let range = CryptoError::SecretRange("secp256k1");
        let Ok(secret) = <[u8; 32]>::try_from(bytes) else { return Err(range) };
        let Ok(key) = SigningKey::from_slice(bytes) else { return Err(range) };
        let mut point = [0; 64];
        point.copy_from_slice(&key.verifying_key().to_encoded_point(false).as_bytes()[1..]);
        Ok(Self { secret, address: Address::from_public_key(&point) })
    }

    /// The secret bytes; do not copy them anywhere that outlives their use.
    pub fn expose(&self) -> &[u8; 32] {
        &self.secret
    }

    /// The account's address.
    pub fn address(&self) -> Address {
        self.address
    }
}

/// In constant time.
impl PartialEq for EoaSecret {
    fn eq(&self, other: &Self) -> bool {
        self.secret.ct_eq(&other.secret).into()
    }
}

impl Eq for EoaSecret {}

impl fmt::Debug for EoaSecret {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "EoaSecret({})", self.address())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_well_known_keys() {
        let mut one = [0; 32];
        one[31] = 1;
        let address = EoaSecret::from_slice(&one).expect("in range").address();
        assert_eq!(address.to_string(), "0x7E5F4552091A69125d5DfCb7b8C2659029395Bdf");
        assert!(EoaSecret::from_slice(&[0; 32]).is_err());
        assert!(EoaSecret::from_slice(&[0xff; 32]).is_err());
        assert!(EoaSecret::from_slice(&[1; 31]).is_err());
        let shown = format!("{:?}", EoaSecret::from_slice(&one));
        assert!(!shown.contains(&"00".repeat(8)), "{shown}");
    }
}
