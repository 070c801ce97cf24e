//! The themes by name; the one under the cursor is the one in use.

use ratatui::layout::Rect;

use super::framed;
use crate::app::State;
use crate::app::themes::ThemeChoice;
use crate::model::clean;
use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::theme::Role;

/// Draws the choice, with a sample of every role beside it.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, choice: &ThemeChoice) {
    let names = &state.settings.themes;
    let wanted = names.len().max(Role::ALL.len());
    let inner = framed(canvas, area, "Theme", 44, u16::try_from(wanted).unwrap_or(u16::MAX));
    let height = usize::from(inner.height.max(1));
    let first = choice.selected - choice.selected % height;
    for (line, (index, name)) in (0u16..).zip(names.iter().enumerate().skip(first).take(height)) {
        let here = index == choice.selected;
        let area = row(inner, line);
        canvas.put(area, if here { "▌" } else { " " }, Role::Accent);
        canvas.put(right_of(area, 1), &clean(name, 20), if here { Role::Selection } else { Role::Body });
    }
    for (line, role) in (0..inner.height).zip(Role::ALL) {
        canvas.put(right_of(row(inner, line), 24), role.word(), role);
    }
}
