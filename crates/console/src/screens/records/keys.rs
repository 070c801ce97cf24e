//! Acts on records: provenance, opening, checks, playback.

use crate::app::{Errand, Lookup, Need, Popup, State, Tag, identity_path};
use crate::model::{Address, Party, TopicName, counted};
use crate::service::{Command, command::Pace, command::PlayWishes, reply::PlayedView};

pub fn details(state: &mut State) {
    let Some(id) = state.row_key() else { return };
    state.popups.push(Popup::Provenance(Lookup::new(&id)));
    state.send(Errand { command: Command::ShowUpload { id: id.clone() }, tag: Tag::Show(id) });
}

pub fn open_record(state: &mut State) {
    let Some(id) = state.row_key() else { return };
    let errand = Errand { command: Command::OpenShared { id: id.clone() }, tag: Tag::Open(id) };
    identity_path::run(state, Need::Unlocked, vec![errand]);
}

pub fn check(state: &mut State) {
    for id in state.marked_keys() {
        state.send_new(Errand { command: Command::CheckShared { id: id.clone() }, tag: Tag::Check(id) });
    }
}

/// Plays the topic under `/shared/NAME`, or ends the playback.
pub fn play(state: &mut State) {
    if state.work.iter().any(|tag| matches!(tag, Tag::Play(_))) {
        return state.send(Errand { command: Command::StopPlay, tag: Tag::StopPlay });
    }
    let key = state.row_key();
    let row = state.received.rows.iter().find(|row| Some(&row.id) == key.as_ref());
    let found = row.and_then(|row| Some((row.owner?, row.owner_name.clone(), row.topic.clone())));
    let Some((owner, name, topic)) = found else { return };
    let (Ok(pattern), Some(prefix)) = (topic.parse(), prefix(owner, name.as_deref())) else {
        return state.complain(format!("{topic} cannot be played: its name is still a pseudonym"));
    };
    let played = format!("{prefix}{topic}");
    let wishes = PlayWishes {
        owner: Some(Party::Address(owner)),
        topics: vec![pattern],
        pace: Pace::Follow,
        prefix: Some(prefix),
        ..PlayWishes::default()
    };
    identity_path::run(state, Need::Unlocked, vec![Errand { command: Command::Play(wishes), tag: Tag::Play(played) }]);
}

/// `/shared/` and the owner's name as a graph allows it, or else the beginning of the address.
fn prefix(owner: Address, name: Option<&str>) -> Option<TopicName> {
    let plain = |name: &str| name.replace(|letter: char| !letter.is_ascii_alphanumeric(), "_");
    let of_name = name.and_then(|name| format!("/shared/{}", plain(name)).parse().ok());
    of_name.or_else(|| {
        let digits: String = owner.to_string().chars().skip(2).take(8).collect();
        format!("/shared/x{digits}").parse().ok()
    })
}

pub fn ended(state: &mut State, view: &PlayedView) {
    let published = counted(view.published, "message");
    let not = view.refused + view.missing;
    let rest = if not > 0 { format!(", {} NOT published", counted(not, "record")) } else { String::new() };
    let text = |why: &str| format!("playback ended ({why}): {published} published{rest}");
    match view.ended_by.cut_short() {
        Some(why) => state.complain(text(why)),
        None => state.inform(text(view.ended_by.word())),
    }
}
