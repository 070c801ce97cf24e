//! The tour's strip at the bottom: what to do next, and why.

use ratatui::layout::Rect;

use super::canvas::{Canvas, row};
use super::theme::Role;
use crate::app::tour::Tour;

/// Draws it.
pub fn draw(canvas: &mut Canvas, area: Rect, tour: &Tour) {
    let Some([name, act, why]) = tour.lines() else { return };
    let (place, of) = tour.count();
    for line in 0..area.height {
        canvas.wipe(row(area, line));
    }
    canvas.put(row(area, 0), &"─".repeat(usize::from(area.width)), Role::Border);
    let head = format!("Tour {place} of {of}  ");
    canvas.puts(row(area, 1), &[(&head, Role::Title), (&name, Role::Accent)]);
    canvas.put_right(row(area, 1), "E ends the tour", Role::Dim);
    canvas.puts(row(area, 2), &[("do   ", Role::Key), (&act, Role::Body)]);
    canvas.puts(row(area, 3), &[("why  ", Role::Dim), (&why, Role::Dim)]);
}
