//! What popups share: their frame, and a list with a cursor.

use ratatui::layout::Rect;

use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::theme::Role;

/// At most that size, centred; returns the space inside.
pub fn framed(canvas: &mut Canvas, area: Rect, title: &str, width: u16, height: u16) -> Rect {
    let width = (width + 4).min(area.width.saturating_sub(2));
    let height = (height + 2).min(area.height);
    let x = area.x + (area.width - width) / 2;
    let y = area.y + (area.height - height) / 2;
    canvas.frame(Rect { x, y, width, height }, title)
}

/// Draws the cursor's page; `line` draws a row beside the mark.
pub fn draw_list<T>(
    canvas: &mut Canvas,
    area: Rect,
    all: &[T],
    selected: usize,
    line: impl Fn(&mut Canvas, Rect, &T, bool),
) {
    let selected = selected.min(all.len().saturating_sub(1));
    let height = usize::from(area.height.max(1));
    let first = selected - selected % height;
    for (place, (index, one)) in (0u16..).zip(all.iter().enumerate().skip(first).take(height)) {
        let (area, here) = (row(area, place), index == selected);
        canvas.put(area, if here { "▌" } else { " " }, Role::Accent);
        line(canvas, right_of(area, 1), one, here);
    }
}

pub fn name_role(here: bool) -> Role {
    if here { Role::Selection } else { Role::Body }
}
