//! The Overview screen: health, life line, law of conservation, alerts, busiest topics, graphs, first steps.

use crate::app::history::{Flow, Period, Sample, highest};
use crate::app::{Feed, State, alerts::Alert, alerts::is_troubled, history};
use crate::model::{clean, counted};
use crate::screens::{grants::state::is_given, topics::draw::watched};
use crate::service::reply::{HealthLevel, LifeLine, SiteView};
use crate::ui::graph::{Graph, SIDE, Scale};
use crate::ui::{
    Canvas, Column, Rect, Role, below, columns, graph, marks, marks::notice_level, marks::simulated, right_of, row,
    rows, table::draw_plain, words, words::wrap,
};

/// Fewer rows drop blank lines and show only the next step.
const ROOMY_FROM: u16 = 18;

/// On a roomy screen.
const MOST_ALERTS: usize = 4;

/// Narrower alerts show the clock without a word.
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
        let taken = canvas.put_wrapped(rest, text, role);
        rest = below(rest, taken);
    }
    rest = draw_alerts(canvas, below(rest, gap), state, if roomy { MOST_ALERTS } else { 1 });
    rest = draw_first_run(canvas, rest, state, roomy);
    rest = draw_flow(canvas, rest, state);
    draw_busiest(canvas, rest, state);
}

fn draw_health(canvas: &mut Canvas, area: Rect, site: &SiteView) -> Rect {
    for (line, part) in (0u16..).zip(&site.health) {
        let (dot, role, _) = marks::level(part);
        let place = row(area, line);
        canvas.put(place, &part.part, Role::Body);
        let mut rest = right_of(place, 9);
        if part.part == "ros" && site.robots > 0 {
            // Simulation must show, whatever else is cut.
            let badge = canvas.put_right(rest, "SIMULATED", Role::Badge);
            rest.width -= badge;
            let robots = canvas.put_right(rest, &format!(" {} ", counted(site.robots.into(), "robot")), Role::Body);
            rest.width -= robots;
        }
        // The badge at the right names the robots already.
        let robots = format!(", {}", counted(site.robots.into(), "SIMULATED robot"));
        let text = part.text.strip_suffix(&robots).unwrap_or(&part.text);
        canvas.puts(rest, &[(dot, role), (" ", Role::Body), (text, Role::Body)]);
    }
    below(area, u16::try_from(site.health.len()).unwrap_or(4))
}

fn draw_life(canvas: &mut Canvas, area: Rect, state: &State, life: &LifeLine) -> Rect {
    let stations = [
        ("captured", life.captured),
        ("stored", life.stored),
        ("anchored", life.anchored),
        ("confirmed", life.confirmed),
        ("verified", life.verified),
    ];
    let width = (area.width / 5).min(16);
    for (place, (name, count)) in (0u16..).zip(stations) {
        let column = Rect { width, ..right_of(area, place * width) };
        let count = words::count(count);
        // `confirmed ›` and a gap must fit.
        let arrow = if place == 4 || width < 12 { "" } else { " ›" };
        canvas.puts(row(column, 0), &[(name, Role::Title), (arrow, Role::Dim)]);
        canvas.put(row(column, 1), &count, if place == 4 { Role::Good } else { Role::Accent });
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

/// Captured = verified + pending + unauthorised + quarantined + dropped + tampered, and whether this balances.
fn draw_law(canvas: &mut Canvas, area: Rect, life: &LifeLine) {
    let parts = [
        (life.verified, "verified", Role::Good),
        (life.pending, "pending", Role::Accent),
        (life.right_ended, "unauthorised", Role::Warning),
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
    // Unusual states show only if there are any: the line is short.
    let named = parts.into_iter().enumerate().filter(|(place, (count, ..))| *place < 2 || *count > 0);
    for (place, (count, name, role)) in named {
        let plus = if place == 0 { "" } else { " + " };
        rest = canvas.puts(rest, &[(plus, Role::Dim), (&words::count(count), role), (" ", role), (name, Role::Dim)]);
    }
    let nothing_else = "; none held, dropped or tampered";
    let is_all = life.right_ended + life.quarantined + life.dropped + life.tampered == 0;
    // Whole or not at all.
    if is_all && columns(nothing_else) <= rest.width {
        canvas.put(rest, nothing_else, Role::Dim);
    }
}

fn draw_alerts(canvas: &mut Canvas, area: Rect, state: &State, most: usize) -> Rect {
    let found = state.alerts.shown();
    let shown = found.len().min(most);
    // The worst one has the rows that the others leave: its remedy must be readable.
    let of_worst = u16::try_from(most - shown.saturating_sub(1)).unwrap_or(1);
    let mut taken = 0;
    for (place, alert) in found.iter().take(shown).enumerate() {
        taken += draw_alert(canvas, below(area, taken), state, alert, if place == 0 { of_worst } else { 1 });
    }
    let gap = u16::from(most > 1 && shown > 0);
    below(area, taken + gap)
}

/// Returns the rows taken, at most `most`; `enter` shows what is cut.
fn draw_alert(canvas: &mut Canvas, area: Rect, state: &State, alert: &Alert, most: u16) -> u16 {
    let often = if alert.count > 1 { format!(", {} times", alert.count) } else { String::new() };
    let since = if area.width < SAID_FROM { "" } else { "since " };
    let (when, mark, role) = match alert.resolved {
        Some(at) => (format!("resolved {}{often}", state.clock(at)), "● ", Role::Good),
        None => {
            let (mark, role) = notice_level(alert.level);
            (format!("{since}{}{often}", state.clock(alert.since)), mark, role)
        }
    };
    let taken = canvas.put_right(area, &format!(" {when}"), Role::Dim);
    let area = Rect { width: area.width.saturating_sub(taken), ..area };
    let text = if alert.resolved.is_some() { Role::Dim } else { role };
    let lines = wrapped(&alert.text, area.width.saturating_sub(columns(mark)), most);
    for (place, line) in (0u16..).zip(&lines) {
        canvas.puts(row(area, place), &[(if place == 0 { mark } else { "  " }, role), (line, text)]);
    }
    rows(lines.len())
}

/// The last of at most `most` lines has the rest, which is cut where it is drawn.
fn wrapped(text: &str, width: u16, most: u16) -> Vec<String> {
    let mut lines = wrap(&clean(text, 1_000), width);
    let last = usize::from(most).saturating_sub(1);
    if lines.len() > last {
        let rest = lines.split_off(last).join(" ");
        lines.push(rest);
    }
    lines
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
        canvas.put_wrapped(area, text, Role::Dim);
        return;
    }
    let rows = state.topics.busiest(usize::from(area.height - 1)).into_iter().map(|row| {
        vec![
            (row.topic.clone(), Role::Body),
            (row.type_name.clone().unwrap_or_default(), Role::Dim),
            (words::rate(row.hz), Role::Accent),
            (words::kilobytes(row.bytes_per_second), Role::Body),
            watched(row),
            (if row.simulated { "SIM".to_owned() } else { String::new() }, Role::Dim),
            simulated(row.simulated),
        ]
    });
    draw_plain(canvas, area, COLUMNS, rows.collect());
}

/// Columns of names and figures at the left of a low graph.
const NAMES: u16 = 11;

/// Columns and rows from which two high graphs stand side by side.
const HIGH_FROM: (u16, u16) = (110, 26);

const HIGH: u16 = 5;

/// Of a low graph. A single row has too few levels to show a fall of a tenth.
const LOW: u16 = 2;

/// Kept for the busiest topics.
const KEPT: u16 = 5;

/// Two low graphs and their heading.
const ROWS: u16 = 1 + 2 * LOW;

struct Panel {
    name: &'static str,
    now: String,
    text: String,
    values: Vec<Option<Sample>>,
    role: Role,
    marks: bool,
}

/// Returns what is left of `area`.
pub fn draw_flow(canvas: &mut Canvas, area: Rect, state: &State) -> Rect {
    if state.site.is_none() || area.height < ROWS + KEPT {
        return area;
    }
    let high = area.width >= HIGH_FROM.0 && area.height >= HIGH_FROM.1;
    let width = if high { (area.width / 2).saturating_sub(2) } else { area.width.saturating_sub(NAMES) };
    let parts = 2 * usize::from(history::cells(width.saturating_sub(SIDE)));
    let flow = state.history.flow(state.period, parts, state.shown_at());
    if !flow.any() {
        return area;
    }
    let minutes = |period: Period| format!("{} min", period.minutes());
    let heading = format!("Last {}", minutes(state.period));
    let hint = format!("  m: {}", minutes(state.period.next()));
    let mut rest = canvas.puts(row(area, 0), &[(&heading, Role::Title), (&hint, Role::Dim)]);
    let panels = panels(state, flow);
    let area = below(area, 1);
    if high {
        return draw_high(canvas, area, &panels);
    }
    let shown = if area.height >= 4 * LOW + KEPT { panels.len() } else { 2 };
    for (place, panel) in panels.iter().enumerate().skip(shown) {
        let gap = if place == shown { "  " } else { "; " };
        rest = canvas
            .puts(rest, &[(gap, Role::Dim), (panel.name, Role::Dim), (" ", Role::Dim), (&panel.text, Role::Body)]);
    }
    draw_low(canvas, area, panels.get(..shown).unwrap_or_default())
}

fn panels(state: &State, flow: Flow) -> [Panel; 4] {
    let rate = |now: f64, values: &[Option<Sample>]| format!("{now:.1}/s, peak {:.1}", highest(values).max(now));
    let after = flow.after.map_or_else(
        || "none verified".to_owned(),
        |(half, most)| format!("p50 {}, p99 {}", words::seconds(half), words::seconds(most)),
    );
    let last = flow.after.map_or_else(String::new, |(_, most)| format!("p99 {}", words::seconds(most)));
    let pending = state.pending_records();
    let most = highest(&flow.pending).max(f64::from(u32::try_from(pending).unwrap_or(u32::MAX)));
    let waiting = format!("{}, peak {most:.0}", words::count(pending));
    let (captured, verified) = (state.rates.captured(), state.rates.verified());
    // The others come in batches, so all their parts would be marked.
    let panel = |name, now, text, values, role| Panel { name, now, text, values, role, marks: name == "captured" };
    let captured_text = rate(captured, &flow.captured);
    let verified_text = rate(verified, &flow.verified);
    [
        panel("captured", format!("{captured:.1}/s"), captured_text, flow.captured, Role::Accent),
        panel("verified", format!("{verified:.1}/s"), verified_text, flow.verified, Role::Good),
        panel("latency", last, after, flow.slowest, Role::Body),
        panel("pending", words::count(pending), waiting, flow.pending, Role::Warning),
    ]
}

fn draw_line(canvas: &mut Canvas, area: Rect, panel: &Panel) {
    let Panel { values, role, marks, .. } = panel;
    graph::draw(canvas, area, &Graph { values, scale: Scale::around(values), role: *role, marks: *marks });
}

/// One below the other: name and figure, line, scale.
fn draw_low(canvas: &mut Canvas, area: Rect, panels: &[Panel]) -> Rect {
    panels.iter().fold(area, |area, panel| {
        canvas.put(row(area, 0), panel.name, Role::Dim);
        canvas.put(row(area, 1), &panel.now, Role::Body);
        draw_line(canvas, Rect { height: LOW, ..right_of(area, NAMES) }, panel);
        below(area, LOW)
    })
}

/// Side by side, figures above.
fn draw_high(canvas: &mut Canvas, area: Rect, panels: &[Panel]) -> Rect {
    let width = area.width / 2;
    for (place, panel) in (0u16..).zip(panels) {
        let here = below(right_of(area, place % 2 * width), place / 2 * (HIGH + 2));
        let here = Rect { width: width.saturating_sub(2), ..here };
        canvas.puts(row(here, 0), &[(panel.name, Role::Title), ("  ", Role::Body), (&panel.text, Role::Body)]);
        draw_line(canvas, Rect { height: HIGH.min(here.height.saturating_sub(1)), ..below(here, 1) }, panel);
    }
    below(area, 2 * (HIGH + 2))
}

/// Only the next step if there is little room; returns what is left of `area`.
pub fn draw_first_run(canvas: &mut Canvas, area: Rect, state: &State, roomy: bool) -> Rect {
    let steps = first_steps(state);
    if steps.is_empty() || state.settings.read_only {
        return area;
    }
    let next = steps.iter().position(|step| !step.done);
    if !roomy {
        if let Some((place, step)) = steps.iter().enumerate().find(|(_, step)| !step.done) {
            draw_step(canvas, row(area, 0), step, place, true);
        }
        return below(area, 1);
    }
    let hint = if state.tour.is_some() {
        "  press the highlighted key"
    } else {
        "  press the highlighted key; five-minute tour: authros tour"
    };
    canvas.puts(row(area, 0), &[("First steps", Role::Title), (hint, Role::Dim)]);
    for (line, (place, step)) in (1u16..).zip(steps.iter().enumerate()) {
        draw_step(canvas, row(area, line), step, place, next == Some(place));
    }
    below(area, 2 + u16::try_from(steps.len()).unwrap_or(u16::MAX))
}

fn draw_step(canvas: &mut Canvas, area: Rect, step: &FirstStep, place: usize, next: bool) {
    let (mark, role) = match (step.done, next) {
        (true, _) => ("done ", Role::Good),
        (false, true) => ("next ", Role::Warning),
        (false, false) => ("     ", Role::Dim),
    };
    let name = format!("{} {:<9} ", place + 1, step.name);
    let text = if step.done { Role::Dim } else { Role::Body };
    canvas.puts(area, &[(mark, role), (&name, text), (step.key, Role::Key), ("  ", Role::Body), (step.text, text)]);
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirstStep {
    pub done: bool,
    pub name: &'static str,
    pub key: &'static str,
    pub text: &'static str,
}

/// Empty once the profile is set up, and while nobody can say whether it is registered.
pub fn first_steps(state: &State) -> Vec<FirstStep> {
    let Some(identity) = &state.identity else { return Vec::new() };
    if identity.exists && !identity.registered && is_troubled(state.site.as_ref(), "chain") {
        return Vec::new();
    }
    let set_up = identity.exists && identity.registered;
    let step = |done, name, key, text| FirstStep { done, name, key, text };
    let first = match identity.exists {
        true => step(set_up, "identity", "R", "register the identity on the chain"),
        false => step(set_up, "identity", "n", "make keys and register them on the chain"),
    };
    let part = |name| state.site.iter().flat_map(|site| &site.health).find(|part| part.part == name);
    // A gateway's worker captures and grants nothing.
    let of_worker = part("lease").map(|_| {
        let serves = part("gateway").is_some_and(|part| part.level == HealthLevel::Ok);
        vec![first.clone(), step(serves, "gateway", "", "`authros gateway serve --listen ADDRESS:PORT` serves robots")]
    });
    let steps = of_worker.unwrap_or_else(|| {
        vec![
            first,
            step(identity.exists, "keys", "L", "created with the identity; press L to load your own"),
            step(state.watches(), "topics", "w", "watch a topic: its messages are encrypted and anchored"),
            step(
                state.grants.rows.iter().any(is_given) || state.is_locked(),
                "grant",
                "g",
                "let another account read them",
            ),
        ]
    });
    if steps.iter().all(|step| step.done) { Vec::new() } else { steps }
}
