//! The choice of a list's columns on screen.

use crate::app::{Screen, State};
use crate::popups::columns;
use crate::popups::columns::state::{ALWAYS, ColumnChoice, offered};
use crate::screens::{pane, records::draw::columns_of, topics::draw::COLUMNS};
use crate::ui::{Canvas, Column, Layout, Rect, Role, draw_list, framed, name_role, right_of, rows};

const WIDTH: u16 = 66;
const BOX: u16 = 4;
const COLUMNS_NAME: u16 = 12;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, choice: &ColumnChoice) {
    let Some(table) = state.table() else { return };
    let width = pane::follow::list_width(state);
    let shown = columns::state::wanted(state.screen, table, width);
    let left_out = Layout::new(&all(state.screen), state.screen, table, width).left_out;
    let offered = offered(state.screen);
    let title = format!("Columns of {}", state.screen.title());
    let inner = framed(canvas, area, &title, WIDTH, rows(offered.len()));
    draw_list(canvas, inner, &offered, choice.selected, |canvas, line, column, here| {
        let (mark, role) = match (shown.contains(&column.name), column.name == ALWAYS) {
            (true, true) => ("[x]", Role::Dim),
            (true, false) => ("[x]", Role::Key),
            (false, _) => ("[ ]", Role::Body),
        };
        canvas.put(line, mark, role);
        let rest = right_of(line, BOX);
        canvas.put(Rect { width: COLUMNS_NAME.min(rest.width), ..rest }, column.name, name_role(here));
        let (words, role) = match left_out.contains(&column.name) {
            true => ("no room for it in this terminal", Role::Warning),
            false => (column.words, Role::Dim),
        };
        canvas.put(right_of(rest, COLUMNS_NAME + 1), words, role);
    });
}

fn all(screen: Screen) -> Vec<Column> {
    if screen == Screen::Topics { COLUMNS.to_vec() } else { columns_of(screen) }
}

#[cfg(test)]
mod columns_tests {
    use super::*;

    #[test]
    fn every_column_that_is_offered_is_drawn_and_in_the_same_order() {
        for screen in [Screen::Topics, Screen::Records, Screen::Received] {
            let all = all(screen);
            let drawn: Vec<&str> = all.iter().map(|column| column.name).filter(|name| !name.is_empty()).collect();
            let named: Vec<&str> = offered(screen).iter().map(|column| column.name).collect();
            assert_eq!(drawn, named, "{screen:?}");
        }
    }
}
