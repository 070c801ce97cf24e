//! A question on screen.

use ratatui::layout::Rect;

use crate::app::{Confirm, State};
use crate::model::clean;
use crate::popups::form::grant;
use crate::ui::{Canvas, Role, draw_text, row, words::wrap};

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, confirm: &Confirm) {
    let caution = grant::caution(state, &confirm.errand.command).unwrap_or_default();
    if let Some(typed) = &confirm.typed {
        let wanted = clean(&typed.wanted, 255);
        let mut lines = confirm.lines.clone();
        lines.push(format!("Type {wanted} and press enter to {}; esc cancels.", confirm.yes));
        let shown = typed.field.shown();
        draw_text(canvas, area, &confirm.title, &lines, &[("› ", Role::Key), (&shown, Role::Warning)]);
        return;
    }
    // Above the terms, and marked so that it is visible without colour.
    let caution = if caution.is_empty() { Vec::new() } else { wrap(&format!("◐ {}", clean(&caution, 500)), 60) };
    let lines: Vec<String> = caution.iter().map(|_| String::new()).chain(confirm.lines.iter().cloned()).collect();
    let answer =
        [("y", Role::Key), (" ", Role::Body), (confirm.yes, Role::Warning), ("    any other key cancels", Role::Dim)];
    let inner = draw_text(canvas, area, &confirm.title, &lines, &answer);
    for (place, line) in (0u16..).zip(&caution) {
        canvas.put(row(inner, place), line, Role::Warning);
    }
}
