//! Keys of the incidents: noted, closed, removed; their contents.

use crate::app::{Confirm, Errand, Feed, Field, Key, Popup, Purpose, Screen, State, Tag, moved, rows};
use crate::model::{IncidentName, Timestamp, counted};
use crate::popups::{form::evidence, incidents, incidents::state::Deed, incidents::state::IncidentList};
use crate::screens::grants::state::day;
use crate::service::{command::CloseIncident, command::RemoveIncident, reply::IncidentView};

/// No event reports what incidents contain, so the console asks, nanoseconds.
const ASKED_EVERY: u64 = 10_000_000_000;

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
        (Key::Char('n'), _) if changes => incidents::form::begin(state),
        (Key::Char('a'), Some(row)) if changes => {
            state.popups.push(Popup::Form(Purpose::NoteIncident, incidents::form::note_form(&row.name)));
        }
        (Key::Char('c'), Some(row)) if changes && row.open => state.popups.push(Popup::Confirm(closing(state, &row))),
        (Key::Char('x'), Some(row)) if changes => state.popups.push(Popup::Confirm(removal(&row))),
        (Key::Char('y'), Some(row)) => {
            let line = state.command_line(&format!("incident show {}", row.name));
            state.copy(line);
        }
        (Key::Char('e'), Some(row)) => evidence::begin(state, &row.name),
        _ => {}
    }
}

/// Records, filtered to the incident.
fn show_records(state: &mut State, name: &IncidentName) {
    state.go(Screen::Records);
    state.records.table.filter = Field::with(&format!("incident:{name}"));
    state.records.table.filtering = false;
    rows::restart_records(state);
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
        format!("It holds   {}", counted(row.records, "record")),
        "Its notes are deleted, and retention may delete what no other incident holds.".to_owned(),
        "What retention deletes cannot be restored: export it first (e).".to_owned(),
    ];
    let tag = Tag::Incident(Deed::Remove, row.name.clone());
    let errand = Errand { command: RemoveIncident { name: row.name.clone() }.into(), tag };
    Confirm { title: format!("Remove incident {}?", row.name), lines, yes: "remove", typed: None, errand }
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
