//! A topic's publishers: pinned, suspect, quarantined.

use crate::app::{Key, Lookup, Popup, State, Verb};
use crate::model::{clean, counted};
use crate::screens::{grants::state::day, topics::draw::watch_rule};
use crate::service::Failure;
use crate::service::reply::{AlarmView, PinView, PinsView};
use crate::ui::{Canvas, Piece, Rect, Role, draw_lines, frame};

pub fn key(state: &mut State, mut lookup: Lookup<PinsView>, key: Key) -> Option<Verb> {
    match key {
        Key::Char('p') => return Some(Verb::Pin),
        Key::Char('P') => return Some(Verb::Unpin),
        _ => {}
    }
    if lookup.scrolls(key, state.page_rows(), |found| found.pins.len() * 3 + found.alarms.len() * 3 + 4) {
        state.popups.push(Popup::Publishers(lookup));
    }
    None
}

pub fn answered(state: &mut State, topic: &str, answer: Result<PinsView, Failure>) {
    state.tell(topic, answer, |popup| if let Popup::Publishers(lookup) = popup { Some(lookup) } else { None });
}

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, lookup: &Lookup<PinsView>) {
    let width = area.width.saturating_sub(6).min(100);
    let lines = frame::answered(lookup, width, |view| publishers(state, &lookup.id, view), |line| line);
    draw_lines(canvas, area, &format!("Publishers of {}", lookup.id), &lines, lookup.scroll);
}

fn publishers(state: &State, topic: &str, view: &PinsView) -> Vec<Piece> {
    let mut lines = Vec::new();
    let row = state.topics.rows.iter().find(|row| row.topic == topic);
    let now = row.map_or_else(String::new, |row| row.publishers.join(" "));
    lines.extend(coverage_lines(state, topic));
    let rule = row.and_then(watch_rule);
    lines.extend(rule.map(|rule| (format!("watched {rule}; l on Topics changes how much is kept"), Role::Body)));
    lines.push((format!("now     {}", if now.is_empty() { "nobody" } else { &now }), Role::Body));
    if view.pins.is_empty() {
        lines.push(("no publisher is pinned yet: the first one captured will be".to_owned(), Role::Dim));
    }
    lines.extend(view.pins.iter().flat_map(|pin| pinned(pin, &now)));
    lines.extend(view.alarms.iter().flat_map(alarm));
    if let Some(held) = row.map(|row| row.quarantined).filter(|held| *held > 0) {
        lines.push((
            format!("{} quarantined: r releases, D discards (on the screen)", counted(held, "message")),
            Role::Warning,
        ));
    }
    lines
}

/// From when to when, a strip of signs, and their meaning.
pub fn coverage_lines(state: &State, topic: &str) -> Vec<Piece> {
    let Some((of, answer)) = &state.detail.coverage else { return Vec::new() };
    let views = match answer {
        _ if of != topic => return Vec::new(),
        Err(failure) => return vec![(clean(&failure.message, 500), Role::Bad)],
        Ok(views) => views,
    };
    let Some(view) = views.first().filter(|view| view.first.is_some()) else {
        return vec![("No records of this topic yet.".to_owned(), Role::Dim), Piece::default()];
    };
    vec![
        (format!("Records from {} to {} UTC", day(view.since), day(view.until)), Role::Title),
        (view.strip(), Role::Accent),
        (view.legend(), Role::Dim),
        Piece::default(),
    ]
}

fn pinned(pin: &PinView, now: &str) -> [Piece; 2] {
    let publisher = &pin.publisher;
    let there =
        if now.split(' ').any(|name| name == publisher.caller_id) { "publishing now" } else { "not publishing" };
    let since = pin.at.map_or_else(String::new, |at| format!(" since {}", at.in_milliseconds()));
    [
        (format!("pinned  {} at {}, {there}", publisher.caller_id, publisher.host), Role::Good),
        (format!("        {} {}, by {}{since}", publisher.type_name, publisher.md5sum, pin.source), Role::Dim),
    ]
}

fn alarm(alarm: &AlarmView) -> [Piece; 2] {
    let (word, role) = if alarm.open { ("ALARM", Role::Bad) } else { ("decided", Role::Dim) };
    [
        (format!("{word}  {}: {}", alarm.publisher, reason(&alarm.reason)), role),
        (format!("        raised {}", alarm.at), Role::Dim),
    ]
}

fn reason(word: &str) -> &str {
    match word {
        "new" => "not among the pinned publishers",
        "host" => "a pinned name on another host",
        "type" => "a pinned name with another type",
        "replaced" => "took over the name of a running publisher",
        "undecided" => "restart or rival: cannot be determined",
        "unconfirmed" => "not confirmed by the master",
        other => other,
    }
}
