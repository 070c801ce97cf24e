//! Recorder ids: who numbers a record. Each id carries a tag of the key that signs, so nobody can number in the name of
//! another key, and a home whose key changes goes on under another recorder.

use super::bytes::{RecorderId, SignerId};

/// Length of the tag of the signing key, bytes.
const TAG: usize = 8;
/// The first byte of the recorder id of a ledger.
const LEDGER: u8 = 1;
/// The first byte of the recorder id of a ring.
const RING: u8 = 2;

/// What a ledger or ring contributes to the ids of its recorders: `kind (1) || random (7)`. The other half of an id is the
/// tag of the key that signs, so one ledger has a recorder for each key that signs in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RecorderPrefix([u8; RecorderPrefix::LENGTH]);

impl RecorderPrefix {
    /// Length in bytes.
    pub const LENGTH: usize = RecorderId::LENGTH - TAG;

    /// Of a ledger; new for each ledger file and each restore.
    pub fn ledger(random: [u8; 7]) -> Self {
        Self::of(LEDGER, random)
    }

    /// Of a ring on a robot's disk; new for each start. Numbers of such a recorder may be missing anywhere: a ring loses
    /// its oldest messages, and its owner requests spans of it.
    pub fn ring(random: [u8; 7]) -> Self {
        Self::of(RING, random)
    }

    fn of(kind: u8, random: [u8; 7]) -> Self {
        let mut prefix = [kind; Self::LENGTH];
        prefix.iter_mut().skip(1).zip(random).for_each(|(place, byte)| *place = byte);
        Self(prefix)
    }

    /// From stored bytes; `None` if they are not a prefix.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        let prefix: [u8; Self::LENGTH] = bytes.try_into().ok()?;
        prefix.first().is_some_and(|kind| is_kind(*kind)).then_some(Self(prefix))
    }

    /// The bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// The recorder of the records that `signer` signs there.
    pub fn of_signer(self, signer: &SignerId) -> RecorderId {
        let mut id = [0; RecorderId::LENGTH];
        id.iter_mut().zip(self.0.iter().chain(tag(signer))).for_each(|(place, byte)| *place = *byte);
        RecorderId(id)
    }

    /// Whether a recorder is one of this ledger's or ring's, whichever key signs.
    pub fn has(self, recorder: &RecorderId) -> bool {
        recorder.0.starts_with(&self.0)
    }
}

impl RecorderId {
    /// Whether records signed by `signer` may carry this id.
    pub fn is_of(&self, signer: &SignerId) -> bool {
        self.0.first().is_some_and(|kind| is_kind(*kind)) && self.0.ends_with(tag(signer))
    }

    /// What the ledger or ring contributed to it.
    pub fn prefix(&self) -> RecorderPrefix {
        let mut prefix = [0; RecorderPrefix::LENGTH];
        prefix.iter_mut().zip(self.0).for_each(|(place, byte)| *place = byte);
        RecorderPrefix(prefix)
    }

    /// Whether it is the recorder of a ring.
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
