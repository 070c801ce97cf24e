//! The tour watches the state and advances when a step is done.

use crate::app::tour::{Cast, Step, TEXT};
use crate::app::{Feed, Lookup, Popup, State, Verb};
use crate::model::Verdict;
use crate::popups::record::state::Opening;
use crate::screens::{grants::state::is_active, grants::state::is_given, records::state::is_settled};

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
        Step::Revoke => owner && state.feeds.slot(Feed::Grants).loaded && !given(),
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
    let opened = |opening: &Opening| opening.lookup.found().is_some_and(|view| view.verdict == Verdict::Verified);
    openings.chain(state.detail.opening.as_ref()).any(opened)
}
