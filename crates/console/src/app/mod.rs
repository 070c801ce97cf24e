//! The console's state and the pure `update(state, action) -> effects`; time comes as [`Action::Tick`].

pub mod administration;
pub mod alerts;
pub mod answer;
pub mod available;
pub mod choosing;
pub mod evidence;
pub mod form;
pub mod granting;
pub mod history;
pub mod identity_path;
pub mod incidents;
pub mod keymap;
pub mod leaving;
pub mod limiting;
pub mod opening;
pub mod palette;
pub mod perform;
pub mod policies;
pub mod popup;
pub mod screens;
pub mod table;
pub mod tour;
pub mod update;
pub mod verb;
pub mod when;

use std::path::PathBuf;

use crate::model::{Address, Clock, ProfileName, Timestamp, Zone};
use crate::service::reply::{ChainView, ContactRow, IdentityView, KeysView, SiteView};
use crate::service::{Failure, NoticeLevel};
use alerts::{AlertBook, Toasts};
use form::{Field, Form};
use history::{History, Period, Progress, Rates};
use identity_path::IdentityPath;
use incidents::Incidents;
use opening::{Detail, Opening};
use palette::Exports;
use perform::Undo;
use popup::{Popup, Purpose};
use screens::topics::Topics;
use screens::{Gateway, Grants, Log, Records};
use serde::{Deserialize, Serialize};
use strum::{EnumCount, EnumIter, IntoEnumIterator as _, IntoStaticStr};
use table::Table;
use tour::{Cast, Tour};
use update::{Ahead, Feed, Feeds};

pub use keymap::{Key, Keymap};
pub use update::update;
pub use verb::{Action, Contents, Effect, Errand, Tag, Verb};

/// Rows of the screen that are not table rows: header, tabs, title, columns, message, bar.
pub const FRAME_ROWS: u16 = 6;

/// Nanoseconds between requests for the progress of imports and exports.
const PROGRESS_EVERY: u64 = 1_000_000_000;

#[derive(Debug, Clone, Default)]
pub struct Settings {
    pub profile: ProfileName,
    /// The operator who speaks, unless it is the profile's owner.
    pub operator: Option<String>,
    /// Hides what changes keys, grants or records.
    pub read_only: bool,
    /// Base of relative paths.
    pub directory: PathBuf,
    /// The meaning of `~`.
    pub home: Option<PathBuf>,
    pub keymap: Keymap,
    pub themes: Vec<String>,
    /// Nanoseconds without a key after which the keyring locks; `None` = never.
    pub lock_after: Option<u64>,
    pub zone: Zone,
    pub process: u32,
    /// Asks for the passphrase of a locked keyring at the start.
    pub asks_passphrase: bool,
    /// The home's profiles at the start.
    pub profiles: Vec<ProfileName>,
    pub tour: Option<Cast>,
    /// Whether a site can continue after this console.
    pub leaves_site: bool,
}

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
        usize::from(self.size.1.saturating_sub(FRAME_ROWS + tour::rows(self))).max(1)
    }

    /// The next moment at which time alone changes the screen.
    pub fn deadline(&self) -> Option<Timestamp> {
        let ages = Some(()).filter(|()| self.screen == Screen::Topics && !self.is_frozen());
        let moments = [
            self.toasts.next_expiry(),
            self.feeds.next_retry(),
            self.rates.still_at(),
            update::due(self),
            update::gives_up_at(self),
            ages.and_then(|()| self.topics.older_at(self.now)),
            self.alerts.forgotten_at(),
            opening::due(self),
            when::moves_at(self),
            self.progress_asked_at(),
            incidents::asked_at(self),
            policies::asked_at(self),
            self.graphs_move_at(),
            self.grants.nearer_at(self.now).filter(|_| self.screen == Screen::Grants && !self.is_frozen()),
        ];
        moments.into_iter().flatten().min()
    }

    /// No event reports the progress of imports and exports.
    fn progress_asked_at(&self) -> Option<Timestamp> {
        let seen = matches!(self.popups.last(), Some(Popup::Tasks)) && !self.is_frozen();
        (seen && self.progress.any()).then(|| Timestamp(self.progress_at.0.saturating_add(PROGRESS_EVERY)))
    }

    fn graphs_move_at(&self) -> Option<Timestamp> {
        let seen = self.screen == Screen::Overview && !self.is_frozen() && self.popups.is_empty();
        // No graph has finer parts.
        let parts = 2 * usize::from(history::cells(self.size.0));
        if seen { self.history.moves_at(self.period, parts, self.now) } else { None }
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
            && let Some(line) = palette::twin(self, &errand)
        {
            self.last_act = Some(line);
        }
        self.work.push(errand.tag.clone());
        self.effects.push(Effect::Send(errand.command, errand.tag));
    }

    /// Skips requests already in flight.
    pub fn send_new(&mut self, errand: Errand) {
        if !self.work.contains(&errand.tag) {
            self.send(errand);
        }
    }
}

/// Number keys 1 to 9 follow this order.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, EnumCount, EnumIter, IntoStaticStr)]
pub enum Screen {
    #[default]
    Overview,
    Topics,
    Records,
    Received,
    Grants,
    Keys,
    Chain,
    Robots,
    Log,
}

impl Screen {
    pub fn all() -> impl Iterator<Item = Self> {
        Self::iter()
    }

    pub fn title(self) -> &'static str {
        self.into()
    }

    pub fn index(self) -> usize {
        self as usize
    }

    /// Wraps around.
    pub fn shifted(self, by: isize) -> Self {
        let place = (self.index().cast_signed() + by).rem_euclid(Self::COUNT.cast_signed());
        Self::iter().nth(place.cast_unsigned()).unwrap_or(self)
    }

    /// Besides those the header always shows.
    pub fn feeds(self) -> &'static [Feed] {
        match self {
            Self::Overview => &[Feed::Topics, Feed::Grants],
            Self::Topics => &[Feed::Topics],
            Self::Records => &[Feed::Topics, Feed::Records],
            Self::Received => &[Feed::Topics, Feed::Received, Feed::Grants],
            Self::Grants => &[Feed::Grants],
            Self::Keys => &[Feed::Keys],
            Self::Chain => &[Feed::Chain],
            Self::Robots => &[Feed::Gateway],
            Self::Log => &[Feed::Audit],
        }
    }

    /// In the order of `s`; empty without a table.
    pub fn orders(self) -> &'static [&'static str] {
        match self {
            Self::Topics => &["name", "Hz", "bytes/s", "watched"],
            Self::Records | Self::Received => &["newest first", "oldest first"],
            Self::Grants => &["newest", "account", "state"],
            Self::Robots => &["connected", "name", "frames", "policy"],
            Self::Log => &["newest first"],
            Self::Overview | Self::Keys | Self::Chain => &[],
        }
    }

    pub fn has_table(self) -> bool {
        !self.orders().is_empty()
    }

    pub fn sorts(self) -> bool {
        self.orders().len() > 1
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirstStep {
    pub done: bool,
    pub name: &'static str,
    pub key: &'static str,
    pub text: &'static str,
}

/// Empty once the profile is set up.
pub fn first_steps(state: &State) -> Vec<FirstStep> {
    let Some(identity) = &state.identity else { return Vec::new() };
    let set_up = identity.exists && identity.registered;
    let step = |done, name, key, text| FirstStep { done, name, key, text };
    let steps = vec![
        match identity.exists {
            true => step(set_up, "identity", "R", "register the identity on the chain"),
            false => step(set_up, "identity", "n", "make keys and register them on the chain"),
        },
        step(identity.exists, "keys", "L", "created with the identity; press L to load your own"),
        step(state.watches(), "topics", "w", "watch a topic: its messages are encrypted and anchored"),
        step(
            state.grants.rows.iter().any(screens::is_given) || state.is_locked(),
            "grant",
            "g",
            "let another account read them",
        ),
    ];
    if steps.iter().all(|step| step.done) { Vec::new() } else { steps }
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptTable {
    pub filter: String,
    pub sort: usize,
    #[serde(default)]
    pub reversed: bool,
    /// In order; empty = the usual ones.
    #[serde(default)]
    pub columns: Vec<String>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Kept {
    pub screen: String,
    /// Topics, Records, Received, Grants, Gateway, Log.
    pub tables: Vec<KeptTable>,
    /// The least urgent level of the log: 0 to 2.
    pub level: u8,
    pub local_time: bool,
}

fn keep(table: &Table) -> KeptTable {
    KeptTable {
        filter: table.filter.text().to_owned(),
        sort: table.sort,
        reversed: table.reversed,
        columns: table.columns.iter().map(|name| (*name).to_owned()).collect(),
    }
}

pub fn kept(state: &State) -> Kept {
    Kept {
        screen: state.screen.title().to_owned(),
        tables: Screen::all().filter_map(|screen| state.table_of(screen)).map(keep).collect(),
        level: state.log.least as u8,
        local_time: state.local_time,
    }
}

/// Ignores what makes no sense here.
pub fn recall(state: &mut State, kept: &Kept) {
    if let Some(screen) = Screen::all().find(|screen| screen.title() == kept.screen) {
        state.screen = screen;
    }
    for (screen, kept) in Screen::all().filter(|screen| screen.has_table()).zip(&kept.tables) {
        let Some(table) = state.table_of_mut(screen) else { continue };
        table.filter = Field::with(&kept.filter);
        table.reversed = kept.reversed;
        table.sort = if kept.sort < screen.orders().len() { kept.sort } else { 0 };
        let names = kept.columns.iter().map(String::as_str);
        table.columns = choosing::known(screen, names).unwrap_or_default();
    }
    let levels = [NoticeLevel::Info, NoticeLevel::Warning, NoticeLevel::Error];
    state.log.least = levels.get(usize::from(kept.level)).copied().unwrap_or(NoticeLevel::Info);
    state.local_time = kept.local_time;
}

/// Upper-cases the first letter.
pub fn sentence(text: &str) -> String {
    let mut characters = text.chars();
    characters.next().map_or_else(String::new, |first| first.to_uppercase().chain(characters).collect())
}

#[cfg(test)]
pub mod tests;
