//! Keys of every form, and what submitting it does.

use crate::app::{
    Effect, Form, FormStep, Key, Need, Popup, Purpose, State, Wrong, completion, completion::Found, completion::Sought,
    identity_path,
};
use crate::popups::form::{evidence, export, grant, identity, limit, policy, profile};
use crate::popups::{contacts, incidents};
use crate::screens::{chain, keys, topics};

pub fn key(state: &mut State, purpose: Purpose, mut form: Form, key: Key) {
    let completes: fn(&State, &mut Form) -> bool = match purpose {
        Purpose::Grant => grant::complete,
        Purpose::OpenIncident => incidents::form::complete,
        Purpose::ExportEvidence => evidence::complete,
        Purpose::SetPolicy => policy::complete,
        _ => |_, _| false,
    };
    if key == Key::Tab && completes(state, &mut form) {
        return state.popups.push(Popup::Form(purpose, form));
    }
    if let Some(asked) = tab(state, &form, key) {
        state.effects.push(asked);
        return state.popups.push(Popup::Form(purpose, form));
    }
    match form.key(key) {
        FormStep::Stay => state.popups.push(Popup::Form(purpose, form)),
        FormStep::Cancel if matches!(purpose, Purpose::CreateIdentity | Purpose::Unlock) => {
            identity_path::abandon(state);
        }
        FormStep::Cancel => {}
        FormStep::Submit => match submit(state, purpose, &form) {
            // The form stays below its question, so that a "no" returns to it.
            Ok(()) if matches!(state.popups.last(), Some(Popup::Confirm(_))) => {
                state.popups.insert(state.popups.len() - 1, Popup::Form(purpose, form));
            }
            // The form also stays while its file is read.
            Ok(()) if purpose == Purpose::SetPolicy => state.popups.push(Popup::Form(purpose, form)),
            Ok(()) => {
                // A refused contact or incident returns to its form.
                let kept = matches!(purpose, Purpose::AddContact | Purpose::OpenIncident | Purpose::NoteIncident);
                if let Some(tag) = state.work.last().filter(|_| kept).cloned() {
                    state.filled = Some((tag, purpose, form));
                }
            }
            Err((line, error)) => {
                form.refuse(line, error);
                state.popups.push(Popup::Form(purpose, form));
            }
        },
    }
}

fn submit(state: &mut State, purpose: Purpose, form: &Form) -> Result<(), Wrong> {
    match purpose {
        Purpose::CreateIdentity => state.send(identity::read_create(form)?),
        Purpose::Unlock => state.send(identity::read_unlock(form)?),
        Purpose::Unpin => state.send(topics::keys::read_unpin(form)?),
        Purpose::AddContact => state.send(contacts::read(form)?),
        Purpose::OpenIncident => state.send(incidents::form::read(state, form)?),
        Purpose::NoteIncident => state.send(incidents::form::read_note(form)?),
        Purpose::ExportEvidence => {
            let question = evidence::read(state, form)?;
            state.popups.push(Popup::Confirm(question));
        }
        Purpose::Export => export::submit(state, form),
        Purpose::SetPolicy => policy::submit(state, form)?,
        Purpose::Limit => limit::submit(state, form)?,
        Purpose::Profile => profile::switch(state, form.parsed(0)?),
        Purpose::ExportKey => {
            let errand = keys::acts::read_export(form)?;
            export::goes_to(state, &errand.tag, form, 3);
            identity_path::run(state, Need::Unlocked, vec![errand]);
        }
        Purpose::Grant => {
            let wish = grant::read_grant(form, state)?;
            grant::check(state, &wish)?;
            grant::ask(state, wish);
        }
        Purpose::Extend => grant::extend(state, form)?,
        Purpose::Administer(act) => state.popups.push(Popup::Confirm(chain::keys::read(act, form)?)),
        Purpose::LoadKey => state.popups.push(Popup::Confirm(keys::acts::read_load(form, &state.settings)?)),
    }
    Ok(())
}

pub fn tab(state: &State, form: &Form, key: Key) -> Option<Effect> {
    completion::sought(form, &state.settings).filter(|_| key == Key::Tab).map(Effect::FindPaths)
}

/// Ignores an answer to a form that changed meanwhile.
pub fn found(state: &mut State, sought: &Sought, found: Result<Found, String>) {
    let Some(Popup::Form(_, form)) = state.popups.last_mut() else { return };
    let here = form.lines.get(form.focus).is_some_and(|line| line.path == Some(sought.kind));
    if !here || form.text(form.focus) != sought.typed {
        return;
    }
    let listed = form.tabbed.take().is_some_and(|text| text == sought.typed);
    form.told.clear();
    match found {
        Err(error) => form.told.push(error),
        Ok(found) => completion::complete(form, sought, &found, listed),
    }
}

pub fn hints(form: &Form) -> Vec<(&'static str, &'static str)> {
    let path = form.lines.get(form.focus).is_some_and(|line| line.path.is_some());
    let tab = path.then_some(("tab", "complete"));
    let all = [("enter", "next field / submit"), ("up down", "move"), ("esc", "cancel")];
    tab.into_iter().chain(all).collect()
}
