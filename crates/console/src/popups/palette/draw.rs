//! The palette on screen.

use ratatui::layout::{Position, Rect};

use crate::app::{State, available::available};
use crate::popups::palette::state::Palette;
use crate::ui::{Canvas, Role, below, columns, draw_list, framed, right_of};

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
