//! The palette: every command by name, some with terms.

use ratatui::layout::Position;

use crate::app::{
    Entry, Field, Key, Popup, State, VERBS, Verb, available::available, matching::score, matching::whole_words, tour,
};
use crate::popups::{columns, form::grant, form::profile, state::Palette};
use crate::screens::topics;
use crate::ui::{Canvas, Rect, Role, below, columns, draw_list, framed, right_of};

#[allow(clippy::wildcard_enum_match_arm, reason = "any other key is typed")]
pub fn key(state: &mut State, mut palette: Palette, key: Key) -> Option<Verb> {
    let matches = palette.matches(state);
    let last = matches.len().saturating_sub(1);
    match key {
        Key::Escape => return None,
        Key::Enter => {
            remember(state, palette.field.text());
            let words: Vec<&str> = palette.field.text().split_whitespace().collect();
            let chosen = matches.get(palette.selected.min(last)).map(|entry| entry.verb);
            let (grants, chooses) = (available(state, Verb::Grant).is_ok(), available(state, Verb::Columns).is_ok());
            let (changes, is_pattern) = (!state.settings.read_only, |word: &&str| word.starts_with(['/', '*']));
            match with_terms(&words) {
                Some(("grant", terms)) if grants => grant::spoken(state, terms),
                Some((word @ ("watch" | "unwatch"), topics)) if changes && topics.iter().all(is_pattern) => {
                    topics::keys::spoken_watch(state, topics, word == "watch");
                }
                Some(("columns", names)) if chooses => columns::keys::spoken(state, names),
                Some(("profile", [name])) => match name.parse() {
                    Ok(profile) => profile::switch(state, profile),
                    Err(_) => return chosen,
                },
                _ => return chosen,
            }
            return None;
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
    None
}

const MOST_COMMANDS: usize = 50;

fn remember(state: &mut State, typed: &str) {
    let typed = typed.trim();
    if !typed.is_empty() {
        state.commands.retain(|other| other != typed);
        state.commands.push(typed.to_owned());
        drop(state.commands.drain(..state.commands.len().saturating_sub(MOST_COMMANDS)));
    }
}

/// Up in an empty palette recalls earlier commands; false if the arrow moves the cursor.
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

fn with_terms<'a>(words: &'a [&'a str]) -> Option<(&'a str, &'a [&'a str])> {
    words.split_first().filter(|(_, terms)| !terms.is_empty()).map(|(name, terms)| (*name, terms))
}

impl Palette {
    /// Available ones first, best match first.
    pub fn matches(&self, state: &State) -> Vec<&'static Entry> {
        let score = |entry: &'static Entry| {
            let name = score(self.field.text(), entry.name);
            name.or_else(|| whole_words(self.field.text(), entry.help).then_some(100))
        };
        let listed = VERBS.iter().filter(|entry| {
            entry.palette && !(state.settings.read_only && entry.changes) && tour::follow::knows(state, entry.verb)
        });
        let mut found: Vec<_> = listed.filter_map(|entry| score(entry).map(|score| (score, entry))).collect();
        found.sort_by_key(|(score, entry)| (available(state, entry.verb).is_err(), *score));
        found.into_iter().map(|(_, entry)| entry).collect()
    }
}

const NAME: u16 = 17;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, palette: &Palette) {
    let inner = framed(canvas, area, "Commands", 72, 14);
    canvas.puts(inner, &[(": ", Role::Key), (palette.field.text(), Role::Accent)]);
    let before: String = palette.field.text().chars().take(palette.field.cursor()).collect();
    canvas.cursor = Some(Position { x: inner.x + 2 + columns(&before), y: inner.y });
    let matches = palette.matches(state);
    if matches.is_empty() {
        canvas.put(below(inner, 1), "no command matches", Role::Dim);
    }
    draw_list(canvas, below(inner, 1), &matches, palette.selected, |canvas, line, entry, here| {
        let reason = available(state, entry.verb).err();
        let role = if reason.is_some() { Role::Dim } else { Role::Body };
        canvas.put(line, entry.name, if here { Role::Selection } else { role });
        let key = state.settings.keymap.label(entry, state.screen);
        canvas.put(Rect { width: 9, ..right_of(line, NAME) }, &key, Role::Key);
        let text = reason.map_or_else(|| entry.help.to_owned(), |reason| format!("({reason}) {}", entry.help));
        canvas.put(right_of(line, NAME + 10), &text, role);
    });
}
