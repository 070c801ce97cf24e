//! Pure `draw(frame, state, theme)`: screens, popups, widgets. Nothing here changes state.
//!
//! ```text
//! AuthROS default   ros ● ok  chain ● ok  store ● ok  gateway ○ absent   FROZEN   header
//! 1 Overview  2 Topics  3 Uploads  4 Shared  5 Grants  6 Keys  7 Chain ...        header
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
pub mod chain;
pub mod detail;
pub mod gateway;
pub mod grants;
pub mod keys;
pub mod log;
pub mod overview;
pub mod plot;
pub mod popups;
pub mod records;
pub mod table;
pub mod theme;
pub mod topics;
pub mod tour;
pub mod words;

#[cfg(test)]
mod tests;

use ratatui::Frame;
use ratatui::layout::Rect;

pub use self::plot::{BAYER, Placement};
use crate::app::{Screen, State};
use canvas::Canvas;
pub use theme::{Role, Theme, ThemeError, Themes};

/// The smallest terminal the screens are made for, columns.
pub const LEAST_COLUMNS: u16 = 60;
/// The smallest terminal the screens are made for, rows.
pub const LEAST_ROWS: u16 = 18;

/// Draws the whole state; returns what is left to the terminal to draw.
pub fn draw(frame: &mut Frame, state: &State, theme: &Theme) -> Option<Placement> {
    let area = frame.area();
    let mut canvas = Canvas::new(frame.buffer_mut(), theme);
    if area.width < LEAST_COLUMNS || area.height < LEAST_ROWS {
        let size = format!("Terminal too small: {}x{}, need {LEAST_COLUMNS}x{LEAST_ROWS}", area.width, area.height);
        canvas.put(area, &size, Role::Warning);
    } else {
        draw_whole(&mut canvas, area, state);
    }
    let (cursor, placement) = (canvas.cursor(), canvas.placement());
    if theme.ascii {
        canvas::flatten(frame.buffer_mut());
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
    // A message of several lines never lies over the row under the cursor: the list is shorter for so long.
    let covered = bars::covered(state, area.width).saturating_sub(strip).min(content.height / 2);
    draw_content(canvas, Rect { height: content.height - covered, ..content }, state);
    if let Some(popup) = state.popups.last() {
        popups::draw(canvas, content, state, popup);
    }
    if let Some(tour) = &state.tour {
        tour::draw(canvas, Rect { y: content.bottom(), height: strip, ..area }, tour);
    }
    // A message of several lines takes precedence over the strip.
    bars::draw_bottom(canvas, area, state);
}

/// Draws the screen in view without header, messages and bar.
fn draw_content(canvas: &mut Canvas, area: Rect, state: &State) {
    let area = detail::draw(canvas, area, state);
    match state.screen {
        Screen::Overview => overview::draw(canvas, area, state),
        Screen::Topics => topics::draw(canvas, area, state),
        Screen::Uploads => records::draw_uploads(canvas, area, state),
        Screen::Shared => records::draw_shared(canvas, area, state),
        Screen::Grants => grants::draw(canvas, area, state),
        Screen::Keys => keys::draw(canvas, area, state),
        Screen::Chain => chain::draw(canvas, area, state),
        Screen::Gateway => gateway::draw(canvas, area, state),
        Screen::Log => log::draw(canvas, area, state),
    }
}
