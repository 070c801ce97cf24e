//! The tour: the paper's mission, step by step, on the operator's own screen. It looks at the state and continues
//! when its step is done.

use super::State;
use super::popup::{Lookup, Popup};
use super::screens::{is_active, is_given};
use super::update::is_settled;
use super::verb::Verb;
use crate::model::{ProfileName, Verdict};

/// Rows of its strip at the bottom.
pub const ROWS: u16 = 4;

/// Who is who in the tour.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cast {
    /// The owner, whose records are captured and shared.
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

    /// Number of the current step, from 1, and of how many.
    pub fn count(&self) -> (usize, usize) {
        (self.place + 1, TEXT.len())
    }

    /// Name, what to do, why.
    pub fn lines(&self) -> Option<[String; 3]> {
        let text = TEXT.get(self.place)?;
        let fill =
            |line: &str| line.replace("OWNER", self.cast.owner.as_str()).replace("READER", self.cast.reader.as_str());
        Some([fill(text.name), fill(text.act), fill(text.why)])
    }
}

/// Rows of the strip now.
pub fn rows(state: &State) -> u16 {
    if state.tour.is_some() { ROWS } else { 0 }
}

/// Whether a verb is useful: the one that ends the tour is not, without a tour.
pub fn knows(state: &State, verb: Verb) -> bool {
    verb != Verb::EndTour || state.tour.is_some()
}

/// Whether the list of grants is needed to see that a step is done.
pub fn wants_grants(state: &State) -> bool {
    let step = state.tour.as_ref().and_then(|tour| TEXT.get(tour.place)).map(|text| text.step);
    matches!(step, Some(Step::Grant | Step::Revoke))
}

/// Advances as far as things are done.
pub fn follow(state: &mut State) {
    let Some(mut tour) = state.tour.take() else { return };
    while TEXT.get(tour.place).is_some_and(|text| is_done(state, &tour.cast, text.step)) {
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
        // The last one stays until it is ended by its key.
        Step::End => false,
    }
}

/// A record's provenance is on screen, and the record is verified.
fn sees_verified(state: &State) -> bool {
    let shown = |popup: &Popup| match popup {
        Popup::Provenance(lookup) => lookup.found().is_some_and(|found| is_settled(found.record.state)),
        _ => false,
    };
    state.popups.iter().any(shown)
        || state.detail.steps.as_ref().and_then(Lookup::found).is_some_and(|found| is_settled(found.record.state))
}

/// A record of the owner is on screen, checked and readable.
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

/// What a step waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The identity is on the chain.
    Register,
    /// A topic is watched.
    Watch,
    /// A record's path to verified is on screen.
    Verified,
    /// A grant is active.
    Grant,
    /// The reader sees a record of the owner.
    Open,
    /// No grant is active any more.
    Revoke,
    End,
}

/// The texts of a step: one line each.
#[derive(Debug, Clone, Copy)]
pub struct StepText {
    /// What it waits for.
    pub step: Step,
    pub name: &'static str,
    pub act: &'static str,
    pub why: &'static str,
}

/// The steps in their order.
pub const TEXT: [StepText; 7] = [
    StepText {
        step: Step::Register,
        name: "Who you are",
        act: "Press n and type any passphrase twice (this home is temporary).",
        why: "Keys are created here; the chain gets only the public ones.",
    },
    StepText {
        step: Step::Watch,
        name: "Capture a robot",
        act: "Press 2 for topics, select /robot1/odom with the arrows, press w.",
        why: "Each message is encrypted and signed before anyone else sees it.",
    },
    StepText {
        step: Step::Verified,
        name: "See a record verified",
        act: "Press 3 for your records, select one, then enter. esc closes it.",
        why: "Its digest is on the chain: nobody can change it now, not even you.",
    },
    StepText {
        step: Step::Grant,
        name: "Share it",
        act: "esc, 2, g on the topic; address READER. Enter through the form, then y.",
        why: "READER gets the topic's key, sealed. The data itself does not move.",
    },
    StepText {
        step: Step::Open,
        name: "Be the reader",
        act: "Type :profile READER and enter. Then 4, down, enter: a record opens.",
        why: "READER checks digest and signature against the chain before decrypting.",
    },
    StepText {
        step: Step::Revoke,
        name: "Take it back",
        act: "esc, :profile OWNER and enter. Then 5, x on the grant, and y.",
        why: "The next record has a new key. What was already read stays read.",
    },
    StepText {
        step: Step::End,
        name: "That is all",
        act: "Look around: ? lists the keys of a screen. E closes this strip.",
        why: "Just authros opens your own site; the manual starts at docs/README.md.",
    },
];
