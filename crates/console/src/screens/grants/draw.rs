//! The Grants screen.

use crate::app::{Feed, Screen, State};
use crate::screens::grants;
use crate::screens::grants::state::{day, is_active, is_given, other_side, scope, soon};
use crate::service::reply::GrantRow;
use crate::ui::{Canvas, Column, Rect, Role, Sheet, empty, table, words};

const GRANT_COLUMNS: &[Column] = &[
    Column::text("State", 8),
    Column::text("", 8),
    Column::text("Account", 13),
    Column::text("Full address", 42).from(130),
    Column::text("SM2 fingerprint", 39).from(180),
    Column::name("Topics"),
    Column::text("Opens since UTC", 16).from(100),
    Column::number("Records", 9),
    Column::text("Ends UTC", 18).from(75),
    Column::number("Block", 8).from(100),
];

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let (grants, table) = (&state.grants, &state.grants.table);
    let rows = grants.visible();
    let keys: Vec<String> = rows.iter().map(|row| grants::state::key(row)).collect();
    let readers = grants.rows.iter().filter(|row| is_given(row) && is_active(row)).count();
    let order = table::order(Screen::Grants, table);
    let note = format!("{} of {}, by {order}; {readers} can read new records now", rows.len(), grants.rows.len());
    let cells = |index: usize| rows.get(index).map_or_else(Vec::new, |row| grant_cells(state, row));
    let empty = empty(state, Feed::Grants, "No grants given or received yet; press g to grant.");
    let (title, columns) = ("Grants", GRANT_COLUMNS);
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table, empty, old: false };
    table::draw(canvas, area, &sheet);
}

/// An end soon shows the time left beside the clock.
fn ends(state: &State, row: &GrantRow) -> (String, Role) {
    let Some(end) = row.expires else { return ("no end".to_owned(), Role::Dim) };
    match soon(row.expires, state.shown_at()).filter(|_| is_active(row)) {
        Some(left) => (format!("{left}, {}", end.clock().get(..5).unwrap_or_default()), Role::Warning),
        None => (day(end), Role::Dim),
    }
}

fn grant_cells(state: &State, row: &GrantRow) -> Vec<(String, Role)> {
    let role = if is_active(row) { Role::Good } else { Role::Dim };
    let direction = if is_given(row) { "given to" } else { "got from" };
    vec![
        (row.state.word().to_owned(), role),
        (direction.to_owned(), Role::Body),
        (row.name.clone().unwrap_or_else(|| other_side(row).short()), Role::Accent),
        (other_side(row).to_string(), Role::Dim),
        (row.fingerprint.clone().unwrap_or_else(|| "not registered".to_owned()), Role::Dim),
        (scope(&row.topics), Role::Body),
        (row.opens.and_then(|opens| opens.since).map_or_else(|| "-".to_owned(), day), Role::Dim),
        (row.opens.map_or_else(|| "-".to_owned(), |opens| words::count(opens.records)), Role::Body),
        ends(state, row),
        (row.block.to_string(), Role::Dim),
    ]
}
