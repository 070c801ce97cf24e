//! A recorder's statements about itself, sealed under the topic `authros/recorder`.

use crate::bytes::{RecorderId, SignerId};
use crate::wire::{Reader, Wire as _, WireError, put_list, read_list};
use crate::{Digest, Hash, TopicId};

const BIRTH: &[u8] = b"AuthROS/birth/1";
const HEIGHTS: &[u8] = b"AuthROS/heights/1";

/// A recorder began: `label (15) || predecessor (16)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Birth {
    /// The recorder whose ledger was copied or restored; `None` if there was none, or none is known.
    pub predecessor: Option<RecorderId>,
}

impl Birth {
    /// Takes the place of a message type.
    pub const TYPE: &'static str = "authros/Birth";

    pub fn encode(&self) -> Vec<u8> {
        let predecessor = self.predecessor.map_or([0; RecorderId::LENGTH], |recorder| recorder.0);
        [BIRTH, &predecessor].concat()
    }

    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let predecessor = RecorderId::whole_behind(BIRTH, "label", bytes)?;
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
    pub const TYPE: &'static str = "authros/Heights";

    pub fn encode(&self) -> Vec<u8> {
        let mut out = HEIGHTS.to_vec();
        put_list::<u32>(&mut out, &self.topics, usize::MAX);
        out
    }

    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes.strip_prefix(HEIGHTS).ok_or(WireError::Value("label"))?);
        let topics: Vec<(TopicId, u64)> = read_list::<u32, _>(&mut reader, 0..=usize::MAX, ("count", "topic"))?;
        reader.end()?;
        let is_ordered = topics.is_sorted_by(|(one, _), (next, _)| one < next);
        if is_ordered { Ok(Self { topics }) } else { Err(WireError::Value("topic id")) }
    }
}

/// The head over a list of numbers: `label (15) || count (4) || root (32) || heights (32) || previous (32)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heads {
    pub count: u32,
    pub root: Hash,
    pub heights: Digest,
    /// Zeros if there is none.
    pub previous: Digest,
}

crate::layout!(Heads { count: "count", root: "root", heights: "heights", previous: "previous" });
crate::body!(Heads behind b"AuthROS/heads/1", "label");

impl Heads {
    pub const TYPE: &'static str = "authros/Heads";
}

// A recorder id carries a tag of the signing key, so that nobody can number in the name of another key.

/// Length of the tag of the signing key, bytes.
const TAG: usize = 8;
/// First byte of the ids of a ledger's recorders, and of a ring's.
const LEDGER: u8 = 1;
const RING: u8 = 2;

/// A ledger's or ring's half of its recorder ids: `kind (1) || random (7)`. The other half is the signing key's tag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RecorderPrefix([u8; RecorderPrefix::LENGTH]);

impl RecorderPrefix {
    pub const LENGTH: usize = RecorderId::LENGTH - TAG;

    /// Of a ledger; new for each ledger file and each restore.
    pub fn ledger(random: [u8; 7]) -> Self {
        Self::of(LEDGER, random)
    }

    /// New for each start. Numbers may be missing anywhere: a ring loses its oldest messages.
    pub fn ring(random: [u8; 7]) -> Self {
        Self::of(RING, random)
    }

    fn of(kind: u8, random: [u8; 7]) -> Self {
        let mut prefix = [kind; Self::LENGTH];
        prefix.iter_mut().skip(1).zip(random).for_each(|(place, byte)| *place = byte);
        Self(prefix)
    }

    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        let prefix: [u8; Self::LENGTH] = bytes.try_into().ok()?;
        prefix.first().is_some_and(|kind| is_kind(*kind)).then_some(Self(prefix))
    }

    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// The recorder of the records that `signer` signs there.
    pub fn of_signer(self, signer: &SignerId) -> RecorderId {
        let mut id = [0; RecorderId::LENGTH];
        id.iter_mut().zip(self.0.iter().chain(tag(signer))).for_each(|(place, byte)| *place = *byte);
        RecorderId(id)
    }

    /// Whichever key signs.
    pub fn has(self, recorder: &RecorderId) -> bool {
        recorder.0.starts_with(&self.0)
    }
}

impl RecorderId {
    /// Whether records signed by `signer` may carry this id.
    pub fn is_of(&self, signer: &SignerId) -> bool {
        self.0.first().is_some_and(|kind| is_kind(*kind)) && self.0.ends_with(tag(signer))
    }

    pub fn prefix(&self) -> RecorderPrefix {
        let mut prefix = [0; RecorderPrefix::LENGTH];
        prefix.iter_mut().zip(self.0).for_each(|(place, byte)| *place = byte);
        RecorderPrefix(prefix)
    }

    pub fn is_ring(&self) -> bool {
        self.0.first() == Some(&RING)
    }
}

fn is_kind(kind: u8) -> bool {
    [LEDGER, RING].contains(&kind)
}

fn tag(signer: &SignerId) -> &[u8] {
    signer.0.get(..TAG).unwrap_or_default()
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

#[cfg(test)]
mod recorder_id_tests {
    use super::*;

    #[test]
    fn a_recorder_is_of_one_key_alone() {
        let (owner, robot) = (SignerId([3; 32]), SignerId([4; 32]));
        let ledger = RecorderPrefix::ledger([9; 7]);
        let recorder = ledger.of_signer(&owner);
        assert_eq!(recorder.to_hex(), "01090909090909090303030303030303");
        assert!(recorder.is_of(&owner) && !recorder.is_of(&robot), "another key does not number there");
        assert_ne!(recorder, ledger.of_signer(&robot), "another key is another recorder");
        assert!(ledger.has(&recorder) && ledger.has(&ledger.of_signer(&robot)));
        assert!(!RecorderPrefix::ledger([8; 7]).has(&recorder));
        let mut none = recorder;
        none.0[0] = 3;
        assert!(!none.is_of(&owner), "neither a ledger nor a ring");
    }

    #[test]
    fn the_recorder_of_a_ring_differs_from_others() {
        let signer = SignerId([4; 32]);
        assert!(RecorderPrefix::ring([7; 7]).of_signer(&signer).is_ring());
        assert!(!RecorderPrefix::ledger([2; 7]).of_signer(&signer).is_ring());
    }

    #[test]
    fn a_stored_prefix_is_read_back_and_nothing_else() {
        let prefix = RecorderPrefix::ledger([5; 7]);
        assert_eq!(RecorderPrefix::from_slice(prefix.as_bytes()), Some(prefix));
        for wrong in [&[0; 8][..], &[1; 7], &[1; 16], &[]] {
            assert_eq!(RecorderPrefix::from_slice(wrong), None, "{wrong:?}");
        }
    }
}
