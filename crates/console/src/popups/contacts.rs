//! The address book.

use crate::app::{Confirm, Errand, Feed, Field, Form, Key, Line, Popup, Purpose, State, Tag, Wrong, moved};
use crate::model::{Address, ContactName, clean};
use crate::popups::form::grant;
use crate::service::{Command, reply::ContactRow};
use crate::ui::{Canvas, Rect, Role, draw_list, empty, framed, name_role, right_of, row, rows};

pub fn chosen(state: &State, selected: usize) -> Option<&ContactRow> {
    state.contacts.get(selected.min(state.contacts.len().saturating_sub(1)))
}

pub fn open(state: &mut State) {
    state.feeds.slot_mut(Feed::Contacts).stale = true;
    state.popups.push(Popup::Contacts(0));
}

pub fn hints(state: &State) -> Vec<(&'static str, &'static str)> {
    let any = !state.contacts.is_empty();
    let changes = [("n", "new"), ("g", "grant"), ("c", "confirm key"), ("x", "remove")];
    let changes = changes.into_iter().filter(|(key, _)| !state.settings.read_only && (*key == "n" || any));
    let looks = any.then_some(("y", "copy address"));
    changes.chain(looks).chain([("q", "close")]).collect()
}

pub fn key(state: &mut State, selected: usize, key: Key) {
    if matches!(key, Key::Escape | Key::Char('q')) {
        return;
    }
    let selected = moved(selected, state.contacts.len(), key);
    let chosen = chosen(state, selected).cloned();
    state.popups.push(Popup::Contacts(selected));
    let changes = !state.settings.read_only;
    match (key, chosen) {
        (Key::Char('n'), _) if changes => state.popups.push(Popup::Form(Purpose::AddContact, form())),
        (Key::Char('x'), Some(row)) if changes => state.popups.push(Popup::Confirm(removal(&row))),
        (Key::Char('c'), Some(row)) if changes => state.popups.push(Popup::Confirm(confirmation(&row))),
        (Key::Char('g'), Some(row)) if changes => grant::open(state, &row.name.to_string(), &[], ""),
        (Key::Char('y'), Some(row)) => state.copy(row.address.to_string()),
        _ => {}
    }
}

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

pub fn read(form: &Form) -> Result<Errand, Wrong> {
    let (name, address): (ContactName, Address) = (form.parsed(0)?, form.parsed(1)?);
    let fingerprint = form.typed(2).map(str::to_owned);
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

const CONTACTS_NAME: u16 = 15;
const ADDRESS: u16 = 43;
const WIDEST: u16 = 124;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, selected: usize) {
    let width = WIDEST.min(area.width.saturating_sub(6));
    let inner = framed(canvas, area, "Address book", width, rows(state.contacts.len().max(1)).saturating_add(3));
    let Some(chosen) = chosen(state, selected) else {
        let text = empty(state, Feed::Contacts, "Nobody yet: n adds a contact.");
        canvas.put(inner, text, Role::Dim);
        return;
    };
    let list = Rect { height: inner.height.saturating_sub(3).max(1), ..inner };
    draw_list(canvas, list, &state.contacts, selected, draw_contact);
    let keys =
        |fingerprint: &Option<String>| fingerprint.as_deref().map_or_else(|| "none".to_owned(), |text| clean(text, 60));
    let noted = format!("noted       {}", keys(&chosen.fingerprint));
    let given = if chosen.given { "" } else { "  (from the chain, not confirmed by a person)" };
    canvas.puts(row(inner, inner.height.saturating_sub(2)), &[(&noted, Role::Body), (given, Role::Dim)]);
    let registered = format!("registered  {}", keys(&chosen.registered));
    canvas.put(row(inner, inner.height.saturating_sub(1)), &registered, Role::Body);
}

fn draw_contact(canvas: &mut Canvas, line: Rect, contact: &ContactRow, here: bool) {
    let name = Rect { width: CONTACTS_NAME.min(line.width), ..line };
    canvas.put(name, &contact.name.to_string(), name_role(here));
    let rest = right_of(line, CONTACTS_NAME + 1);
    let whole = rest.width > ADDRESS + 10;
    let address = if whole { contact.address.to_string() } else { contact.address.short() };
    canvas.put(rest, &address, Role::Accent);
    let role = match contact.state.as_str() {
        "same" => Role::Good,
        "differs" => Role::Bad,
        _ => Role::Dim,
    };
    canvas.put(right_of(rest, if whole { ADDRESS } else { 15 }), &clean(&contact.state, 20), role);
}
