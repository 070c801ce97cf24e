//! Commands that need an identity wait while the operator creates, unlocks and registers one.

#![deny(clippy::wildcard_enum_match_arm)]

use crate::app::{Errand, Feed, Need, Popup, Purpose, State, Tag, state::IdentityPath};
use crate::popups::form::identity;
use crate::service::{Command, Failure, reply::IdentityView};

pub fn run(state: &mut State, need: Need, errands: Vec<Errand>) {
    match &mut state.identity_path {
        Some(path) => {
            path.need = path.need.max(need);
            path.errands.extend(errands);
        }
        None => state.identity_path = Some(IdentityPath { need, registered: false, errands }),
    }
    advance(state);
}

pub fn advance(state: &mut State) {
    let under_way = state.work.iter().any(|tag| matches!(tag, Tag::CreateIdentity | Tag::Unlock | Tag::Register));
    let asks = |popup: &Popup| matches!(popup, Popup::Form(Purpose::CreateIdentity | Purpose::Unlock, _));
    let asking = state.popups.iter().any(asks);
    let (Some(path), Some(identity)) = (&state.identity_path, &state.identity) else { return };
    if under_way || asking {
        return;
    }
    if !identity.unlocked && state.settings.operator.is_some() {
        state.complain("the keyring is locked, and only the owner of this site unlocks it");
        abandon(state);
    } else if !identity.exists {
        open_form(state, Purpose::CreateIdentity, None);
    } else if !identity.unlocked {
        open_form(state, Purpose::Unlock, None);
    } else if path.need == Need::Registered && !identity.registered && !path.registered {
        state.send(Errand { command: Command::Register, tag: Tag::Register });
    } else if let Some(path) = state.identity_path.take() {
        path.errands.into_iter().for_each(|errand| state.send(errand));
    }
}

/// Asks once for the passphrase: until the keyring is open, watched topics are not captured.
pub fn greet(state: &mut State) {
    if state.identity.as_ref().is_some_and(|identity| identity.unlocked) {
        return state.popups.retain(|popup| !matches!(popup, Popup::Form(Purpose::Unlock, _)));
    }
    let wanted = state.settings.asks_passphrase && state.is_locked() && state.popups.is_empty();
    if wanted && !std::mem::replace(&mut state.greeted, true) {
        open_form(state, Purpose::Unlock, None);
    }
}

/// Drops what waited, and names it.
pub fn abandon(state: &mut State) {
    if let Some(path) = state.identity_path.take() {
        let dropped: Vec<String> = path.errands.iter().map(|errand| errand.tag.words()).collect();
        if !dropped.is_empty() {
            state.inform(format!("not done: {}", dropped.join(", ")));
        }
    }
}

pub fn registered(state: &mut State, result: Result<IdentityView, Failure>) {
    out_of_date(state);
    match result {
        Ok(identity) => {
            state.identity = Some(identity);
            state.inform("registered");
            if let Some(path) = &mut state.identity_path {
                path.registered = true;
            }
            advance(state);
        }
        Err(failure) => {
            state.complain_of(&Tag::Register, &failure);
            abandon(state);
        }
    }
}

pub fn opened(state: &mut State, result: Result<IdentityView, Failure>, purpose: Purpose, text: &'static str) {
    out_of_date(state);
    match result {
        Ok(identity) => {
            state.identity = Some(identity);
            state.inform(text);
            advance(state);
        }
        Err(failure) => open_form(state, purpose, Some(failure.message)),
    }
}

fn out_of_date(state: &mut State) {
    state.feeds.renew(Feed::Identity);
    state.feeds.slot_mut(Feed::Keys).stale = true;
}

fn open_form(state: &mut State, purpose: Purpose, error: Option<String>) {
    let profile = state.settings.profile.as_str();
    let waiting = state.identity_path.iter().flat_map(|path| &path.errands);
    let mut notes: Vec<String> = waiting.take(3).map(|errand| format!("then: {}", errand.tag.words())).collect();
    if state.identity_path.is_none() {
        notes.push("While locked, nothing can be opened, granted or revoked, and a restarted site captures nothing. Esc: look around.".to_owned());
    }
    let stored = state.identity.as_ref().and_then(|identity| identity.passphrase_file.as_ref());
    let mut form = if purpose == Purpose::CreateIdentity {
        notes.insert(0, "This passphrase protects your keys on this machine. It cannot be recovered.".to_owned());
        identity::create_identity(profile, notes)
    } else {
        notes.extend(stored.map(|file| format!("Its passphrase is stored in {file}.")));
        identity::unlock(profile, notes)
    };
    form.error = error;
    state.popups.push(Popup::Form(purpose, form));
}
