//! The pane beside a list on a wide terminal. What it tells of a record is asked for when the cursor rests on it: a
//! record of others is opened then, as by enter, and the audit log says so.

use super::action::{Effect, Errand, Tag};
use super::opening::Opening;
use super::popup::Lookup;
use super::screen::Screen;
use super::state::State;
use crate::model::{Timestamp, TopicName};
use crate::service::reply::{CoverageView, OpenedView, Provenance};
use crate::service::{Command, Failure};

/// From so many columns on there is a pane.
pub const WIDE_FROM: u16 = 140;
/// How long the cursor rests before a record is asked for, nanoseconds.
const REST: u64 = 300_000_000;
/// How often a topic's coverage in the pane is asked for, nanoseconds.
const COVERAGE_EVERY: u64 = 30_000_000_000;
/// Parts of a topic's coverage.
const PARTS: usize = 60;

/// What the pane knows of a record.
#[derive(Debug, Default)]
pub struct Detail {
    /// The record under the cursor, and its list.
    about: Option<(Screen, String)>,
    /// When it is asked for.
    due: Option<Timestamp>,
    /// Where an own record comes from and where it stands.
    pub steps: Option<Lookup<Provenance>>,
    /// A record of others.
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

/// What is asked about when there are records of a topic.
pub fn coverage_of(topic: &TopicName) -> Errand {
    let command = Command::TopicCoverage { topic: topic.clone(), since: None, until: None, parts: PARTS };
    Errand { command, tag: Tag::Beside(Screen::Topics, topic.to_string()) }
}

/// When the record under the cursor is asked for. While an answer is awaited, it is that answer that goes on.
pub fn due(state: &State) -> Option<Timestamp> {
    state.detail.due.filter(|_| may_ask(state))
}

/// One record is asked for at a time, none behind a popup, and none while the keys are being wiped.
fn may_ask(state: &State) -> bool {
    state.popups.is_empty() && !state.work.iter().any(|tag| matches!(tag, Tag::Beside(..) | Tag::Lock))
}

/// Whether there is a pane beside the list on screen.
pub fn is_shown(state: &State) -> bool {
    state.size.0 >= WIDE_FROM && state.screen.has_table()
}

/// The record that the pane is to tell of: one that the cursor was put on, not whichever is the newest.
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

/// Follows the cursor; asks when it has come to rest.
pub fn follow(state: &mut State) -> Vec<Effect> {
    if state.popups.is_empty() {
        let wanted = wanted(state);
        if wanted != state.detail.about {
            let due = wanted.as_ref().map(|_| Timestamp(state.now.0.saturating_add(REST)));
            // Coverage is told of the topic that it names, and stays until another's comes.
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
        // What was told of it before stays until the new answer comes.
        state.detail.steps =
            state.detail.steps.take().filter(|steps| steps.id == id).or_else(|| Some(Lookup::new(&id)));
        Command::ShowUpload { id: id.clone() }
    } else {
        state.detail.opening = Some(Opening::new(&id));
        Command::OpenShared { id: id.clone() }
    };
    vec![state.send(Errand { command, tag: Tag::Beside(screen, id) })]
}

/// Records went on: where the one in the pane is not at its end, it is asked for again.
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

/// Takes the answer about a topic; in the pane it is asked again after a while, for nothing tells of it.
pub fn covered(state: &mut State, topic: &str, answer: Result<CoverageView, Failure>) {
    state.detail.coverage = Some((topic.to_owned(), answer.map(Box::new)));
    let beside = state.detail.about.as_ref().is_some_and(|(screen, id)| *screen == Screen::Topics && id == topic);
    if beside && !state.is_frozen() {
        state.detail.due = Some(Timestamp(state.now.0.saturating_add(COVERAGE_EVERY)));
    }
}

/// Takes the answer about a record of others.
pub fn opened(state: &mut State, id: &str, answer: Result<Box<OpenedView>, Failure>) {
    if let Some(opening) = state.detail.opening.as_mut().filter(|opening| opening.lookup.id == id) {
        opening.lookup.answer = Some(answer);
    }
}
