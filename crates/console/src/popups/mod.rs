//! The popups, a folder or a file each: a popup is a value with keys, hints, the answer to what it asked for, and a
//! picture. Which is meant is told apart here, and nowhere else.

pub mod alerts;
pub mod browse;
pub mod chord;
pub mod confirm;
pub mod contacts;
pub mod help;
pub mod line;
pub mod lookup;
pub mod palette;
pub mod provenance;
pub mod publishers;
pub mod quit;
pub mod readers;
pub mod robot;
pub mod state;
pub mod tasks;
pub mod themes;
pub mod columns {
    pub mod draw;
    pub mod keys;
    pub mod state;
}
pub mod form {
    pub mod draw;
    pub mod evidence;
    pub mod export;
    pub mod grant;
    pub mod identity;
    pub mod keys;
    pub mod limit;
    pub mod policy;
    pub mod profile;
}
pub mod incidents {
    pub mod draw;
    pub mod form;
    pub mod keys;
    pub mod state;
}
pub mod record {
    pub mod draw;
    pub mod keys;
    pub mod state;
}

use self::state::Help;
use crate::app::{Key, Popup, State, Verb};
use crate::ui::{Canvas, Rect, Role, draw_text};

type Hints = Vec<(&'static str, &'static str)>;

/// The keys of the bar.
#[deny(clippy::wildcard_enum_match_arm)]
pub fn hints(state: &State, popup: &Popup) -> Hints {
    match popup {
        Popup::Palette(_) => vec![("enter", "run"), ("up down", "choose, earlier"), ("esc", "close")],
        Popup::Help(Help { filtering: true, .. }) => vec![("enter", "apply"), ("esc", "clear")],
        Popup::Help(_) => vec![("up down", "scroll"), ("/", "filter"), ("q", "close")],
        Popup::Confirm(confirm) => confirm::hints(state, confirm),
        Popup::Form(_, form) => form::keys::hints(form),
        Popup::Provenance(_) => vec![("n p", "next/prev"), ("up down", "scroll"), ("q", "close")],
        Popup::Record(opening) => opening.hints(),
        Popup::Chord(_) => vec![("esc", "close")],
        Popup::Themes(_) => vec![("up down", "preview"), ("enter", "keep"), ("esc", "cancel")],
        Popup::Columns(_) => columns::keys::HINTS.to_vec(),
        Popup::Publishers(_) => vec![("up down", "scroll"), ("p", "pin"), ("P", "unpin"), ("q", "close")],
        Popup::Tasks | Popup::Readers(_) => vec![("q", "close")],
        Popup::Alerts(_) => vec![("up down", "scroll"), ("q", "close")],
        Popup::Unlocked => vec![("enter", "close"), ("esc", "close")],
        Popup::Line(_) => vec![("y", "copy"), ("q", "close")],
        Popup::Browse(_) => vec![("enter", "show these"), ("up down", "choose"), ("q", "close")],
        Popup::Contacts(_) => contacts::hints(state),
        Popup::Incidents(list) => incidents::keys::hints(state, list),
        Popup::Robot(_) => robot::hints(state),
        Popup::Quit(leaving) => leaving.hints(state),
    }
}

/// The topmost popup has the keys; what it returns is to be performed.
#[deny(clippy::wildcard_enum_match_arm)]
pub fn key(state: &mut State, key: Key) -> Option<Verb> {
    if key == Key::Char('?') && !state.popups.last().is_some_and(Popup::takes_text) {
        let window = state.popups.last().map(|popup| explained(state, popup));
        state.popups.push(Popup::Help(Help { window, ..Help::default() }));
        return None;
    }
    let popup = state.popups.pop()?;
    let quitting = matches!(popup, Popup::Quit(_));
    let key = if key == Key::Control('c') && !quitting { Key::Escape } else { key };
    match popup {
        Popup::Palette(palette) => return palette::key(state, palette, key),
        Popup::Chord(begun) => return chord::key(state, begun, key),
        Popup::Record(opening) => return record::keys::key(state, opening, key),
        Popup::Provenance(lookup) => return provenance::key(state, lookup, key),
        Popup::Publishers(lookup) => return publishers::key(state, lookup, key),
        Popup::Form(purpose, form) => form::keys::key(state, purpose, form, key),
        Popup::Confirm(confirm) => confirm::key(state, confirm, key),
        Popup::Quit(leaving) => quit::key(state, leaving, key),
        Popup::Themes(choice) => themes::key(state, choice, key),
        Popup::Columns(choice) => columns::keys::key(state, choice, key),
        Popup::Browse(selected) => browse::key(state, selected, key),
        Popup::Contacts(selected) => contacts::key(state, selected, key),
        Popup::Incidents(list) => incidents::keys::key(state, list, key),
        Popup::Robot(lookup) => robot::key(state, lookup, key),
        Popup::Alerts(scroll) => alerts::key(state, scroll, key),
        Popup::Line(line) => line::key(state, line, key),
        Popup::Help(help) => help::key(state, help, key),
        Popup::Tasks | Popup::Readers(_) if matches!(key, Key::Char('q' | 't' | 'i')) => {}
        Popup::Tasks | Popup::Readers(_) | Popup::Unlocked if matches!(key, Key::Escape | Key::Enter) => {}
        Popup::Tasks | Popup::Readers(_) | Popup::Unlocked => state.popups.push(popup),
    }
    None
}

/// What the help of this window says of its keys.
fn explained(state: &State, popup: &Popup) -> Hints {
    if let Popup::Incidents(list) = popup { incidents::keys::explained(state, list) } else { hints(state, popup) }
}

#[deny(clippy::wildcard_enum_match_arm)]
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, popup: &Popup) {
    match popup {
        Popup::Palette(palette) => palette::draw(canvas, area, state, palette),
        Popup::Help(help) => help::draw(canvas, area, state, help),
        Popup::Confirm(confirm) => confirm::draw(canvas, area, state, confirm),
        Popup::Form(_, form) => form::draw::draw(canvas, area, state, form),
        Popup::Provenance(lookup) => provenance::draw(canvas, area, lookup),
        Popup::Record(opening) => record::draw::draw(canvas, area, opening),
        Popup::Chord(pressed) => chord::draw(canvas, area, state, pressed),
        Popup::Themes(choice) => themes::draw(canvas, area, state, choice),
        Popup::Columns(choice) => columns::draw::draw(canvas, area, state, choice),
        Popup::Robot(lookup) => robot::draw(canvas, area, state, lookup),
        Popup::Publishers(lookup) => publishers::draw(canvas, area, state, lookup),
        Popup::Readers(topics) => readers::draw(canvas, area, state, topics),
        Popup::Line(line) => line::draw(canvas, area, line),
        Popup::Unlocked => {
            let lines = ["The keyring is already unlocked: no passphrase is needed.".to_owned()];
            draw_text(canvas, area, "Keyring", &lines, &[("enter", Role::Key), (" close", Role::Body)]);
        }
        Popup::Tasks => tasks::draw(canvas, area, state),
        Popup::Alerts(scroll) => alerts::draw(canvas, area, state, *scroll),
        Popup::Browse(selected) => browse::draw(canvas, area, state, *selected),
        Popup::Contacts(selected) => contacts::draw(canvas, area, state, *selected),
        Popup::Incidents(list) => incidents::draw::draw(canvas, area, state, list),
        Popup::Quit(leaving) => quit::draw(canvas, area, state, *leaving),
    }
}
