//! The public identity that an EOA registers on the chain.

use serde::{Deserialize, Serialize};

use super::bytes::{PublicKey, Signature, Token};
use super::wire::{Reader, WireError};

/// `token || P_C || P_E || proof`: 224 bytes. The proof is an SM2 signature by d_C over label, domain, address, P_C,
/// P_E and token; the contract cannot verify it, so every client does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Token of the epoch at registration.
    pub token: Token,
    /// P_C, which verifies signatures.
    pub signing: PublicKey,
    /// P_E, to which envelopes are encrypted.
    pub envelope: PublicKey,
    /// Proof that the holder of d_C registered these keys for this address.
    pub proof: Signature,
}

impl Identity {
    /// Length of the encoding, bytes.
    pub const LENGTH: usize = 224;

    /// The argument of the contract's `register`.
    pub fn encode(&self) -> Vec<u8> {
        [&self.token.0[..], &self.signing.0, &self.envelope.0, &self.proof.0].concat()
    }

    /// From the chain's bytes.
    ///
    /// # Errors
    /// [`WireError`] if they are not exactly [`Self::LENGTH`] bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let identity = Self {
            token: Token(reader.array("token")?),
            signing: PublicKey(reader.array("signing key")?),
            envelope: PublicKey(reader.array("envelope key")?),
            proof: Signature(reader.array("proof")?),
        };
        reader.end()?;
        Ok(identity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exactly_224_bytes() {
        let bytes: Vec<u8> = (0..224).map(|i| u8::try_from(i).unwrap_or(0)).collect();
        let identity = Identity::parse(&bytes).expect("parses");
        assert_eq!(identity.encode(), bytes);
        assert!(Identity::parse(&bytes[1..]).is_err());
        assert!(Identity::parse(&[bytes.clone(), vec![0]].concat()).is_err());
    }
}
