//! The tour: the paper's mission step by step; it watches the state and advances when a step is done.

use super::State;
use super::popup::{Lookup, Popup};
use super::screens::{is_active, is_given};
use super::update::is_settled;
use super::verb::Verb;
use crate::model::{ProfileName, Verdict};

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

pub fn rows(state: &State) -> u16 {
    if state.tour.is_some() { ROWS } else { 0 }
}

/// Without a tour there is none to end.
pub fn knows(state: &State, verb: Verb) -> bool {
    verb != Verb::EndTour || state.tour.is_some()
}

/// Whether a step needs the list of grants.
pub fn wants_grants(state: &State) -> bool {
    let text = state.tour.as_ref().and_then(|tour| TEXT.get(tour.place));
    matches!(text, Some((Step::Grant | Step::Revoke, _)))
}

pub fn follow(state: &mut State) {
    let Some(mut tour) = state.tour.take() else { return };
    while TEXT.get(tour.place).is_some_and(|(step, _)| is_done(state, &tour.cast, *step)) {
        tour.place += 1;
    }
    state.tour = (tour.place < TEXT.len()).then_some(tour);
}

fn is_done(state: &State, cast: &Cast, step: Step) -> bool {
    let owner = state.settings.profile == cast.owner;
    let given = || state.grants.rows.iter().any(|row| is_given(row) && is_active(row));
    match step {
        Step::Register => state.identity.as_ref().is_some_and(|identity| identity.registered),
        Step::Watch => owner && state.watches(),
        Step::Verified => owner && sees_verified(state),
        Step::Grant => owner && given(),
        Step::Open => !owner && state.settings.profile == cast.reader && has_opened(state),
        Step::Revoke => owner && state.feeds.slot(super::update::Feed::Grants).loaded && !given(),
        // The last step stays until its key ends it.
        Step::End => false,
    }
}

fn sees_verified(state: &State) -> bool {
    let shown = |popup: &Popup| match popup {
        Popup::Provenance(lookup) => lookup.found().is_some_and(|found| is_settled(found.record.state)),
        _ => false,
    };
    state.popups.iter().any(shown)
        || state.detail.steps.as_ref().and_then(Lookup::found).is_some_and(|found| is_settled(found.record.state))
}

/// Checked, readable, and the owner's.
fn has_opened(state: &State) -> bool {
    let openings = state.popups.iter().filter_map(|popup| match popup {
        Popup::Record(opening) => Some(opening),
        _ => None,
    });
    let opened = |opening: &super::opening::Opening| {
        opening.lookup.found().is_some_and(|view| view.verdict == Verdict::Verified)
    };
    openings.chain(state.detail.opening.as_ref()).any(opened)
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
