//! Keys of the palette: every command by name, some with terms behind it, and what was typed before.

use super::action::Effect;
use super::available::available;
use super::field::Field;
use super::key::Key;
use super::perform::perform;
use super::popup::{Palette, Popup};
use super::state::State;
use super::verb::Verb;
use super::{columns, granting, profiles};

/// A key while the palette is open.
pub(super) fn key(state: &mut State, mut palette: Palette, key: Key) -> Vec<Effect> {
    let matches = palette.matches(state);
    let last = matches.len().saturating_sub(1);
    match key {
        Key::Escape => return Vec::new(),
        Key::Enter => {
            remember(state, palette.field.text());
            let words: Vec<&str> = palette.field.text().split_whitespace().collect();
            if let (Some(("grant", terms)), Ok(())) = (with_terms(&words), available(state, Verb::Grant)) {
                return granting::spoken(state, terms);
            }
            if let (Some(("columns", names)), Ok(())) = (with_terms(&words), available(state, Verb::Columns)) {
                return columns::spoken(state, names);
            }
            if let Some(("profile", [name])) = with_terms(&words)
                && let Ok(profile) = name.parse()
            {
                return profiles::switch(state, profile);
            }
            let Some(entry) = matches.get(palette.selected.min(last)) else { return Vec::new() };
            return perform(state, entry.verb);
        }
        Key::Up | Key::Down if recalls(state, &mut palette, key == Key::Up) => {}
        Key::Up | Key::BackTab => palette.selected = palette.selected.min(last).saturating_sub(1),
        Key::Down | Key::Tab => palette.selected = (palette.selected + 1).min(last),
        _ => {
            palette.field.key(key);
            (palette.selected, palette.recalled) = (0, None);
        }
    }
    state.popups.push(Popup::Palette(palette));
    Vec::new()
}

/// The most commands remembered.
const MOST_COMMANDS: usize = 50;

fn remember(state: &mut State, typed: &str) {
    let typed = typed.trim();
    if !typed.is_empty() {
        state.commands.retain(|other| other != typed);
        state.commands.push(typed.to_owned());
        drop(state.commands.drain(..state.commands.len().saturating_sub(MOST_COMMANDS)));
    }
}

/// In an empty palette, up brings the last command back, and then earlier ones; false if the arrow moves the cursor.
fn recalls(state: &State, palette: &mut Palette, earlier: bool) -> bool {
    let wanted = match (palette.recalled, earlier) {
        (None, true) if palette.field.text().is_empty() && palette.selected == 0 => Some(0),
        (None, _) => return false,
        (Some(back), true) => Some((back + 1).min(state.commands.len().saturating_sub(1))),
        (Some(back), false) => back.checked_sub(1),
    };
    let text = wanted.and_then(|back| state.commands.iter().rev().nth(back));
    if text.is_none() && palette.recalled.is_none() {
        return false;
    }
    palette.field = Field::with(text.map_or("", String::as_str));
    (palette.recalled, palette.selected) = (wanted, 0);
    true
}

/// A command's name and the terms after it, if there are any.
fn with_terms<'a>(words: &'a [&'a str]) -> Option<(&'a str, &'a [&'a str])> {
    words.split_first().filter(|(_, terms)| !terms.is_empty()).map(|(name, terms)| (*name, terms))
}
