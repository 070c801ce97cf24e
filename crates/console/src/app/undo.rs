//! Taking the last act back, where that is true; where it would be another transaction, or where nothing can bring
//! it back, that is said instead.

#![deny(clippy::wildcard_enum_match_arm)]

use super::action::{Effect, Errand, Tag};
use super::confirm;
use super::incidents;
use super::popup::Popup;
use super::state::State;
use crate::model::TopicName;
use crate::service::Command;

/// What was done last, as far as undoing goes.
#[expect(clippy::large_enum_variant, reason = "there is one at a time")]
#[derive(Debug, Clone)]
pub enum Undo {
    /// This takes it back, wholly.
    By(Errand),
    /// A grant: revoking it is another transaction, and nothing that was read meanwhile comes back.
    Granted(String),
    /// Nothing takes it back: why.
    Never(&'static str),
}

/// Notes what a command did that was asked for under `tag`.
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
        Tag::Extend(_) => Some(Undo::Never("it was a transaction; e gives the grant another end (5)")),
        Tag::Revoke(_) => Some(Undo::Never("a revoke is a transaction: to share again, make a new grant (5, then g)")),
        Tag::Rotate => Some(Undo::Never("a new epoch cannot be taken back")),
        Tag::LoadKey(_) => Some(Undo::Never("the key that was replaced is gone from the keyring; load its file again")),
        Tag::Release(_) => {
            Some(Undo::Never("released messages are already on their way to the chain; they keep their tag"))
        }
        Tag::Discard(_) => Some(Undo::Never("discarded messages are deleted; their count stands on the chain")),
        Tag::Administer(_) | Tag::Deploy | Tag::Adopt => {
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
        Tag::Play(_) | Tag::StopPlay | Tag::Contact(_) => None,
        Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Open(_) | Tag::Path(_) | Tag::Check(_) => None,
    };
    if undo.is_some() {
        state.undo = undo;
    }
}

/// Takes the last act back, or says why that cannot be.
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
                None => state.inform("that grant is not active any more"),
            }
        }
        Some(Undo::Never(why)) => state.inform(format!("cannot be undone: {why}")),
        None => state.inform("nothing to undo"),
    }
    Vec::new()
}
