//! Incidents on screen.

use crate::app::{Feed, State};
use crate::model::{Timestamp, clean, counted};
use crate::popups::incidents::state::IncidentList;
use crate::screens::grants::state::day;
use crate::service::reply::{IncidentNoteView, IncidentView, SpanCoverageView};
use crate::ui::{
    Canvas, Piece, Rect, Role, below, draw_list, draw_told, empty, frame::LOOKUP_WIDEST, framed, name_role, right_of,
    rows, words, words::wrap,
};

const INCIDENT_NAME: u16 = 22;
const STATE: u16 = 8;
const DAY: u64 = 86_400;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, list: &IncidentList) {
    let width = LOOKUP_WIDEST.min(area.width.saturating_sub(6));
    let Some(chosen) = list.chosen(state) else {
        let inner = framed(canvas, area, "Incidents", width.min(72), 2);
        let nothing = "No incidents yet: n opens one, to keep the records of a time span.";
        canvas.put(inner, empty(state, Feed::Incidents, nothing), Role::Dim);
        return;
    };
    let incidents = &state.incidents.rows;
    let told: Vec<Piece> = holdings(state, chosen)
        .into_iter()
        .flat_map(|(text, role)| wrap(&text, width).into_iter().map(move |line| (line, role)))
        .collect();
    // The list takes a third, however many there are.
    let listed = rows(incidents.len()).min((area.height.saturating_sub(4) / 3).max(1));
    let inner = framed(canvas, area, "Incidents", width, rows(told.len()).saturating_add(listed + 1));
    draw_list(canvas, Rect { height: listed, ..inner }, incidents, list.selected, draw_incident);
    draw_told(canvas, below(inner, listed + 1), &told, list.scroll);
}

fn draw_incident(canvas: &mut Canvas, line: Rect, incident: &IncidentView, here: bool) {
    let name = Rect { width: INCIDENT_NAME.min(line.width), ..line };
    canvas.put(name, incident.name.as_str(), name_role(here));
    let rest = right_of(line, INCIDENT_NAME + 1);
    let (word, role) = if incident.open { ("open", Role::Good) } else { ("closed", Role::Dim) };
    canvas.put(rest, word, role);
    let topics = incident.coverage.iter().filter(|one| one.records > 0).count() as u64;
    let held = format!("{} in {}", counted(incident.records, "record"), counted(topics, "topic"));
    canvas.puts(
        right_of(rest, STATE),
        &[(&held, Role::Body), (&format!(", {}", words::size(incident.bytes)), Role::Dim)],
    );
}

/// Span, notes, and coverage of each topic.
fn holdings(state: &State, incident: &IncidentView) -> Vec<Piece> {
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
    lines.push(Piece::default());
    if incident.coverage.is_empty() {
        lines.push(("Nothing was recorded in that time.".to_owned(), Role::Dim));
    }
    lines.extend(incident.coverage.iter().flat_map(|one| topic(state, one)));
    lines
}

fn note(note: &IncidentNoteView) -> Vec<Piece> {
    let mut lines = note.text.lines().map(|line| clean(line, 2_000));
    let first = lines.next().unwrap_or_default();
    let rest = lines.map(|line| (format!("  {line}"), Role::Body));
    std::iter::once((format!("{}  {first}", day(note.at)), Role::Body)).chain(rest).collect()
}

fn topic(state: &State, one: &SpanCoverageView) -> Vec<Piece> {
    let name = clean(&one.topic, 255);
    let mut lines = match (one.first, one.last) {
        (Some(first), Some(last)) => {
            vec![(format!("{name}  {}, {}", counted(one.records, "record"), from_to(state, first, last)), Role::Body)]
        }
        _ if one.quarantined > 0 => vec![(format!("{name}  no record"), Role::Warning)],
        _ => vec![(format!("{name}  nothing in that time: check the name and whether it is watched"), Role::Warning)],
    };
    let missing =
        [(one.lost, "lost"), (one.quarantined, "in quarantine"), (one.deleted, "deleted earlier by retention")];
    let missing: Vec<String> = missing
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, word)| format!("{} {word}", words::count(count)))
        .collect();
    if !missing.is_empty() {
        lines.push((format!("  {}", missing.join(", ")), Role::Warning));
    }
    lines
}

pub fn from_to(state: &State, first: Timestamp, last: Timestamp) -> String {
    if first.seconds() / DAY == last.seconds() / DAY {
        return format!("{} to {}", state.clock(first), state.clock(last));
    }
    format!("{} to {}", day(first), day(last))
}
