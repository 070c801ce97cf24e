//! The console's state and the pure `update(state, action) -> effects`.
//!
//! Nothing here draws, reads a clock, touches a file or waits: time comes in as
//! [`Action::Tick`], data as answers to the commands that went out as [`Effect`]s.
//! [`verb`] is the one list of what an operator can do; keymap, palette, help and bottom
//! bar are made from it.

pub mod action;
pub mod administration;
pub mod alerts;
pub mod answer;
pub mod available;
pub mod choosing;
pub mod contacts;
pub mod feed;
pub mod form;
pub mod granting;
pub mod history;
pub mod identity_path;
pub mod incidents;
pub mod key;
pub mod keymap;
pub mod leaving;
pub mod opening;
pub mod palette;
pub mod paths;
pub mod perform;
pub mod playing;
pub mod policies;
pub mod popup;
pub mod popup_keys;
pub mod profiles;
pub mod resume;
pub mod screen;
pub mod screens;
pub mod state;
pub mod table;
pub mod tour;
pub mod update;
pub mod verb;
pub mod when;
pub mod words;

#[cfg(test)]
pub mod tests;

pub use action::{Action, Contents, Effect, Errand, Tag};
pub use key::Key;
pub use keymap::Keymap;
pub use screen::Screen;
pub use state::{Settings, State};
pub use update::update;
pub use verb::Verb;
