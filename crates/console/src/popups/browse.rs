//! What to browse: owners, topics, types, times.

use crate::app::{Field, Key, Popup, Screen, State, moved, rows};
use crate::model::{clean, natural};
use crate::screens::grants::state::{end, is_active, is_given, scope};
use crate::service::reply::RecordView;
use crate::ui::{Canvas, Rect, Role, draw_list, framed, name_role, right_of, rows};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Choice {
    pub text: String,
    pub note: String,
    pub filter: String,
}

pub fn choices(state: &State) -> Vec<Choice> {
    let mut all = vec![choice("All records", String::new(), String::new())];
    if state.screen == Screen::Records {
        let watched = state.topics.rows.iter().filter(|row| row.watched || row.messages > 0);
        all.extend(watched.map(|row| choice(&row.topic, format!("{} captured", row.messages), row.topic.clone())));
        all.extend(seen(&state.records.rows, &all));
        let states = ["stored", "verified", "quarantined", "tampered"];
        all.extend(states.map(|word| choice(word, "by state".to_owned(), format!("state:{word}"))));
    } else {
        all.extend(shared(state));
        all.extend(seen(&state.received.rows, &all));
    }
    all.push(choice("the last hour", "by time of capture".to_owned(), "since:1h".to_owned()));
    all.push(choice("the last day", "by time of capture".to_owned(), "since:1d".to_owned()));
    all
}

fn choice(text: &str, note: String, filter: String) -> Choice {
    Choice { text: text.to_owned(), note, filter }
}

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

/// Topics and types of the visible page that are not choices yet.
fn seen(rows: &[RecordView], known: &[Choice]) -> Vec<Choice> {
    let mut seen: Vec<Choice> = Vec::new();
    for row in rows {
        seen.push(choice(&row.topic, "a topic on this page".to_owned(), row.topic.clone()));
        seen.push(choice(&row.type_name, "a type on this page".to_owned(), format!("type:{}", row.type_name)));
    }
    seen.sort_by(|one, other| natural(&one.filter, &other.filter));
    seen.dedup();
    let is_new = |choice: &Choice| !choice.text.is_empty() && known.iter().all(|other| other.filter != choice.filter);
    seen.into_iter().filter(is_new).collect()
}

pub fn key(state: &mut State, selected: usize, key: Key) {
    let choices = choices(state);
    match key {
        Key::Escape | Key::Char('q') => {}
        Key::Enter => {
            if let (Some(choice), Some(table)) = (choices.get(moved(selected, choices.len(), key)), state.table_mut()) {
                table.filter = Field::with(&choice.filter);
            }
            rows::restart_records(state);
        }
        _ => state.popups.push(Popup::Browse(moved(selected, choices.len(), key))),
    }
}

const TEXT: u16 = 34;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, selected: usize) {
    let choices = choices(state);
    let inner = framed(canvas, area, "Browse", 76, rows(choices.len()));
    draw_list(canvas, inner, &choices, selected, |canvas, line, choice, here| {
        canvas.put(Rect { width: TEXT.min(line.width), ..line }, &clean(&choice.text, 255), name_role(here));
        canvas.put(right_of(line, TEXT + 1), &clean(&choice.note, 255), Role::Dim);
    });
}
