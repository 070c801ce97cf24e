//! The state of the console, and what every part of it may ask of it.

use std::path::PathBuf;

use crate::app::history::{History, Period, Progress, Rates};
use crate::app::verb::{Errand, Need, Tag, Undo};
use crate::app::{
    alerts::AlertBook, alerts::Toasts, event::Effect, feeds::Feed, feeds::Feeds, form::Form, key::Key, screen::Screen,
    settings::Settings, table::Table, tour::ROWS, tour::Tour,
};
use crate::model::{Address, Clock, ProfileName, Timestamp};
use crate::popups::{
    incidents::state::Incidents, lookup::Lookup, record::state::Opening, state::Exports, state::Popup, state::Purpose,
};
use crate::screens::{
    grants::state::Grants, log::state::Log, pane::state::Detail, records::state::Records, robots::state::Gateway,
    topics::state::Topics,
};
use crate::service::reply::{ChainView, ContactRow, IdentityView, KeysView, SiteView};
use crate::service::{Failure, NoticeLevel};

/// Rows of the screen that are not table rows: header, tabs, title, columns, message, bar.
pub const FRAME_ROWS: u16 = 6;

#[derive(Debug, Default)]
pub struct State {
    pub settings: Settings,
    pub now: Timestamp,
    /// Columns and rows.
    pub size: (u16, u16),
    pub screen: Screen,
    /// The moment of the freeze.
    pub frozen: Option<Timestamp>,
    /// Set by the first key press or passphrase prompt.
    pub greeted: bool,
    pub theme: String,
    pub mouse: bool,
    pub feeds: Feeds,
    pub identity: Option<IdentityView>,
    pub keys: Option<KeysView>,
    pub site: Option<SiteView>,
    /// When the site answered.
    pub site_at: Timestamp,
    pub rates: Rates,
    pub history: History,
    pub period: Period,
    pub progress: Progress,
    pub progress_at: Timestamp,
    pub detail: Detail,
    pub alerts: AlertBook,
    pub chain: Option<ChainView>,
    pub topics: Topics,
    pub records: Records,
    pub received: Records,
    pub grants: Grants,
    pub log: Log,
    /// Topmost last.
    pub popups: Vec<Popup>,
    pub toasts: Toasts,
    /// Unanswered requests, besides the feeds.
    pub work: Vec<Tag>,
    pub identity_path: Option<IdentityPath>,
    pub gateway: Gateway,
    /// The file being read for a form.
    pub reading: Option<PathBuf>,
    pub contacts: Vec<ContactRow>,
    pub incidents: Incidents,
    /// The form of the running act, restored if the act fails.
    pub filled: Option<(Tag, Purpose, Form)>,
    /// Sent when the act of the tag succeeds: one question asked for both.
    pub follow_up: Option<(Tag, Errand)>,
    /// The last act, as a command line.
    pub last_act: Option<String>,
    pub undo: Option<Undo>,
    /// Palette input, newest last.
    pub commands: Vec<String>,
    pub exports: Exports,
    /// Time of the last key press.
    pub touched: Timestamp,
    pub ahead: Ahead,
    pub local_time: bool,
    /// The previous profile, until the current one is claimed.
    pub former: Option<ProfileName>,
    pub tour: Option<Tour>,
    /// Work for the caller; `update` returns it.
    pub effects: Vec<Effect>,
}

impl State {
    pub fn new(settings: Settings) -> Self {
        let tour = settings.tour.clone().map(Tour::new);
        let records = || Records { table: Table::following(), ..Records::default() };
        Self { settings, tour, size: (80, 24), records: records(), received: records(), ..Self::default() }
    }

    pub fn is_frozen(&self) -> bool {
        self.frozen.is_some()
    }

    pub fn shown_at(&self) -> Timestamp {
        self.frozen.unwrap_or(self.now)
    }

    pub fn is_locked(&self) -> bool {
        self.identity.as_ref().is_some_and(|identity| identity.exists && !identity.unlocked)
    }

    pub fn page_rows(&self) -> usize {
        usize::from(self.size.1.saturating_sub(FRAME_ROWS + self.tour_rows())).max(1)
    }

    pub fn pending_records(&self) -> u64 {
        self.site.as_ref().map_or(0, |site| site.life.pending)
    }

    /// Whether quitting now leaves something undone.
    pub fn has_pending_work(&self) -> bool {
        self.pending_records() > 0 || self.work.iter().any(Tag::is_work)
    }

    pub fn address(&self) -> Option<Address> {
        self.identity.as_ref().and_then(|identity| identity.address)
    }

    pub fn watches(&self) -> bool {
        self.topics.rows.iter().any(|row| row.watched)
    }

    /// Whether the feed's first answer is still outstanding.
    pub fn awaits(&self, feed: Feed) -> bool {
        !self.feeds.slot(feed).loaded && self.feeds.slot(feed).failure.is_none()
    }

    /// Frozen with the view, except the identity (commands wait for it) and the counts while leaving waits for them.
    pub fn holds(&self, feed: Feed) -> bool {
        let leaving = matches!(self.popups.last(), Some(Popup::Quit(_)));
        let needed = feed == Feed::Identity || feed == Feed::Site && leaving;
        // Pages of the past can still be turned: the request itself excludes newer records.
        self.is_frozen() && self.feeds.slot(feed).is_answered() && !needed
    }

    /// Shows a message for 3 s.
    pub fn inform(&mut self, text: impl Into<String>) {
        self.toasts.push(NoticeLevel::Info, text.into(), self.now, None);
    }

    /// Shows a message until seen.
    pub fn warn(&mut self, text: impl Into<String>) {
        let text = text.into();
        self.log.notice(self.now, NoticeLevel::Warning, &text);
        self.toasts.push(NoticeLevel::Warning, text, self.now, None);
    }

    /// What typed times are read against.
    pub fn times(&self) -> Clock {
        Clock { now: self.now, zone: self.settings.zone.clone() }
    }

    /// `22:13:20`, followed by the local time if shown.
    pub fn clock(&self, moment: Timestamp) -> String {
        let local = if self.local_time { self.settings.zone.clock(moment) } else { None };
        local.map_or_else(|| moment.clock(), |local| format!("{} {local}", moment.clock()))
    }

    /// Shows a failure until seen, and logs it.
    pub fn complain(&mut self, text: impl Into<String>) {
        let text = text.into();
        self.log.notice(self.now, NoticeLevel::Error, &text);
        self.toasts.push(NoticeLevel::Error, text, self.now, None);
    }

    pub fn complain_of(&mut self, tag: &Tag, failure: &Failure) {
        let text = format!("{}: {}", tag.words(), failure.message);
        self.log.notice(self.now, NoticeLevel::Error, &text);
        self.toasts.push(NoticeLevel::Error, text, self.now, Some(tag.words()));
    }

    /// Opens the popup of a record before its answer.
    pub fn send(&mut self, errand: Errand) {
        if let Tag::Open(id) = &errand.tag {
            self.popups.push(Popup::Record(Opening::new(id)));
        }
        if errand.tag.is_work()
            && let Some(line) = self.twin(&errand)
        {
            self.last_act = Some(line);
        }
        self.work.push(errand.tag.clone());
        self.effects.push(Effect::Send(errand.command, errand.tag));
    }

    /// Rows of the tour's strip.
    pub fn tour_rows(&self) -> u16 {
        if self.tour.is_some() { ROWS } else { 0 }
    }

    pub fn go(&mut self, screen: Screen) {
        if self.screen != screen {
            screen.feeds().iter().for_each(|feed| self.feeds.look(*feed));
        }
        self.screen = screen;
    }

    /// Only the terminal knows whether it takes the text.
    pub fn copy(&mut self, text: String) {
        self.inform(format!("sent to the terminal's clipboard (W writes a file): {text}"));
        self.effects.push(Effect::CopyText(text));
    }

    /// Gives an answer to the popup that waits for it.
    pub fn tell<T>(&mut self, id: &str, answer: Result<T, Failure>, of: fn(&mut Popup) -> Option<&mut Lookup<T>>) {
        if let Some(lookup) = self.popups.iter_mut().filter_map(of).find(|lookup| lookup.id == id) {
            lookup.answer = Some(answer.map(Box::new));
        }
    }

    /// `None` for acts that have no command line.
    pub fn twin(&self, errand: &Errand) -> Option<String> {
        let line = self.command_line(&errand.line()?);
        // What follows a revoke is part of the same question.
        let follows = matches!(errand.tag, Tag::Revoke(_)).then_some(self.follow_up.as_ref()).flatten();
        let after = follows.and_then(|(_, errand)| self.twin(errand));
        Some(after.map_or_else(|| line.clone(), |after| format!("{line} && {after}")))
    }

    pub fn command_line(&self, words: &str) -> String {
        match self.settings.profile.as_str() {
            "default" => format!("authros {words}"),
            profile => format!("authros --profile {profile} {words}"),
        }
    }

    /// Skips requests already in flight.
    pub fn send_new(&mut self, errand: Errand) {
        if !self.work.contains(&errand.tag) {
            self.send(errand);
        }
    }
}

#[derive(Debug)]
pub struct IdentityPath {
    pub need: Need,
    pub registered: bool,
    pub errands: Vec<Errand>,
}

#[derive(Debug, Default)]
pub struct Ahead {
    pub keys: Vec<Key>,
    pub since: Timestamp,
}
