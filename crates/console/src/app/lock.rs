//! Locking: by a key, or after a time without one.

use crate::app::{Errand, Popup, Purpose, State, Tag};
use crate::model::{Timestamp, counted};
use crate::screens::pane::state::Detail;
use crate::service::Command;

/// Wipes the keys, and takes everything decrypted off the screen.
pub fn lock(state: &mut State) {
    state.popups.retain(|popup| match popup {
        Popup::Record(_) | Popup::Confirm(_) => false,
        Popup::Form(purpose, _) => *purpose == Purpose::Unlock,
        _ => true,
    });
    (state.identity_path, state.filled) = (None, None);
    state.detail = Detail::default();
    state.ahead.keys.clear();
    state.send_new(Errand { command: Command::Lock, tag: Tag::Lock });
}

pub fn due(state: &State) -> Option<Timestamp> {
    let after = state.settings.lock_after?;
    let open = state.identity.as_ref().is_some_and(|identity| identity.unlocked);
    let begun = state.work.contains(&Tag::Lock);
    (open && !begun && state.touched.0 > 0).then(|| Timestamp(state.touched.0.saturating_add(after)))
}

pub fn when_due(state: &mut State) {
    // A clock that was set back does not put it off.
    state.touched = state.touched.min(state.now);
    if due(state).is_some_and(|at| at <= state.now) {
        let minutes = counted(state.settings.lock_after.unwrap_or(0) / 60_000_000_000, "minute");
        state.warn(format!(
            "locked: by this machine's clock, {minutes} passed without a key press; a running capture \
             continues, u unlocks"
        ));
        lock(state);
    }
}
