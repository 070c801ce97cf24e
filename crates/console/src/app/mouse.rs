//! The mouse, if the operator wants it: the wheel moves the cursor, a click chooses a screen or a row. It is off by
//! default, so that the terminal's own selection works.

use super::action::Effect;
use super::key::Key;
use super::perform::perform;
use super::popup_keys::popup_key;
use super::screen::Screen;
use super::state::State;
use super::verb::Verb;

/// Rows above the first row of a list: header, screens, title, columns.
const ABOVE: u16 = 4;

/// Takes the mouse, or leaves it to the terminal.
pub fn toggle(state: &mut State) -> Vec<Effect> {
    state.mouse = !state.mouse;
    let text = if state.mouse {
        "mouse on; hold shift to select text in most terminals"
    } else {
        "mouse off; the terminal handles text selection again"
    };
    state.inform(text);
    vec![Effect::Mouse(state.mouse)]
}

/// The wheel was turned.
pub fn wheel(state: &mut State, up: bool) -> Vec<Effect> {
    if state.popups.is_empty() {
        return perform(state, if up { Verb::Up } else { Verb::Down });
    }
    popup_key(state, if up { Key::Up } else { Key::Down })
}

/// A cell was clicked.
pub fn click(state: &mut State, column: u16, row: u16) {
    if !state.popups.is_empty() {
        return;
    }
    if row == 1 {
        if let Some(screen) = named_at(state.size.0, column) {
            state.screen = screen;
        }
        return;
    }
    // The rows of this screen begin lower, and are in two parts.
    if state.screen == Screen::Gateway {
        return;
    }
    let Some(line) = row.checked_sub(ABOVE).map(usize::from).filter(|line| *line < state.page_rows()) else { return };
    let keys = state.row_keys();
    let page = state.page_rows();
    if let Some(table) = state.table() {
        let here = table.position(&keys);
        let wanted = here - here % page + line;
        if wanted < keys.len() {
            super::cursor::select(state, wanted);
        }
    }
}

/// The screen whose name is there; if names do not fit, nothing can be clicked.
fn named_at(columns: u16, column: u16) -> Option<Screen> {
    let gap = Screen::ALL.iter().map(|screen| screen.title().len() + 3).sum::<usize>() < usize::from(columns);
    let mut left = 0;
    let wide_enough = columns >= 80;
    Screen::ALL.into_iter().filter(|_| wide_enough).find(|screen| {
        let from = left;
        left += screen.title().len() + 2 + usize::from(gap);
        (from..left - 1).contains(&usize::from(column))
    })
}
