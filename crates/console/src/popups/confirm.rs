//! A question before an act: yes, no, its command line.

use crate::app::{Confirm, Key, Popup, Purpose, State, identity_path};
use crate::model::clean;
use crate::popups::form::grant;
use crate::ui::{Canvas, Rect, Role, draw_text, row, words::wrap};

pub fn key(state: &mut State, mut confirm: Confirm, key: Key) {
    // Where a word is typed, letters belong to it.
    let copies = if confirm.typed.is_some() { Key::Control('y') } else { Key::Char('Y') };
    if key == copies {
        state.twin(&confirm.errand).into_iter().for_each(|line| state.copy(line));
        return state.popups.push(Popup::Confirm(confirm));
    }
    let said = match &mut confirm.typed {
        Some(_) if key == Key::Escape => return unasked(state),
        Some(typed) if key == Key::Enter => typed.is_done(),
        Some(typed) => {
            typed.field.key(key);
            false
        }
        None if key != Key::Char('y') => return unasked(state),
        None => true,
    };
    if !said {
        return state.popups.push(Popup::Confirm(confirm));
    }
    // The form that led here is done.
    let led_here = |purpose: &Purpose| {
        use Purpose::{Administer, ExportEvidence, Extend, Grant, LoadKey, SetPolicy};
        matches!(purpose, Grant | Extend | LoadKey | Administer(_) | SetPolicy | ExportEvidence)
    };
    let form = state.popups.iter().position(|popup| matches!(popup, Popup::Form(purpose, _) if led_here(purpose)));
    if let Some(Popup::Form(purpose, form)) = form.map(|place| state.popups.remove(place)) {
        state.filled = Some((confirm.errand.tag.clone(), purpose, form));
    }
    match confirm.errand.tag.needs_and_touches().0 {
        Some(need) => identity_path::run(state, need, vec![confirm.errand]),
        None => state.send(confirm.errand),
    }
}

/// Neither the act nor what was to follow it happens.
fn unasked(state: &mut State) {
    state.follow_up = None;
}

pub fn hints(state: &State, confirm: &Confirm) -> Vec<(&'static str, &'static str)> {
    let [yes, copy, no, cancel] = match &confirm.typed {
        Some(_) => ["enter", "ctrl-y", "esc", "cancel"],
        None => ["y", "Y", "any other key", "cancels"],
    };
    let twin = state.twin(&confirm.errand).map(|_| (copy, "copy as command"));
    [(yes, confirm.yes)].into_iter().chain(twin).chain([(no, cancel)]).collect()
}

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
