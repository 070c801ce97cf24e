//! Browsing what others share.

use ratatui::layout::Rect;

use super::framed;
use crate::app::State;
use crate::app::browse::{Browse, choices};
use crate::model::clean;
use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::theme::Role;

/// Columns of the choices.
const TEXT: u16 = 34;

/// Draws the list.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, browse: &Browse) {
    let choices = choices(state);
    let inner = framed(canvas, area, "Browse", 76, u16::try_from(choices.len()).unwrap_or(u16::MAX));
    let selected = browse.selected.min(choices.len().saturating_sub(1));
    let height = usize::from(inner.height.max(1));
    let first = selected - selected % height;
    for (place, (index, choice)) in (0u16..).zip(choices.iter().enumerate().skip(first).take(height)) {
        let (line, here) = (row(inner, place), index == selected);
        canvas.put(line, if here { "▌" } else { " " }, Role::Accent);
        let text = Rect { width: TEXT.min(line.width.saturating_sub(1)), ..right_of(line, 1) };
        canvas.put(text, &clean(&choice.text, 255), if here { Role::Selection } else { Role::Body });
        canvas.put(right_of(line, TEXT + 2), &clean(&choice.note, 255), Role::Dim);
    }
}
