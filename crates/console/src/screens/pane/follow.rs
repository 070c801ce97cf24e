//! The pane follows the cursor: what it asks for, and when.

use crate::app::{Errand, Lookup, Screen, State, Tag};
use crate::model::{Timestamp, TopicName};
use crate::popups::record::state::Opening;
use crate::screens::{pane::state::Detail, records::state::is_settled};
use crate::service::reply::{CoverageView, OpenedView, Provenance};
use crate::service::{Command, Failure};

/// Terminal width from which there is a pane.
pub const WIDE_FROM: u16 = 140;

/// Columns that the list beside a pane keeps.
const LIST: u16 = 84;

/// Columns of the widest pane.
const WIDEST: u16 = 84;

/// How long the cursor rests before a record is requested, nanoseconds.
const REST: u64 = 300_000_000;

/// Nanoseconds between requests for a topic's coverage.
const COVERAGE_EVERY: u64 = 30_000_000_000;

const PARTS: usize = 60;

pub fn coverage_of(topic: &TopicName) -> Errand {
    let command = Command::TopicCoverage { topic: topic.clone(), robot: None, since: None, until: None, parts: PARTS };
    Errand { command, tag: Tag::Beside(Screen::Topics, topic.to_string()) }
}

/// Waits while another answer is outstanding.
pub fn due(state: &State) -> Option<Timestamp> {
    state.detail.due.filter(|_| may_ask(state))
}

/// One record at a time; nothing behind a popup or while keys are being wiped.
fn may_ask(state: &State) -> bool {
    state.popups.is_empty() && !state.work.iter().any(|tag| matches!(tag, Tag::Beside(..) | Tag::Lock))
}

pub fn is_shown(state: &State) -> bool {
    state.size.0 >= WIDE_FROM && state.screen.has_table()
}

pub fn list_width(state: &State) -> u16 {
    let whole = state.size.0;
    if is_shown(state) { whole - (whole / 2).min(WIDEST).min(whole.saturating_sub(LIST)) } else { whole }
}

/// Only a record that the cursor was moved to, not just the newest.
fn wanted(state: &State) -> Option<(Screen, String)> {
    let open = state.identity.as_ref().is_some_and(|identity| identity.unlocked);
    let tells = match state.screen {
        Screen::Topics => state.identity.as_ref().is_some_and(|identity| identity.exists),
        Screen::Records => true,
        Screen::Received => open,
        _ => false,
    };
    let aimed = state.table().is_some_and(|table| table.is_bound() && !table.filtering);
    if !tells || !aimed || !is_shown(state) || !state.popups.is_empty() {
        return None;
    }
    Some((state.screen, state.row_key()?))
}

/// Sends a request once the cursor rests.
pub fn follow(state: &mut State) {
    if state.popups.is_empty() {
        let wanted = wanted(state);
        if wanted != state.detail.about {
            let due = wanted.as_ref().map(|_| Timestamp(state.now.0.saturating_add(REST)));
            // Coverage names its topic, so it stays until another topic's arrives.
            let coverage = state.detail.coverage.take();
            state.detail = Detail { about: wanted, due, coverage, ..Detail::default() };
        }
    }
    let rested = state.detail.due.is_some_and(|due| due <= state.now);
    let may_ask = may_ask(state);
    let Some((screen, id)) = state.detail.about.clone().filter(|_| rested && may_ask) else { return };
    state.detail.due = None;
    if screen == Screen::Topics {
        let topic = id.parse::<TopicName>().ok().filter(|_| state.topics.robot(&id).is_none());
        return topic.into_iter().for_each(|topic| state.send(coverage_of(&topic)));
    }
    let command = if screen == Screen::Records {
        // The previous details stay until the new answer arrives.
        state.detail.steps =
            state.detail.steps.take().filter(|steps| steps.id == id).or_else(|| Some(Lookup::new(&id)));
        Command::ShowUpload { id: id.clone() }
    } else {
        state.detail.opening = Some(Opening::new(&id));
        Command::OpenShared { id: id.clone() }
    };
    state.send(Errand { command, tag: Tag::Beside(screen, id) });
}

/// Requests a record in the pane again unless it is in its final state.
pub fn touch(state: &mut State) {
    let found = state.detail.steps.as_ref().and_then(Lookup::found);
    let goes_on = found.is_some_and(|found| !is_settled(found.record.state));
    if goes_on && state.detail.due.is_none() && !state.is_frozen() {
        state.detail.due = Some(Timestamp(state.now.0.saturating_add(REST)));
    }
}

pub fn looked_up(state: &mut State, id: &str, answer: Result<Provenance, Failure>) {
    if let Some(steps) = state.detail.steps.as_mut().filter(|steps| steps.id == id) {
        steps.answer = Some(answer.map(Box::new));
    }
}

/// No event reports coverage, so it is requested again after a while.
pub fn covered(state: &mut State, topic: &str, answer: Result<CoverageView, Failure>) {
    state.detail.coverage = Some((topic.to_owned(), answer.map(Box::new)));
    let beside = state.detail.about.as_ref().is_some_and(|(screen, id)| *screen == Screen::Topics && id == topic);
    if beside && !state.is_frozen() {
        state.detail.due = Some(Timestamp(state.now.0.saturating_add(COVERAGE_EVERY)));
    }
}

pub fn opened_beside(state: &mut State, id: &str, answer: Result<Box<OpenedView>, Failure>) {
    if let Some(opening) = state.detail.opening.as_mut().filter(|opening| opening.lookup.id == id) {
        opening.lookup.answer = Some(answer);
    }
}
