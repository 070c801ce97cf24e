//! The colours of rows: where the cursor is, and what is not a warning.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;

use super::{Action, Robot, at, draw, fixtures, night};
use crate::app::{Screen, State};
use crate::ui::theme::Role;

fn drawn(state: &State) -> Buffer {
    let (columns, rows) = state.size;
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("a terminal");
    terminal.draw(|frame| drop(draw(frame, state, &night()))).expect("drawn");
    terminal.backend().buffer().clone()
}

/// The characters of a row with their columns.
fn row_of(buffer: &Buffer, row: u16) -> Vec<(u16, String)> {
    (0..buffer.area().width).map(|column| (column, buffer[(column, row)].symbol().to_owned())).collect()
}

/// The rows that end in the mark of what is simulated, with the column of its first letter.
fn simulated(buffer: &Buffer) -> Vec<(u16, u16)> {
    let marked = |row: u16| {
        let text: String = row_of(buffer, row).into_iter().map(|(_, symbol)| symbol).collect();
        let list = text.chars().take_while(|character| *character != '│').collect::<String>();
        let ended = ["SIM", "SIMULATED"].into_iter().find(|mark| list.trim_end().ends_with(&format!(" {mark}")))?;
        let end = u16::try_from(list.trim_end().chars().count()).ok()?;
        Some((row, end - u16::try_from(ended.len()).ok()?))
    };
    (2..buffer.area().height).filter_map(marked).collect()
}

#[test]
fn the_row_of_the_cursor_is_lit_at_both_ends_where_it_is_long() {
    for (size, lit) in [((80, 24), false), ((120, 40), true)] {
        let buffer = drawn(&at(Screen::Topics, size).state);
        let selection = night().style(Role::Selection);
        let is_lit = |column: u16, row: u16| {
            buffer[(column, row)].style().fg == selection.fg
                && buffer[(column, row)].style().add_modifier.contains(selection.add_modifier)
        };
        let rows = simulated(&buffer);
        assert!(rows.len() > 1, "{size:?}: {rows:?}");
        for (row, end) in rows {
            let here = buffer[(0, row)].symbol() == "▌";
            assert_eq!((is_lit(2, row), is_lit(end, row)), (here, here && lit), "{size:?}, row {row}");
        }
    }
}

#[test]
fn amber_is_for_what_is_wrong_and_not_for_what_is_simulated() {
    let warning = night().style(Role::Warning).fg;
    for screen in [Screen::Topics, Screen::Records, Screen::Received] {
        for size in [(80, 24), (120, 40)] {
            let buffer = drawn(&at(screen, size).state);
            for (row, column) in simulated(&buffer) {
                assert_ne!(buffer[(column, row)].style().fg, warning, "{screen:?}, {size:?}, row {row}");
            }
        }
    }
}

#[test]
fn robots_come_before_their_gateway_which_keeps_three_rows() {
    for (size, count) in [((80, 24), 0_u8), ((80, 24), 40), ((120, 40), 0), ((200, 50), 40)] {
        let mut robot = Robot::at_work(true);
        robot.act(Action::Resize { columns: size.0, rows: size.1 });
        let many = (10..10 + count).map(|device| fixtures::robots::robot(&format!("robot-{device}"), device));
        fixtures::robots::shows(&mut robot, fixtures::robots::robots().into_iter().chain(many).collect());
        let buffer = drawn(&robot.state);
        let text = |row: u16| row_of(&buffer, row).into_iter().map(|(_, symbol)| symbol).collect::<String>();
        let find = |words: &str| (2..buffer.area().height).find(|row| text(*row).contains(words));
        let heads = text(find("Last UTC").expect("heads"));
        for head in ["State", "Robot", "Lag", "Lost", "Policy"] {
            assert!(heads.contains(head), "{size:?}: {heads}");
        }
        assert!(size.0 != 120 || heads.contains("Delivers to"), "{heads}");
        let (first, listens) = (find("robot1"), find("Listens"));
        assert!(first.is_some() && first < listens && find("Fingerprint").is_some(), "{size:?}: {first:?} {listens:?}");
        let row = text(find("rover").expect("a row"));
        for part in ["active", "4 s", " 7 ", "policy 3 waiting, runs 2"] {
            assert!(row.contains(part), "{size:?}: {row}");
        }
    }
}
