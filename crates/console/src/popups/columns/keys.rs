//! Keys of the choice of a list's columns.

use crate::app::{Key, Popup, Screen, State, moved};
use crate::popups::columns;
use crate::popups::columns::state::{ALWAYS, ColumnChoice, known, offered};
use crate::screens::pane;

pub const HINTS: [(&str, &str); 6] =
    [("space", "show/hide"), ("<", "left"), (">", "right"), ("r", "usual"), ("enter", "keep"), ("esc", "cancel")];

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

pub fn key(state: &mut State, mut choice: ColumnChoice, key: Key) {
    let offered = offered(state.screen);
    match key {
        Key::Escape => return set(state, choice.before),
        Key::Enter | Key::Char('q') => return,
        Key::Char('r') => set(state, Vec::new()),
        Key::Char(' ' | '<' | '>') => {
            let name = offered.get(choice.selected).map(|column| column.name);
            let now =
                state.table().map(|table| columns::state::wanted(state.screen, table, pane::follow::list_width(state)));
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
