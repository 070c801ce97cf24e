//! Locking: on the operator's command, or when nobody has touched a key for a while. What was decrypted leaves the
//! screen at once; the site wipes the keys and answers when that is done.

use super::action::{Effect, Errand, Tag};
use super::popup::{Popup, Purpose};
use super::state::State;
use crate::model::Timestamp;
use crate::service::{Command, Operation};

/// Asks the site to wipe the keys, and takes everything decrypted off the screen.
pub fn lock(state: &mut State) -> Vec<Effect> {
    state.popups.retain(|popup| match popup {
        Popup::Record(_) | Popup::Confirm(_) => false,
        Popup::Form(purpose, _) => *purpose == Purpose::Unlock,
        _ => true,
    });
    (state.identity_path, state.filled) = (None, None);
    state.detail.clear();
    state.ahead.clear();
    if state.work.contains(&Tag::Lock) {
        return Vec::new();
    }
    vec![state.send(Errand { command: Command::Operate(Operation::Lock), tag: Tag::Lock })]
}

/// When the keyring locks unless a key is pressed first.
pub fn due(state: &State) -> Option<Timestamp> {
    let after = state.settings.lock_after?;
    let open = state.identity.as_ref().is_some_and(|identity| identity.unlocked);
    let begun = state.work.contains(&Tag::Lock);
    (open && !begun && state.touched.0 > 0).then(|| Timestamp(state.touched.0.saturating_add(after)))
}

/// Locks when it is time.
pub fn tick(state: &mut State) -> Vec<Effect> {
    if due(state).is_none_or(|at| at > state.now) {
        return Vec::new();
    }
    let minutes = state.settings.lock_after.unwrap_or(0) / 60_000_000_000;
    state.warn(format!("locked after {minutes} minutes without a key press; a running capture continues, u unlocks"));
    lock(state)
}
