//! The columns of a list, each with a box that says whether it is shown.

use ratatui::layout::Rect;

use super::framed;
use crate::app::columns::{ALWAYS, ColumnChoice, Offered, offered, wanted};
use crate::app::{Screen, State, detail};
use crate::ui::canvas::{Canvas, right_of, row};
use crate::ui::table::Layout;
use crate::ui::theme::Role;
use crate::ui::{records, topics};

/// Columns of the window.
const WIDTH: u16 = 66;
/// Columns of the cursor and the box.
const BOX: u16 = 5;
/// Columns of a name.
const NAME: u16 = 12;

/// Draws the choice.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, choice: &ColumnChoice) {
    let Some(table) = state.table() else { return };
    let all = match state.screen {
        Screen::Topics => topics::COLUMNS,
        screen => records::all_columns(screen),
    };
    let width = detail::list_width(state);
    let shown = wanted(state.screen, table, width);
    let left_out = Layout::new(all, state.screen, table, width).left_out;
    let offered = offered(state.screen);
    let title = format!("Columns of {}", state.screen.title());
    let inner = framed(canvas, area, &title, WIDTH, u16::try_from(offered.len()).unwrap_or(u16::MAX));
    let height = usize::from(inner.height.max(1));
    let selected = choice.selected.min(offered.len().saturating_sub(1));
    let first = selected - selected % height;
    for (line, (index, column)) in (0u16..).zip(offered.iter().enumerate().skip(first).take(height)) {
        let fits = !left_out.contains(&column.name);
        draw_column(canvas, row(inner, line), column, (index == selected, shown.contains(&column.name), fits));
    }
}

fn draw_column(canvas: &mut Canvas, line: Rect, column: &Offered, (here, shown, fits): (bool, bool, bool)) {
    canvas.put(line, if here { "▌" } else { " " }, Role::Accent);
    let (mark, role) = match (shown, column.name == ALWAYS) {
        (true, true) => ("[x]", Role::Dim),
        (true, false) => ("[x]", Role::Key),
        (false, _) => ("[ ]", Role::Body),
    };
    canvas.put(right_of(line, 1), mark, role);
    let rest = right_of(line, BOX);
    canvas.put(
        Rect { width: NAME.min(rest.width), ..rest },
        column.name,
        if here { Role::Selection } else { Role::Body },
    );
    let words = right_of(rest, NAME + 1);
    if fits {
        canvas.put(words, column.words, Role::Dim);
    } else {
        canvas.put(words, "no room for it in this terminal", Role::Warning);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_that_is_offered_is_drawn_and_in_the_same_order() {
        for screen in [Screen::Topics, Screen::Uploads, Screen::Shared] {
            let all = if screen == Screen::Topics { topics::COLUMNS } else { records::all_columns(screen) };
            let drawn: Vec<&str> = all.iter().map(|column| column.name).filter(|name| !name.is_empty()).collect();
            let named: Vec<&str> = offered(screen).iter().map(|column| column.name).collect();
            assert_eq!(drawn, named, "{screen:?}");
        }
    }
}
