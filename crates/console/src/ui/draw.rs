//! The whole screen: bars, the screen in view, the topmost popup, the strip of the tour.

use ratatui::Frame;
use ratatui::layout::Rect;

use super::bars;
use super::canvas::{Canvas, Placement, flatten, row};
use super::theme::{Role, Theme};
use crate::app::{State, tour::Tour};
use crate::screens::pane;
use crate::{popups, screens};

/// Columns of the smallest supported terminal.
pub const LEAST_COLUMNS: u16 = 60;
/// Rows of the smallest supported terminal.
pub const LEAST_ROWS: u16 = 18;

/// Returns the picture left to the terminal.
pub fn draw(frame: &mut Frame, state: &State, theme: &Theme) -> Option<Placement> {
    let area = frame.area();
    let mut canvas = Canvas::new(frame.buffer_mut(), theme);
    if area.width < LEAST_COLUMNS || area.height < LEAST_ROWS {
        let size = format!("Terminal too small: {}x{}, need {LEAST_COLUMNS}x{LEAST_ROWS}", area.width, area.height);
        canvas.put(area, &size, Role::Warning);
    } else {
        draw_whole(&mut canvas, area, state);
    }
    let (cursor, placement) = (canvas.cursor, canvas.placement());
    if theme.ascii {
        flatten(frame.buffer_mut());
    }
    if let Some(position) = cursor {
        frame.set_cursor_position(position);
    }
    placement
}

fn draw_whole(canvas: &mut Canvas, area: Rect, state: &State) {
    let strip = state.tour_rows();
    let content = Rect { y: area.y + 2, height: area.height - 4 - strip, ..area };
    bars::draw(canvas, Rect { height: 2, ..area }, state);
    // Several message lines shorten the list instead of covering the cursor's row.
    let covered = bars::covered(state, area.width).saturating_sub(strip).min(content.height / 2);
    let list = pane::draw::draw(canvas, Rect { height: content.height - covered, ..content }, state);
    screens::draw(canvas, list, state);
    if let Some(popup) = state.popups.last() {
        popups::draw(canvas, content, state, popup);
    }
    if let Some(tour) = &state.tour {
        draw_tour(canvas, Rect { y: content.bottom(), height: strip, ..area }, tour);
    }
    // Several message lines take precedence over the strip.
    bars::draw_bottom(canvas, area, state);
}

fn draw_tour(canvas: &mut Canvas, area: Rect, tour: &Tour) {
    let Some([name, act, why]) = tour.lines() else { return };
    let (place, of) = tour.count();
    for line in 0..area.height {
        canvas.wipe(row(area, line));
    }
    canvas.put(row(area, 0), &"─".repeat(usize::from(area.width)), Role::Border);
    let head = format!("Tour {place} of {of}  ");
    canvas.puts(row(area, 1), &[(&head, Role::Title), (&name, Role::Accent)]);
    canvas.put_right(row(area, 1), "E ends the tour", Role::Dim);
    canvas.puts(row(area, 2), &[("do   ", Role::Key), (&act, Role::Body)]);
    canvas.puts(row(area, 3), &[("why  ", Role::Dim), (&why, Role::Dim)]);
}
