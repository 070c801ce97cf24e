//! The last two lines: the message, and the available actions.

use ratatui::layout::Rect;

use super::canvas::{Canvas, columns, row};
use super::theme::Role;
use super::words::wrap;
use crate::app::State;
use crate::app::available::available;
use crate::app::popup_keys::hints;
use crate::app::update::under_way;
use crate::app::verb::{Entry, VERBS, Verb};
use crate::service::NoticeLevel;

/// What keeps its place at the right of the bar.
const TAIL_NAMES: [&str; 3] = ["palette", "help", "quit"];
/// The most lines a message takes.
const MOST_LINES: usize = 3;

/// The part of a screen that bar and message never cover.
pub fn above(screen: Rect) -> Rect {
    let taken = u16::try_from(MOST_LINES + 1).unwrap_or(u16::MAX);
    Rect { height: screen.height.saturating_sub(taken), ..screen }
}

/// Draws message and bar at the bottom of `area`.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    draw_message(canvas, Rect { height: area.height - 1, ..area }, state);
    draw_bar(canvas, row(area, area.height - 1), state);
}

/// Mark and role of a level.
pub fn level(level: NoticeLevel) -> (&'static str, Role) {
    match level {
        NoticeLevel::Info => ("› ", Role::Accent),
        NoticeLevel::Warning => ("◐ ", Role::Warning),
        NoticeLevel::Error => ("✖ ", Role::Bad),
    }
}

/// Rows above its own that the message shown now takes.
pub fn covered(state: &State, width: u16) -> u16 {
    let lines = state.toasts.shown().map(|toast| wrap(&toast.text, width_beside(&hint(state), width)).len());
    u16::try_from(lines.unwrap_or_default().clamp(1, MOST_LINES) - 1).unwrap_or_default()
}

fn hint(state: &State) -> String {
    match state.toasts.unseen() {
        0 => String::new(),
        1 => " esc: hide".to_owned(),
        more => format!(" esc: hide, {} more", more - 1),
    }
}

fn width_beside(hint: &str, width: u16) -> u16 {
    width.saturating_sub(columns(hint) + 3)
}

fn draw_message(canvas: &mut Canvas, area: Rect, state: &State) {
    let last = row(area, area.height - 1);
    let Some(toast) = state.toasts.shown() else {
        if let Some(work) = under_way(state) {
            canvas.put(last, &format!("› {work}…"), Role::Dim);
        }
        return;
    };
    let (mark, role) = level(toast.level);
    let hint = hint(state);
    let lines = wrap(&toast.text, width_beside(&hint, area.width));
    let shown = lines.len().min(MOST_LINES);
    let top = area.height - u16::try_from(shown).unwrap_or(1);
    for (index, line) in (0u16..).zip(lines.iter().take(shown)) {
        let place = row(area, top + index);
        canvas.wipe(place);
        let cut = usize::from(index) + 1 == shown && lines.len() > shown;
        let line = if cut { format!("{line}… (9: log)") } else { line.clone() };
        canvas.puts(place, &[(if index == 0 { mark } else { "  " }, role), (&line, role)]);
    }
    canvas.put_right(row(area, top), &hint, Role::Dim);
}

fn draw_bar(canvas: &mut Canvas, area: Rect, state: &State) {
    canvas.wipe(area);
    if let Some(popup) = state.popups.last() {
        return draw_hints(canvas, area, &hints(state, popup));
    }
    if state.table().is_some_and(|table| table.filtering) {
        return draw_hints(canvas, area, &[("enter", "apply"), ("esc", "clear"), ("up down", "earlier filters, rows")]);
    }
    // Help and quit keep their place at the right, whatever is cut.
    let tail = Rect { x: area.x + area.width.saturating_sub(TAIL), width: TAIL.min(area.width), ..area };
    draw_tail(canvas, tail, state);
    let mut rest = Rect { width: area.width - tail.width, ..area };
    let mut shown: Vec<&Entry> = entries(state).collect();
    // The most used verbs keep their place when there is little room, and unavailable ones come last.
    shown.sort_by_key(|entry| (available(state, entry.verb).is_err(), use_of(entry.verb)));
    for entry in shown {
        rest = draw_entry(canvas, rest, state, entry);
    }
}

/// Columns of `: commands  ? help  q quit`.
const TAIL: u16 = 28;

fn draw_tail(canvas: &mut Canvas, area: Rect, state: &State) {
    let tail = TAIL_NAMES.iter().filter_map(|name| VERBS.iter().find(|entry| entry.name == *name));
    let hints = tail.map(|entry| (state.settings.keymap.label(entry, state.screen), entry.label));
    let hints: Vec<(String, &str)> = hints.filter(|(key, _)| !key.is_empty()).collect();
    let hints: Vec<(&str, &str)> = hints.iter().map(|(key, label)| (key.as_str(), *label)).collect();
    draw_hints(canvas, area, &hints);
}

fn draw_hints(canvas: &mut Canvas, area: Rect, hints: &[(&str, &str)]) {
    hints.iter().fold(area, |rest, (key, label)| {
        canvas.puts(rest, &[(key, Role::Key), (" ", Role::Body), (label, Role::Body), ("  ", Role::Body)])
    });
}

/// The verbs of the bar, most used first.
const BY_USE: [Verb; 16] = [
    Verb::Watch,
    Verb::Details,
    Verb::Inspect,
    Verb::SetPolicy,
    Verb::Open,
    Verb::Grant,
    Verb::Revoke,
    Verb::Filter,
    Verb::Browse,
    Verb::Readers,
    Verb::Extend,
    Verb::Export,
    Verb::Publishers,
    Verb::Check,
    Verb::Sort,
    Verb::Mark,
];

fn use_of(verb: Verb) -> usize {
    BY_USE.iter().position(|other| *other == verb).unwrap_or(BY_USE.len())
}

/// The verbs shown for a screen: its own first.
fn entries(state: &State) -> impl Iterator<Item = &'static Entry> + use<'_> {
    let (screen, read_only) = (state.screen, state.settings.read_only);
    let shown = move |entry: &&Entry| {
        let hidden = read_only && entry.changes;
        let keys = state.settings.keymap.of(entry, screen).next().is_some();
        !entry.label.is_empty() && keys && !hidden && !TAIL_NAMES.contains(&entry.name)
    };
    // What works everywhere, or is done once, is named only if it is available.
    let rare = |verb| matches!(verb, Verb::CreateIdentity | Verb::Register | Verb::Inspect | Verb::SetPolicy);
    let once = move |entry: &Entry| entry.on.is_empty() || rare(entry.verb);
    let named = move |entry: &&Entry| !once(entry) || available(state, entry.verb).is_ok();
    VERBS.iter().filter(shown).filter(named)
}

fn draw_entry(canvas: &mut Canvas, area: Rect, state: &State, entry: &Entry) -> Rect {
    let key = state.settings.keymap.label(entry, state.screen);
    let reason = available(state, entry.verb).err();
    let label = reason.map_or_else(|| entry.label.to_owned(), |reason| format!("{} ({reason})", entry.label));
    if columns(&key) + columns(&label) + 3 > area.width {
        return area;
    }
    let (key_role, role) = if reason.is_some() { (Role::Dim, Role::Dim) } else { (Role::Key, Role::Body) };
    canvas.puts(area, &[(&key, key_role), (" ", Role::Body), (&label, role), ("  ", Role::Body)])
}
