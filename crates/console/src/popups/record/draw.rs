//! An opened record on screen.

use crate::model::{Verdict, clean};
use crate::popups::record::state::{BYTES_A_LINE, Face, Opening};
use crate::ros::readable::{Readable, Table};
use crate::service::reply::{OpenedView, RecordView};
use crate::ui::words::{size, wrap};
use crate::ui::{
    Canvas, Piece, Rect, Role, below, columns, frame, framed, labelled, pad, plot, plot::draw_raster, put_lines, row,
    rows,
};

const WIDEST: u16 = 120;
const LABEL: u16 = 20;

pub fn draw(canvas: &mut Canvas, area: Rect, opening: &Opening) {
    let width = WIDEST.min(area.width.saturating_sub(6));
    let title = format!("Record {}", opening.lookup.id);
    if let Some(view) = opening.lookup.found() {
        let inner = framed(canvas, area, &title, WIDEST, u16::MAX - 2);
        return inside(canvas, inner, opening, view);
    }
    let lines = frame::answered(&opening.lookup, width, |_| Vec::new(), |line| vec![line]);
    let inner = framed(canvas, area, &title, WIDEST, rows(lines.len()));
    put_lines(canvas, inner, &lines, 0);
}

pub fn inside(canvas: &mut Canvas, inner: Rect, opening: &Opening, view: &OpenedView) {
    let head = if opening.alone && opening.is_drawn() { Vec::new() } else { head(view, inner.height) };
    put_lines(canvas, inner, &head, 0);
    let taken = rows(head.len());
    faces(canvas, row(inner, taken), opening, view);
    let content = below(inner, taken + 1);
    match opening.shown() {
        Face::Picture => {
            if let Some(picture) = view.readable.as_ref().and_then(|readable| readable.picture.as_ref()) {
                draw_raster(canvas, content, picture);
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

/// Shorter without room.
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
        Some(None) => drop(canvas.put(row(area, 0), "Reading the records up to here…", Role::Dim)),
        Some(Some(Err(failure))) => drop(canvas.put(row(area, 0), &clean(&failure.message, 300), Role::Bad)),
        Some(Some(Ok(path))) => path.plot.iter().for_each(|found| plot::draw(canvas, area, found)),
        None => own.iter().for_each(|own| plot::draw(canvas, area, own)),
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

/// Offset, sixteen bytes, ASCII.
fn bytes(view: &OpenedView) -> Vec<Vec<Piece>> {
    let line = |(at, chunk): (usize, &[u8])| {
        let hex: Vec<String> = chunk.iter().map(|byte| format!("{byte:02x}")).collect();
        let shown = |byte: &u8| if byte.is_ascii_graphic() || *byte == b' ' { char::from(*byte) } else { '.' };
        vec![
            (format!("{:08x}  ", at * BYTES_A_LINE), Role::Dim),
            // 74 columns in all: a window of 80 fits them.
            (format!("{:47} ", hex.join(" ")), Role::Body),
            (chunk.iter().map(shown).collect(), Role::Accent),
        ]
    };
    view.beginning.chunks(BYTES_A_LINE).enumerate().map(line).collect()
}

pub fn record_lines(record: &RecordView) -> Vec<Vec<Piece>> {
    let mut type_name = labelled("type", record.type_name.clone(), Role::Body);
    if record.simulated {
        type_name.extend([("  ".to_owned(), Role::Body), ("SIMULATED".to_owned(), Role::Badge)]);
    }
    let facts = format!("seq {}, epoch {}, {}", record.seq, record.epoch, size(record.bytes));
    let (topic, captured) = (record.topic.clone(), record.captured_at.to_string());
    let mut lines = vec![labelled("topic", topic, Role::Accent), type_name];
    lines.extend([labelled("record", facts, Role::Body), labelled("captured", captured, Role::Body)]);
    lines.extend(record.owner.map(|owner| labelled("owner", owner.to_string(), Role::Body)));
    lines.push(labelled("digest", record.digest.to_hex(), Role::Dim));
    lines.extend(record.erased.as_ref().map(|erased| labelled("erased", clean(erased, 600), Role::Warning)));
    lines
}

fn verdict_line(verdict: Verdict) -> Vec<Piece> {
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
