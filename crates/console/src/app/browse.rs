//! Browsing records: those of others by owner, own ones by topic and state, both by type and time; a choice sets the
//! filter of the list.

use super::action::Effect;
use super::cursor;
use super::field::Field;
use super::key::Key;
use super::popup::Popup;
use super::screen::Screen;
use super::screens::grants::{end, is_active, is_given, scope};
use super::state::State;
use crate::service::reply::RecordView;

/// One thing to choose.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Choice {
    /// The text shown.
    pub text: String,
    /// The text beside it.
    pub note: String,
    /// The filter that it sets.
    pub filter: String,
}

/// A list to choose from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Browse {
    /// The selected line.
    pub selected: usize,
}

/// All present choices: everything, each owner who shares, topics, types, times.
pub fn choices(state: &State) -> Vec<Choice> {
    let mut all = vec![choice("All records", String::new(), String::new())];
    if state.screen == Screen::Uploads {
        let watched = state.topics.rows.iter().filter(|row| row.watched || row.messages > 0);
        all.extend(watched.map(|row| choice(&row.topic, format!("{} captured", row.messages), row.topic.clone())));
        all.extend(seen(&state.uploads.rows, &all));
        let states = ["sealed", "verified", "quarantined", "tampered"];
        all.extend(states.map(|word| choice(word, "by state".to_owned(), format!("state:{word}"))));
    } else {
        all.extend(shared(state));
        all.extend(seen(&state.shared.rows, &all));
    }
    all.push(choice("the last hour", "by time of capture".to_owned(), "since:1h".to_owned()));
    all.push(choice("the last day", "by time of capture".to_owned(), "since:1d".to_owned()));
    all
}

fn choice(text: &str, note: String, filter: String) -> Choice {
    Choice { text: text.to_owned(), note, filter }
}

/// Each owner who shares, and the topics.
fn shared(state: &State) -> Vec<Choice> {
    let mut all = Vec::new();
    let received = state.grants.rows.iter().filter(|row| !is_given(row) && is_active(row));
    for row in received {
        let word = row.name.clone().unwrap_or_else(|| row.owner.to_string());
        let note = format!("shares {}, {}", scope(&row.topics), end(row.expires));
        all.push(choice(&row.name.clone().unwrap_or_else(|| row.owner.short()), note, format!("owner:{word}")));
        let topics = row.topics.iter().map(|topic| {
            choice(&format!("  {topic}"), "one of the shared topics".to_owned(), format!("owner:{word} {topic}"))
        });
        all.extend(topics);
    }
    all
}

/// Topics and types of the visible page that are not among the choices yet.
fn seen(rows: &[RecordView], known: &[Choice]) -> Vec<Choice> {
    let mut seen: Vec<Choice> = Vec::new();
    for row in rows {
        seen.push(choice(&row.topic, "a topic on this page".to_owned(), row.topic.clone()));
        seen.push(choice(&row.type_name, "a type on this page".to_owned(), format!("type:{}", row.type_name)));
    }
    seen.sort_by(|one, other| one.filter.cmp(&other.filter));
    seen.dedup();
    let is_new = |choice: &Choice| !choice.text.is_empty() && known.iter().all(|other| other.filter != choice.filter);
    seen.into_iter().filter(is_new).collect()
}

/// A key while the list is open.
pub fn key(state: &mut State, mut browse: Browse, key: Key) -> Vec<Effect> {
    let choices = choices(state);
    let last = choices.len().saturating_sub(1);
    match key {
        Key::Escape | Key::Char('q') => return Vec::new(),
        Key::Enter => {
            if let Some(choice) = choices.get(browse.selected.min(last)) {
                if let Some(table) = state.table_mut() {
                    table.filter = Field::with(&choice.filter);
                }
                cursor::restart_records(state);
            }
            return Vec::new();
        }
        Key::Up | Key::Char('k') => browse.selected = browse.selected.min(last).saturating_sub(1),
        Key::Down | Key::Char('j') => browse.selected = (browse.selected + 1).min(last),
        Key::Home => browse.selected = 0,
        Key::End => browse.selected = last,
        _ => {}
    }
    state.popups.push(Popup::Browse(browse));
    Vec::new()
}
