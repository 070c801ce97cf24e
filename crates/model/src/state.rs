//! The states of a record.

use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantArray};

/// The state of a record. Every transition is a compare-and-set in the ledger.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, IntoStaticStr, VariantArray,
)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum RecordState {
    /// In memory, not yet sealed.
    Captured,
    /// Sealed and fsynced in the store, row and ciphertext in one commit: acknowledged.
    Stored,
    Batched,
    Submitted,
    Mined,
    /// The block has enough confirmations.
    Confirmed,
    /// Re-read from the store, digest equal to the chain, signature valid.
    Verified,
    /// Quarantined: its publisher is not the pinned one.
    Quarantined,
    /// Never acknowledged, only counted.
    Dropped,
    /// The stored bytes differ from the anchored digest.
    Tampered,
    /// Stored, but its signer may not sign for its owner now. Nobody here anchors it until that right is back.
    #[serde(rename = "waits: unauthorised")]
    #[strum(to_string = "waits: unauthorised")]
    RightEnded,
}

impl RecordState {
    /// In the order of a record's life.
    pub const ALL: &[Self] = <Self as VariantArray>::VARIANTS;

    pub fn code(self) -> u8 {
        self as u8
    }

    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// Whether the record still needs work. A record waiting for a right needs somebody's decision, not work.
    pub fn is_pending(self) -> bool {
        self < Self::Verified
    }

    pub fn is_before_block(self) -> bool {
        self < Self::Mined || self == Self::RightEnded
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Fact {
    /// It is here and waits for the chain: an owner's notice.
    Stored = 1,
    Verified = 2,
    /// It is verified, and its ciphertext was deleted.
    Erased = 3,
}

crate::layout!(Fact by code, from_code);

impl Fact {
    pub fn code(self) -> u8 {
        self as u8
    }

    pub fn from_code(code: u8) -> Option<Self> {
        [Self::Stored, Self::Verified, Self::Erased].into_iter().find(|fact| fact.code() == code)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Digest equals a confirmed anchor, signature valid, opened.
    Verified,
    /// All checks but the chain's pass; the digest is not anchored (yet).
    Unanchored,
    /// It was confirmed earlier and the checks without the chain pass, but the chain cannot be asked now.
    #[strum(to_string = "not checked against the chain now")]
    NotChecked,
    /// The stored bytes differ from those anchored or signed.
    Tampered,
    Missing,
    /// Retention has deleted the stored bytes, as a record on the chain states; signature and anchor are valid.
    #[strum(to_string = "deleted by retention")]
    Deleted,
    #[strum(to_string = "no key")]
    NoKey,
}

crate::words!(RecordState, Verdict);

/// Determines the exit code of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorKind {
    /// A fault of the program itself.
    Internal = 1,
    Usage,
    Input,
    /// A peer (ROS master, node, Redis, gateway) does not answer.
    Unreachable,
    /// A peer, the chain or a check refused.
    Refused,
    /// Stored data differs from what was anchored, or is missing.
    Tampered,
    /// The home is locked by another process or cannot be written.
    Home,
    Incomplete,
}

impl ErrorKind {
    pub fn exit_code(self) -> u8 {
        self as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_and_words_are_distinct_and_stable() {
        for (index, state) in RecordState::ALL.iter().copied().enumerate() {
            assert_eq!(usize::from(state.code()), index);
            assert_eq!(RecordState::from_code(state.code()), Some(state));
        }
        assert!(RecordState::Confirmed.is_pending());
        assert!(!RecordState::Verified.is_pending());
        assert!(!RecordState::Tampered.is_pending());
        assert!(!RecordState::RightEnded.is_pending() && RecordState::RightEnded.is_before_block());
        for &state in RecordState::ALL {
            assert_eq!(serde_json::to_value(state).expect("JSON"), state.word(), "one word everywhere");
        }
    }
}
