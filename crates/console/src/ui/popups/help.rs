//! Help: every key that works on this screen, and what it does.

use ratatui::layout::Rect;

use super::framed;
use crate::app::State;
use crate::app::available::available;
use crate::app::key::chord_label;
use crate::app::keymap::Binding;
use crate::app::verb::{Entry, VERBS};
use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::theme::Role;

/// Columns of the keys.
const KEYS: u16 = 14;

/// Draws the list from its `scroll`-th line on.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, scroll: usize) {
    let hidden = |entry: &&Entry| state.settings.read_only && entry.changes;
    let bound = |entry: &&Entry| state.settings.keymap.of(entry, state.screen).next().is_some() && !hidden(entry);
    let (own, all): (Vec<&Entry>, Vec<&Entry>) = VERBS.iter().filter(bound).partition(|entry| !entry.on.is_empty());
    let entries: Vec<&Entry> = own.into_iter().chain(all).collect();
    let title = format!("Keys of the {} screen", state.screen.title());
    let wanted = u16::try_from(entries.len()).unwrap_or(u16::MAX);
    let inner = framed(canvas, area, &title, 72, wanted);
    let first = scroll.min(entries.len().saturating_sub(usize::from(inner.height)));
    for (place, entry) in (0..inner.height).zip(entries.iter().skip(first)) {
        draw_entry(canvas, row(inner, place), state, entry);
    }
}

fn draw_entry(canvas: &mut Canvas, area: Rect, state: &State, entry: &Entry) {
    let bindings: Vec<&Binding> = state.settings.keymap.of(entry, state.screen).collect();
    let keys: Vec<String> = bindings.iter().map(|binding| chord_label(&binding.on)).collect();
    let words = bindings.iter().find(|binding| binding.desc.is_some()).map_or(entry.help, |binding| binding.help());
    let reason = available(state, entry.verb).err();
    let (key_role, role) = if reason.is_some() { (Role::Dim, Role::Dim) } else { (Role::Key, Role::Body) };
    canvas.put(Rect { width: KEYS.min(area.width), ..area }, &keys.join(", "), key_role);
    let text = reason.map_or_else(|| words.to_owned(), |reason| format!("{words} ({reason})"));
    canvas.put(right_of(area, KEYS), &text, role);
}
