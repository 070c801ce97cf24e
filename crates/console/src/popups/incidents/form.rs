//! An incident opened from the row under the cursor, and a note for one.

use crate::app::{Errand, Feed, Field, Form, Line, Popup, Purpose, Screen, State, Tag, Wrong, completion};
use crate::model::{Direction, IncidentName, Timestamp, counted, natural};
use crate::popups::incidents::state::Deed;
use crate::screens::grants::state::day;
use crate::service::command::{NoteIncident, OpenIncident};

/// Seconds kept before and after a record.
const AROUND: u64 = 600;

/// [`AROUND`] before now, as typed.
const BEFORE_NOW: &str = "10m";

/// Characters of the topics' line.
const LONGEST_TOPICS: usize = 200;

const TOPICS: usize = 3;

/// Span and topics of the marked rows, or of the one under the cursor.
struct Around {
    since: String,
    until: String,
    topics: Vec<String>,
    at: Timestamp,
}

fn around(state: &State) -> Around {
    let now = Around { since: BEFORE_NOW.to_owned(), until: String::new(), topics: Vec::new(), at: state.now };
    match state.screen {
        Screen::Topics => {
            Around { topics: state.topics.targets().into_iter().map(|row| row.topic.clone()).collect(), ..now }
        }
        Screen::Records => {
            let marks = &state.records.table.marks;
            let key = state.row_key();
            let is_it = |id: &String| if marks.is_empty() { Some(id) == key.as_ref() } else { marks.contains(id) };
            let rows: Vec<_> = state.records.rows.iter().filter(|row| is_it(&row.id)).collect();
            let times = || rows.iter().map(|row| row.captured_at);
            let (Some(first), Some(last)) = (times().min(), times().max()) else { return now };
            let until = Timestamp::from_seconds(last.seconds().saturating_add(AROUND));
            let mut topics: Vec<String> = rows.iter().map(|row| row.topic.clone()).collect();
            topics.sort_by(|one, other| natural(one, other));
            topics.dedup();
            Around {
                since: Timestamp::from_seconds(first.seconds().saturating_sub(AROUND)).to_string(),
                // A span that reaches into the future stays open.
                until: if until <= state.now { until.to_string() } else { String::new() },
                topics,
                at: first,
            }
        }
        _ => now,
    }
}

/// Fills the form from the marked rows, or else from the row under the cursor.
pub fn begin(state: &mut State) {
    let form = form(&around(state));
    state.feeds.slot_mut(Feed::Incidents).stale = true;
    state.popups.push(Popup::Form(Purpose::OpenIncident, form));
}

fn form(around: &Around) -> Form {
    let (topics, left) = fitting(&around.topics);
    let lines = vec![
        Line::text("Name", "such as crash-1114", Field::offering(&suggested(&around.topics, around.at))),
        Line::text("From", "10m, yesterday 18:00, 2023-05-31 08:30", Field::offering(&around.since))
            .time(Direction::Back),
        Line::text("To", "empty = when it is closed; 5m, 2036-12-31", Field::offering(&around.until))
            .time(Direction::Back),
        Line::text("Topics", "topic names, /robot*/camera/**; empty = all", Field::offering(&topics)),
        Line::text("Note", "what happened", Field::default()),
    ];
    let mut notes = vec!["Protects what was recorded in this time from retention.".to_owned()];
    if left > 0 {
        notes.push(format!("No room here for {}; use `authros incident open`.", counted(left as u64, "more topic")));
    }
    Form::new("New incident", notes, lines)
}

/// Whole names only, and how many found no room.
fn fitting(topics: &[String]) -> (String, usize) {
    let mut line = String::new();
    for (place, topic) in topics.iter().enumerate() {
        let width = line.chars().count() + 1 + topic.chars().count();
        if width > LONGEST_TOPICS {
            return (line, topics.len() - place);
        }
        line = if line.is_empty() { topic.clone() } else { format!("{line} {topic}") };
    }
    (line, 0)
}

/// `odom-1114-2213`: topic and time.
fn suggested(topics: &[String], at: Timestamp) -> String {
    let last = topics.first().and_then(|topic| topic.rsplit('/').find(|part| !part.is_empty())).unwrap_or_default();
    let plain: String = last.chars().filter(|letter| letter.is_ascii_alphanumeric() || *letter == '_').collect();
    let what: String = plain.trim_start_matches('_').chars().take(40).collect();
    let what = if what.is_empty() { "incident" } else { &what };
    let digits: String = day(at).chars().filter(char::is_ascii_digit).collect();
    match (digits.get(4..8), digits.get(8..12)) {
        (Some(date), Some(time)) => format!("{what}-{date}-{time}"),
        _ => what.to_owned(),
    }
}

pub fn complete(state: &State, form: &mut Form) -> bool {
    let names: Vec<String> = state.topics.rows.iter().map(|row| row.topic.clone()).collect();
    form.focus == TOPICS && completion::complete_from(form, &names)
}

pub fn read(state: &State, form: &Form) -> Result<Errand, Wrong> {
    let name: IncidentName = form.parsed(0)?;
    if state.incidents.rows.iter().any(|row| row.name == name) {
        return Err((0, format!("an incident {name} already exists; choose another name")));
    }
    let times = state.times();
    let since = times.back(form.text(1)).map_err(|error| (1, error.to_string()))?;
    if since > state.now {
        return Err((1, "that is in the future; enter a past time".to_owned()));
    }
    let until = form.typed(2).map(|text| times.back(text)).transpose().map_err(|error| (2, error.to_string()))?;
    if until.is_some_and(|until| until <= since) {
        return Err((2, "it would end before it begins; enter a later time".to_owned()));
    }
    let (topics, note) = (form.patterns(TOPICS)?, form.typed(4).map(str::to_owned));
    let tag = Tag::Incident(Deed::Open, name.clone());
    Ok(Errand { command: OpenIncident { name, since, until, topics, note, robots: Vec::new() }.into(), tag })
}

pub fn note_form(name: &IncidentName) -> Form {
    let lines = vec![
        Line::text("Incident", "such as crash-1114", Field::with(name.as_str())),
        Line::text("Note", "what is known now", Field::default()),
    ];
    let notes = vec!["Notes are permanent and included in exported bundles.".to_owned()];
    let mut form = Form::new("Note for an incident", notes, lines);
    form.focus = 1;
    form
}

pub fn read_note(form: &Form) -> Result<Errand, Wrong> {
    let name: IncidentName = form.parsed(0)?;
    let text = form.typed(1).ok_or_else(|| (1, "type the note, or press esc".to_owned()))?.to_owned();
    let tag = Tag::Incident(Deed::Note, name.clone());
    Ok(Errand { command: NoteIncident { name, text }.into(), tag })
}
