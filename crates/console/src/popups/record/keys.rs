//! Keys of an opened record, and its answers.

use crate::app::{Effect, Key, Popup, State, Verb, rows, scrolled};
use crate::popups::{record::state::Opening, record::state::writable};
use crate::service::{Failure, reply::OpenedView, reply::PathView};

pub fn key(state: &mut State, mut opening: Opening, key: Key) -> Option<Verb> {
    match key {
        Key::Tab | Key::Right => opening.turn(false),
        Key::BackTab | Key::Left => opening.turn(true),
        Key::Enter if opening.is_drawn() => opening.alone = !opening.alone,
        Key::Char('n') => return neighbour(state, Popup::Record(opening), 1),
        Key::Char('p') => return neighbour(state, Popup::Record(opening), -1),
        Key::Char('W') => match opening.lookup.found().map(writable) {
            Some(Some(file)) => {
                state.effects.push(Effect::WriteFiles { base: None, directory: None, files: vec![file] });
            }
            Some(None) => state
                .inform(format!("too large to save here; use `authros records open {} --out FILE`", opening.lookup.id)),
            None => {}
        },
        Key::Char('y') => {
            let digest = opening.lookup.found().map(|view| view.record.digest.to_hex());
            digest.into_iter().for_each(|digest| state.copy(digest));
        }
        _ => match scrolled(opening.lookup.scroll, key, state.page_rows()) {
            Some(scroll) => opening.lookup.scroll = scroll.min(opening.lines()),
            None => return None,
        },
    }
    let path = opening.wants_path();
    state.popups.push(Popup::Record(opening));
    path.into_iter().for_each(|errand| state.send(errand));
    None
}

/// The verb that shows it.
pub fn neighbour(state: &mut State, popup: Popup, by: isize) -> Option<Verb> {
    let before = state.row_key();
    let keys = state.row_keys();
    let moved = state.table_mut().is_some_and(|table| table.step(&keys, by));
    if !moved || state.row_key() == before {
        state.popups.push(popup);
        let place = if by > 0 { "last" } else { "first" };
        state.inform(format!("this is the {place} record of the page"));
        return None;
    }
    rows::stand(state);
    Some(if matches!(popup, Popup::Record(_)) { Verb::Open } else { Verb::Details })
}

pub fn answered(state: &mut State, id: &str, answer: Result<Box<OpenedView>, Failure>) {
    let Some(opening) = find(state, id) else { return };
    opening.lookup.answer = Some(answer);
    opening.wants_path().into_iter().for_each(|errand| state.send(errand));
}

pub fn path_found(state: &mut State, id: &str, answer: Result<PathView, Failure>) {
    if let Some(path) = find(state, id).and_then(|opening| opening.path.as_mut()) {
        path.answer = Some(answer.map(Box::new));
    }
}

fn find<'a>(state: &'a mut State, id: &str) -> Option<&'a mut Opening> {
    state.popups.iter_mut().find_map(|popup| match popup {
        Popup::Record(opening) if opening.lookup.id == id => Some(opening),
        _ => None,
    })
}
