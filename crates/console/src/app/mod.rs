//! The console's state and the pure `update(state, action) -> effects`.
//!
//! Nothing here draws, reads a clock, touches a file or waits: time comes in as
//! [`Action::Tick`], data as answers to the commands that went out as [`Effect`]s.
//! [`verb`] is the one list of what an operator can do; keymap, palette, help and bottom
//! bar are made from it.

pub mod administration;
pub mod alerts;
pub mod answer;
pub mod available;
pub mod choosing;
pub mod form;
pub mod granting;
pub mod history;
pub mod identity_path;
pub mod incidents;
pub mod keymap;
pub mod leaving;
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

use crate::model::{Address, ProfileName, Timestamp};
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
use when::Zone;

pub use keymap::{Key, Keymap};
pub use update::update;
pub use verb::{Action, Contents, Effect, Errand, Tag, Verb};

/// Rows of the screen that are not table rows: header, tabs, title, columns, message, bar.
pub const FRAME_ROWS: u16 = 6;

/// Interval between requests for the progress of running imports and exports, nanoseconds.
const PROGRESS_EVERY: u64 = 1_000_000_000;
/// Parts of a period that a graph shows, each a column.
pub const GRAPH_PARTS: usize = 45;

/// What does not change while the console runs.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// The profile it speaks for.
    pub profile: ProfileName,
    /// The operator who speaks, if it is not the profile's owner.
    pub operator: Option<String>,
    /// Hide what changes keys, grants or records.
    pub read_only: bool,
    /// Where relative paths start.
    pub directory: PathBuf,
    /// The meaning of `~`.
    pub home: Option<PathBuf>,
    /// Which keys do what.
    pub keymap: Keymap,
    /// Names of the themes that can be chosen.
    pub themes: Vec<String>,
    /// Nanoseconds without a key after which the keyring locks; `None` = never.
    pub lock_after: Option<u64>,
    /// The operator's time zone.
    pub zone: Zone,
    /// The process that the console runs in.
    pub process: u32,
    /// Ask for the passphrase of a locked keyring at the start.
    pub asks_passphrase: bool,
    /// The profiles of the home, as they were at the start.
    pub profiles: Vec<ProfileName>,
    /// Who is who in the tour, if the console starts with it.
    pub tour: Option<Cast>,
    /// Whether a site can be left running in the console's place.
    pub leaves_site: bool,
}

/// Everything the console knows and shows.
#[derive(Debug, Default)]
pub struct State {
    /// What does not change.
    pub settings: Settings,
    /// The latest known time.
    pub now: Timestamp,
    /// Columns and rows of the terminal.
    pub size: (u16, u16),
    /// The screen in view.
    pub screen: Screen,
    /// The moment at which the view is frozen, if it is.
    pub frozen: Option<Timestamp>,
    /// Whether any key was pressed, or the passphrase was asked for, since the start.
    pub greeted: bool,
    /// Name of the theme in use.
    pub theme: String,
    /// Whether the console has the mouse.
    pub mouse: bool,
    /// The state of the requests to the site.
    pub feeds: Feeds,
    /// The profile's public side.
    pub identity: Option<IdentityView>,
    pub keys: Option<KeysView>,
    /// The site at a glance.
    pub site: Option<SiteView>,
    /// When it answered so.
    pub site_at: Timestamp,
    /// How fast records flow.
    pub rates: Rates,
    /// Their flow over the last hour.
    pub history: History,
    /// The period of the graphs.
    pub period: Period,
    /// Imports, exports, audits and back-ups that run.
    pub progress: Progress,
    /// When they were reported.
    pub progress_at: Timestamp,
    /// The pane beside a list.
    pub detail: Detail,
    /// What needs attention, or did recently.
    pub alerts: AlertBook,
    pub chain: Option<ChainView>,
    pub topics: Topics,
    pub uploads: Records,
    pub shared: Records,
    pub grants: Grants,
    pub log: Log,
    /// The popups over the screen, topmost last.
    pub popups: Vec<Popup>,
    pub toasts: Toasts,
    /// Requests not yet answered, besides the feeds.
    pub work: Vec<Tag>,
    /// Commands that wait for an identity.
    pub identity_path: Option<IdentityPath>,
    pub gateway: Gateway,
    /// The file that is being read for a form.
    pub reading: Option<PathBuf>,
    pub contacts: Vec<ContactRow>,
    /// Spans that are kept.
    pub incidents: Incidents,
    /// The form behind the act that is under way, to come back to where it fails.
    pub filled: Option<(Tag, Purpose, Form)>,
    /// What is sent when the act of the tag is done, because one question asked for both.
    pub follow_up: Option<(Tag, Errand)>,
    /// The act that was sent last, as a command line.
    pub last_act: Option<String>,
    /// What undoing would do.
    pub undo: Option<Undo>,
    /// What was typed into the palette, the newest last.
    pub commands: Vec<String>,
    /// What is being exported, and where to.
    pub exports: Exports,
    /// When a key was last pressed.
    pub touched: Timestamp,
    /// Keys that wait for rows.
    pub ahead: Ahead,
    /// Whether local times are shown beside UTC.
    pub local_time: bool,
    /// The profile that this console spoke for before, until the current one is claimed.
    pub former: Option<ProfileName>,
    /// The tour, while it runs.
    pub tour: Option<Tour>,
}

impl State {
    /// Before the first answer.
    pub fn new(settings: Settings) -> Self {
        let tour = settings.tour.clone().map(Tour::new);
        Self { settings, tour, size: (80, 24), ..Self::default() }
    }

    /// Whether the view is frozen.
    pub fn is_frozen(&self) -> bool {
        self.frozen.is_some()
    }

    /// The moment that the screen shows.
    pub fn shown_at(&self) -> Timestamp {
        self.frozen.unwrap_or(self.now)
    }

    /// Whether there is a keyring, and it is locked.
    pub fn is_locked(&self) -> bool {
        self.identity.as_ref().is_some_and(|identity| identity.exists && !identity.unlocked)
    }

    /// How many table rows fit on the screen.
    pub fn page_rows(&self) -> usize {
        usize::from(self.size.1.saturating_sub(FRAME_ROWS + tour::rows(self))).max(1)
    }

    /// When time alone changes something; `None` = never.
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

    /// When the progress of imports and exports is requested again: no event reports it.
    fn progress_asked_at(&self) -> Option<Timestamp> {
        let seen = matches!(self.popups.last(), Some(Popup::Tasks)) && !self.is_frozen();
        (seen && self.progress.any()).then(|| Timestamp(self.progress_at.0.saturating_add(PROGRESS_EVERY)))
    }

    /// Sends the request again when it is time.
    pub fn ask_for_progress(&mut self) {
        if self.progress_asked_at().is_some_and(|at| at <= self.now) {
            self.feeds.slot_mut(Feed::Progress).stale = true;
        }
    }

    /// When the graphs move on, if they are on screen.
    fn graphs_move_at(&self) -> Option<Timestamp> {
        let seen = self.screen == Screen::Overview && !self.is_frozen() && self.popups.is_empty();
        if seen { self.history.moves_at(self.period, GRAPH_PARTS, self.now) } else { None }
    }

    /// Records not yet verified.
    pub fn pending_records(&self) -> u64 {
        self.site.as_ref().map_or(0, |site| site.life.pending)
    }

    /// Whether something would be left undone by leaving now.
    pub fn has_pending_work(&self) -> bool {
        self.pending_records() > 0 || self.work.iter().any(Tag::is_work)
    }

    pub fn address(&self) -> Option<Address> {
        self.identity.as_ref().and_then(|identity| identity.address)
    }

    /// Whether any topic is watched.
    pub fn watches(&self) -> bool {
        self.topics.rows.iter().any(|row| row.watched)
    }

    /// Whether a feed's data is being requested for the first time.
    pub fn awaits(&self, feed: Feed) -> bool {
        !self.feeds.slot(feed).loaded && self.feeds.slot(feed).failure.is_none()
    }

    /// Whether a feed is frozen with the view. The identity never is, because commands wait for it; nor are the counts
    /// while the console waits for them to be able to leave.
    pub fn holds(&self, feed: Feed) -> bool {
        let leaving = matches!(self.popups.last(), Some(Popup::Quit(_)));
        let needed = feed == Feed::Identity || feed == Feed::Site && leaving;
        // Pages of the past can still be turned; the request itself excludes what came later.
        self.is_frozen() && self.feeds.slot(feed).is_answered() && !needed
    }

    /// Shows the operator a message for 3 s.
    pub fn inform(&mut self, text: impl Into<String>) {
        self.toasts.push(NoticeLevel::Info, text.into(), self.now);
    }

    /// Shows the operator a message until it is seen.
    pub fn warn(&mut self, text: impl Into<String>) {
        let text = text.into();
        self.log.notice(self.now, NoticeLevel::Warning, &text);
        self.toasts.push(NoticeLevel::Warning, text, self.now);
    }

    /// `22:13:20`, with the local time beside it if that is wanted.
    pub fn clock(&self, moment: Timestamp) -> String {
        let local = if self.local_time { self.settings.zone.clock(moment) } else { None };
        local.map_or_else(|| moment.clock(), |local| format!("{} {local}", moment.clock()))
    }

    /// Reports a failure to the operator, until seen, and in the log.
    pub fn complain(&mut self, text: impl Into<String>) {
        let text = text.into();
        self.log.notice(self.now, NoticeLevel::Error, &text);
        self.toasts.push(NoticeLevel::Error, text, self.now);
    }

    /// Reports a failed command.
    pub fn complain_of(&mut self, tag: &Tag, failure: &Failure) {
        let text = format!("{}: {}", tag.words(), failure.message);
        self.log.notice(self.now, NoticeLevel::Error, &text);
        self.toasts.push_about(NoticeLevel::Error, text, self.now, Some(tag.words()));
    }

    /// Sends a command; an opened record gets its popup at once.
    pub fn send(&mut self, errand: Errand) -> Effect {
        if let Tag::Open(id) = &errand.tag {
            self.popups.push(Popup::Record(Opening::new(id)));
        }
        if errand.tag.is_work()
            && let Some(line) = palette::twin(self, &errand)
        {
            self.last_act = Some(line);
        }
        self.work.push(errand.tag.clone());
        Effect::Send(errand.command, errand.tag)
    }

    /// Sends what is not on its way already.
    pub fn send_new(&mut self, errands: Vec<Errand>) -> Vec<Effect> {
        let mut effects = Vec::new();
        for errand in errands {
            if !self.work.contains(&errand.tag) {
                effects.push(self.send(errand));
            }
        }
        effects
    }
}

/// A screen; number keys 1 to 9 switch in this order.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, EnumCount, EnumIter, IntoStaticStr)]
pub enum Screen {
    /// Health, record counts, alerts, busiest topics, first steps.
    #[default]
    Overview,
    /// Topics of the ROS graph.
    Topics,
    Uploads,
    /// Records shared with this profile.
    Shared,
    /// Grants given and received.
    Grants,
    Keys,
    Chain,
    Gateway,
    /// Notices and audit lines.
    Log,
}

impl Screen {
    pub fn all() -> impl Iterator<Item = Self> {
        Self::iter()
    }

    pub fn title(self) -> &'static str {
        self.into()
    }

    /// Its place, from 0.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The screen this many places further, wrapping around.
    pub fn shifted(self, by: isize) -> Self {
        let place = (self.index().cast_signed() + by).rem_euclid(Self::COUNT.cast_signed());
        Self::iter().nth(place.cast_unsigned()).unwrap_or(self)
    }

    /// The data it shows, besides what the header always shows.
    pub fn feeds(self) -> &'static [Feed] {
        match self {
            Self::Overview => &[Feed::Topics, Feed::Grants],
            Self::Topics => &[Feed::Topics],
            Self::Uploads => &[Feed::Topics, Feed::Uploads],
            Self::Shared => &[Feed::Topics, Feed::Shared, Feed::Grants],
            Self::Grants => &[Feed::Grants],
            Self::Keys => &[Feed::Keys],
            Self::Chain => &[Feed::Chain],
            Self::Gateway => &[Feed::Gateway],
            Self::Log => &[Feed::Audit],
        }
    }

    /// The orders of its table, in the order of `s`; none without a table.
    pub fn orders(self) -> &'static [&'static str] {
        match self {
            Self::Topics => &["name", "Hz", "bytes/s", "watched"],
            Self::Uploads | Self::Shared => &["newest first", "oldest first"],
            Self::Grants => &["newest", "account", "state"],
            Self::Gateway => &["connected", "name", "frames", "policy"],
            Self::Log => &["newest first"],
            Self::Overview | Self::Keys | Self::Chain => &[],
        }
    }

    /// Whether it is a table with cursor, filter and sort.
    pub fn has_table(self) -> bool {
        !self.orders().is_empty()
    }

    /// Whether `s` can sort the lines of its table.
    pub fn sorts(self) -> bool {
        self.orders().len() > 1
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirstStep {
    pub done: bool,
    pub name: &'static str,
    /// The key to press.
    pub key: &'static str,
    pub text: &'static str,
}

/// The steps while one that matters is open; empty once the profile is set up.
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
        step(state.grants.any_given() || state.is_locked(), "grant", "g", "let another account read them"),
    ];
    if steps.iter().all(|step| step.done) { Vec::new() } else { steps }
}

/// One table's filter and order.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptTable {
    /// The text of the filter.
    pub filter: String,
    pub sort: usize,
    /// Whether the order is reversed.
    #[serde(default)]
    pub reversed: bool,
    /// The columns chosen, in order; empty = the usual ones.
    #[serde(default)]
    pub columns: Vec<String>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Kept {
    /// Title of the screen in view.
    pub screen: String,
    /// Tables of Topics, Uploads, Shared, Grants, Gateway, Log.
    pub tables: Vec<KeptTable>,
    /// The least urgent level of the log: 0 to 2.
    pub level: u8,
    /// Whether local times are shown beside UTC.
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

/// What the next run should know.
pub fn kept(state: &State) -> Kept {
    Kept {
        screen: state.screen.title().to_owned(),
        tables: Screen::all().filter_map(|screen| state.table_of(screen)).map(keep).collect(),
        level: state.log.least as u8,
        local_time: state.local_time,
    }
}

/// Restores the state of the last run; what makes no sense here is left as it is.
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

/// With its first letter in upper case.
pub fn sentence(text: &str) -> String {
    let mut characters = text.chars();
    characters.next().map_or_else(String::new, |first| first.to_uppercase().chain(characters).collect())
}

/// `1 record`, `2 records`.
pub fn counted(count: u64, one: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {one}s") }
}

#[cfg(test)]
pub mod tests;
