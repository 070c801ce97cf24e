//! The core: the state, and the pure `update(state, action) -> effects`; time comes as [`Action::Tick`].
//!
//! What a screen or a popup knows stands in its own folder, and [`State`] holds all of it. Named here is what screens
//! and popups build upon; what is above them, `acts` and `update`, is named by those alone that are above it too.

pub mod acts;
pub mod ahead;
pub mod alerts;
pub mod answer;
pub mod available;
pub mod completion;
pub mod event;
pub mod feeds;
pub mod form;
pub mod history;
pub mod identity_path;
pub mod kept;
pub mod key;
pub mod keymap;
pub mod lock;
pub mod matching;
pub mod rows;
pub mod screen;
pub mod settings;
pub mod standing;
pub mod state;
pub mod table;
pub mod tour;
pub mod twin;
pub mod update;
pub mod verb;
pub mod when;

pub use crate::popups::lookup::{Lookup, moved, scrolled};
pub use crate::popups::state::{Confirm, Popup, Purpose, Typed};
pub use event::{Action, Contents, Effect};
pub use feeds::Feed;
pub use form::{Field, Form, FormStep, Input, Line, PathKind, Wrong};
pub use key::{Key, chord_label};
pub use keymap::Keymap;
pub use screen::Screen;
pub use settings::Settings;
pub use state::State;
pub use table::Table;
pub use verb::{Entry, Errand, Need, Tag, VERBS, Verb, entry_of};

#[cfg(test)]
pub mod tests;
