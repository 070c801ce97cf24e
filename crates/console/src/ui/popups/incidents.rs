//! The incidents: a line for each, and below what the one under the cursor holds.

use ratatui::layout::Rect;

use super::framed;
use crate::app::incidents::IncidentList;
use crate::app::screens::day;
use crate::app::update::Feed;
use crate::app::{State, counted};
use crate::model::{Timestamp, clean};
use crate::service::reply::{IncidentNoteView, IncidentView, SpanCoverageView};
use crate::ui;
use crate::ui::lists::empty;
use crate::ui::theme::Role;
use crate::ui::{Canvas, below, right_of, row};

/// Columns of a name.
const NAME: u16 = 22;
/// Columns of a state.
const STATE: u16 = 8;
/// The widest the list grows.
const WIDEST: u16 = 110;
/// Seconds of a day.
const DAY: u64 = 86_400;

type Line = (String, Role);

/// Draws the list, and below it what the incident under the cursor holds.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, list: &IncidentList) {
    let width = WIDEST.min(area.width.saturating_sub(6));
    let Some(chosen) = list.chosen(state) else {
        let inner = framed(canvas, area, "Incidents", width.min(72), 2);
        let nothing = "None yet: n opens one, to keep the records of a time span.";
        canvas.put(inner, empty(state, Feed::Incidents, nothing), Role::Dim);
        return;
    };
    let rows = &state.incidents.rows;
    let told: Vec<Line> = holdings(state, chosen)
        .into_iter()
        .flat_map(|(text, role)| ui::wrap(&text, width).into_iter().map(move |line| (line, role)))
        .collect();
    let number = |count: usize| u16::try_from(count).unwrap_or(u16::MAX);
    // A third is the list's, however many there are.
    let listed = number(rows.len()).min((area.height.saturating_sub(4) / 3).max(1));
    let inner = framed(canvas, area, "Incidents", width, number(told.len()).saturating_add(listed + 1));
    let selected = list.selected.min(rows.len().saturating_sub(1));
    let height = usize::from(listed);
    let first = selected - selected % height.max(1);
    for (place, (index, incident)) in (0u16..).zip(rows.iter().enumerate().skip(first).take(height)) {
        draw_row(canvas, row(inner, place), incident, index == selected);
    }
    draw_told(canvas, below(inner, listed + 1), &told, list.scroll);
}

fn draw_row(canvas: &mut Canvas, line: Rect, incident: &IncidentView, here: bool) {
    canvas.put(line, if here { "▌" } else { " " }, Role::Accent);
    let name = Rect { width: NAME.min(line.width.saturating_sub(1)), ..right_of(line, 1) };
    canvas.put(name, incident.name.as_str(), if here { Role::Selection } else { Role::Body });
    let rest = right_of(line, NAME + 2);
    let (word, role) = if incident.open { ("open", Role::Good) } else { ("closed", Role::Dim) };
    canvas.put(rest, word, role);
    let topics = incident.coverage.iter().filter(|one| one.records > 0).count() as u64;
    let held = format!("{} in {}", records(incident.records), counted(topics, "topic"));
    canvas.puts(right_of(rest, STATE), &[(&held, Role::Body), (&format!(", {}", ui::size(incident.bytes)), Role::Dim)]);
}

/// Draws lines from the `scroll`-th on, and says how many are above and below.
pub(super) fn draw_told(canvas: &mut Canvas, area: Rect, told: &[Line], scroll: usize) {
    let height = usize::from(area.height);
    let first = scroll.min(told.len().saturating_sub(height));
    for (place, (line, role)) in (0..area.height).zip(told.iter().skip(first)) {
        canvas.put(row(area, place), line, *role);
    }
    let left = told.len().saturating_sub(first + height);
    if first > 0 || left > 0 {
        let edge = Rect { y: area.bottom(), height: 1, ..area };
        canvas.put_right(edge, &format!(" {first} above, {left} below "), Role::Dim);
    }
}

fn records(count: u64) -> String {
    format!("{} {}", ui::count(count), if count == 1 { "record" } else { "records" })
}

/// Its span, its notes, and what there is of each topic.
fn holdings(state: &State, incident: &IncidentView) -> Vec<Line> {
    let to = match incident.until {
        Some(until) => format!("to {} UTC", day(until)),
        None => "UTC, until it is closed".to_owned(),
    };
    let about = match incident.topics.len() {
        0 => "all topics".to_owned(),
        count => counted(count as u64, "topic"),
    };
    let mut lines = vec![(format!("From {} {to}, {about}", day(incident.since)), Role::Title)];
    lines.extend(incident.notes.iter().flat_map(note));
    lines.push(Line::default());
    if incident.coverage.is_empty() {
        lines.push(("Nothing was recorded in that time.".to_owned(), Role::Dim));
    }
    lines.extend(incident.coverage.iter().flat_map(|one| topic(state, one)));
    lines
}

fn note(note: &IncidentNoteView) -> Vec<Line> {
    let mut lines = note.text.lines().map(|line| clean(line, 2_000));
    let first = lines.next().unwrap_or_default();
    let rest = lines.map(|line| (format!("  {line}"), Role::Body));
    std::iter::once((format!("{}  {first}", day(note.at)), Role::Body)).chain(rest).collect()
}

fn topic(state: &State, one: &SpanCoverageView) -> Vec<Line> {
    let name = clean(&one.topic, 255);
    let mut lines = match (one.first, one.last) {
        (Some(first), Some(last)) => {
            vec![(format!("{name}  {}, {}", records(one.records), from_to(state, first, last)), Role::Body)]
        }
        _ if one.quarantined > 0 => vec![(format!("{name}  no record"), Role::Warning)],
        _ => vec![(format!("{name}  nothing in that time: check the name and whether it is watched"), Role::Warning)],
    };
    let missing =
        [(one.lost, "lost"), (one.quarantined, "in quarantine"), (one.deleted, "deleted earlier by retention")];
    let missing: Vec<String> = missing
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, word)| format!("{} {word}", ui::count(count)))
        .collect();
    if !missing.is_empty() {
        lines.push((format!("  {}", missing.join(", ")), Role::Warning));
    }
    lines
}

fn from_to(state: &State, first: Timestamp, last: Timestamp) -> String {
    if first.seconds() / DAY == last.seconds() / DAY {
        return format!("{} to {}", state.clock(first), state.clock(last));
    }
    format!("{} to {}", day(first), day(last))
}
