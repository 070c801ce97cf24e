//! The address book on screen: names for accounts and their known keys; adding, confirming, removing.

use super::action::{Effect, Errand, Tag};
use super::feed::Feed;
use super::form::{Form, Line};
use super::granting;
use super::key::Key;
use super::perform::copy;
use super::popup::{Confirm, Popup, Purpose};
use super::state::State;
use crate::app::form::Field;
use crate::model::{Address, ContactName};
use crate::service::Command;
use crate::service::reply::ContactRow;

/// The list, with its cursor.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Book {
    /// The selected line.
    pub selected: usize,
}

impl Book {
    /// The contact under the cursor.
    pub fn chosen<'a>(&self, state: &'a State) -> Option<&'a ContactRow> {
        state.contacts.get(self.selected.min(state.contacts.len().saturating_sub(1)))
    }
}

/// Opens the list.
pub fn open(state: &mut State) {
    state.feeds.slot_mut(Feed::Contacts).stale = true;
    state.popups.push(Popup::Contacts(Book::default()));
}

/// The actions here, by key.
pub fn hints(state: &State) -> Vec<(&'static str, &'static str)> {
    let changes = [("n", "new"), ("g", "grant"), ("c", "confirm key"), ("x", "remove")];
    let changes = changes.into_iter().filter(|(key, _)| !state.settings.read_only && (*key == "n" || any(state)));
    let looks = [("y", "copy address")].into_iter().filter(|_| any(state));
    changes.chain(looks).chain([("q", "close")]).collect()
}

fn any(state: &State) -> bool {
    !state.contacts.is_empty()
}

/// A key while the list is open.
pub fn key(state: &mut State, mut book: Book, key: Key) -> Vec<Effect> {
    let last = state.contacts.len().saturating_sub(1);
    match key {
        Key::Escape | Key::Char('q') => return Vec::new(),
        Key::Up | Key::Char('k') => book.selected = book.selected.min(last).saturating_sub(1),
        Key::Down | Key::Char('j') => book.selected = (book.selected + 1).min(last),
        Key::Home => book.selected = 0,
        Key::End | Key::Char('G') => book.selected = last,
        _ => {}
    }
    let chosen = book.chosen(state).cloned();
    state.popups.push(Popup::Contacts(book));
    let changes = !state.settings.read_only;
    match (key, chosen) {
        (Key::Char('n'), _) if changes => state.popups.push(Popup::Form(Purpose::AddContact, form())),
        (Key::Char('x'), Some(row)) if changes => state.popups.push(Popup::Confirm(removal(&row))),
        (Key::Char('c'), Some(row)) if changes => state.popups.push(Popup::Confirm(confirmation(&row))),
        (Key::Char('g'), Some(row)) if changes => granting::begin_for(state, &row.name.to_string()),
        (Key::Char('y'), Some(row)) => return vec![copy(state, row.address.to_string())],
        _ => {}
    }
    Vec::new()
}

/// Asks for a new contact.
pub fn form() -> Form {
    let lines = vec![
        Line::text("Name", "such as bob", Field::default()),
        Line::text("Address", "0x and 40 hex", Field::default()),
        Line::text("Fingerprint", "empty = the registered key", Field::default()),
    ];
    let notes = vec![
        "A name for an account in this home's forms, lists and commands.".to_owned(),
        "The fingerprint is checked from then on: get it from its owner.".to_owned(),
    ];
    Form::new("New contact", notes, lines)
}

/// The command of a completed [`form`].
///
/// # Errors
/// The field in error, and why.
pub fn read(form: &Form) -> Result<Errand, (usize, String)> {
    let name: ContactName = form.text(0).trim().parse().map_err(|error| (0, format!("{error}")))?;
    let address: Address = form.text(1).trim().parse().map_err(|error| (1, format!("{error}")))?;
    let fingerprint = Some(form.text(2).trim().to_owned()).filter(|text| !text.is_empty());
    let tag = Tag::Contact(name.to_string());
    Ok(Errand { command: Command::AddContact { name, address, fingerprint }, tag })
}

fn removal(row: &ContactRow) -> Confirm {
    let lines = vec![
        format!("{}  {}", row.name, row.address),
        "Grants to this account stay active; they are then listed by address.".to_owned(),
    ];
    let tag = Tag::Contact(row.name.to_string());
    let errand = Errand { command: Command::RemoveContact { name: row.name.clone() }, tag };
    Confirm { title: format!("Remove {} from the address book?", row.name), lines, yes: "remove", typed: None, errand }
}

fn confirmation(row: &ContactRow) -> Confirm {
    let or_none = |text: &Option<String>| text.clone().unwrap_or_else(|| "none".to_owned());
    let lines = vec![
        format!("Noted       {}", or_none(&row.fingerprint)),
        format!("Registered  {}", or_none(&row.registered)),
        String::new(),
        "Ask its owner over another channel first: from now on the registered key counts as genuine.".to_owned(),
    ];
    let tag = Tag::Contact(row.name.to_string());
    let command = Command::ConfirmContact { name: row.name.clone(), fingerprint: row.registered.clone() };
    let errand = Errand { command, tag };
    Confirm { title: format!("Is this the key of {}?", row.name), lines, yes: "it is", typed: None, errand }
}
