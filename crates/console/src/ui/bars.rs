//! The top lines (profile, health, badges; screens) and the bottom ones (messages, keys).

use ratatui::layout::Rect;

use crate::app::{Entry, Feed, Screen, State, VERBS, Verb, available::available};
use crate::popups;
use crate::popups::quit::Standing;
use crate::service::reply::{HealthLevel, PartHealth};
use crate::ui::canvas::{Canvas, columns, right_of, row};
use crate::ui::{frame::MOST_LINES, marks, marks::notice_level, theme::Role, words::wrap};

/// Narrower terminals name only the screen in view.
const NAMED_FROM: u16 = 80;

/// Columns from which the address is shown.
const ADDRESS_FROM: u16 = 100;

/// Columns of a short badge.
const BADGE: u16 = 12;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    draw_first(canvas, row(area, 0), state);
    draw_screens(canvas, row(area, 1), state);
}

fn draw_first(canvas: &mut Canvas, area: Rect, state: &State) {
    let mut rest = area;
    for (badge, role) in badges(state) {
        let taken = canvas.put_right(rest, &badge, role);
        rest.width = rest.width.saturating_sub(taken + 1);
    }
    let crowded = rest.width < area.width.saturating_sub(BADGE) && area.width < ADDRESS_FROM;
    if area.width >= NAMED_FROM && !crowded {
        rest = canvas.puts(rest, &[("AuthROS ", Role::Title)]);
    }
    rest = canvas.puts(rest, &[(state.settings.profile.as_str(), Role::Accent), ("  ", Role::Body)]);
    if let Some(address) = state.address().filter(|_| area.width >= ADDRESS_FROM) {
        rest = canvas.puts(rest, &[(&address.short(), Role::Dim), ("  ", Role::Body)]);
    }
    match (&state.site, &state.feeds.slot(Feed::Site).failure) {
        (_, Some(_)) => drop(canvas.put(rest, "✖ the site does not answer", Role::Bad)),
        (Some(site), None) => draw_health(canvas, rest, &site.health),
        (None, None) => drop(canvas.put(rest, "site starting…", Role::Warning)),
    }
}

/// From the right; where the site runs, if there is room.
fn badges(state: &State) -> Vec<(String, Role)> {
    let frozen = state.frozen.map(|at| format!(" FROZEN {} ", at.clock()));
    let locked = state.is_locked().then(|| " LOCKED ".to_owned());
    let read_only = state.settings.read_only.then(|| " READ-ONLY ".to_owned());
    let operator = state.settings.operator.as_ref().map(|name| format!(" OPERATOR {name} "));
    let mut badges: Vec<(String, Role)> =
        [operator, frozen, locked, read_only].into_iter().flatten().map(|badge| (badge, Role::Badge)).collect();
    // Unusual badges take precedence over the site's place, and health over both.
    let room = if badges.is_empty() { NAMED_FROM } else { ADDRESS_FROM };
    if state.size.0 >= room {
        badges.extend(Standing::of(state).map(|standing| (standing.badge(), Role::Dim)));
    }
    badges
}

/// Without room, healthy parts shrink to a dot, then the others to one word.
fn draw_health(canvas: &mut Canvas, area: Rect, health: &[PartHealth]) {
    // Background parts show only if something is wrong.
    let shown: Vec<&PartHealth> =
        health.iter().filter(|part| part.part != "proofs" || part.level != HealthLevel::Ok).collect();
    let fits = |word: fn(&PartHealth) -> &str| {
        let whole: u16 = shown.iter().map(|part| columns(&part.part) + columns(word(part)) + 5).sum();
        whole <= area.width + 2
    };
    let words: [fn(&PartHealth) -> &str; 3] = [|part| marks::level(part).2, brief, briefest];
    let word = words.into_iter().find(|word| fits(*word)).unwrap_or(briefest);
    let mut rest = area;
    for part in shown {
        let (dot, role, _) = marks::level(part);
        let (dot, word) = (format!(" {dot} "), word(part));
        rest = canvas.puts(rest, &[(&part.part, Role::Body), (&dot, role), (word, role), ("  ", Role::Body)]);
    }
}

fn brief(part: &PartHealth) -> &str {
    if matches!(part.level, HealthLevel::Ok | HealthLevel::Absent) { "" } else { marks::level(part).2 }
}

fn briefest(part: &PartHealth) -> &str {
    match part.level {
        HealthLevel::Ok | HealthLevel::Absent => "",
        HealthLevel::Waiting => "waits",
        HealthLevel::Failed => "failed",
    }
}

fn draw_screens(canvas: &mut Canvas, area: Rect, state: &State) {
    let mut rest = area;
    let all: u16 = Screen::all().map(|screen| columns(screen.title()) + 3).sum();
    for screen in Screen::all() {
        let here = screen == state.screen;
        let number = (screen.index() + 1).to_string();
        let name = if here || area.width >= NAMED_FROM { screen.title() } else { "" };
        let role = if here { Role::Selection } else { Role::Dim };
        rest = canvas.puts(rest, &[(&number, if here { Role::Selection } else { Role::Key })]);
        if !name.is_empty() {
            let gap = if all <= area.width || here { " " } else { "" };
            rest = canvas.puts(rest, &[(gap, role), (name, role)]);
        }
        rest = right_of(rest, 1);
    }
}

/// Stays at the right of the bar.
const TAIL_NAMES: [&str; 3] = ["palette", "help", "quit"];

pub fn draw_bottom(canvas: &mut Canvas, area: Rect, state: &State) {
    draw_message(canvas, Rect { height: area.height - 1, ..area }, state);
    draw_bar(canvas, row(area, area.height - 1), state);
}

/// Rows above its own that the message takes.
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
    let (mark, role) = notice_level(toast.level);
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
        return draw_hints(canvas, area, &popups::hints(state, popup));
    }
    if state.table().is_some_and(|table| table.filtering) {
        return draw_hints(canvas, area, &[("enter", "apply"), ("esc", "clear"), ("up down", "earlier filters, rows")]);
    }
    // Help and quit stay at the right, whatever is cut.
    let tail = Rect { x: area.x + area.width.saturating_sub(TAIL), width: TAIL.min(area.width), ..area };
    draw_tail(canvas, tail, state);
    let mut rest = Rect { width: area.width - tail.width, ..area };
    let mut shown: Vec<&Entry> = entries(state).collect();
    // The most used verbs win when there is little room; unavailable ones come last.
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

/// Most used first.
fn use_of(verb: Verb) -> usize {
    use Verb::{
        Browse, Check, Details, Export, Extend, Filter, Grant, Inspect, Mark, Open, Publishers, Readers, Revoke,
    };
    use Verb::{SetPolicy, Sort, Watch};
    let often = [Watch, Details, Inspect, SetPolicy, Open, Grant, Revoke, Filter];
    let rest = [Browse, Readers, Extend, Export, Publishers, Check, Sort, Mark];
    often.iter().chain(&rest).position(|other| *other == verb).unwrap_or(often.len() + rest.len())
}

fn entries(state: &State) -> impl Iterator<Item = &'static Entry> + use<'_> {
    let (screen, read_only) = (state.screen, state.settings.read_only);
    let shown = move |entry: &&Entry| {
        let hidden = read_only && entry.changes;
        let keys = state.settings.keymap.of(entry, screen).next().is_some();
        !entry.label.is_empty() && keys && !hidden && !TAIL_NAMES.contains(&entry.name)
    };
    // Verbs that work everywhere or are done once show only when available.
    let rare =
        |verb| matches!(verb, Verb::CreateIdentity | Verb::Register | Verb::Alerts | Verb::Inspect | Verb::SetPolicy);
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

pub fn under_way(state: &State) -> Option<String> {
    let mut work = state.work.iter().filter(|tag| tag.is_work());
    let first = work.next()?;
    let more = work.count();
    Some(if more > 0 { format!("{} and {more} more", first.words()) } else { first.words() })
}
