//! The pane beside a list on a wide terminal. A record's details are requested when the cursor rests on it: another
//! owner's record is then opened, as with enter, and the audit log says so.

use super::action::{Effect, Errand, Tag};
use super::opening::Opening;
use super::popup::Lookup;
use super::screen::Screen;
use super::state::State;
use crate::model::{Timestamp, TopicName};
use crate::service::reply::{CoverageView, OpenedView, Provenance};
use crate::service::{Command, Failure};

/// Terminal width from which there is a pane, columns.
pub const WIDE_FROM: u16 = 140;
/// The fewest columns that the list beside a pane keeps.
const LIST: u16 = 84;
/// The greatest width of a pane, columns.
const WIDEST: u16 = 84;
/// How long the cursor rests before a record is requested, nanoseconds.
const REST: u64 = 300_000_000;
/// How often a topic's coverage in the pane is requested, nanoseconds.
const COVERAGE_EVERY: u64 = 30_000_000_000;
/// Parts of a topic's coverage.
const PARTS: usize = 60;

/// The pane's data about a record.
#[derive(Debug, Default)]
pub struct Detail {
    /// The record under the cursor, and its list.
    about: Option<(Screen, String)>,
    /// When it is requested.
    due: Option<Timestamp>,
    /// An own record's provenance and state.
    pub steps: Option<Lookup<Provenance>>,
    /// Another owner's record.
    pub opening: Option<Opening>,
    /// When there are records of a topic.
    pub coverage: Option<(String, Result<Box<CoverageView>, Failure>)>,
}

impl Detail {
    /// Forgets everything, as when the keys are wiped.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

/// The topic whose coverage is requested.
pub fn coverage_of(topic: &TopicName) -> Errand {
    let command = Command::TopicCoverage { topic: topic.clone(), robot: None, since: None, until: None, parts: PARTS };
    Errand { command, tag: Tag::Beside(Screen::Topics, topic.to_string()) }
}

/// When the record under the cursor is requested. While an answer is awaited, that answer comes first.
pub fn due(state: &State) -> Option<Timestamp> {
    state.detail.due.filter(|_| may_ask(state))
}

/// One record is requested at a time, none behind a popup, and none while the keys are being wiped.
fn may_ask(state: &State) -> bool {
    state.popups.is_empty() && !state.work.iter().any(|tag| matches!(tag, Tag::Beside(..) | Tag::Lock))
}

/// Whether there is a pane beside the list on screen.
pub fn is_shown(state: &State) -> bool {
    state.size.0 >= WIDE_FROM && state.screen.has_table()
}

/// The width of the list on screen, columns: the terminal's, less the pane's.
pub fn list_width(state: &State) -> u16 {
    let whole = state.size.0;
    if is_shown(state) { whole - (whole / 2).min(WIDEST).min(whole.saturating_sub(LIST)) } else { whole }
}

/// The record to show in the pane: one that the cursor was moved to, not just the newest.
fn wanted(state: &State) -> Option<(Screen, String)> {
    let open = state.identity.as_ref().is_some_and(|identity| identity.unlocked);
    let tells = match state.screen {
        Screen::Topics => state.identity.as_ref().is_some_and(|identity| identity.exists),
        Screen::Uploads => true,
        Screen::Shared => open,
        _ => false,
    };
    let aimed = state.table().is_some_and(|table| table.is_bound() && !table.filtering);
    if !tells || !aimed || !is_shown(state) || !state.popups.is_empty() {
        return None;
    }
    Some((state.screen, state.row_key()?))
}

/// Follows the cursor; sends a request when it has come to rest.
pub fn follow(state: &mut State) -> Vec<Effect> {
    if state.popups.is_empty() {
        let wanted = wanted(state);
        if wanted != state.detail.about {
            let due = wanted.as_ref().map(|_| Timestamp(state.now.0.saturating_add(REST)));
            // Coverage belongs to the topic that it names, and stays until another topic's arrives.
            let coverage = state.detail.coverage.take();
            state.detail = Detail { about: wanted, due, coverage, ..Detail::default() };
        }
    }
    let rested = state.detail.due.is_some_and(|due| due <= state.now);
    let may_ask = may_ask(state);
    let Some((screen, id)) = state.detail.about.clone().filter(|_| rested && may_ask) else { return Vec::new() };
    state.detail.due = None;
    if screen == Screen::Topics {
        let topic = id.parse::<TopicName>().ok().filter(|_| state.topics.robot(&id).is_none());
        return topic.map(|topic| coverage_of(&topic)).map(|errand| state.send(errand)).into_iter().collect();
    }
    let command = if screen == Screen::Uploads {
        // The previous details stay until the new answer arrives.
        state.detail.steps =
            state.detail.steps.take().filter(|steps| steps.id == id).or_else(|| Some(Lookup::new(&id)));
        Command::ShowUpload { id: id.clone() }
    } else {
        state.detail.opening = Some(Opening::new(&id));
        Command::OpenShared { id: id.clone() }
    };
    vec![state.send(Errand { command, tag: Tag::Beside(screen, id) })]
}

/// Records changed state: if the one in the pane is not in its final state, it is requested again.
pub fn touch(state: &mut State) {
    let found = state.detail.steps.as_ref().and_then(Lookup::found);
    let goes_on = found.is_some_and(|found| !super::update::is_settled(found.record.state));
    if goes_on && state.detail.due.is_none() && !state.is_frozen() {
        state.detail.due = Some(Timestamp(state.now.0.saturating_add(REST)));
    }
}

/// Takes the answer about an own record.
pub fn looked_up(state: &mut State, id: &str, answer: Result<Provenance, Failure>) {
    if let Some(steps) = state.detail.steps.as_mut().filter(|steps| steps.id == id) {
        steps.answer = Some(answer.map(Box::new));
    }
}

/// Takes the answer about a topic; in the pane it is requested again after a while, because no event reports it.
pub fn covered(state: &mut State, topic: &str, answer: Result<CoverageView, Failure>) {
    state.detail.coverage = Some((topic.to_owned(), answer.map(Box::new)));
    let beside = state.detail.about.as_ref().is_some_and(|(screen, id)| *screen == Screen::Topics && id == topic);
    if beside && !state.is_frozen() {
        state.detail.due = Some(Timestamp(state.now.0.saturating_add(COVERAGE_EVERY)));
    }
}

/// Takes the answer about another owner's record.
pub fn opened(state: &mut State, id: &str, answer: Result<Box<OpenedView>, Failure>) {
    if let Some(opening) = state.detail.opening.as_mut().filter(|opening| opening.lookup.id == id) {
        opening.lookup.answer = Some(answer);
    }
}
