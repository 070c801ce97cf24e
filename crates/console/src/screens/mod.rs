//! The screens, a folder each: its state, what its keys do, how it is drawn; and the pane beside a list.

pub mod chain {
    pub mod draw;
    pub mod keys;
    pub mod state;
}
pub mod grants {
    pub mod draw;
    pub mod keys;
    pub mod state;
}
pub mod keys {
    pub mod acts;
    pub mod draw;
}
pub mod log {
    pub mod draw;
    pub mod state;
}
pub mod overview;
pub mod pane {
    pub mod draw;
    pub mod follow;
    pub mod state;
}
pub mod records {
    pub mod draw;
    pub mod keys;
    pub mod state;
}
pub mod robots {
    pub mod draw;
    pub mod keys;
    pub mod state;
}
pub mod topics {
    pub mod capture;
    pub mod draw;
    pub mod keys;
    pub mod state;
}

use crate::app::{Screen, State};
use crate::ui::{Canvas, Rect};

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    match state.screen {
        Screen::Overview => overview::draw(canvas, area, state),
        Screen::Topics => topics::draw::draw(canvas, area, state),
        Screen::Records | Screen::Received => records::draw::draw(canvas, area, state),
        Screen::Grants => grants::draw::draw(canvas, area, state),
        Screen::Keys => keys::draw::draw(canvas, area, state),
        Screen::Chain => chain::draw::draw(canvas, area, state),
        Screen::Robots => robots::draw::draw(canvas, area, state),
        Screen::Log => log::draw::draw(canvas, area, state),
    }
}
