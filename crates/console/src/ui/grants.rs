//! The Grants screen.

use ratatui::layout::Rect;

use super::canvas::Canvas;
use super::table::{Column, Sheet, draw as draw_table, order};
use super::theme::Role;
use super::topics::empty;
use crate::app::State;
use crate::app::feed::Feed;
use crate::app::screens::grants::{SORTS, day, is_active, is_given, key, other_side, scope, soon};
use crate::service::reply::GrantRow;

const COLUMNS: &[Column] = &[
    Column::text("State", 8),
    Column::text("", 8),
    Column::text("Account", 13),
    Column::text("Full address", 42).from(130),
    Column::text("SM2 fingerprint", 39).from(180),
    Column::name("Topics"),
    Column::number("Epoch", 6),
    Column::text("Ends UTC", 18).from(75),
    Column::number("Block", 8).from(100),
];

/// Draws the screen.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let grants = &state.grants;
    let rows = grants.visible();
    let keys: Vec<String> = rows.iter().map(|row| key(row)).collect();
    let readers = grants.rows.iter().filter(|row| is_given(row) && is_active(row)).count();
    let order = order(&SORTS, &grants.table);
    let note = format!("{} of {}, by {order}; {readers} can read new records now", rows.len(), grants.rows.len());
    let cells = |index: usize| rows.get(index).map_or_else(Vec::new, |row| cells(state, row));
    let empty = empty(state, Feed::Grants, "No grants given or received yet; press g to grant.");
    let sheet = Sheet {
        title: "Grants",
        note,
        columns: COLUMNS,
        keys: &keys,
        cells: &cells,
        table: &grants.table,
        empty,
        old: false,
    };
    draw_table(canvas, area, &sheet);
}

/// When it ends: if soon, by the time left, with the clock beside it.
fn ends(state: &State, row: &GrantRow) -> (String, Role) {
    let Some(end) = row.expires else { return ("no end".to_owned(), Role::Dim) };
    match soon(row.expires, state.shown_at()).filter(|_| is_active(row)) {
        Some(left) => (format!("{left}, {}", end.clock().get(..5).unwrap_or_default()), Role::Warning),
        None => (day(end), Role::Dim),
    }
}

fn cells(state: &State, row: &GrantRow) -> Vec<(String, Role)> {
    let role = if is_active(row) { Role::Good } else { Role::Dim };
    let direction = if is_given(row) { "given to" } else { "got from" };
    vec![
        (row.state.word().to_owned(), role),
        (direction.to_owned(), Role::Body),
        (row.name.clone().unwrap_or_else(|| other_side(row).short()), Role::Accent),
        (other_side(row).to_string(), Role::Dim),
        (row.fingerprint.clone().unwrap_or_else(|| "not registered".to_owned()), Role::Dim),
        (scope(&row.topics), Role::Body),
        (if row.earlier == Some(true) { "all".to_owned() } else { row.epoch.to_string() }, Role::Body),
        ends(state, row),
        (row.block.to_string(), Role::Dim),
    ]
}
