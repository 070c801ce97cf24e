//! The answer to a request by id: provenance of a record.

use ratatui::layout::Rect;

use super::framed;
use crate::app::popup::Lookup;
use crate::model::{Verdict, clean};
use crate::service::reply::{Provenance, RecordView, ShownState};
use crate::ui::canvas::{Canvas, columns, right_of, row};
use crate::ui::records::state_role;
use crate::ui::theme::Role;
use crate::ui::words::{size, wrap};

/// Columns of the labels of provenance steps.
const STEP: u16 = 14;
/// The greatest width of a record's view.
const WIDEST: u16 = 110;

pub(in crate::ui) type Piece = (String, Role);

/// Draws a record's provenance and state.
pub fn draw_provenance(canvas: &mut Canvas, area: Rect, lookup: &Lookup<Provenance>) {
    draw(canvas, area, lookup, "Provenance of record", provenance_lines);
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
        "vault",
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

fn draw<T>(
    canvas: &mut Canvas,
    area: Rect,
    lookup: &Lookup<T>,
    title: &str,
    lines: impl Fn(&T, u16) -> Vec<Vec<Piece>>,
) {
    let width = WIDEST.min(area.width.saturating_sub(6));
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
