//! What is reported about a topic: gaps, and messages held in quarantine.

use crate::wire::{Reader, Wire, WireError};
use crate::{Digest, Timestamp, TopicId};

/// Why messages did not become records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum LossReason {
    /// They never arrived here: numbers are missing in `header.seq`.
    Transport = 1,
    #[strum(to_string = "memory full")]
    Memory,
    /// The disk was full, then the memory for waiting messages too.
    #[strum(to_string = "disk full")]
    Disk,
    #[strum(to_string = "no key")]
    Key,
    End,
    Fault,
}

crate::words!(LossReason);

impl LossReason {
    pub const ALL: [Self; 6] = [Self::Transport, Self::Memory, Self::Disk, Self::Key, Self::End, Self::Fault];

    pub fn code(self) -> u8 {
        self as u8
    }

    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| reason.code() == code)
    }

    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| reason.word() == word)
    }

    /// As the continuation of a sentence: "3 messages …".
    pub fn text(self) -> &'static str {
        match self {
            Self::Transport => "never arrived (numbers are missing in header.seq)",
            Self::Memory => "arrived while the message buffer was full",
            Self::Disk => "arrived while the disk was full",
            Self::Key => "arrived while there was no key to seal them with",
            Self::End => "could not be stored before the program ended",
            Self::Fault => "could not be sealed because of a bug in the program",
        }
    }
}

/// `label (13) || topic id (16) || topic (2 + n) || publisher (2 + n) || reason (1) || count (8) || has numbers (1) ||
/// first header.seq (4) || last header.seq (4) || first time (8) || last time (8)`, big endian.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GapReport {
    pub topic_id: TopicId,
    pub topic: String,
    /// Empty if there were too many to list.
    pub publisher: String,
    pub reason: LossReason,
    pub count: u64,
    /// `header.seq` of the first and the last, if the type has a header; some in between may have become records.
    pub numbers: Option<(u32, u32)>,
    pub first_at: Timestamp,
    pub last_at: Timestamp,
}

crate::layout!(LossReason by code, from_code);
crate::body!(GapReport behind b"AuthROS/gap/1", "label");

impl Wire for GapReport {
    fn put(&self, out: &mut Vec<u8>) {
        self.topic_id.put(out);
        self.topic.put(out);
        self.publisher.put(out);
        (self.reason, self.count).put(out);
        (self.numbers.is_some(), self.numbers.unwrap_or_default()).put(out);
        (self.first_at, self.last_at).put(out);
    }

    fn read(reader: &mut Reader<'_>, _: &'static str) -> Result<Self, WireError> {
        let (topic_id, topic) = (Wire::read(reader, "topic id")?, Wire::read(reader, "topic")?);
        let (publisher, reason) = (Wire::read(reader, "publisher")?, Wire::read(reader, "reason")?);
        let count = Wire::read(reader, "count")?;
        let numbers = match Wire::read(reader, "numbers")? {
            (true, pair) => Some(pair),
            (false, (0, 0)) => None,
            (false, _) => return Err(WireError::Value("numbers")),
        };
        let (first_at, last_at) = (Wire::read(reader, "first time")?, Wire::read(reader, "last time")?);
        Ok(Self { topic_id, topic, publisher, reason, count, numbers, first_at, last_at })
    }
}

// Quarantine record: the quarantined messages of one topic and minute, so that none can be removed selectively.

/// `label (20) || topic id (16) || topic (2 + n) || minute (8) || first seq (8) || last seq (8) || count (8) ||
/// rolling (32)`, big endian.
/// The rolling hash begins with SM3(`AuthROS/quarantined/1` || domain || owner || recorder || topic id || minute) and
/// continues with SM3(rolling || D) for each quarantined record's digest D in the order of acknowledgement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QuarantineReport {
    pub topic_id: TopicId,
    pub topic: String,
    /// Minutes since 1970 UTC, by the capture times.
    pub minute: u64,
    pub first_seq: u64,
    pub last_seq: u64,
    pub count: u64,
    pub rolling: Digest,
}

crate::layout!(QuarantineReport {
    topic_id: "topic id",
    topic: "topic",
    minute: "minute",
    first_seq: "first seq",
    last_seq: "last seq",
    count: "count",
    rolling: "rolling hash",
});
crate::body!(QuarantineReport behind b"AuthROS/quarantine/1", "label");

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reasons_have_distinct_codes_and_words() {
        for reason in LossReason::ALL {
            assert_eq!(LossReason::from_code(reason.code()), Some(reason));
            assert_eq!(LossReason::from_word(reason.word()), Some(reason));
        }
        assert_eq!((LossReason::from_code(0), LossReason::from_code(200)), (None, None));
    }

    proptest! {
        #[test]
        fn round_trip_and_every_cut_is_refused(
            topic in "/[a-z]{0,20}", publisher in "[ -~]{0,20}", reason in 1u8..7, count: u64,
            numbers: Option<(u32, u32)>, times: (u64, u64), noise: Vec<u8>,
        ) {
            let report = GapReport {
                topic_id: TopicId([3; 16]),
                topic,
                publisher,
                reason: LossReason::from_code(reason).expect("a reason"),
                count,
                numbers,
                first_at: Timestamp(times.0),
                last_at: Timestamp(times.1),
            };
            let bytes = report.encode();
            prop_assert_eq!(GapReport::parse(&bytes), Ok(report));
            prop_assert!((0..bytes.len()).all(|cut| GapReport::parse(&bytes[..cut]).is_err()));
            prop_assert!(GapReport::parse(&[bytes, vec![0]].concat()).is_err());
            let _ = GapReport::parse(&[&b"AuthROS/gap/1"[..], &noise].concat());
        }
    }
}

#[cfg(test)]
mod quarantine_tests {
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
            let _ = QuarantineReport::parse(&[&b"AuthROS/quarantine/1"[..], &noise].concat());
        }
    }
}
