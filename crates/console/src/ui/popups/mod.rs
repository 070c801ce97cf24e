//! Popups over a screen: a frame in its middle, one file per popup.

mod browse;
mod chord;
mod columns;
mod contacts;
mod form;
mod gateway;
mod help;
mod incidents;
mod lookup;
mod palette;
mod record;
mod situation;
mod themes;

use ratatui::layout::Rect;

use super::canvas::{Canvas, columns, row};
use super::theme::Role;
use super::words::wrap;
use crate::app::leaving::Leaving;
use crate::app::popup::{Confirm, Popup};
use crate::app::{State, granting};
use crate::model::clean;

pub(in crate::ui) use lookup::{Piece, provenance_lines, record_lines as record_facts};
pub(in crate::ui) use record::{inside, put_lines};
pub(in crate::ui) use situation::coverage_lines;

/// Draws a popup into the middle of `area`.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, popup: &Popup) {
    match popup {
        Popup::Palette(palette) => palette::draw(canvas, area, state, palette),
        Popup::Help(help) => help::draw(canvas, area, state, help),
        Popup::Confirm(confirm) => draw_confirm(canvas, area, state, confirm),
        Popup::Form(_, form) => form::draw(canvas, area, form),
        Popup::Provenance(lookup) => lookup::draw_provenance(canvas, area, lookup),
        Popup::Record(opening) => record::draw(canvas, area, opening),
        Popup::Chord(pressed) => chord::draw(canvas, area, state, pressed),
        Popup::Themes(choice) => themes::draw(canvas, area, state, choice),
        Popup::Columns(choice) => columns::draw(canvas, area, state, choice),
        Popup::Robot(lookup) => gateway::draw_robot(canvas, area, state, lookup),
        Popup::Publishers(lookup) => situation::draw_publishers(canvas, area, state, lookup),
        Popup::Readers(topics) => situation::draw_readers(canvas, area, state, topics),
        Popup::Line(line) => situation::draw_line(canvas, area, line),
        Popup::Unlocked => {
            let lines = ["The keyring is already unlocked: no passphrase is needed.".to_owned()];
            draw_text(canvas, area, "Keyring", &lines, &[("enter", Role::Key), (" close", Role::Body)]);
        }
        Popup::Tasks => situation::draw_tasks(canvas, area, state),
        Popup::Browse(browse) => browse::draw(canvas, area, state, browse),
        Popup::Contacts(book) => contacts::draw(canvas, area, state, book),
        Popup::Incidents(list) => incidents::draw(canvas, area, state, list),
        Popup::Quit(leaving) => draw_quit(canvas, area, state, *leaving),
    }
}

/// A framed area of at most that size in the middle of `area`; returns the space inside.
fn framed(canvas: &mut Canvas, area: Rect, title: &str, width: u16, height: u16) -> Rect {
    let width = (width + 4).min(area.width.saturating_sub(2));
    let height = (height + 2).min(area.height);
    let x = area.x + (area.width - width) / 2;
    let y = area.y + (area.height - height) / 2;
    canvas.frame(Rect { x, y, width, height }, title)
}

/// A framed text with wrapped lines; the last line is the answer's.
fn draw_text(canvas: &mut Canvas, area: Rect, title: &str, lines: &[String], answer: &[(&str, Role)]) -> Rect {
    let widest = lines.iter().map(|line| columns(line)).max().unwrap_or(0);
    let width = widest.max(40).min(area.width.saturating_sub(6));
    let lines: Vec<String> = lines.iter().flat_map(|line| wrap(&clean(line, 2_000), width)).collect();
    let height = u16::try_from(lines.len()).unwrap_or(u16::MAX).saturating_add(2);
    let inner = framed(canvas, area, title, width, height);
    let last = inner.height.saturating_sub(1);
    for (place, line) in (0..last.saturating_sub(1)).zip(&lines) {
        canvas.put(row(inner, place), line, Role::Body);
    }
    canvas.puts(row(inner, last), answer);
    inner
}

fn draw_confirm(canvas: &mut Canvas, area: Rect, state: &State, confirm: &Confirm) {
    let caution = granting::caution(state, &confirm.errand.command).unwrap_or_default();
    if let Some(typed) = &confirm.typed {
        let wanted = clean(&typed.wanted, 255);
        let mut lines = confirm.lines.clone();
        lines.push(format!("Type {wanted} and press enter to {}; esc cancels.", confirm.yes));
        let shown = typed.field.shown();
        draw_text(canvas, area, &confirm.title, &lines, &[("› ", Role::Key), (&shown, Role::Warning)]);
        return;
    }
    // What deserves a second look is above the terms.
    let room = caution_lines(&caution);
    let lines: Vec<String> = room.iter().map(|_| String::new()).chain(confirm.lines.iter().cloned()).collect();
    let answer =
        [("y", Role::Key), (" ", Role::Body), (confirm.yes, Role::Warning), ("    any other key cancels", Role::Dim)];
    let inner = draw_text(canvas, area, &confirm.title, &lines, &answer);
    for (place, line) in (0u16..).zip(&room) {
        canvas.put(row(inner, place), line, Role::Warning);
    }
}

/// The caution, marked so that it is visible without colour too, in lines of a popup.
fn caution_lines(caution: &str) -> Vec<String> {
    if caution.is_empty() { Vec::new() } else { wrap(&format!("◐ {}", clean(caution, 500)), 60) }
}

fn draw_quit(canvas: &mut Canvas, area: Rect, state: &State, leaving: Leaving) {
    let hints = leaving.hints(state);
    // Four of them fit 80 columns only so.
    let gap = if hints.len() > 3 { "  " } else { "    " };
    let answer: Vec<(&str, Role)> = hints
        .iter()
        .flat_map(|(key, word)| [(*key, Role::Key), (" ", Role::Body), (*word, Role::Body), (gap, Role::Body)])
        .collect();
    draw_text(canvas, area, "Quit?", &leaving.lines(state), &answer);
}
