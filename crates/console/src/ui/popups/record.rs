//! A record: where it comes from, and opened, its description and below it one of its faces (values, plot, picture,
//! fields, bytes).

use ratatui::layout::Rect;

use super::framed;
use crate::app::opening::{BYTES_A_LINE, Face, Opening};
use crate::app::popup::Lookup;
use crate::model::{Verdict, clean};
use crate::ros::readable::{Readable, Table};
use crate::service::reply::{OpenedView, Provenance, RecordView, ShownState};
use crate::ui::canvas::{Canvas, below, columns, right_of, row};
use crate::ui::plot;
use crate::ui::records::state_role;
use crate::ui::theme::Role;
use crate::ui::words::{size, wrap};

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
                plot::draw_raster(canvas, content, picture);
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

/// Columns of the labels of provenance steps.
const STEP: u16 = 14;
/// The greatest width of a record's view.
const LOOKUP_WIDEST: u16 = 110;

pub(in crate::ui) type Piece = (String, Role);

/// Draws a record's provenance and state.
pub fn draw_provenance(canvas: &mut Canvas, area: Rect, lookup: &Lookup<Provenance>) {
    draw_lookup(canvas, area, lookup, "Provenance of record", provenance_lines);
}

/// The steps of a record, in lines of that width.
pub(in crate::ui) fn provenance_lines(view: &Provenance, width: u16) -> Vec<Vec<Piece>> {
    // What the steps say themselves is not repeated before them: all of it should fit on a screen.
    let mut lines: Vec<Vec<Piece>> = record_lines(&view.record).into_iter().take(2).collect();
    lines.push(Vec::new());
    let width = width.saturating_sub(STEP);
    for (word, evidence) in &view.steps {
        let role = step_role(word);
        let pieces = wrap(&fitted(&clean(evidence, 500), width), width);
        for (index, piece) in pieces.into_iter().enumerate() {
            let label = if index == 0 { clean(word, 13) } else { String::new() };
            lines.push(vec![(pad(&label, STEP), role), (piece, Role::Body)]);
        }
    }
    lines
}

/// Evidence in its width: if it does not fit, hashes are shortened to their ends (`authros uploads show` has them in
/// full).
fn fitted(evidence: &str, width: u16) -> String {
    const WHOLE: usize = 40;
    if columns(evidence) <= width {
        return evidence.to_owned();
    }
    let ends = |word: &str| match (word.get(..24), word.get(word.len().saturating_sub(8)..)) {
        (Some(head), Some(tail)) if word.len() > WHOLE && word.is_ascii() => format!("{head}…{tail}"),
        _ => word.to_owned(),
    };
    evidence.split(' ').map(ends).collect::<Vec<_>>().join(" ")
}

/// A step that is done, or the state that a record is in.
fn step_role(word: &str) -> Role {
    const DONE: [&str; 11] = [
        "message",
        "record",
        "digest",
        "signature",
        "store",
        "batch",
        "proof",
        "anchored by",
        "transaction",
        "block",
        "confirmations",
    ];
    if DONE.contains(&word) {
        return Role::Accent;
    }
    match ShownState::from_word(word) {
        Some(state) => state_role(state),
        None if word == "missing" => Role::Bad,
        None => Role::Accent,
    }
}

fn draw_lookup<T>(
    canvas: &mut Canvas,
    area: Rect,
    lookup: &Lookup<T>,
    title: &str,
    lines: impl Fn(&T, u16) -> Vec<Vec<Piece>>,
) {
    let width = LOOKUP_WIDEST.min(area.width.saturating_sub(6));
    let lines = match &lookup.answer {
        None => vec![vec![("Asking…".to_owned(), Role::Dim)]],
        Some(Err(failure)) => {
            wrap(&clean(&failure.message, 500), width).into_iter().map(|line| vec![(line, Role::Bad)]).collect()
        }
        Some(Ok(view)) => lines(view, width),
    };
    let height = u16::try_from(lines.len()).unwrap_or(u16::MAX);
    let inner = framed(canvas, area, &format!("{title} {}", lookup.id), width, height);
    let rows = usize::from(inner.height);
    let first = lookup.scroll.min(lines.len().saturating_sub(rows));
    for (place, line) in (0..inner.height).zip(lines.iter().skip(first)) {
        let pieces: Vec<(&str, Role)> = line.iter().map(|(text, role)| (text.as_str(), *role)).collect();
        canvas.puts(row(inner, place), &pieces);
    }
    if lines.len() > first + rows {
        let more = format!(" {} more lines below ", lines.len() - first - rows);
        let edge = Rect { y: inner.bottom().min(area.bottom().saturating_sub(1)), height: 1, ..inner };
        canvas.put_right(right_of(edge, 0), &more, Role::Dim);
    }
}

pub(in crate::ui) fn record_lines(record: &RecordView) -> Vec<Vec<Piece>> {
    let mut type_name = labelled("type", record.type_name.clone(), Role::Body);
    if record.simulated {
        type_name.extend([("  ".to_owned(), Role::Body), ("SIMULATED".to_owned(), Role::Badge)]);
    }
    let facts = format!("seq {}, epoch {}, {}", record.seq, record.epoch, size(record.bytes));
    let mut lines =
        vec![labelled("topic", record.topic.clone(), Role::Accent), type_name, labelled("record", facts, Role::Body)];
    lines.push(labelled("captured", record.captured_at.to_string(), Role::Body));
    lines.extend(record.owner.map(|owner| labelled("owner", owner.to_string(), Role::Body)));
    lines.push(labelled("digest", record.digest.to_hex(), Role::Dim));
    lines.extend(record.erased.as_ref().map(|erased| labelled("erased", clean(erased, 600), Role::Warning)));
    lines
}

pub(super) fn verdict_line(verdict: Verdict) -> Vec<Piece> {
    let (text, role) = match verdict {
        Verdict::Verified => ("verified: digest matches the chain, signature valid", Role::Good),
        Verdict::Unanchored => ("unanchored: signature valid, but the digest is not on the chain yet", Role::Warning),
        Verdict::NotChecked => ("not checked against the chain now; confirmed earlier, signature valid", Role::Warning),
        Verdict::Tampered => ("tampered: the stored bytes are not the ones anchored or signed", Role::Bad),
        Verdict::Deleted => ("deleted by retention: header, signature and proof stay", Role::Warning),
        Verdict::Missing => ("missing: the stored bytes are gone", Role::Bad),
        Verdict::NoKey => ("no key: cannot be opened with this profile's keys", Role::Warning),
    };
    vec![(text.to_owned(), role)]
}

pub(super) fn labelled(label: &str, value: String, role: Role) -> Vec<Piece> {
    vec![(pad(label, 10), Role::Dim), (value, role)]
}

pub(super) fn pad(text: &str, width: u16) -> String {
    let missing = usize::from(width.saturating_sub(columns(text)));
    format!("{text}{}", " ".repeat(missing))
}
