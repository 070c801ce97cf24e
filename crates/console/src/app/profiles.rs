//! Speaking for another profile of the same home, without leaving the console.

use super::action::Effect;
use super::form::{Field, Form, Line};
use super::popup::{Popup, Purpose};
use super::screen::Screen;
use super::state::State;
use super::update::start;
use crate::model::ProfileName;

/// Asks for which profile.
pub fn open(state: &mut State) {
    let lines = vec![Line::text("Profile", "name of a profile in this home", Field::default())];
    let known: Vec<String> = state.settings.profiles.iter().map(ToString::to_string).collect();
    let mut notes = vec![format!("Now: {}. A keyring opened here stays open until you quit.", state.settings.profile)];
    if !known.is_empty() {
        notes.push(format!("Profiles: {}", known.join(" ")));
    }
    state.popups.push(Popup::Form(Purpose::Profile, Form::new("Switch to another profile", notes, lines)));
}

/// The profile of a completed form.
///
/// # Errors
/// The field in error, and why.
pub fn read(form: &Form) -> Result<ProfileName, (usize, String)> {
    form.text(0).trim().parse().map_err(|error| (0, format!("{error}")))
}

/// Switches to another profile: everything known belongs to the previous one and is requested anew.
pub fn switch(state: &mut State, profile: ProfileName) -> Vec<Effect> {
    if profile == state.settings.profile {
        state.inform(format!("this console already uses profile {profile}"));
        return Vec::new();
    }
    if let Some(work) = state.work.iter().find(|tag| tag.is_work()) {
        let text = format!("{} is still running; wait until it ends, then switch to {profile}", work.words());
        state.inform(text);
        return Vec::new();
    }
    let mut settings = state.settings.clone();
    settings.profile.clone_from(&profile);
    // The successor would be given the flags of the start, with another profile.
    settings.leaves_site = false;
    let mut next = State::new(settings);
    (next.now, next.touched, next.size) = (state.now, state.now, state.size);
    (next.mouse, next.local_time, next.period) = (state.mouse, state.local_time, state.period);
    next.theme = std::mem::take(&mut state.theme);
    next.tour = state.tour.take();
    next.log = std::mem::take(&mut state.log);
    next.screen = Screen::Overview;
    next.former = Some(state.settings.profile.clone());
    // Requests of the previous profile are still answered, but not for this one.
    next.feeds.follow(&state.feeds);
    *state = next;
    state.inform(format!("this console now uses profile {profile}"));
    let mut effects = vec![Effect::SpeakFor(profile)];
    effects.extend(start(state));
    effects
}
