//! Popups in which one of a few is chosen: what to browse, a theme, a list's columns.

use super::form::Field;
use super::keymap::Key;
use super::popup::{Popup, moved};
use super::screens::{end, is_active, is_given, scope};
use super::table::{self, Table};
use super::verb::Effect;
use super::{Screen, State};
use crate::service::reply::RecordView;

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
    seen.sort_by(|one, other| one.filter.cmp(&other.filter));
    seen.dedup();
    let is_new = |choice: &Choice| !choice.text.is_empty() && known.iter().all(|other| other.filter != choice.filter);
    seen.into_iter().filter(is_new).collect()
}

pub fn browse_key(state: &mut State, selected: usize, key: Key) {
    let choices = choices(state);
    match key {
        Key::Escape | Key::Char('q') => {}
        Key::Enter => {
            if let (Some(choice), Some(table)) = (choices.get(moved(selected, choices.len(), key)), state.table_mut()) {
                table.filter = Field::with(&choice.filter);
            }
            table::restart_records(state);
        }
        _ => state.popups.push(Popup::Browse(moved(selected, choices.len(), key))),
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThemeChoice {
    pub selected: usize,
    /// The previous theme, which Esc restores.
    pub before: String,
}

pub fn choose(state: &mut State) {
    let before = state.theme.clone();
    let selected = state.settings.themes.iter().position(|name| *name == before).unwrap_or(0);
    state.popups.push(Popup::Themes(ThemeChoice { selected, before }));
}

pub fn theme_key(state: &mut State, mut choice: ThemeChoice, key: Key) {
    let themes = &state.settings.themes;
    match key {
        Key::Escape | Key::Char('q') => return state.effects.push(Effect::ShowTheme(choice.before)),
        Key::Enter => {
            let kept = themes.get(choice.selected).cloned().unwrap_or(choice.before);
            return state.inform(format!("theme: {kept}; to make it permanent, set console.theme in config.toml"));
        }
        Key::Char('T') => choice.selected = moved(choice.selected, themes.len(), Key::Down),
        _ => choice.selected = moved(choice.selected, themes.len(), key),
    }
    state.effects.extend(themes.get(choice.selected).cloned().map(Effect::ShowTheme));
    state.popups.push(Popup::Themes(choice));
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Offered {
    /// Its name, as in `:columns topic,state`.
    pub name: &'static str,
    pub words: &'static str,
    /// The width of the list from which it is usually shown, columns.
    pub from: u16,
}

/// The column every list shows: it carries the cursor.
pub const ALWAYS: &str = "topic";
/// Shown only if chosen.
const NEVER: u16 = u16::MAX;

const fn column(name: &'static str, from: u16, words: &'static str) -> Offered {
    Offered { name, words, from }
}

const TOPICS: &[Offered] = &[
    column("topic", 0, "Name of the topic (always shown)"),
    column("type", 150, "Message type"),
    column("publishers", 170, "Nodes that publish it"),
    column("pinned", 90, "Whether its publishers are pinned"),
    column("watched", 0, "Whether it is captured, or why not"),
    column("kept", NEVER, "How many of its messages are kept: every one, or by a rule"),
    column("hz", 0, "Messages a second"),
    column("rate", 0, "Kilobytes a second"),
    column("line", 110, "The last 16 seconds as a line"),
    column("captured", 130, "Messages captured so far"),
    column("lost", 70, "Messages lost: in transport, in the recorder"),
    column("age", 80, "Time since the last message"),
];

/// Of records: name, widths from which Records and Received show it usually, words.
const RECORDS: [(&str, [Option<u16>; 2], &str); 12] = [
    ("state", [Some(0), Some(0)], "Record state"),
    ("owner", [None, Some(0)], "Who shares it"),
    ("topic", [Some(0), Some(0)], "Name of the topic (always shown)"),
    ("type", [Some(120), Some(120)], "Message type"),
    ("seq", [Some(0), Some(0)], "Number of the record"),
    ("size", [Some(0), Some(0)], "Size of the message"),
    ("time", [Some(0), Some(70)], "When it was captured"),
    ("epoch", [Some(130), Some(130)], "Epoch of its key"),
    ("block", [Some(100), Some(110)], "Block that anchors it"),
    ("id", [Some(140), Some(150)], "Its id"),
    ("digest", [Some(NEVER), Some(NEVER)], "Beginning of its SM3 digest"),
    ("transaction", [Some(NEVER), Some(NEVER)], "Beginning of the transaction's hash"),
];

pub fn offered(screen: Screen) -> Vec<Offered> {
    let of_list = |list: usize| {
        let found = RECORDS.iter().filter_map(|(name, from, words)| Some(column(name, from[list]?, words)));
        found.collect()
    };
    match screen {
        Screen::Topics => TOPICS.to_vec(),
        Screen::Records => of_list(0),
        Screen::Received => of_list(1),
        Screen::Overview | Screen::Grants | Screen::Keys | Screen::Chain | Screen::Robots | Screen::Log => Vec::new(),
    }
}

/// Chosen columns in order, or else the usual ones for that width.
pub fn wanted(screen: Screen, table: &Table, width: u16) -> Vec<&'static str> {
    if !table.columns.is_empty() {
        return table.columns.clone();
    }
    offered(screen).iter().filter(|column| column.from <= width).map(|column| column.name).collect()
}

/// Those `names` that the screen offers, each once, plus [`ALWAYS`].
pub fn known<'a>(screen: Screen, names: impl IntoIterator<Item = &'a str>) -> Result<Vec<&'static str>, &'a str> {
    let mut found: Vec<&'static str> = Vec::new();
    for name in names {
        let column = offered(screen).into_iter().find(|column| column.name == name).ok_or(name)?;
        if !found.contains(&column.name) {
            found.push(column.name);
        }
    }
    if !found.is_empty() && !found.contains(&ALWAYS) {
        found.insert(0, ALWAYS);
    }
    Ok(found)
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColumnChoice {
    pub selected: usize,
    /// Restored by Esc.
    pub before: Vec<&'static str>,
}

pub fn open(state: &mut State) {
    let before = state.table().map(|table| table.columns.clone()).unwrap_or_default();
    state.popups.push(Popup::Columns(ColumnChoice { selected: 0, before }));
}

/// `columns topic,state,size` of the palette; `columns usual` goes back to the usual ones.
pub fn spoken(state: &mut State, words: &[&str]) {
    let screen = state.screen;
    let names: Vec<String> =
        words.iter().flat_map(|word| word.split(',')).filter(|name| !name.is_empty()).map(str::to_lowercase).collect();
    let chosen = match names.as_slice() {
        [usual] if usual == "usual" => Ok(Vec::new()),
        names => known(screen, names.iter().map(String::as_str)),
    };
    match chosen {
        Ok(chosen) => set(state, chosen),
        Err(name) => {
            let offered: Vec<&str> = offered(screen).iter().map(|column| column.name).collect();
            state.inform(format!("no column is named '{name}'; there are {}, and usual", offered.join(" ")));
        }
    }
}

fn set(state: &mut State, chosen: Vec<&'static str>) {
    if let Some(table) = state.table_mut() {
        table.columns = chosen;
    }
}

pub fn column_key(state: &mut State, mut choice: ColumnChoice, key: Key) {
    let offered = offered(state.screen);
    match key {
        Key::Escape => return set(state, choice.before),
        Key::Enter | Key::Char('q') => return,
        Key::Char('r') => set(state, Vec::new()),
        Key::Char(' ' | '<' | '>') => {
            let name = offered.get(choice.selected).map(|column| column.name);
            let now = state.table().map(|table| wanted(state.screen, table, super::opening::list_width(state)));
            if let (Some(name), Some(now)) = (name, now) {
                let changed = if key == Key::Char(' ') {
                    toggled(state.screen, now, name)
                } else {
                    swapped(now, name, key == Key::Char('>'))
                };
                set(state, changed);
            }
        }
        _ => choice.selected = moved(choice.selected, offered.len(), key),
    }
    state.popups.push(Popup::Columns(choice));
}

/// Adds a column at its usual place if the others are at theirs, otherwise at the end.
fn toggled(screen: Screen, mut now: Vec<&'static str>, name: &'static str) -> Vec<&'static str> {
    if name == ALWAYS {
        return now;
    }
    if let Some(place) = now.iter().position(|other| *other == name) {
        now.remove(place);
        return now;
    }
    let usual = |name: &&str| offered(screen).iter().position(|column| column.name == *name);
    let in_order = now.is_sorted_by_key(usual);
    now.push(name);
    if in_order {
        now.sort_by_key(usual);
    }
    now
}

fn swapped(mut now: Vec<&'static str>, name: &str, right: bool) -> Vec<&'static str> {
    if let Some(place) = now.iter().position(|other| *other == name) {
        let wanted = if right { (place + 1).min(now.len() - 1) } else { place.saturating_sub(1) };
        now.swap(place, wanted);
    }
    now
}
