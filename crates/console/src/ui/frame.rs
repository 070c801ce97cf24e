//! Windows: their frame, lists and lines in them.

use ratatui::layout::Rect;

use crate::app::Lookup;
use crate::model::{clean, counted};
use crate::ui::canvas::{Canvas, columns, right_of, row, rows};
use crate::ui::{theme::Role, words::wrap};

pub const MOST_LINES: usize = 3;

/// Never covered by bar and message.
pub fn above(screen: Rect) -> Rect {
    let taken = u16::try_from(MOST_LINES + 1).unwrap_or(u16::MAX);
    Rect { height: screen.height.saturating_sub(taken), ..screen }
}

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

/// The last line is the answer's.
pub fn draw_text(canvas: &mut Canvas, area: Rect, title: &str, lines: &[String], answer: &[(&str, Role)]) -> Rect {
    let widest = lines.iter().map(|line| columns(line)).max().unwrap_or(0);
    let width = widest.max(40).min(area.width.saturating_sub(6));
    let lines: Vec<String> = lines.iter().flat_map(|line| wrap(&clean(line, 2_000), width)).collect();
    let inner = framed(canvas, area, title, width, rows(lines.len()).saturating_add(2));
    let last = inner.height.saturating_sub(1);
    for (place, line) in (0..last.saturating_sub(1)).zip(&lines) {
        canvas.put(row(inner, place), line, Role::Body);
    }
    canvas.puts(row(inner, last), answer);
    inner
}

pub const LOOKUP_WIDEST: u16 = 110;

pub type Piece = (String, Role);

/// Lines of an answer, or of its absence and the reason.
pub fn answered<T, L>(lookup: &Lookup<T>, width: u16, lines: impl FnOnce(&T) -> Vec<L>, one: fn(Piece) -> L) -> Vec<L> {
    match &lookup.answer {
        None => vec![one(("Asking…".to_owned(), Role::Dim))],
        Some(Err(failure)) => {
            wrap(&clean(&failure.message, 500), width).into_iter().map(|line| one((line, Role::Bad))).collect()
        }
        Some(Ok(view)) => lines(view),
    }
}

pub fn put_lines(canvas: &mut Canvas, area: Rect, lines: &[Vec<Piece>], scroll: usize) {
    put_lines_above(canvas, area, lines, scroll, row(area, area.height.saturating_sub(1)));
}

/// `edge` says how much more there is.
pub fn put_lines_above(canvas: &mut Canvas, area: Rect, lines: &[Vec<Piece>], scroll: usize, edge: Rect) {
    let height = usize::from(area.height);
    let first = scroll.min(lines.len().saturating_sub(height));
    for (place, line) in (0..area.height).zip(lines.iter().skip(first)) {
        let pieces: Vec<(&str, Role)> = line.iter().map(|(text, role)| (text.as_str(), *role)).collect();
        canvas.puts(row(area, place), &pieces);
    }
    if lines.len() > first + height && height > 0 {
        canvas.put_right(
            edge,
            &format!(" {} below ", counted((lines.len() - first - height) as u64, "more line")),
            Role::Dim,
        );
    }
}

pub fn draw_lines(canvas: &mut Canvas, area: Rect, title: &str, lines: &[Piece], scroll: usize) {
    let width = area.width.saturating_sub(6).min(100);
    let wrapped: Vec<Piece> = lines
        .iter()
        .flat_map(|(text, role)| wrap(&clean(text, 1_000), width).into_iter().map(|line| (line, *role)))
        .collect();
    let widest = wrapped.iter().map(|(line, _)| columns(line)).max().unwrap_or(0);
    let inner = framed(canvas, area, title, widest.max(40), rows(wrapped.len()));
    let first = scroll.min(wrapped.len().saturating_sub(usize::from(inner.height)));
    for (place, (line, role)) in (0..inner.height).zip(wrapped.iter().skip(first)) {
        canvas.put(row(inner, place), line, *role);
    }
}

/// Says how many lines are above and below.
pub fn draw_told(canvas: &mut Canvas, area: Rect, told: &[Piece], scroll: usize) {
    let height = usize::from(area.height);
    let first = scroll.min(told.len().saturating_sub(height));
    for (place, (line, role)) in (0..area.height).zip(told.iter().skip(first)) {
        canvas.put(row(area, place), line, *role);
    }
    let left = told.len().saturating_sub(first + height);
    if first > 0 || left > 0 {
        let edge = Rect { y: area.bottom(), height: 1, ..area };
        canvas.put_right(edge, &format!(" {first} above, {left} below "), Role::Dim);
    }
}

pub fn labelled(label: &str, value: String, role: Role) -> Vec<Piece> {
    vec![(pad(label, 10), Role::Dim), (value, role)]
}

pub fn pad(text: &str, width: u16) -> String {
    let missing = usize::from(width.saturating_sub(columns(text)));
    format!("{text}{}", " ".repeat(missing))
}
