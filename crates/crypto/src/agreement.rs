//! Diffie-Hellman on the SM2 curve with keys that live for one session only. The standard's own key exchange (GB/T
//! 32918.3) uses long-lived keys; here the transcript is signed instead.

use std::fmt;

use zeroize::Zeroizing;

use crate::model::PublicKey;

use super::{CryptoError, Provider, SmSecret, sm2};

/// A private key for one session, wiped when it is used or dropped.
pub struct Ephemeral {
    secret: SmSecret,
    public: PublicKey,
}

impl Ephemeral {
    /// Fresh, from the operating system's random source.
    ///
    /// # Errors
    /// [`CryptoError::Random`] if that fails.
    pub fn generate(provider: &dyn Provider) -> Result<Self, CryptoError> {
        Self::from_secret(provider, SmSecret::generate()?)
    }

    /// From a secret drawn elsewhere; only test vectors need this.
    ///
    /// # Errors
    /// [`CryptoError::Internal`] if the algorithm fails.
    pub fn from_secret(provider: &dyn Provider, secret: SmSecret) -> Result<Self, CryptoError> {
        let public = *secret.public_key(provider)?;
        Ok(Self { secret, public })
    }

    /// The point to send, x || y.
    pub fn public(&self) -> PublicKey {
        self.public
    }

    /// The x coordinate of `[d]peer`, 32 bytes big endian, in constant time. Consumes the secret.
    ///
    /// # Errors
    /// [`CryptoError::PublicPoint`] if `peer` is not a point of the curve in its canonical encoding.
    pub fn agree(self, peer: &PublicKey) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
        sm2::shared_x(self.secret.expose(), peer)
    }
}

impl fmt::Debug for Ephemeral {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Ephemeral({})", self.public)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};
    use crate::model::bytes::hex;

    /// From GB/T 32918.5-2017, annex C: the key pair of the encryption example is as good as any other.
    const STANDARD_SECRET: &str = "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8";

    #[test]
    fn both_sides_agree_and_others_do_not() {
        for name in ProviderName::ALL {
            let provider = provider(name);
            let [one, other, third] = [(); 3].map(|()| Ephemeral::generate(provider).expect("random"));
            let (first, second, stranger) = (one.public(), other.public(), third.public());
            assert_ne!(first, second);
            let secret = one.agree(&second).expect("agrees");
            assert_eq!(secret, other.agree(&first).expect("agrees"));
            assert_ne!(secret, third.agree(&first).expect("agrees"));
            assert_ne!(first, stranger);
        }
    }

    #[test]
    fn the_secret_is_the_x_coordinate_of_the_product() {
        let provider = provider(ProviderName::default());
        let mut one = [0; 32];
        one[31] = 1;
        let one = Ephemeral::from_secret(provider, SmSecret::from_slice(&one).expect("1")).expect("G");
        let bytes = crate::model::bytes::unhex(STANDARD_SECRET).expect("hex");
        let pair = Ephemeral::from_secret(provider, SmSecret::from_slice(&bytes).expect("in range")).expect("pair");
        let point = pair.public();
        assert_eq!(hex(&point.0[..32]), "09f9df311e5421a150dd7d161e4bc5c672179fad1833fc076bb08ff356f35020");
        assert_eq!(one.agree(&point).expect("agrees")[..], point.0[..32]);
    }

    #[test]
    fn what_is_no_point_is_refused() {
        let provider = provider(ProviderName::default());
        let valid = Ephemeral::generate(provider).expect("random").public();
        let mut off = valid;
        off.0[63] ^= 1;
        // x + p encodes the same residue whenever it fits in 32 bytes; it is not canonical and not accepted.
        for bad in [off, PublicKey([0; 64]), PublicKey([0xff; 64])] {
            let ephemeral = Ephemeral::generate(provider).expect("random");
            assert!(matches!(ephemeral.agree(&bad), Err(CryptoError::PublicPoint)), "{bad}");
        }
        assert!(!format!("{:?}", Ephemeral::generate(provider)).contains("secret"));
    }
}
