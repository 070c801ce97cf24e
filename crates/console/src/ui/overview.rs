//! The Overview: health, record counts, alerts, first steps, busiest topics.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below, right_of, row};
use super::table::{Column, draw_plain};
use super::theme::Role;
use super::{bottom, first_run, flow, header, topics, words};
use crate::app::State;
use crate::app::alerts::Alert;
use crate::app::feed::Feed;
use crate::model::clean;
use crate::service::reply::{LifeLine, SiteView};

/// Below this many rows blank lines are left out and only the next step is shown.
const ROOMY_FROM: u16 = 18;
/// The most alerts shown on a roomy screen.
const MOST_ALERTS: usize = 4;

/// Below this many columns the clock beside an alert has no word.
const SAID_FROM: u16 = 100;

const COLUMNS: &[Column] = &[
    Column::name("Busiest topics"),
    Column::text("Type", 27).from(100),
    Column::number("Hz", 7),
    Column::number("kB/s", 8),
    Column::text("", 13),
    Column::text("", 3).below(100),
    Column::text("", 9).from(100),
];

/// Draws the screen.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let roomy = area.height >= ROOMY_FROM;
    let gap = u16::from(roomy);
    let mut rest = area;
    if let Some(site) = &state.site {
        rest = draw_health(canvas, rest, site);
        rest = draw_life(canvas, below(rest, gap), state, &site.life);
    } else {
        let failure = state.feeds.slot(Feed::Site).failure.as_ref();
        let (text, role) =
            failure.map_or(("The site is starting…", Role::Dim), |failure| (&failure.message, Role::Bad));
        let lines = words::wrap(&clean(text, 500), rest.width);
        for (line, text) in (0u16..).zip(&lines) {
            canvas.put(row(rest, line), text, role);
        }
        rest = below(rest, u16::try_from(lines.len()).unwrap_or(1));
    }
    rest = draw_alerts(canvas, below(rest, gap), state, if roomy { MOST_ALERTS } else { 1 });
    rest = first_run::draw(canvas, rest, state, roomy);
    rest = flow::draw(canvas, rest, state);
    draw_busiest(canvas, rest, state);
}

fn draw_health(canvas: &mut Canvas, area: Rect, site: &SiteView) -> Rect {
    for (line, part) in (0u16..).zip(&site.health) {
        let (dot, role, _) = header::level(part);
        let place = row(area, line);
        canvas.put(place, &part.part, Role::Body);
        let mut rest = right_of(place, 9);
        if part.part == "ros" && site.robots > 0 {
            // What is simulated must be said, whatever else is cut.
            let badge = canvas.put_right(rest, "SIMULATED", Role::Badge);
            rest.width -= badge;
            let robots = canvas.put_right(rest, &format!(" {} robots ", site.robots), Role::Body);
            rest.width -= robots;
        }
        // The robots are named at the right already.
        let text = part.text.strip_suffix(&format!(", {} SIMULATED robots", site.robots)).unwrap_or(&part.text);
        canvas.puts(rest, &[(dot, role), (" ", Role::Body), (text, Role::Body)]);
    }
    below(area, u16::try_from(site.health.len()).unwrap_or(4))
}

fn draw_life(canvas: &mut Canvas, area: Rect, state: &State, life: &LifeLine) -> Rect {
    let stations = [
        ("captured", life.captured),
        ("sealed", life.sealed),
        ("stored", life.stored),
        ("anchored", life.anchored),
        ("confirmed", life.confirmed),
        ("verified", life.verified),
    ];
    let width = (area.width / 6).min(16);
    for (place, (name, count)) in (0u16..).zip(stations) {
        let column = Rect { width, ..right_of(area, place * width) };
        let count = words::count(count);
        // `confirmed ›` and a gap must fit.
        let arrow = if place == 5 || width < 12 { "" } else { " ›" };
        canvas.puts(row(column, 0), &[(name, Role::Title), (arrow, Role::Dim)]);
        canvas.put(row(column, 1), &count, if place == 5 { Role::Good } else { Role::Accent });
        let rate = state.rates.stations.get(usize::from(place)).copied().unwrap_or(0.0);
        canvas.put(row(column, 2), &format!("{rate:.1}/s"), Role::Dim);
    }
    draw_law(canvas, row(area, 3), life);
    let lost = life.lost_in_transport > 0;
    if lost {
        let text = format!("{} lost in transport before capture", words::count(life.lost_in_transport));
        canvas.put(row(area, 4), &text, Role::Warning);
    }
    below(area, 4 + u16::from(lost))
}

/// Captured = verified + pending + right ended + quarantined + dropped + tampered, in figures, and whether it balances.
fn draw_law(canvas: &mut Canvas, area: Rect, life: &LifeLine) {
    let parts = [
        (life.verified, "verified", Role::Good),
        (life.pending, "pending", Role::Accent),
        (life.right_ended, "right ended", Role::Warning),
        (life.quarantined, "quarantined", Role::Warning),
        (life.dropped, "dropped", Role::Warning),
        (life.tampered, "tampered", Role::Bad),
    ];
    let sum: u64 = parts.iter().map(|(count, ..)| count).sum();
    let (verdict, role) = if sum == life.captured && life.conserved {
        ("● balanced: ", Role::Good)
    } else {
        ("✖ NOT balanced: ", Role::Bad)
    };
    let mut rest =
        canvas.puts(area, &[(verdict, role), (&words::count(life.captured), Role::Accent), (" = ", Role::Dim)]);
    // Unusual states are named if there are any; figures grow, and the line is short.
    let named = parts.into_iter().enumerate().filter(|(place, (count, ..))| *place < 2 || *count > 0);
    for (place, (count, name, role)) in named {
        let plus = if place == 0 { "" } else { " + " };
        rest = canvas.puts(rest, &[(plus, Role::Dim), (&words::count(count), role), (" ", role), (name, Role::Dim)]);
    }
    if life.right_ended + life.quarantined + life.dropped + life.tampered == 0 {
        canvas.put(rest, "; none held, dropped or tampered", Role::Dim);
    }
}

fn draw_alerts(canvas: &mut Canvas, area: Rect, state: &State, most: usize) -> Rect {
    let found = state.alerts.shown();
    let shown = found.len().min(most);
    for (line, alert) in (0u16..).zip(found.iter().take(shown)) {
        draw_alert(canvas, row(area, line), state, alert);
    }
    let gap = u16::from(most > 1 && shown > 0);
    below(area, u16::try_from(shown).unwrap_or(0) + gap)
}

/// One alert with its start and count, or that it has ended.
fn draw_alert(canvas: &mut Canvas, area: Rect, state: &State, alert: &Alert) {
    let often = if alert.count > 1 { format!(", {} times", alert.count) } else { String::new() };
    let since = if area.width < SAID_FROM { "" } else { "since " };
    let (when, mark, role) = match alert.resolved {
        Some(at) => (format!("resolved {}{often}", state.clock(at)), "● ", Role::Good),
        None => {
            let (mark, role) = bottom::level(alert.level);
            (format!("{since}{}{often}", state.clock(alert.since)), mark, role)
        }
    };
    let taken = canvas.put_right(area, &format!(" {when}"), Role::Dim);
    let area = Rect { width: area.width.saturating_sub(taken), ..area };
    let text = if alert.resolved.is_some() { Role::Dim } else { role };
    canvas.puts(area, &[(mark, role), (&alert.text, text)]);
}

fn draw_busiest(canvas: &mut Canvas, area: Rect, state: &State) {
    if area.height < 2 {
        return;
    }
    if state.topics.rows.is_empty() {
        let failure = state.feeds.slot(Feed::Topics).failure.as_ref();
        let text = match failure {
            Some(failure) => failure.message.as_str(),
            None if state.awaits(Feed::Topics) => "Asking for the topics…",
            None => "No topics published yet; they appear here automatically.",
        };
        canvas.put(area, text, Role::Dim);
        return;
    }
    let rows = state.topics.busiest(usize::from(area.height - 1)).into_iter().map(|row| {
        vec![
            (row.topic.clone(), Role::Body),
            (row.type_name.clone().unwrap_or_default(), Role::Dim),
            (words::rate(row.hz), Role::Accent),
            (words::kilobytes(row.bytes_per_second), Role::Body),
            topics::watched(row),
            (if row.simulated { "SIM".to_owned() } else { String::new() }, Role::Dim),
            topics::simulated(row.simulated),
        ]
    });
    draw_plain(canvas, area, COLUMNS, rows.collect());
}
