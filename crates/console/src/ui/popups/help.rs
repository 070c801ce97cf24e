//! Help: every key that works on this screen, and what it does.

use ratatui::layout::Rect;

use super::framed;
use crate::app::State;
use crate::app::available::available;
use crate::app::fuzzy::whole_words;
use crate::app::key::chord_label;
use crate::app::keymap::Binding;
use crate::app::popup::Help;
use crate::app::verb::{Entry, VERBS};
use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::theme::Role;
use crate::ui::words::wrap;

/// Columns of the keys.
const KEYS: u16 = 14;
/// Columns of the list.
const WIDTH: u16 = 72;

/// A line of the list: keys, words, and whether it is available now.
struct Told {
    keys: String,
    words: String,
    possible: bool,
}

/// Draws the list from its `scroll`-th line on; no sentence is cut.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, help: &Help) {
    let (title, told) = match &help.window {
        Some(hints) => ("Keys of this window".to_owned(), of_window(hints)),
        None => (format!("Keys of the {} screen", state.screen.title()), of_screen(state)),
    };
    let width = WIDTH.min(area.width.saturating_sub(6));
    let wanted = help.filter.text();
    let fits = |told: &&Told| whole_words(wanted, &format!("{} {}", told.keys, told.words));
    let lines: Vec<(String, String, Role)> = told.iter().filter(fits).flat_map(|told| broken(told, width)).collect();
    let rows = u16::try_from(lines.len().max(1)).unwrap_or(u16::MAX);
    let searched = help.filtering || !wanted.is_empty();
    let inner = framed(canvas, area, &title, WIDTH, rows.saturating_add(u16::from(searched)));
    let list = Rect { height: inner.height.saturating_sub(u16::from(searched)), ..inner };
    let first = help.scroll.min(lines.len().saturating_sub(usize::from(list.height)));
    for (place, (keys, words, role)) in (0..list.height).zip(lines.iter().skip(first)) {
        let key_role = if *role == Role::Dim { Role::Dim } else { Role::Key };
        canvas.put(Rect { width: KEYS.min(list.width), ..row(list, place) }, keys, key_role);
        canvas.put(right_of(row(list, place), KEYS), words, *role);
    }
    let below = lines.len().saturating_sub(first + usize::from(list.height));
    if first > 0 || below > 0 {
        let edge = Rect { y: inner.bottom().min(area.bottom().saturating_sub(1)), height: 1, ..inner };
        canvas.put_right(edge, &format!(" {first} above, {below} below "), Role::Dim);
    }
    if searched {
        canvas.puts(row(inner, inner.height.saturating_sub(1)), &[("/ ", Role::Key), (wanted, Role::Accent)]);
    }
}

fn of_window(hints: &[(&str, &str)]) -> Vec<Told> {
    let told =
        |(keys, words): &(&str, &str)| Told { keys: (*keys).to_owned(), words: (*words).to_owned(), possible: true };
    hints.iter().map(told).collect()
}

/// Verbs of the screen come first.
fn of_screen(state: &State) -> Vec<Told> {
    let hidden =
        |entry: &&Entry| state.settings.read_only && entry.changes || !crate::app::tour::knows(state, entry.verb);
    let bound = |entry: &&Entry| state.settings.keymap.of(entry, state.screen).next().is_some() && !hidden(entry);
    let (own, all): (Vec<&Entry>, Vec<&Entry>) = VERBS.iter().filter(bound).partition(|entry| !entry.on.is_empty());
    own.into_iter().chain(all).map(|entry| of_entry(state, entry)).collect()
}

fn of_entry(state: &State, entry: &Entry) -> Told {
    let bindings: Vec<&Binding> = state.settings.keymap.of(entry, state.screen).collect();
    let keys: Vec<String> = bindings.iter().map(|binding| chord_label(&binding.on)).collect();
    let words = bindings.iter().find(|binding| binding.desc.is_some()).map_or(entry.help, |binding| binding.help());
    let reason = available(state, entry.verb).err();
    let possible = reason.is_none();
    let words = reason.map_or_else(|| words.to_owned(), |reason| format!("{words} ({reason})"));
    Told { keys: keys.join(", "), words, possible }
}

fn broken(told: &Told, width: u16) -> Vec<(String, String, Role)> {
    let role = if told.possible { Role::Body } else { Role::Dim };
    let lines = wrap(&told.words, width.saturating_sub(KEYS)).into_iter().enumerate();
    lines.map(|(place, line)| (if place == 0 { told.keys.clone() } else { String::new() }, line, role)).collect()
}
