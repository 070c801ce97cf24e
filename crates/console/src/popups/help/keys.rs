//! Keys of help.

use crate::app::{Key, Popup, State, VERBS, scrolled};
use crate::popups::help::state::Help;

pub fn key(state: &mut State, mut help: Help, key: Key) {
    match key {
        Key::Escape if help.filtering || !help.filter.text().is_empty() => {
            (help.filtering, help.filter) = Default::default()
        }
        Key::Enter if help.filtering => help.filtering = false,
        Key::Up | Key::Down | Key::PageUp | Key::PageDown | Key::Home if help.filtering => {}
        _ if help.filtering => drop(help.filter.key(key)),
        Key::Char('/') => help.filtering = true,
        Key::Char('?') => return,
        _ => match scrolled(help.scroll, key, state.page_rows()) {
            Some(scroll) => help.scroll = scroll.min(VERBS.len() * 2),
            None => return,
        },
    }
    state.popups.push(Popup::Help(help));
}
