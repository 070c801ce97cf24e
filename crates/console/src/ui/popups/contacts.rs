//! The address book.

use ratatui::layout::Rect;

use super::framed;
use crate::app::State;
use crate::app::contacts::Book;
use crate::app::feed::Feed;
use crate::model::clean;
use crate::service::reply::ContactRow;
use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::theme::Role;
use crate::ui::topics::empty;

/// Columns of a name.
const NAME: u16 = 15;
/// Columns of an address, whole.
const ADDRESS: u16 = 43;
/// The greatest width of the list.
const WIDEST: u16 = 124;

/// Draws the list, and below it the keys of the contact under the cursor.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, book: &Book) {
    let count = u16::try_from(state.contacts.len().max(1)).unwrap_or(u16::MAX);
    let width = WIDEST.min(area.width.saturating_sub(6));
    let inner = framed(canvas, area, "Address book", width, count.saturating_add(3));
    let Some(chosen) = book.chosen(state) else {
        let text = empty(state, Feed::Contacts, "Nobody yet: n adds a contact.");
        canvas.put(inner, text, Role::Dim);
        return;
    };
    let list = Rect { height: inner.height.saturating_sub(3).max(1), ..inner };
    let height = usize::from(list.height);
    let selected = book.selected.min(state.contacts.len().saturating_sub(1));
    let first = selected - selected % height;
    for (place, (index, contact)) in (0u16..).zip(state.contacts.iter().enumerate().skip(first).take(height)) {
        draw_row(canvas, row(list, place), contact, index == selected);
    }
    let keys =
        |fingerprint: &Option<String>| fingerprint.as_deref().map_or_else(|| "none".to_owned(), |text| clean(text, 60));
    let noted = format!("noted       {}", keys(&chosen.fingerprint));
    let given = if chosen.given { "" } else { "  (from the chain, not confirmed by a person)" };
    canvas.puts(row(inner, inner.height.saturating_sub(2)), &[(&noted, Role::Body), (given, Role::Dim)]);
    canvas.put(
        row(inner, inner.height.saturating_sub(1)),
        &format!("registered  {}", keys(&chosen.registered)),
        Role::Body,
    );
}

fn draw_row(canvas: &mut Canvas, line: Rect, contact: &ContactRow, here: bool) {
    canvas.put(line, if here { "▌" } else { " " }, Role::Accent);
    let name = Rect { width: NAME.min(line.width.saturating_sub(1)), ..right_of(line, 1) };
    canvas.put(name, &contact.name.to_string(), if here { Role::Selection } else { Role::Body });
    let rest = right_of(line, NAME + 2);
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
