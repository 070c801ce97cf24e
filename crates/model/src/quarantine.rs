//! The body of a quarantine record: which messages of one topic and minute were quarantined, so that none can be
//! removed selectively.

use super::wire::{Reader, WireError, put_text};
use super::{Digest, TopicId};

/// First bytes of the body.
const LABEL: [u8; 20] = *b"AuthROS/quarantine/1";

/// `label (20) || topic id (16) || topic (2 + n) || minute (8) || first seq (8) || last seq (8) || count (8) ||
/// rolling (32)`, big endian.
///
/// The rolling hash begins with SM3(`AuthROS/quarantined/1` || domain || owner || recorder || topic id || minute) and
/// continues with SM3(rolling || D) for each quarantined record's digest D in the order of acknowledgement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QuarantineReport {
    /// The topic's pseudonym, as in its records.
    pub topic_id: TopicId,
    /// Its name.
    pub topic: String,
    /// Minutes since 1970 UTC, by the capture times.
    pub minute: u64,
    /// The lowest sequence number quarantined.
    pub first_seq: u64,
    /// The highest one.
    pub last_seq: u64,
    /// The number of records quarantined.
    pub count: u64,
    /// The rolling hash over their digests.
    pub rolling: Digest,
}

impl QuarantineReport {
    /// Encodes the bytes to be sealed.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = [&LABEL[..], &self.topic_id.0].concat();
        put_text(&mut out, &self.topic);
        for number in [self.minute, self.first_seq, self.last_seq, self.count] {
            out.extend_from_slice(&number.to_be_bytes());
        }
        out.extend_from_slice(&self.rolling.0);
        out
    }

    /// Parses a whole body.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one report.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        if reader.array::<20>("label")? != LABEL {
            return Err(WireError::Value("label"));
        }
        let report = Self {
            topic_id: TopicId(reader.array("topic id")?),
            topic: reader.text("topic")?,
            minute: reader.u64("minute")?,
            first_seq: reader.u64("first seq")?,
            last_seq: reader.u64("last seq")?,
            count: reader.u64("count")?,
            rolling: Digest(reader.array("rolling hash")?),
        };
        reader.end()?;
        Ok(report)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn round_trip_and_every_cut_is_refused(topic in "/[a-z]{0,20}", numbers in any::<[u64; 4]>(), rolling in any::<[u8; 32]>()) {
            let [minute, first_seq, last_seq, count] = numbers;
            let topic_id = TopicId([3; 16]);
            let report =
                QuarantineReport { topic_id, topic, minute, first_seq, last_seq, count, rolling: Digest(rolling) };
            let bytes = report.encode();
            prop_assert_eq!(QuarantineReport::parse(&bytes), Ok(report));
            prop_assert!((0..bytes.len()).all(|cut| QuarantineReport::parse(&bytes[..cut]).is_err()));
            prop_assert!(QuarantineReport::parse(&[bytes, vec![0]].concat()).is_err());
        }

        #[test]
        fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = QuarantineReport::parse(&noise);
            let _ = QuarantineReport::parse(&[&LABEL[..], &noise].concat());
        }
    }
}
