//! Pure `draw(frame, state, theme)`, and what screens and popups are drawn with. Nothing here changes state.
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
pub mod draw;
pub mod facts;
pub mod frame;
pub mod graph;
pub mod marks;
pub mod plot;
pub mod table;
pub mod theme;
pub mod words;

pub use canvas::{Canvas, Placement, below, columns, right_of, row, rows};
pub use facts::{Fact, draw_facts, empty};
pub use frame::{Piece, draw_lines, draw_list, draw_text, draw_told, framed, labelled, name_role, pad, put_lines};
pub use plot::BAYER;
pub use ratatui::layout::Rect;
pub use table::{Column, Layout, Sheet};
pub use theme::{Role, Theme, ThemeError, Themes};

#[cfg(test)]
mod tests;
