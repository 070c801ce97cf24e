//! A form: notes, fields, the error of the last attempt.

use ratatui::layout::Rect;

use super::framed;
use crate::app::form::{Form, Input, Line};
use crate::model::clean;
use crate::ui::canvas::{Canvas, columns, right_of, row};
use crate::ui::theme::Role;
use crate::ui::words::wrap;

/// Columns of the labels.
const LABEL: u16 = 13;
/// The most characters of what tab found.
const MOST_TOLD: usize = 20_000;
/// Rows that notes, fields and frame take at most.
const ROWS: u16 = 12;
/// Columns of a form.
const WIDTH: u16 = 68;

/// Draws a form.
pub fn draw(canvas: &mut Canvas, area: Rect, form: &Form) {
    let width = WIDTH.min(area.width.saturating_sub(6));
    let notes: Vec<String> = form.notes.iter().flat_map(|note| wrap(&clean(note, 500), width)).collect();
    let error: Vec<String> = form.error.iter().flat_map(|error| wrap(&clean(error, 500), width)).collect();
    let told: Vec<String> = form.told.iter().flat_map(|line| wrap(&clean(line, MOST_TOLD), width)).collect();
    let told = shortened(told, area.height.saturating_sub(ROWS));
    let rows = notes.len() + form.lines.len() + 2 + error.len() + told.len();
    let inner = framed(canvas, area, &form.title, WIDTH, u16::try_from(rows).unwrap_or(u16::MAX));
    let mut place = 0;
    for note in &notes {
        canvas.put(row(inner, place), note, Role::Dim);
        place += 1;
    }
    place += 1;
    for (index, line) in form.lines.iter().enumerate() {
        draw_line(canvas, row(inner, place), line, index == form.focus);
        place += 1;
    }
    place += 1;
    for (line, role) in error.iter().map(|line| (line, Role::Bad)).chain(told.iter().map(|line| (line, Role::Dim))) {
        canvas.put(row(inner, place), line, role);
        place += 1;
    }
}

/// As many lines as there is room for; the last says how many are missing.
fn shortened(mut lines: Vec<String>, room: u16) -> Vec<String> {
    let room = usize::from(room).max(2);
    let left = lines.len().saturating_sub(room - 1);
    if left > 1 {
        lines.truncate(room - 1);
        lines.push(format!("… {left} more lines"));
    }
    lines
}

fn draw_line(canvas: &mut Canvas, area: Rect, line: &Line, focused: bool) {
    canvas.put(area, if focused { "▌" } else { " " }, Role::Accent);
    canvas.put(right_of(area, 1), line.label, if focused { Role::Title } else { Role::Dim });
    let place = right_of(area, LABEL);
    match &line.input {
        Input::Text(field) => {
            let before: String = field.shown().chars().take(field.cursor()).collect();
            // A long text is scrolled so that the cursor is visible.
            let hidden = usize::from(columns(&before).saturating_sub(place.width.saturating_sub(1)));
            let shown: String = field.shown().chars().skip(hidden).collect();
            let empty = shown.is_empty();
            canvas.put(place, if empty { line.hint } else { &shown }, if empty { Role::Dim } else { Role::Body });
            if focused && place.width > 0 {
                let offset = columns(&before).min(place.width - 1);
                canvas.set_cursor(place.x + offset, place.y);
            }
        }
        Input::Choice { options, chosen } => {
            let word = options.get(*chosen).map(String::as_str).unwrap_or_default();
            let hint = if focused { "  space: change" } else { "" };
            canvas.puts(place, &[(word, Role::Body), (hint, Role::Dim)]);
        }
    }
}
