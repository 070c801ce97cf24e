//! Shared records into the reader's own ROS: one key starts it for the topic under the cursor, live, and ends it.

use super::action::{Effect, Errand, Tag};
use super::identity_path::{self, Need};
use super::state::State;
use crate::model::{Address, Party, TopicName};
use crate::service::Command;
use crate::service::command::{Pace, PlayWishes};
use crate::service::reply::{PlayEnd, PlayedView};

/// Plays the selected record's topic under `/shared/NAME`, or ends the playback.
pub fn toggle(state: &mut State) -> Vec<Effect> {
    if state.work.iter().any(|tag| matches!(tag, Tag::Play(_))) {
        return vec![state.send(Errand { command: Command::StopPlay, tag: Tag::StopPlay })];
    }
    let key = state.row_key();
    let row = state.shared.rows.iter().find(|row| Some(&row.id) == key.as_ref());
    let found = row.and_then(|row| Some((row.owner?, row.owner_name.clone(), row.topic.clone())));
    let Some((owner, name, topic)) = found else { return Vec::new() };
    let (Ok(pattern), Some(prefix)) = (topic.parse(), prefix(owner, name.as_deref())) else {
        state.complain(format!("{topic} cannot be played: its name is still a pseudonym"));
        return Vec::new();
    };
    let played = format!("{prefix}{topic}");
    let wishes = PlayWishes {
        owner: Some(Party::Address(owner)),
        topics: vec![pattern],
        pace: Pace::Follow,
        prefix: Some(prefix),
        ..PlayWishes::default()
    };
    identity_path::run(state, Need::Unlocked, vec![Errand { command: Command::Play(wishes), tag: Tag::Play(played) }])
}

/// `/shared/` and the owner's name in a form that a graph allows, or else the beginning of the address.
fn prefix(owner: Address, name: Option<&str>) -> Option<TopicName> {
    let plain = |name: &str| name.replace(|letter: char| !letter.is_ascii_alphanumeric(), "_");
    let of_name = name.and_then(|name| format!("/shared/{}", plain(name)).parse().ok());
    of_name.or_else(|| {
        let digits: String = owner.to_string().chars().skip(2).take(8).collect();
        format!("/shared/x{digits}").parse().ok()
    })
}

/// The message when it has ended.
pub fn ended(state: &mut State, view: &PlayedView) {
    let published = view.published;
    let not = view.refused + view.missing;
    let rest = if not > 0 { format!(", {not} records NOT published") } else { String::new() };
    let text = |why: &str| format!("playback ended ({why}): {published} messages published{rest}");
    match view.ended_by {
        PlayEnd::Asked | PlayEnd::Whole => state.inform(text(view.ended_by.word())),
        PlayEnd::Revoked => state.complain(text("the grant was revoked")),
        PlayEnd::Expired => state.complain(text("the grant has expired")),
        PlayEnd::Locked => state.complain(text("the keyring was locked")),
        PlayEnd::Site => state.complain(text("the site stopped")),
    }
}
