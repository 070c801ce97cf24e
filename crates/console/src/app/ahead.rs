//! Keys typed ahead: a command on a row, typed before the rows of a new filter, order or page are here, waits for them,
//! and so do the keys after it. It would otherwise be done to a row that is about to go, or to none.

use super::key::Key;
use super::keymap::Meaning;
use super::state::State;
use super::verb::Verb;
use crate::model::Timestamp;

/// The longest wait for the rows, nanoseconds.
const LONGEST: u64 = 3_000_000_000;
/// The most keys that wait.
const MOST: usize = 64;

/// Keys that wait for rows.
#[derive(Debug, Default)]
pub struct Ahead {
    keys: Vec<Key>,
    since: Timestamp,
}

impl Ahead {
    /// What waits is not done.
    pub fn clear(&mut self) {
        self.keys.clear();
    }
}

/// Keeps `key` back if it is for rows that are not here yet, or comes after one that is. Esc takes back what waits;
/// Ctrl-C never waits.
pub fn keeps(state: &mut State, key: Key) -> bool {
    if !state.awaits_rows() {
        return false;
    }
    let waiting = !state.ahead.keys.is_empty();
    if matches!(key, Key::Escape | Key::Control('c')) {
        state.ahead.clear();
        return waiting && key == Key::Escape;
    }
    if !waiting && !is_for_a_row(state, key) {
        return false;
    }
    if !waiting {
        state.ahead.since = state.now;
    }
    if state.ahead.keys.len() < MOST {
        state.ahead.keys.push(key);
    }
    true
}

/// The keys whose rows are here. Those whose rows do not come are given up, and the operator is told.
pub fn ready(state: &mut State) -> Vec<Key> {
    if state.ahead.keys.is_empty() {
        return Vec::new();
    }
    if !state.awaits_rows() {
        let keys = std::mem::take(&mut state.ahead.keys);
        let shown = state.popups.is_empty() && state.rows_are_here();
        return if shown { keys } else { given_up(state) };
    }
    if gives_up_at(state).is_some_and(|at| at <= state.now) { given_up(state) } else { Vec::new() }
}

/// When the wait is over, if anything waits.
pub fn gives_up_at(state: &State) -> Option<Timestamp> {
    (!state.ahead.keys.is_empty()).then(|| Timestamp(state.ahead.since.0.saturating_add(LONGEST)))
}

fn given_up(state: &mut State) -> Vec<Key> {
    state.ahead.clear();
    state.inform("not done: the list was not here yet");
    Vec::new()
}

fn is_for_a_row(state: &State, key: Key) -> bool {
    let Meaning::Does(verb) = state.settings.keymap.meaning(&[key], state.screen) else { return false };
    matches!(
        verb,
        Verb::Details
            | Verb::Open
            | Verb::Check
            | Verb::Export
            | Verb::Mark
            | Verb::MarkAll
            | Verb::Readers
            | Verb::Play
            | Verb::Incident
            | Verb::Copy
            | Verb::WriteFile
    )
}
