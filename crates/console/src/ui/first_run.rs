//! The card of the first steps, with the key for each.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below, row};
use super::theme::Role;
use crate::app::State;
use crate::app::first_run::{FirstStep, first_steps};

/// Draws the card, or its next step if there is little room; returns what is left of `area`.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, roomy: bool) -> Rect {
    let steps = first_steps(state);
    if steps.is_empty() || state.settings.read_only {
        return area;
    }
    let next = steps.iter().position(|step| !step.done);
    if !roomy {
        if let Some((place, step)) = steps.iter().enumerate().find(|(_, step)| !step.done) {
            draw_step(canvas, row(area, 0), step, place, true);
        }
        return below(area, 1);
    }
    let hint = if state.tour.is_some() {
        "  press the highlighted key"
    } else {
        "  press the highlighted key; five-minute tour: authros tour"
    };
    canvas.puts(row(area, 0), &[("First steps", Role::Title), (hint, Role::Dim)]);
    for (line, (place, step)) in (1u16..).zip(steps.iter().enumerate()) {
        draw_step(canvas, row(area, line), step, place, next == Some(place));
    }
    below(area, 6)
}

fn draw_step(canvas: &mut Canvas, area: Rect, step: &FirstStep, place: usize, next: bool) {
    let (mark, role) = match (step.done, next) {
        (true, _) => ("done ", Role::Good),
        (false, true) => ("next ", Role::Warning),
        (false, false) => ("     ", Role::Dim),
    };
    let name = format!("{} {:<9} ", place + 1, step.name);
    let text = if step.done { Role::Dim } else { Role::Body };
    canvas.puts(area, &[(mark, role), (&name, text), (step.key, Role::Key), ("  ", Role::Body), (step.text, text)]);
}
