//! A recorder's statements about itself, in sealed records of the topic `authros/recorder`: its birth, the highest
//! sequence numbers of its topics, and the head over these numbers, which can be disclosed without them.

use super::wire::{Reader, WireError};
use super::{Digest, Hash, RecorderId, TopicId};

/// First bytes of a birth.
const BIRTH: &[u8] = b"AuthROS/birth/1";
/// First bytes of a list of numbers.
const HEIGHTS: &[u8] = b"AuthROS/heights/1";
/// First bytes of a head over numbers.
const HEADS: &[u8] = b"AuthROS/heads/1";

/// A recorder began: `label (15) || predecessor (16)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Birth {
    /// The recorder whose ledger was copied or restored; `None` if there was none, or none is known.
    pub predecessor: Option<RecorderId>,
}

impl Birth {
    /// Takes the place of a message type.
    pub const TYPE: &'static str = "authros/Birth";

    /// Encodes the bytes to be sealed.
    pub fn encode(&self) -> Vec<u8> {
        let predecessor = self.predecessor.map_or([0; RecorderId::LENGTH], |recorder| recorder.0);
        [BIRTH, &predecessor].concat()
    }

    /// Parses a whole body.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = labelled(bytes, BIRTH)?;
        let predecessor = RecorderId(reader.array("predecessor")?);
        reader.end()?;
        Ok(Self { predecessor: Some(predecessor).filter(|recorder| recorder.0 != [0; RecorderId::LENGTH]) })
    }
}

/// The highest number of each topic: `label (17) || count (4) || topic id (16) and number (8) each`, by topic id.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Heights {
    /// Topics with their numbers, in ascending order, without duplicates.
    pub topics: Vec<(TopicId, u64)>,
}

impl Heights {
    /// Takes the place of a message type.
    pub const TYPE: &'static str = "authros/Heights";

    /// Encodes the bytes to be sealed.
    pub fn encode(&self) -> Vec<u8> {
        let count = u32::try_from(self.topics.len()).unwrap_or(u32::MAX);
        let mut out = [HEIGHTS, &count.to_be_bytes()].concat();
        for (topic, number) in &self.topics {
            out.extend_from_slice(&topic.0);
            out.extend_from_slice(&number.to_be_bytes());
        }
        out
    }

    /// Parses a whole body.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one list, or its topics are not in order.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = labelled(bytes, HEIGHTS)?;
        let (count, mut topics) = (reader.u32("count")?, Vec::new());
        for _ in 0..count {
            let topic = TopicId(reader.array("topic id")?);
            if topics.last().is_some_and(|(last, _)| *last >= topic) {
                return Err(WireError::Value("topic id"));
            }
            topics.push((topic, reader.u64("number")?));
        }
        reader.end()?;
        Ok(Self { topics })
    }
}

/// The head over a list of numbers: `label (15) || count (4) || root (32) || heights (32) || previous (32)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heads {
    /// The number of topics.
    pub count: u32,
    /// Merkle root over topics with their highest numbers.
    pub root: Hash,
    /// The digest of the record with the list.
    pub heights: Digest,
    /// The digest of the previous head's record; zeros if there is none.
    pub previous: Digest,
}

impl Heads {
    /// Takes the place of a message type.
    pub const TYPE: &'static str = "authros/Heads";

    /// Encodes the bytes to be sealed.
    pub fn encode(&self) -> Vec<u8> {
        [HEADS, &self.count.to_be_bytes(), &self.root.0, &self.heights.0, &self.previous.0].concat()
    }

    /// Parses a whole body.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = labelled(bytes, HEADS)?;
        let heads = Self {
            count: reader.u32("count")?,
            root: Hash(reader.array("root")?),
            heights: Digest(reader.array("heights")?),
            previous: Digest(reader.array("previous")?),
        };
        reader.end()?;
        Ok(heads)
    }
}

fn labelled<'a>(bytes: &'a [u8], label: &[u8]) -> Result<Reader<'a>, WireError> {
    let mut reader = Reader::new(bytes);
    if reader.take(label.len(), "label")? != label {
        return Err(WireError::Value("label"));
    }
    Ok(reader)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn what_is_written_is_read_and_nothing_else(
            topics: BTreeMap<[u8; 16], u64>, root: [u8; 32], other: [u8; 32], before: Option<[u8; 16]>, noise: Vec<u8>,
        ) {
            let birth = Birth { predecessor: before.filter(|id| *id != [0; 16]).map(RecorderId) };
            let topics: Vec<_> = topics.into_iter().map(|(topic, number)| (TopicId(topic), number)).collect();
            let heights = Heights { topics };
            let heads = Heads { count: 3, root: Hash(root), heights: Digest(other), previous: Digest(root) };
            prop_assert_eq!(Birth::parse(&birth.encode()), Ok(birth));
            prop_assert_eq!(Heights::parse(&heights.encode()), Ok(heights.clone()));
            prop_assert_eq!((heads.encode().len(), Heads::parse(&heads.encode())), (115, Ok(heads)));
            for bytes in [birth.encode(), heights.encode(), heads.encode()] {
                let longer = [bytes.clone(), vec![0]].concat();
                for wrong in (0..bytes.len()).map(|cut| &bytes[..cut]).chain([&longer[..], &noise]) {
                    prop_assert!(Birth::parse(wrong).is_err() && Heights::parse(wrong).is_err());
                    prop_assert!(Heads::parse(wrong).is_err());
                }
            }
        }
    }

    #[test]
    fn topics_are_in_order_and_each_once() {
        for topics in [[2, 1], [1, 1]] {
            let heights = Heights { topics: topics.map(|topic| (TopicId([topic; 16]), 1)).to_vec() };
            assert!(Heights::parse(&heights.encode()).is_err(), "{topics:?}");
        }
    }
}
