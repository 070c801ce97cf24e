//! Every step from message to verified.

use crate::app::{Key, Lookup, Popup, State, Verb};
use crate::model::clean;
use crate::popups::{record, record::draw::record_lines};
use crate::service::{Failure, reply::Provenance, reply::ShownState};
use crate::ui::{
    Canvas, Piece, Rect, Role, columns, frame, frame::LOOKUP_WIDEST, frame::put_lines_above, framed, marks::state_role,
    pad, rows, words::wrap,
};

const STEP: u16 = 14;

pub fn key(state: &mut State, mut lookup: Lookup<Provenance>, key: Key) -> Option<Verb> {
    match key {
        Key::Char('n') => return record::keys::neighbour(state, Popup::Provenance(lookup), 1),
        Key::Char('p') => return record::keys::neighbour(state, Popup::Provenance(lookup), -1),
        _ => {}
    }
    if lookup.scrolls(key, state.page_rows(), |found| found.steps.len() * 3 + 8) {
        state.popups.push(Popup::Provenance(lookup));
    }
    None
}

pub fn answered(state: &mut State, id: &str, answer: Result<Provenance, Failure>) {
    state.tell(id, answer, |popup| if let Popup::Provenance(lookup) = popup { Some(lookup) } else { None });
}

pub fn draw(canvas: &mut Canvas, area: Rect, lookup: &Lookup<Provenance>) {
    let width = LOOKUP_WIDEST.min(area.width.saturating_sub(6));
    let lines = frame::answered(lookup, width, |view| provenance_lines(view, width), |line| vec![line]);
    let inner = framed(canvas, area, &format!("Provenance of record {}", lookup.id), width, rows(lines.len()));
    let edge = Rect { y: inner.bottom().min(area.bottom().saturating_sub(1)), height: 1, ..inner };
    put_lines_above(canvas, inner, &lines, lookup.scroll, edge);
}

pub fn provenance_lines(view: &Provenance, width: u16) -> Vec<Vec<Piece>> {
    // Steps repeat the other facts; everything should fit on one screen.
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

/// Shortens hashes to their ends if the evidence does not fit; `authros records show` has them in full.
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

fn step_role(word: &str) -> Role {
    match ShownState::from_word(word) {
        Some(state) => state_role(state),
        None if word == "missing" => Role::Bad,
        None => Role::Accent,
    }
}
