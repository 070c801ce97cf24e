//! The body of an adoption record: the owner moves to another chain, and states so first on that chain.

use super::Domain;
use super::wire::{Reader, WireError};

/// First bytes of the body.
const LABEL: [u8; 18] = *b"AuthROS/adoption/1";

/// `label (18) || from (32) || to (32) || last epoch (8) || verified (8) || others (8)`, big endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Adoption {
    /// The network that was left.
    pub from: Domain,
    /// The network used from now on.
    pub to: Domain,
    /// The owner's last epoch on the old network.
    pub last_epoch: u64,
    /// The owner's records verified before, whose anchors stay behind.
    pub verified: u64,
    /// The owner's records not verified yet, which are anchored on the new network.
    pub others: u64,
}

impl Adoption {
    /// Encodes the bytes to be sealed.
    pub fn encode(&self) -> Vec<u8> {
        let numbers = [self.last_epoch, self.verified, self.others].map(u64::to_be_bytes).concat();
        [&LABEL[..], &self.from.0, &self.to.0, &numbers].concat()
    }

    /// Parses a whole body.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one adoption.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        if reader.array::<18>("label")? != LABEL {
            return Err(WireError::Value("label"));
        }
        let adoption = Self {
            from: Domain(reader.array("from")?),
            to: Domain(reader.array("to")?),
            last_epoch: reader.u64("last epoch")?,
            verified: reader.u64("verified")?,
            others: reader.u64("others")?,
        };
        reader.end()?;
        Ok(adoption)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exactly_106_bytes() {
        let adoption = Adoption { from: Domain([1; 32]), to: Domain([2; 32]), last_epoch: 3, verified: 4, others: 5 };
        let bytes = adoption.encode();
        assert_eq!((bytes.len(), Adoption::parse(&bytes)), (106, Ok(adoption)));
        assert!((0..bytes.len()).all(|cut| Adoption::parse(&bytes[..cut]).is_err()));
        assert!(Adoption::parse(&[bytes, vec![0]].concat()).is_err());
        assert!(Adoption::parse(&[0; 106]).is_err());
    }
}
