//! Incidents on screen: opened from the row under the cursor, noted, closed, removed; their contents.

use super::form::{Field, Form, Line, Wrong};
use super::keymap::Key;
use super::perform::{copy, go};
use super::popup::{Confirm, Popup, Purpose, moved};
use super::screens::day;
use super::update::Feed;
use super::verb::{Errand, Tag};
use super::{Screen, State, evidence, granting, palette, table};
use crate::model::{Direction, IncidentName, Timestamp, counted};
use crate::service::command::{CloseIncident, NoteIncident, OpenIncident, RemoveIncident};
use crate::service::reply::IncidentView;

/// Seconds kept before and after a record.
const AROUND: u64 = 600;
/// [`AROUND`] before now, as typed.
const BEFORE_NOW: &str = "10m";
/// No event reports what incidents contain, so the console asks, nanoseconds.
const ASKED_EVERY: u64 = 10_000_000_000;
/// Characters of the topics' line.
const LONGEST_TOPICS: usize = 200;
const TOPICS: usize = 3;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deed {
    Open,
    Note,
    Close,
    Remove,
}

impl Deed {
    pub fn words(self, name: &IncidentName) -> String {
        match self {
            Self::Open => format!("opening incident {name}"),
            Self::Note => format!("adding a note to incident {name}"),
            Self::Close => format!("closing incident {name}"),
            Self::Remove => format!("removing incident {name}"),
        }
    }

    /// Why it cannot be taken back; `None` = removing undoes it.
    pub fn stays(self) -> Option<&'static str> {
        match self {
            Self::Open => None,
            Self::Note => Some("a note cannot be removed from its incident"),
            Self::Close => Some("the span has ended; I opens another incident from there"),
            Self::Remove => Some("what it held may be deleted by now; I keeps what is left"),
        }
    }
}

#[derive(Debug, Clone, Default)]
pub struct Incidents {
    /// In the order of the site.
    pub rows: Vec<IncidentView>,
    /// When the site answered.
    told_at: Timestamp,
}

impl Incidents {
    pub fn set(&mut self, rows: Vec<IncidentView>, now: Timestamp) {
        (self.rows, self.told_at) = (rows, now);
    }

    pub fn put(&mut self, view: IncidentView) {
        match self.rows.iter_mut().find(|row| row.name == view.name) {
            Some(row) => *row = view,
            None => self.rows.push(view),
        }
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct IncidentList {
    pub selected: usize,
    /// First line shown of the contents.
    pub scroll: usize,
}

impl IncidentList {
    pub fn chosen<'a>(&self, state: &'a State) -> Option<&'a IncidentView> {
        let rows = &state.incidents.rows;
        rows.get(self.selected.min(rows.len().saturating_sub(1)))
    }
}

pub fn open(state: &mut State) {
    state.feeds.slot_mut(Feed::Incidents).stale = true;
    state.popups.push(Popup::Incidents(IncidentList::default()));
}

pub fn asked_at(state: &State) -> Option<Timestamp> {
    let seen = matches!(state.popups.last(), Some(Popup::Incidents(_))) && !state.is_frozen();
    let goes_on = state.incidents.rows.iter().any(|row| row.open);
    (seen && goes_on).then(|| Timestamp(state.incidents.told_at.0.saturating_add(ASKED_EVERY)))
}

/// Key, word of the bar, sentence of the help.
fn possible(state: &State, list: &IncidentList) -> Vec<[&'static str; 3]> {
    let chosen = list.chosen(state);
    let changes = !state.settings.read_only;
    let (one, open) = (chosen.is_some(), chosen.is_some_and(|row| row.open));
    let all = [
        (["n", "new", "Open an incident, filled in from the row behind this window"], changes),
        (["enter", "records", "Show its records on the Records screen"], one),
        (["a", "note", "Add a note; exported bundles include notes"], changes && one),
        (["c", "close", "End its span now; its records stay held"], changes && open),
        (["x", "remove", "Remove it: retention may then delete what only it held"], changes && one),
        (["y", "copy command", "Copy the equivalent command line"], one),
        (["e", "export", "Export it as an evidence bundle, and choose what becomes readable"], one),
        (["q", "back", "Close this window"], true),
        (["pgup pgdn", "scroll", "Scroll what the incident holds"], one),
    ];
    all.into_iter().filter(|(_, possible)| *possible).map(|(told, _)| told).collect()
}

pub fn hints(state: &State, list: &IncidentList) -> Vec<(&'static str, &'static str)> {
    possible(state, list).into_iter().map(|[key, word, _]| (key, word)).collect()
}

pub fn explained(state: &State, list: &IncidentList) -> Vec<(&'static str, &'static str)> {
    possible(state, list).into_iter().map(|[key, _, sentence]| (key, sentence)).collect()
}

pub fn key(state: &mut State, mut list: IncidentList, key: Key) {
    let before = list.selected;
    match key {
        Key::Escape | Key::Char('q') => return,
        Key::PageUp => list.scroll = list.scroll.saturating_sub(state.page_rows() / 2),
        Key::PageDown | Key::Char(' ') => {
            let most = list.chosen(state).map_or(0, |row| row.coverage.len() * 3 + row.notes.len() * 4);
            list.scroll = (list.scroll + state.page_rows() / 2).min(most);
        }
        _ => list.selected = moved(before, state.incidents.rows.len(), key),
    }
    if list.selected != before {
        list.scroll = 0;
    }
    let chosen = list.chosen(state).cloned();
    if let (Key::Enter, Some(row)) = (key, &chosen) {
        return show_records(state, &row.name);
    }
    state.popups.push(Popup::Incidents(list));
    let changes = !state.settings.read_only;
    match (key, chosen) {
        (Key::Char('n'), _) if changes => begin(state),
        (Key::Char('a'), Some(row)) if changes => {
            state.popups.push(Popup::Form(Purpose::NoteIncident, note_form(&row.name)));
        }
        (Key::Char('c'), Some(row)) if changes && row.open => state.popups.push(Popup::Confirm(closing(state, &row))),
        (Key::Char('x'), Some(row)) if changes => state.popups.push(Popup::Confirm(removal(&row))),
        (Key::Char('y'), Some(row)) => {
            let line = palette::of_words(state, &format!("incident show {}", row.name));
            copy(state, line);
        }
        (Key::Char('e'), Some(row)) => evidence::begin(state, &row.name),
        _ => {}
    }
}

/// Records, filtered to the incident.
fn show_records(state: &mut State, name: &IncidentName) {
    go(state, Screen::Records);
    state.records.table.filter = Field::with(&format!("incident:{name}"));
    state.records.table.filtering = false;
    table::restart_records(state);
}

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
            topics.sort();
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
        notes.push(format!("{left} more topics do not fit here; use `authros incident open`."));
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
    form.focus == TOPICS && granting::complete_from(form, &names)
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

fn note_form(name: &IncidentName) -> Form {
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

fn closing(state: &State, row: &IncidentView) -> Confirm {
    let ends = row.until.filter(|until| *until <= state.now);
    let ends = ends.map_or_else(|| "now".to_owned(), |until| format!("{} UTC, as it was opened", day(until)));
    let lines = vec![
        format!("It ends    {ends}"),
        "Its records stay held until you remove it (x). It cannot be reopened.".to_owned(),
    ];
    let tag = Tag::Incident(Deed::Close, row.name.clone());
    let errand = Errand { command: CloseIncident { name: row.name.clone() }.into(), tag };
    Confirm { title: format!("Close incident {}?", row.name), lines, yes: "close it", typed: None, errand }
}

fn removal(row: &IncidentView) -> Confirm {
    let lines = vec![
        format!("It holds   {} records", row.records),
        "Its notes are deleted, and retention may delete what no other incident holds.".to_owned(),
        "What retention deletes cannot be restored: export it first (e).".to_owned(),
    ];
    let tag = Tag::Incident(Deed::Remove, row.name.clone());
    let errand = Errand { command: RemoveIncident { name: row.name.clone() }.into(), tag };
    Confirm { title: format!("Remove incident {}?", row.name), lines, yes: "remove", typed: None, errand }
}

pub fn taken_back(name: &IncidentName) -> Errand {
    let tag = Tag::Incident(Deed::Remove, name.clone());
    Errand { command: RemoveIncident { name: name.clone() }.into(), tag }
}

pub fn changed(state: &mut State, deed: Deed, view: IncidentView) {
    let held = counted(view.records, "record");
    let text = match deed {
        Deed::Open => format!("incident {}: {held} kept so far (U: undo)", view.name),
        Deed::Note => format!("incident {}: note added", view.name),
        Deed::Close => format!("incident {} closed; {held} stay held", view.name),
        Deed::Remove => format!("incident {} removed", view.name),
    };
    state.incidents.put(view);
    state.inform(text);
}
