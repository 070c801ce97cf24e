//! Pure `draw(frame, state, theme)`: screens, popups, widgets. Nothing here changes state.
//!
//! ```text
//! AuthROS default   ros ● ok  chain ● ok  store ● ok  gateway ○ absent   FROZEN   header
//! 1 Overview  2 Topics  3 Records  4 Received  5 Grants  6 Keys  7 Chain ...        header
//! Topics  12 of 40, by name, filter: odom                                         table
//!   Topic                 Watched     Hz     kB/s  Lost  Last                     table
//! ▌ /robot1/odom          watched   20.0     14.2   0/0  12:03:22  SIMULATED      one file per screen
//!            ┌ Grant ────────────────────────────┐
//!            │ Address  0x…                      │                                popups
//!            └───────────────────────────────────┘
//! ✖ chain: connection refused                              esc: hide, 2 more      bottom
//! space mark  w watch  / filter  s sort  ? help  q quit                           bottom
//! ```

pub mod bars;
pub mod canvas;
pub mod detail;
pub mod gateway;
pub mod graph;
mod lists;
pub mod overview;
pub mod plot;
pub mod popups;
pub mod table;
pub mod theme;
pub mod words;

use crate::app::tour::Tour;
use crate::app::{Screen, State};
use canvas::{Canvas, flatten, row};
use ratatui::Frame;
use ratatui::layout::Rect;

pub use canvas::Placement;
pub use plot::BAYER;
pub use theme::{Role, Theme, ThemeError, Themes};

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
    let strip = crate::app::tour::rows(state);
    let content = Rect { y: area.y + 2, height: area.height - 4 - strip, ..area };
    bars::draw(canvas, Rect { height: 2, ..area }, state);
    // Several message lines shorten the list instead of covering the cursor's row.
    let covered = bars::covered(state, area.width).saturating_sub(strip).min(content.height / 2);
    let list = detail::draw(canvas, Rect { height: content.height - covered, ..content }, state);
    match state.screen {
        Screen::Overview => overview::draw(canvas, list, state),
        Screen::Topics => lists::draw_topics(canvas, list, state),
        Screen::Records | Screen::Received => lists::draw_records(canvas, list, state),
        Screen::Grants => lists::draw_grants(canvas, list, state),
        Screen::Keys => lists::draw_keys(canvas, list, state),
        Screen::Chain => lists::draw_chain(canvas, list, state),
        Screen::Robots => gateway::draw(canvas, list, state),
        Screen::Log => lists::draw_log(canvas, list, state),
    }
    if let Some(popup) = state.popups.last() {
        popups::draw(canvas, content, state, popup);
    }
    if let Some(tour) = &state.tour {
        draw_tour(canvas, Rect { y: content.bottom(), height: strip, ..area }, tour);
    }
    // Several message lines take precedence over the strip.
    bars::draw_bottom(canvas, area, state);
}

pub fn draw_tour(canvas: &mut Canvas, area: Rect, tour: &Tour) {
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

#[cfg(test)]
mod tests;
