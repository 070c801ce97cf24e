//! Undoing the last act, if that is possible; if it would be another transaction, or nothing can undo it, that is said
//! instead.

#![deny(clippy::wildcard_enum_match_arm)]

use super::action::{Effect, Errand, Tag};
use super::popup::Popup;
use super::state::State;
use super::{confirm, incidents};
use crate::model::TopicName;
use crate::service::Command;

/// The last act, as far as undoing is concerned.
#[expect(clippy::large_enum_variant, reason = "there is one at a time")]
#[derive(Debug, Clone)]
pub enum Undo {
    /// This undoes it completely.
    By(Errand),
    /// A grant: revoking it is another transaction, and does not undo what was read meanwhile.
    Granted(String),
    /// Nothing undoes it: why.
    Never(&'static str),
}

/// Notes the effect of the command with `tag`.
pub fn note(state: &mut State, tag: &Tag) {
    let topic = |name: &String| name.parse::<TopicName>().ok();
    let undo = match tag {
        Tag::Watch(name) => topic(name).map(|topic| {
            Undo::By(Errand { command: Command::UnwatchTopic { topic }, tag: Tag::Unwatch(name.clone()) })
        }),
        Tag::Unwatch(name) => topic(name).map(|topic| {
            let command = Command::WatchTopic { topic, type_name: None };
            Undo::By(Errand { command, tag: Tag::Watch(name.clone()) })
        }),
        Tag::Grant(grantee) => Some(Undo::Granted(grantee.to_string())),
        Tag::Extend(_) => Some(Undo::Never("it was a transaction; e changes the end of the grant (5)")),
        Tag::Revoke(_) => Some(Undo::Never("a revoke is a transaction: to share again, make a new grant (5, then g)")),
        Tag::Rotate => Some(Undo::Never("a new epoch cannot be undone")),
        Tag::LoadKey(_) => Some(Undo::Never("the replaced key is no longer in the keyring; load its file again")),
        Tag::Release(_) => Some(Undo::Never("released messages are already being anchored; they keep their tag")),
        Tag::Discard(_) => Some(Undo::Never("discarded messages are deleted; their count is on the chain")),
        Tag::Administer(_) | Tag::Deploy => {
            Some(Undo::Never("it was a transaction; send the opposite one instead (7, then :)"))
        }
        Tag::Feed(..)
        | Tag::OpenConsole
        | Tag::CreateIdentity
        | Tag::Unlock
        | Tag::Register
        | Tag::Lock
        | Tag::HoldCapture => None,
        Tag::ExportKey(_) | Tag::BackUp | Tag::Export(_) | Tag::Pin(_) | Tag::Unpin(_) => None,
        Tag::Incident(deed, name) => {
            Some(deed.stays().map_or_else(|| Undo::By(incidents::taken_back(name)), Undo::Never))
        }
        Tag::SetPolicy(..) => Some(Undo::Never("a policy's version only rises; set the earlier one again (8, then p)")),
        Tag::Play(_) | Tag::StopPlay | Tag::Contact(_) | Tag::Robot(_) => None,
        Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Open(_) | Tag::Path(_) | Tag::Check(_) => None,
    };
    if undo.is_some() {
        state.undo = undo;
    }
}

/// Undoes the last act, or says why that is not possible.
pub fn undo(state: &mut State) -> Vec<Effect> {
    match state.undo.take() {
        Some(Undo::By(errand)) => return vec![state.send(errand)],
        Some(Undo::Granted(grantee)) => {
            let row = state.grants.rows.iter().find(|row| {
                let is_it = row.grantee.to_string() == grantee || row.name.as_deref() == Some(grantee.as_str());
                is_it && super::screens::grants::is_given(row) && super::screens::grants::is_active(row)
            });
            match row.map(|row| confirm::revoke(state, row)) {
                Some(question) => state.popups.push(Popup::Confirm(question)),
                None => state.inform("that grant is no longer active"),
            }
        }
        Some(Undo::Never(why)) => state.inform(format!("cannot be undone: {why}")),
        None => state.inform("nothing to undo"),
    }
    Vec::new()
}
