//! A form on screen.

use ratatui::layout::Position;

use crate::app::{Form, Input, Line, State, when};
use crate::model::{clean, counted};
use crate::ui::{Canvas, Rect, Role, columns, framed, right_of, row, rows, words::wrap};

const LABEL: u16 = 13;

/// Characters of what Tab found.
const MOST_TOLD: usize = 20_000;

/// Rows of notes, fields and frame.
const ROWS: u16 = 12;

const FORM_WIDTH: u16 = 68;

/// What the time under the cursor means stands below it.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, form: &Form) {
    let width = FORM_WIDTH.min(area.width.saturating_sub(6));
    let meaning = when::meaning(form, &state.times());
    let meaning: Vec<String> = meaning.iter().flat_map(|text| wrap(text, width.saturating_sub(LABEL))).collect();
    let notes: Vec<String> = form.notes.iter().flat_map(|note| wrap(&clean(note, 500), width)).collect();
    let error: Vec<String> = form.error.iter().flat_map(|error| wrap(&clean(error, 500), width)).collect();
    let told: Vec<String> = form.told.iter().flat_map(|line| wrap(&clean(line, MOST_TOLD), width)).collect();
    let told = shortened(told, area.height.saturating_sub(ROWS));
    let needed = notes.len() + form.lines.len() + meaning.len() + 2 + error.len() + told.len();
    let inner = framed(canvas, area, &form.title, FORM_WIDTH, rows(needed));
    for (place, note) in (0..).zip(&notes) {
        canvas.put(row(inner, place), note, Role::Dim);
    }
    let mut place = rows(notes.len()) + 1;
    for (index, line) in form.lines.iter().enumerate() {
        draw_line(canvas, row(inner, place), line, index == form.focus);
        place += 1;
        for text in meaning.iter().filter(|_| index == form.focus) {
            canvas.put(right_of(row(inner, place), LABEL), text, Role::Accent);
            place += 1;
        }
    }
    let answers = error.iter().map(|line| (line, Role::Bad)).chain(told.iter().map(|line| (line, Role::Dim)));
    for (place, (line, role)) in (place + 1..).zip(answers) {
        canvas.put(row(inner, place), line, role);
    }
}

/// The last line says how many are missing.
fn shortened(mut lines: Vec<String>, room: u16) -> Vec<String> {
    let room = usize::from(room).max(2);
    let left = lines.len().saturating_sub(room - 1);
    if left > 1 {
        lines.truncate(room - 1);
        lines.push(format!("… {}", counted(left as u64, "more line")));
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
            // Scrolls a long text so that the cursor is visible.
            let hidden = usize::from(columns(&before).saturating_sub(place.width.saturating_sub(1)));
            let shown: String = field.shown().chars().skip(hidden).collect();
            let empty = shown.is_empty();
            canvas.put(place, if empty { line.hint } else { &shown }, if empty { Role::Dim } else { Role::Body });
            if focused && place.width > 0 {
                let offset = columns(&before).min(place.width - 1);
                canvas.cursor = Some(Position { x: place.x + offset, y: place.y });
            }
        }
        Input::Choice { options, chosen } => {
            let word = options.get(*chosen).map(String::as_str).unwrap_or_default();
            let hint = if focused { "  space: change" } else { "" };
            canvas.puts(place, &[(word, Role::Body), (hint, Role::Dim)]);
        }
    }
}
