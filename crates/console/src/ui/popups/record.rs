//! An opened record: its description, and below it one of its faces (values, plot, picture, fields, bytes).

use ratatui::layout::Rect;

use super::framed;
use super::lookup::{Piece, labelled, pad, record_lines, verdict_line};
use crate::app::opening::{BYTES_A_LINE, Face, Opening};
use crate::model::clean;
use crate::ros::readable::{Readable, Table};
use crate::service::reply::OpenedView;
use crate::ui::canvas::{Canvas, below, columns, right_of, row};
use crate::ui::theme::Role;
use crate::ui::words::{size, wrap};
use crate::ui::{plot, raster};

/// Its greatest width.
const WIDEST: u16 = 120;

/// Columns of the labels of values.
const LABEL: u16 = 20;

/// Draws the record in view.
pub fn draw(canvas: &mut Canvas, area: Rect, opening: &Opening) {
    let width = WIDEST.min(area.width.saturating_sub(6));
    let title = format!("Record {}", opening.lookup.id);
    match &opening.lookup.answer {
        None => text(canvas, area, &title, vec![vec![("Asking…".to_owned(), Role::Dim)]]),
        Some(Err(failure)) => {
            let lines = wrap(&clean(&failure.message, 500), width).into_iter().map(|line| vec![(line, Role::Bad)]);
            text(canvas, area, &title, lines.collect());
        }
        Some(Ok(view)) => whole(canvas, area, &title, opening, view),
    }
}

fn text(canvas: &mut Canvas, area: Rect, title: &str, lines: Vec<Vec<Piece>>) {
    let height = u16::try_from(lines.len()).unwrap_or(u16::MAX);
    let inner = framed(canvas, area, title, WIDEST, height);
    put_lines(canvas, inner, &lines, 0);
}

fn whole(canvas: &mut Canvas, area: Rect, title: &str, opening: &Opening, view: &OpenedView) {
    let inner = framed(canvas, area, title, WIDEST, u16::MAX - 2);
    inside(canvas, inner, opening, view);
}

/// An opened record: its description, and below it the face in view.
pub(in crate::ui) fn inside(canvas: &mut Canvas, inner: Rect, opening: &Opening, view: &OpenedView) {
    let head = if opening.alone && opening.is_drawn() { Vec::new() } else { head(view, inner.height) };
    put_lines(canvas, inner, &head, 0);
    let taken = u16::try_from(head.len()).unwrap_or(u16::MAX);
    faces(canvas, row(inner, taken), opening, view);
    let content = below(inner, taken + 1);
    match opening.shown() {
        Face::Picture => {
            if let Some(picture) = view.readable.as_ref().and_then(|readable| readable.picture.as_ref()) {
                raster::draw(canvas, content, picture);
            }
        }
        Face::Plot => draw_plot(canvas, content, opening, view),
        Face::Readable => {
            let lines = view.readable.as_ref().map(readable).unwrap_or_default();
            put_lines(canvas, content, &lines, opening.lookup.scroll);
        }
        Face::Fields => put_lines(canvas, content, &fields(view, content.width), opening.lookup.scroll),
        Face::Bytes => put_lines(canvas, content, &bytes(view), opening.lookup.scroll),
    }
}

/// The record's description; shorter if there is little room.
fn head(view: &OpenedView, room: u16) -> Vec<Vec<Piece>> {
    let mut lines = vec![verdict_line(view.verdict)];
    let mut facts = record_lines(&view.record);
    if room < 24 {
        facts.truncate(3);
        lines.extend(facts);
        return lines;
    }
    lines.append(&mut facts);
    if !view.caller_id.is_empty() {
        lines.push(labelled("sent by", view.caller_id.clone(), Role::Body));
    }
    let shown = view.tags.iter().filter(|(name, _)| !name.starts_with("mcap."));
    let tags: Vec<String> = shown.map(|(name, value)| format!("{name}={value}")).collect();
    if !tags.is_empty() {
        lines.push(labelled("tags", tags.join("  "), Role::Dim));
    }
    if view.compression != "none" && !view.compression.is_empty() {
        let text = format!("{} sealed, compressed ({})", size(view.stored), view.compression);
        lines.push(labelled("stored", text, Role::Dim));
    }
    lines
}

/// The names of all faces; the one in view is highlighted.
fn faces(canvas: &mut Canvas, area: Rect, opening: &Opening, view: &OpenedView) {
    let shown = opening.shown();
    let mut rest = area;
    for face in Face::of(view) {
        let role = if face == shown { Role::Badge } else { Role::Dim };
        rest = canvas.puts(rest, &[(&format!(" {} ", face.title()), role), (" ", Role::Body)]);
    }
}

fn draw_plot(canvas: &mut Canvas, area: Rect, opening: &Opening, view: &OpenedView) {
    let own = view.readable.as_ref().and_then(|readable| readable.plot.as_ref());
    match opening.path.as_ref().map(|path| &path.answer) {
        Some(None) => {
            canvas.put(row(area, 0), "Reading the records up to here…", Role::Dim);
        }
        Some(Some(Err(failure))) => {
            canvas.put(row(area, 0), &clean(&failure.message, 300), Role::Bad);
        }
        Some(Some(Ok(path))) => {
            if let Some(found) = &path.plot {
                plot::draw(canvas, area, found);
            }
        }
        None => {
            if let Some(own) = own {
                plot::draw(canvas, area, own);
            }
        }
    }
}

fn readable(view: &Readable) -> Vec<Vec<Piece>> {
    let widest = view.lines.iter().map(|(label, _)| columns(label) + 2).max().unwrap_or(0).max(LABEL);
    let line = |(label, value): &(String, String)| vec![(pad(label, widest), Role::Dim), (value.clone(), Role::Body)];
    let mut lines: Vec<Vec<Piece>> = view.lines.iter().map(line).collect();
    for table in &view.tables {
        lines.push(Vec::new());
        lines.push(vec![(table.title.clone(), Role::Title)]);
        lines.extend(tabled(table));
    }
    lines
}

fn tabled(table: &Table) -> Vec<Vec<Piece>> {
    let rows = || table.rows.iter().chain((!table.head.is_empty()).then_some(&table.head));
    let count = rows().map(Vec::len).max().unwrap_or(0);
    let width = |at: usize| rows().filter_map(|row| row.get(at)).map(|cell| columns(cell)).max().unwrap_or(0);
    let widths: Vec<u16> = (0..count).map(width).collect();
    let line = |cells: &Vec<String>, role: Role| -> Vec<Piece> {
        cells.iter().zip(&widths).map(|(cell, width)| (pad(cell, width + 2), role)).collect()
    };
    let head = (!table.head.is_empty()).then(|| line(&table.head, Role::Dim));
    head.into_iter().chain(table.rows.iter().map(|row| line(row, Role::Body))).collect()
}

fn fields(view: &OpenedView, width: u16) -> Vec<Vec<Piece>> {
    let widest = view.fields.iter().map(|(path, _)| columns(path)).max().unwrap_or(0);
    let label = (widest + 2).min(width / 2);
    let line = |(path, value): &(String, String)| vec![(pad(path, label), Role::Dim), (value.clone(), Role::Body)];
    let notes = view.note.iter().flat_map(|note| wrap(note, width)).map(|line| vec![(line, Role::Warning)]);
    notes.chain(view.fields.iter().map(line)).collect()
}

/// In the form of a hex dump: offset, sixteen bytes, their ASCII characters.
fn bytes(view: &OpenedView) -> Vec<Vec<Piece>> {
    let line = |(at, chunk): (usize, &[u8])| {
        let hex: Vec<String> = chunk.iter().map(|byte| format!("{byte:02x}")).collect();
        let shown = |byte: &u8| if byte.is_ascii_graphic() || *byte == b' ' { char::from(*byte) } else { '.' };
        vec![
            (format!("{:08x}  ", at * BYTES_A_LINE), Role::Dim),
            // 74 columns in all: what a window of 80 has.
            (format!("{:47} ", hex.join(" ")), Role::Body),
            (chunk.iter().map(shown).collect(), Role::Accent),
        ]
    };
    view.beginning.chunks(BYTES_A_LINE).enumerate().map(line).collect()
}

pub(in crate::ui) fn put_lines(canvas: &mut Canvas, area: Rect, lines: &[Vec<Piece>], scroll: usize) {
    let rows = usize::from(area.height);
    let first = scroll.min(lines.len().saturating_sub(rows));
    for (place, line) in (0..area.height).zip(lines.iter().skip(first)) {
        let pieces: Vec<(&str, Role)> = line.iter().map(|(text, role)| (text.as_str(), *role)).collect();
        canvas.puts(row(area, place), &pieces);
    }
    if lines.len() > first + rows && rows > 0 {
        let more = format!(" {} more lines below ", lines.len() - first - rows);
        let edge = row(area, area.height.saturating_sub(1));
        let width = columns(&more).min(edge.width);
        canvas.put(right_of(edge, edge.width - width), &more, Role::Dim);
    }
}
