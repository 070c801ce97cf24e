//! Robot users: each file is one behaviour, as an operator would describe it.

pub mod fixtures;

mod ahead;
mod aiming;
mod columns;
mod contacts;
mod first_use;
mod freezing;
mod granting;
mod helping;
mod incidents;
mod keys;
mod keystrokes;
mod leaving;
mod logging;
mod operating;
mod palette;
mod paths;
mod placeholders;
mod policies;
mod profiles;
mod pulling;
mod records;
mod standing;
mod touring;
mod watching;
mod wide;

use zeroize::Zeroizing;

use super::update::{start, update};
use super::{Action, Effect, Feed, Key, Lookup, Popup, Screen, Settings, State, Tag};
use crate::model::Timestamp;
use crate::service::reply::{LifeLine, SiteView};
use crate::service::{Command, Event, Failure, Part, Reply};

/// Someone at the keyboard, with a site that answers when told to.
pub struct Robot {
    pub state: State,
    /// Commands sent and not yet answered.
    pub sent: Vec<(Command, Tag)>,
    /// Other effects so far.
    pub effects: Vec<Effect>,
}

impl Robot {
    /// Opens the console; nothing is answered yet.
    pub fn opens(settings: Settings) -> Self {
        let mut state = State::new(settings);
        state.now = fixtures::NOW;
        let effects = start(&mut state);
        let mut robot = Self { state, sent: Vec::new(), effects: Vec::new() };
        robot.note(effects);
        robot
    }

    /// Seconds at 44 records a second, with a minute of fewer and a stop of three seconds.
    pub fn sees_records_flow(&mut self, seconds: u64) {
        for second in 1..=seconds {
            self.waits(1);
            let (fewer, stopped) = (second.saturating_sub(200).min(60), second.saturating_sub(430).min(3));
            let (captured, late) = (12_345 + 44 * (second - stopped) - 6 * fewer, 30 + 20 * (second / 60 % 2));
            let verified = captured - late;
            let life = LifeLine {
                captured,
                stored: captured,
                anchored: verified,
                confirmed: verified,
                verified,
                pending: late,
                ..fixtures::site().life
            };
            let verified_after = vec![(400_000, 40 * second), (900_000, 4 * second)];
            self.hears_of(Part::Health);
            let site = SiteView { life, verified_after, ..fixtures::site() };
            self.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
        }
    }

    /// Opens it on a site that has answered everything.
    pub fn at_work(exists: bool) -> Self {
        let mut robot = Self::opens(Settings::default());
        robot.site_answers(exists);
        robot
    }

    /// Everything the console requests for its screens is answered from the fixtures, until it requests no more.
    pub fn site_answers(&mut self, exists: bool) {
        let is_pull = |tag: &Tag| matches!(tag, Tag::Feed(..) | Tag::OpenConsole | Tag::Foresee(_));
        while let Some(place) = self.sent.iter().position(|(_, tag)| is_pull(tag)) {
            let (command, tag) = self.sent.remove(place);
            self.act(Action::Answered { tag, result: Box::new(Ok(fixtures::reply(&command, exists))) });
        }
    }

    pub fn act(&mut self, action: Action) {
        let effects = update(&mut self.state, action);
        self.note(effects);
    }

    fn note(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            match effect {
                Effect::Send(command, tag) => self.sent.push((command, tag)),
                other => self.effects.push(other),
            }
        }
    }

    /// Presses keys, one per character.
    pub fn types(&mut self, text: &str) {
        text.chars().for_each(|character| self.presses(Key::Char(character)));
    }

    pub fn presses(&mut self, key: Key) {
        self.act(Action::Key(key));
    }

    pub fn pastes(&mut self, text: &str) {
        self.act(Action::Paste(Zeroizing::new(text.to_owned())));
    }

    pub fn waits(&mut self, seconds: u64) {
        self.act(Action::Tick(Timestamp(self.state.now.0 + seconds * 1_000_000_000)));
    }

    /// The site reports a change.
    pub fn hears_of(&mut self, part: Part) {
        self.act(Action::Told(Event::Changed { part }));
    }

    /// The site answers the request with that tag.
    pub fn is_answered(&mut self, tag: &Tag, result: Result<Reply, Failure>) {
        let place = self.sent.iter().position(|(_, sent)| sent == tag).expect("it was asked");
        let (_, tag) = self.sent.remove(place);
        self.act(Action::Answered { tag, result: Box::new(result) });
    }

    /// The commands in flight that are not pulls, by tag.
    pub fn work(&self) -> Vec<Tag> {
        let tags = self.sent.iter().map(|(_, tag)| tag.clone());
        tags.filter(|tag| !matches!(tag, Tag::Feed(..) | Tag::OpenConsole | Tag::Foresee(_))).collect()
    }

    pub fn message(&self) -> &str {
        self.state.toasts.shown().map_or("", |toast| &toast.text)
    }

    /// The error in the form on top.
    pub fn form_error(&self) -> Option<&str> {
        match self.state.popups.last() {
            Some(Popup::Form(_, form)) => form.error.as_deref(),
            _ => None,
        }
    }
}

/// The answer in a lookup popup, if it is the topmost.
pub fn record_shown(state: &State) -> Option<&Lookup<crate::service::reply::OpenedView>> {
    match state.popups.last() {
        Some(Popup::Record(opening)) => Some(&opening.lookup),
        _ => None,
    }
}

#[test]
fn number_keys_and_tab_go_from_screen_to_screen() {
    let mut robot = Robot::at_work(true);
    robot.types("9");
    assert_eq!(robot.state.screen, Screen::Log);
    robot.presses(Key::Tab);
    assert_eq!(robot.state.screen, Screen::Overview);
    robot.presses(Key::BackTab);
    assert_eq!(robot.state.screen, Screen::Log);
}
