//! The two lines on top: the profile, the state of the parts, badges; and the screens.

use ratatui::layout::Rect;

use super::canvas::{Canvas, columns, right_of, row};
use super::theme::Role;
use crate::app::feed::Feed;
use crate::app::standing::Standing;
use crate::app::{Screen, State};
use crate::service::reply::{HealthLevel, PartHealth};

/// Below this many columns only the screen in view is named.
const NAMED_FROM: u16 = 80;
/// Columns from which the address is shown.
const ADDRESS_FROM: u16 = 100;

/// Columns that one short badge takes.
const BADGE: u16 = 12;

/// Draws both lines.
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

/// What is unusual, from the right; and where the site runs, as far as there is room.
fn badges(state: &State) -> Vec<(String, Role)> {
    let frozen = state.frozen.map(|at| format!(" FROZEN {} ", at.clock()));
    let locked = state.is_locked().then(|| " LOCKED ".to_owned());
    let read_only = state.settings.read_only.then(|| " READ-ONLY ".to_owned());
    let operator = state.settings.operator.as_ref().map(|name| format!(" OPERATOR {name} "));
    let mut badges: Vec<(String, Role)> =
        [operator, frozen, locked, read_only].into_iter().flatten().map(|badge| (badge, Role::Badge)).collect();
    // What is unusual takes precedence over where the site runs, and the health of its parts over both.
    let room = if badges.is_empty() { NAMED_FROM } else { ADDRESS_FROM };
    if state.size.0 >= room {
        badges.extend(Standing::of(state).map(|standing| (standing.badge(), Role::Dim)));
    }
    badges
}

/// If there is no room, parts that are well are only a dot, and then the others one word.
fn draw_health(canvas: &mut Canvas, area: Rect, health: &[PartHealth]) {
    // Of what is only looked after in the background, the line tells what is wrong.
    let shown: Vec<&PartHealth> =
        health.iter().filter(|part| part.part != "proofs" || part.level != HealthLevel::Ok).collect();
    let fits = |word: fn(&PartHealth) -> &str| {
        let whole: u16 = shown.iter().map(|part| columns(&part.part) + columns(word(part)) + 5).sum();
        whole <= area.width + 2
    };
    let words: [fn(&PartHealth) -> &str; 3] = [|part| level(part).2, brief, briefest];
    let word = words.into_iter().find(|word| fits(*word)).unwrap_or(briefest);
    let mut rest = area;
    for part in shown {
        let (dot, role, _) = level(part);
        let (dot, word) = (format!(" {dot} "), word(part));
        rest = canvas.puts(rest, &[(&part.part, Role::Body), (&dot, role), (word, role), ("  ", Role::Body)]);
    }
}

fn brief(part: &PartHealth) -> &str {
    if matches!(part.level, HealthLevel::Ok | HealthLevel::Absent) { "" } else { level(part).2 }
}

fn briefest(part: &PartHealth) -> &str {
    match part.level {
        HealthLevel::Ok | HealthLevel::Absent => "",
        HealthLevel::Waiting => "waits",
        HealthLevel::Failed => "failed",
    }
}

/// Dot, role and words of a part's health.
pub fn level(part: &PartHealth) -> (&'static str, Role, &str) {
    match part.level {
        HealthLevel::Ok => ("●", Role::Good, "ok"),
        HealthLevel::Waiting => ("◐", Role::Warning, &part.text),
        // `retry in 4 s: why`: the header has room for the first half.
        HealthLevel::Failed if part.text.starts_with("retry in") => {
            ("✖", Role::Bad, part.text.split(':').next().unwrap_or("failed"))
        }
        HealthLevel::Failed => ("✖", Role::Bad, "failed"),
        HealthLevel::Absent => ("○", Role::Dim, "absent"),
    }
}

fn draw_screens(canvas: &mut Canvas, area: Rect, state: &State) {
    let mut rest = area;
    let all: u16 = Screen::ALL.iter().map(|screen| columns(screen.title()) + 3).sum();
    for screen in Screen::ALL {
        let here = screen == state.screen;
        let number = (screen.index() + 1).to_string();
        let name = if here || area.width >= NAMED_FROM { screen.title() } else { "" };
        let role = if here { Role::Selection } else { Role::Dim };
        rest = canvas.puts(rest, &[(&number, if here { Role::Selection } else { Role::Key })]);
        if !name.is_empty() {
            let gap = if all < area.width || here { " " } else { "" };
            rest = canvas.puts(rest, &[(gap, role), (name, role)]);
        }
        rest = right_of(rest, 1);
    }
}
