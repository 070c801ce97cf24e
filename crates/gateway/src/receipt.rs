//! The gateway's signature over time and digests, after the fsync: time (8) || count (2) || digests (32 each) ||
//! signature (64).

use crate::crypto::{CryptoError, Provider, SmKeyPair};
use crate::model::wire::{Reader, Wire as _, WireError, put_list, read_list};
use crate::model::{Digest, Domain, PublicKey, Signature, Timestamp};

pub const MOST_DIGESTS: usize = 1024;

/// The sender keeps it until the proof arrives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    /// When they were on disk.
    pub time: Timestamp,
    pub digests: Vec<Digest>,
    /// By the identity key.
    pub signature: Signature,
}

fn signed_bytes(domain: &Domain, time: Timestamp, digests: &[Digest]) -> Vec<u8> {
    let mut out = [&b"AuthROS/receipt/1"[..], &domain.0].concat();
    put(&mut out, time, digests);
    out
}

fn put(out: &mut Vec<u8>, time: Timestamp, digests: &[Digest]) {
    time.put(out);
    put_list::<u16>(out, digests, MOST_DIGESTS);
}

impl Receipt {
    /// At most [`MOST_DIGESTS`].
    pub fn sign(
        provider: &dyn Provider,
        domain: &Domain,
        identity: &SmKeyPair,
        time: Timestamp,
        digests: Vec<Digest>,
    ) -> Result<Self, CryptoError> {
        if digests.len() > MOST_DIGESTS {
            return Err(CryptoError::Length { what: "receipt", found: digests.len(), allowed: "1,024 digests" });
        }
        let signature = provider.sign(&identity.secret, &signed_bytes(domain, time, &digests))?;
        Ok(Self { time, digests, signature })
    }

    /// The signature covers [`Self::digests`].
    pub fn verify(&self, provider: &dyn Provider, domain: &Domain, gateway: &PublicKey) -> Result<(), CryptoError> {
        provider.verify(gateway, &signed_bytes(domain, self.time, &self.digests), &self.signature)
    }

    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(74 + 32 * self.digests.len());
        put(&mut out, self.time, &self.digests);
        out.extend_from_slice(&self.signature.0);
        out
    }

    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let receipt = Self::read(&mut reader)?;
        reader.end()?;
        Ok(receipt)
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let time = Timestamp::read(reader, "time")?;
        let digests = read_list::<u16, _>(reader, 0..=MOST_DIGESTS, ("digest count", "digest"))?;
        Ok(Self { time, digests, signature: Signature::read(reader, "signature")? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{ProviderName, provider};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn receipts_round_trip_and_no_altered_one_holds(count in 0usize..6, at: usize, bit in 0u8..8) {
            let provider = provider(ProviderName::RustCrypto);
            let identity = SmKeyPair::generate(provider).expect("pair");
            let domain = Domain([4; 32]);
            let digests = (0..count).map(|index| Digest([u8::try_from(index).expect("small"); 32])).collect();
            let receipt = Receipt::sign(provider, &domain, &identity, Timestamp(77), digests).expect("signs");
            receipt.verify(provider, &domain, &identity.public).expect("valid");
            prop_assert!(receipt.verify(provider, &Domain([5; 32]), &identity.public).is_err());
            let mut bytes = receipt.encode();
            prop_assert_eq!(Receipt::parse(&bytes), Ok(receipt));
            let at = at % bytes.len();
            prop_assert!(Receipt::parse(&bytes[..at]).is_err());
            bytes[at] ^= 1 << bit;
            if let Ok(altered) = Receipt::parse(&bytes) {
                prop_assert!(altered.verify(provider, &domain, &identity.public).is_err());
            }
        }
    }
}
