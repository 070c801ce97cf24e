//! The palette: every command by name.

use ratatui::layout::Rect;

use super::framed;
use crate::app::State;
use crate::app::available::available;
use crate::app::popup::Palette;
use crate::app::verb::Entry;
use crate::ui::canvas::{Canvas, below, columns, right_of, row};
use crate::ui::theme::Role;

/// Columns of the names.
const NAME: u16 = 18;

/// Draws the palette.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, palette: &Palette) {
    let inner = framed(canvas, area, "Commands", 72, 14);
    canvas.puts(inner, &[(": ", Role::Key), (palette.field.text(), Role::Accent)]);
    let before: String = palette.field.text().chars().take(palette.field.cursor()).collect();
    canvas.set_cursor(inner.x + 2 + columns(&before), inner.y);
    let matches = palette.matches(state);
    let list = below(inner, 1);
    if matches.is_empty() {
        canvas.put(list, "no command matches", Role::Dim);
    }
    let selected = palette.selected.min(matches.len().saturating_sub(1));
    let height = usize::from(list.height.max(1));
    let first = selected - selected % height;
    for (place, (index, entry)) in (0u16..).zip(matches.iter().enumerate().skip(first).take(height)) {
        draw_entry(canvas, row(list, place), state, entry, index == selected);
    }
}

fn draw_entry(canvas: &mut Canvas, area: Rect, state: &State, entry: &Entry, here: bool) {
    let reason = available(state, entry.verb).err();
    let role = if reason.is_some() { Role::Dim } else { Role::Body };
    canvas.put(area, if here { "▌" } else { " " }, Role::Accent);
    canvas.put(right_of(area, 1), entry.name, if here { Role::Selection } else { role });
    let key = state.settings.keymap.label(entry, state.screen);
    canvas.put(Rect { width: 9, ..right_of(area, NAME) }, &key, Role::Key);
    let text = reason.map_or_else(|| entry.help.to_owned(), |reason| format!("({reason}) {}", entry.help));
    canvas.put(right_of(area, NAME + 10), &text, role);
}
