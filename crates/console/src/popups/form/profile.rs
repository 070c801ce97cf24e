//! Another profile of this home.

use crate::app::{Effect, Errand, Field, Form, Line, Popup, Purpose, Screen, State, Tag};
use crate::model::ProfileName;
use crate::service::Command;

pub fn open(state: &mut State) {
    let lines = vec![Line::text("Profile", "name of a profile in this home", Field::default())];
    let known: Vec<String> = state.settings.profiles.iter().map(ToString::to_string).collect();
    let mut notes = vec![format!("Now: {}. A keyring opened here stays open until you quit.", state.settings.profile)];
    if !known.is_empty() {
        notes.push(format!("Profiles: {}", known.join(" ")));
    }
    state.popups.push(Popup::Form(Purpose::Profile, Form::new("Switch to another profile", notes, lines)));
}

/// Everything known belongs to the previous profile and is requested anew.
pub fn switch(state: &mut State, profile: ProfileName) {
    if profile == state.settings.profile {
        return state.inform(format!("this console already uses profile {profile}"));
    }
    if let Some(work) = state.work.iter().find(|tag| tag.is_work()) {
        let text = format!("{} is still running; wait until it ends, then switch to {profile}", work.words());
        return state.inform(text);
    }
    let mut settings = state.settings.clone();
    settings.profile.clone_from(&profile);
    // The successor would start with this console's flags, but for another profile.
    settings.leaves_site = false;
    let mut next = State::new(settings);
    (next.now, next.touched, next.size) = (state.now, state.now, state.size);
    (next.mouse, next.local_time, next.period) = (state.mouse, state.local_time, state.period);
    next.theme = std::mem::take(&mut state.theme);
    next.tour = state.tour.take();
    next.log = std::mem::take(&mut state.log);
    next.screen = Screen::Overview;
    next.former = Some(state.settings.profile.clone());
    // Answers to requests of the previous profile must not match this one's.
    next.feeds.follow(&state.feeds);
    next.effects = std::mem::take(&mut state.effects);
    *state = next;
    state.inform(format!("this console now uses profile {profile}"));
    state.effects.push(Effect::SpeakFor(profile));
    state.send(Errand { command: Command::OpenConsole, tag: Tag::OpenConsole });
}
