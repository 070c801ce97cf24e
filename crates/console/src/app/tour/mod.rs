//! The tour's text: the paper's mission step by step.

pub mod follow;

use crate::model::ProfileName;

/// Rows of the strip.
pub const ROWS: u16 = 4;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cast {
    pub owner: ProfileName,
    pub reader: ProfileName,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tour {
    cast: Cast,
    place: usize,
}

impl Tour {
    pub fn new(cast: Cast) -> Self {
        Self { cast, place: 0 }
    }

    /// The step's number, from 1, and how many there are.
    pub fn count(&self) -> (usize, usize) {
        (self.place + 1, TEXT.len())
    }

    /// Name, action, reason.
    pub fn lines(&self) -> Option<[String; 3]> {
        let (_, text) = TEXT.get(self.place)?;
        let (owner, reader) = (self.cast.owner.as_str(), self.cast.reader.as_str());
        Some(text.map(|line| line.replace("OWNER", owner).replace("READER", reader)))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    Register,
    Watch,
    Verified,
    Grant,
    Open,
    Revoke,
    End,
}

/// Of each step: name, action, reason.
pub const TEXT: [(Step, [&str; 3]); 7] = [
    (
        Step::Register,
        [
            "Who you are",
            "Press n and type any passphrase twice (this home is temporary).",
            "Keys are created here; the chain gets only the public ones.",
        ],
    ),
    (
        Step::Watch,
        [
            "Capture a robot",
            "Press 2 for topics, select /robot1/odom with the arrows, press w.",
            "Each message is encrypted and signed before anyone else sees it.",
        ],
    ),
    (
        Step::Verified,
        [
            "See a record verified",
            "Press 3 for your records, select one, then enter. esc closes it.",
            "Its digest is on the chain: a changed record no longer matches it.",
        ],
    ),
    (
        Step::Grant,
        [
            "Share it",
            "esc, 2, g on the topic; address READER. Enter through the form, then y.",
            "READER gets the topic's key, sealed. The data itself does not move.",
        ],
    ),
    (
        Step::Open,
        [
            "Be the reader",
            "Type :profile READER and enter. Then 4, down, enter: a record opens.",
            "READER checks digest and signature against the chain before decrypting.",
        ],
    ),
    (
        Step::Revoke,
        [
            "Take it back",
            "esc, :profile OWNER and enter. Then 5, x on the grant, and y.",
            "The next record has a new key. What was already read stays read.",
        ],
    ),
    (
        Step::End,
        [
            "That is all",
            "Look around: ? lists the keys of a screen. E closes this strip.",
            "Just authros opens your own site; the manual starts at docs/README.md.",
        ],
    ),
];
