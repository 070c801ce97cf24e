//! The body of an audit record: the head of a home's audit log, anchored on the chain while the log changes.

use super::Digest;
use super::wire::{Reader, WireError};

/// First bytes of the body.
const LABEL: [u8; 20] = *b"AuthROS/audit-head/1";

/// `label (20) || line (8) || hash (32) || previous line (8) || previous hash (32)`, big endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AuditHead {
    /// How many lines the log had.
    pub line: u64,
    /// The hash stored with its last line.
    pub hash: Digest,
    /// The number of lines under the head that this owner anchored before; 0 = this is the first.
    pub previous_line: u64,
    /// The hash of that head, zeros if there is none.
    pub previous_hash: Digest,
}

impl AuditHead {
    /// Encodes the bytes to be sealed.
    pub fn encode(&self) -> Vec<u8> {
        let (line, previous) = (self.line.to_be_bytes(), self.previous_line.to_be_bytes());
        [&LABEL[..], &line, &self.hash.0, &previous, &self.previous_hash.0].concat()
    }

    /// Parses a whole body.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one head, or it does not continue the one before.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        if reader.array::<20>("label")? != LABEL {
            return Err(WireError::Value("label"));
        }
        let head = Self {
            line: reader.u64("line")?,
            hash: Digest(reader.array("hash")?),
            previous_line: reader.u64("previous line")?,
            previous_hash: Digest(reader.array("previous hash")?),
        };
        reader.end()?;
        if head.line <= head.previous_line {
            return Err(WireError::Value("line"));
        }
        Ok(head)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read_and_nothing_else(previous in 0u64..9, more in 1u64..9, hash: [u8; 32], other: [u8; 32], noise: Vec<u8>) {
            let (hash, previous_hash) = (Digest(hash), Digest(other));
            let head = AuditHead { line: previous + more, hash, previous_line: previous, previous_hash };
            let bytes = head.encode();
            prop_assert_eq!((bytes.len(), AuditHead::parse(&bytes)), (100, Ok(head)));
            prop_assert!((0..bytes.len()).all(|cut| AuditHead::parse(&bytes[..cut]).is_err()));
            prop_assert!(AuditHead::parse(&[bytes, vec![0]].concat()).is_err());
            prop_assert!(AuditHead::parse(&noise).is_err());
            let back = AuditHead { line: previous, ..head };
            prop_assert!(AuditHead::parse(&back.encode()).is_err(), "a head goes on from the one before");
        }
    }
}
