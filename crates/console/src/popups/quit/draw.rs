//! Leaving on screen.

use ratatui::layout::Rect;

use crate::app::State;
use crate::popups::quit::state::Leaving;
use crate::ui::{Canvas, Role, draw_text};

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, leaving: Leaving) {
    let hints = leaving.hints(state);
    // Four hints fit 80 columns only with narrow gaps.
    let gap = if hints.len() > 3 { "  " } else { "    " };
    let answer: Vec<(&str, Role)> = hints
        .iter()
        .flat_map(|(key, word)| [(*key, Role::Key), (" ", Role::Body), (*word, Role::Body), (gap, Role::Body)])
        .collect();
    draw_text(canvas, area, "Quit?", &leaving.lines(state), &answer);
}
