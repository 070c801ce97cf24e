//! Keys typed before their rows have arrived.

use crate::app::{Key, State, Verb, keymap::Meaning};
use crate::model::Timestamp;

/// Longest wait for rows, nanoseconds.
const LONGEST: u64 = 3_000_000_000;

/// The most keys that wait.
const MOST: usize = 64;

/// Keeps back keys for rows that are still on their way, and keys after those; Esc drops them, Ctrl-C never waits.
pub fn keeps(state: &mut State, key: Key) -> bool {
    if !state.awaits_rows() {
        return false;
    }
    let waiting = !state.ahead.keys.is_empty();
    if matches!(key, Key::Escape | Key::Control('c')) {
        state.ahead.keys.clear();
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

/// Gives up keys whose rows do not come, and says so.
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

pub fn gives_up_at(state: &State) -> Option<Timestamp> {
    (!state.ahead.keys.is_empty()).then(|| Timestamp(state.ahead.since.0.saturating_add(LONGEST)))
}

fn given_up(state: &mut State) -> Vec<Key> {
    state.ahead.keys.clear();
    state.inform("not done: the list was not here yet");
    Vec::new()
}

fn is_for_a_row(state: &State, key: Key) -> bool {
    use Verb::{Check, Copy, Details, Export, Incident, Mark, MarkAll, Open, Play, Readers, WriteFile};
    let Meaning::Does(verb) = state.settings.keymap.meaning(&[key], state.screen) else { return false };
    let acts = matches!(verb, Details | Open | Check | Export | Mark | MarkAll | Readers | Play | Incident);
    acts || matches!(verb, Copy | WriteFile)
}
