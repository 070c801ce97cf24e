//! One action in, the state changed, effects out; never waits, never fails. Also the mouse, keys typed ahead, locking.

use super::answer::answered;
use super::keymap::{Key, Meaning, chord_label};
use super::perform::perform;
use super::popup::{Popup, Purpose, popup_key, popup_paste};
use super::screens::{MOST_AUDIT, Records, Source};
use super::verb::{Action, Effect, Errand, Tag, Verb};
use super::{Screen, State, alerts, incidents, leaving, opening, palette, policies, table, tour, when};
use crate::model::{Clock, RecordState, Timestamp};
use crate::service::command::{AuditQuery, ListIncidents, ListRobots, RecordingProgress};
use crate::service::reply::{Caveat, ShownState};
use crate::service::{Command, Event, Failure, NoticeLevel, Part};
use strum::{EnumCount, EnumIter, IntoEnumIterator as _};

/// Claims the profile and requests what is on screen.
pub fn start(state: &mut State) -> Vec<Effect> {
    claim(state);
    std::mem::take(&mut state.effects)
}

pub(super) fn claim(state: &mut State) {
    state.send(Errand { command: Command::OpenConsole, tag: Tag::OpenConsole });
    pull(state);
}

pub fn update(state: &mut State, action: Action) -> Vec<Effect> {
    if matches!(action, Action::Key(_) | Action::Paste(_) | Action::Click { .. } | Action::Do(_)) {
        state.touched = state.now;
    }
    if matches!(action, Action::Paste(_) | Action::Click { .. } | Action::Do(_)) {
        state.ahead.keys.clear();
    }
    act(state, action);
    for key in ready(state) {
        pressed(state, key);
    }
    state.topics.refresh(false);
    policies::forget_if_locked(state);
    alerts::refresh(state);
    tour::follow(state);
    if leaving::is_over(state) {
        state.effects.push(Effect::Quit);
    }
    opening::follow(state);
    pull(state);
    std::mem::take(&mut state.effects)
}

fn act(state: &mut State, action: Action) {
    match action {
        Action::Do(verb) => perform(state, verb),
        Action::Key(key) => pressed(state, key),
        Action::Answered { tag, result } => answered(state, &tag, *result),
        Action::Told(event) => told(state, event),
        Action::Paste(text) if state.popups.is_empty() => table::filter_paste(state, &text),
        Action::Paste(text) => popup_paste(state, &text),
        Action::Resize { columns, rows } => resize(state, columns, rows),
        Action::Tick(now) => tick(state, now),
        Action::Missed => state.feeds.touch_all(),
        Action::FilesWritten(Ok(place)) => state.inform(format!("written: {place}")),
        Action::FilesWritten(Err(error)) => state.complain(error),
        Action::Fault(error) => {
            state.log.keep(state.now, NoticeLevel::Error, &error, Source::Site, None);
            state.toasts.push(NoticeLevel::Error, error, state.now, None);
        }
        Action::PathsFound(sought, found) => palette::found(state, &sought, found),
        Action::TextRead(path, read) => policies::text_read(state, &path, read),
        Action::ThemeIs(name) => state.theme = name,
        Action::Wheel { up } => wheel(state, up),
        Action::Click { column, row } => click(state, column, row),
        Action::Resumed => {
            state.feeds.touch_all();
            state.inform("resumed; a site hosted by this console was stopped meanwhile");
        }
    }
}

fn pressed(state: &mut State, key: Key) {
    state.greeted = true;
    // Both take precedence over any popup.
    for verb in [Verb::Suspend, Verb::Redraw] {
        if state.settings.keymap.is(key, verb, state.screen) {
            return perform(state, verb);
        }
    }
    if !state.popups.is_empty() {
        return popup_key(state, key);
    }
    if state.table().is_some_and(|table| table.filtering) && key != Key::Control('c') {
        return filter_or_move(state, key);
    }
    if keeps(state, key) {
        return;
    }
    match state.settings.keymap.meaning(&[key], state.screen) {
        Meaning::Does(verb) => perform(state, verb),
        Meaning::Begins(_) => state.popups.push(Popup::Chord(vec![key])),
        Meaning::Nothing => say_where(state, key),
    }
}

/// A key that works on more screens than this is no news.
const MOST_PLACES: usize = 3;

/// A key of other screens does nothing here, and says where it would.
fn say_where(state: &mut State, key: Key) {
    let means = |screen: &Screen| !matches!(state.settings.keymap.meaning(&[key], *screen), Meaning::Nothing);
    let places: Vec<String> =
        Screen::all().filter(means).map(|at| format!("{} ({})", at.title(), at.index() + 1)).collect();
    if matches!(key, Key::Char(_)) && (1..=MOST_PLACES).contains(&places.len()) {
        state.inform(format!("{} works on {}", chord_label(&[key]), places.join(", ")));
    }
}

fn filter_or_move(state: &mut State, key: Key) {
    match key {
        // An empty filter recalls earlier ones; otherwise arrows move through the rows.
        Key::Up | Key::Down if state.table_mut().is_some_and(|table| table.recall(key == Key::Up)) => {
            table::restart_records(state);
        }
        Key::Up => perform(state, Verb::Up),
        Key::Down => perform(state, Verb::Down),
        _ => table::filter_key(state, key),
    }
}

fn told(state: &mut State, event: Event) {
    match event {
        Event::Changed { part } => {
            state.feeds.touch(part);
            if part == Part::Uploads {
                opening::touch(state);
                state.gateway.robots_told = true;
                refresh_provenance(state);
            }
        }
        Event::Notice { at, level, text, about } => {
            if let Some(about) = &about {
                state.toasts.supersede(about);
            }
            state.log.keep(at, level, &text, Source::Site, about.clone());
            state.feeds.slot_mut(Feed::Audit).stale = true;
            state.toasts.push(level, text, state.now, about);
        }
    }
}

/// An open provenance view follows its record until it is settled.
fn refresh_provenance(state: &mut State) {
    let Some(Popup::Provenance(lookup)) = state.popups.last() else { return };
    let settled = lookup.found().is_some_and(|found| is_settled(found.record.state));
    let (id, tag) = (lookup.id.clone(), Tag::Show(lookup.id.clone()));
    if !settled && !state.is_frozen() {
        state.send_new(Errand { command: Command::ShowUpload { id }, tag });
    }
}

pub fn is_settled(state: ShownState) -> bool {
    matches!(
        state,
        ShownState::Kept(RecordState::Verified) | ShownState::Verified(Caveat::NamesUnchecked) | ShownState::Refused(_)
    )
}

fn resize(state: &mut State, columns: u16, rows: u16) {
    let before = state.page_rows();
    state.size = (columns, rows);
    if state.page_rows() != before {
        state.feeds.renew(Feed::Records);
        state.feeds.renew(Feed::Received);
    }
}

fn tick(state: &mut State, now: Timestamp) {
    state.now = now;
    if state.touched.0 == 0 {
        state.touched = now;
    }
    state.toasts.expire(now);
    state.feeds.retry(now);
    state.rates.settle(now);
    when::tick(state);
    let again = [
        (Feed::Progress, state.progress_asked_at()),
        (Feed::Incidents, incidents::asked_at(state)),
        (Feed::Robots, policies::asked_at(state)),
    ];
    for (feed, _) in again.into_iter().filter(|(_, at)| at.is_some_and(|at| at <= now)) {
        state.feeds.slot_mut(feed).stale = true;
    }
    lock_when_due(state);
}

/// One request per feed at a time.
fn pull(state: &mut State) {
    let clock = Clock { now: state.frozen.unwrap_or(state.now), ..state.times() };
    state.records.note_filter(&clock);
    state.received.note_filter(&clock);
    let mut wanted = vec![Feed::Site, Feed::Identity];
    wanted.extend(state.screen.feeds());
    wanted.extend(state.popups.iter().flat_map(Popup::feeds));
    wanted.extend(tour::wants_grants(state).then_some(Feed::Grants));
    wanted.extend(policies::wanted(state));
    if state.is_frozen() {
        // All screens freeze at one moment; data valid for it is not requested again.
        wanted.extend(Feed::iter());
    }
    wanted.into_iter().for_each(|feed| ask(state, feed));
}

fn ask(state: &mut State, feed: Feed) {
    let slot = state.feeds.slot(feed);
    if !slot.stale || slot.outstanding || state.holds(feed) {
        return;
    }
    let Some(command) = question(state, feed) else { return };
    let slot = state.feeds.slot_mut(feed);
    (slot.stale, slot.outstanding) = (false, true);
    state.effects.push(Effect::Send(command, Tag::Feed(feed, slot.generation)));
}

/// `None` while there is nothing to request.
fn question(state: &State, feed: Feed) -> Option<Command> {
    let exists = state.identity.as_ref().is_some_and(|identity| identity.exists);
    let query = |records: &Records| records.query(&state.topics.rows, state.page_rows(), state.frozen);
    match feed {
        Feed::Site => Some(Command::SiteStatus),
        Feed::Identity => Some(Command::ShowIdentity),
        Feed::Topics => Some(Command::ListTopics),
        Feed::Chain => Some(Command::ChainStatus),
        Feed::Audit => Some(Command::ListAudit(AuditQuery { limit: MOST_AUDIT, ..AuditQuery::default() })),
        Feed::Keys => exists.then_some(Command::ListKeys),
        Feed::Grants => exists.then_some(Command::ListGrants),
        Feed::Records => query(&state.records).filter(|_| exists).map(Command::ListUploads),
        Feed::Received => query(&state.received).filter(|_| exists).map(Command::ListShared),
        Feed::Contacts => exists.then_some(Command::ListContacts),
        Feed::Incidents => exists.then(|| ListIncidents.into()),
        Feed::Progress => Some(RecordingProgress.into()),
        Feed::Gateway => Some(Command::GatewayStatus),
        Feed::Robots => policies::is_open(state).then(|| ListRobots.into()),
    }
}

pub fn under_way(state: &State) -> Option<String> {
    let mut work = state.work.iter().filter(|tag| tag.is_work());
    let first = work.next()?;
    let more = work.count();
    Some(if more > 0 { format!("{} and {more} more", first.words()) } else { first.words() })
}

/// Rows above a list: header, screens, title, columns.
const ABOVE: u16 = 4;

pub fn toggle(state: &mut State) {
    state.mouse = !state.mouse;
    state.inform(match state.mouse {
        true => "mouse on; hold shift to select text in most terminals",
        false => "mouse off; the terminal handles text selection again",
    });
    state.effects.push(Effect::Mouse(state.mouse));
}

pub fn wheel(state: &mut State, up: bool) {
    if state.popups.is_empty() {
        return perform(state, if up { Verb::Up } else { Verb::Down });
    }
    popup_key(state, if up { Key::Up } else { Key::Down });
}

pub fn click(state: &mut State, column: u16, row: u16) {
    if !state.popups.is_empty() {
        return;
    }
    if row == 1 {
        if let Some(screen) = named_at(state.size.0, column) {
            state.screen = screen;
        }
        return;
    }
    // This screen's rows begin lower, in two parts.
    if state.screen == Screen::Robots {
        return;
    }
    let Some(line) = row.checked_sub(ABOVE).map(usize::from).filter(|line| *line < state.page_rows()) else { return };
    let keys = state.row_keys();
    let page = state.page_rows();
    if let Some(table) = state.table() {
        let here = table.position(&keys);
        let wanted = here - here % page + line;
        if wanted < keys.len() {
            super::table::select(state, wanted);
        }
    }
}

/// `None` everywhere if the names do not fit.
fn named_at(columns: u16, column: u16) -> Option<Screen> {
    let gap = Screen::all().map(|screen| screen.title().len() + 3).sum::<usize>() <= usize::from(columns);
    let mut left = 0;
    let wide_enough = columns >= 80;
    Screen::all().filter(|_| wide_enough).find(|screen| {
        let from = left;
        left += screen.title().len() + 2 + usize::from(gap);
        (from..left - 1).contains(&usize::from(column))
    })
}

/// Longest wait for rows, nanoseconds.
const LONGEST: u64 = 3_000_000_000;
/// The most keys that wait.
const MOST: usize = 64;

#[derive(Debug, Default)]
pub struct Ahead {
    keys: Vec<Key>,
    since: Timestamp,
}

/// Keeps back keys for rows that are still on their way, and keys after those; Esc drops them, Ctrl-C never waits.
pub fn keeps(state: &mut State, key: Key) -> bool {
    if !state.awaits_rows() {
        return false;
    }
    let waiting = !state.ahead.keys.is_empty();
    if matches!(key, Key::Escape | Key::Control('c')) {
        state.ahead.keys.clear();
        return waiting && key == Key::Escape;
    }
    if !waiting && !is_for_a_row(state, key) {
        return false;
    }
    if !waiting {
        state.ahead.since = state.now;
    }
    if state.ahead.keys.len() < MOST {
        state.ahead.keys.push(key);
    }
    true
}

/// Gives up keys whose rows do not come, and says so.
pub fn ready(state: &mut State) -> Vec<Key> {
    if state.ahead.keys.is_empty() {
        return Vec::new();
    }
    if !state.awaits_rows() {
        let keys = std::mem::take(&mut state.ahead.keys);
        let shown = state.popups.is_empty() && state.rows_are_here();
        return if shown { keys } else { given_up(state) };
    }
    if gives_up_at(state).is_some_and(|at| at <= state.now) { given_up(state) } else { Vec::new() }
}

pub fn gives_up_at(state: &State) -> Option<Timestamp> {
    (!state.ahead.keys.is_empty()).then(|| Timestamp(state.ahead.since.0.saturating_add(LONGEST)))
}

fn given_up(state: &mut State) -> Vec<Key> {
    state.ahead.keys.clear();
    state.inform("not done: the list was not here yet");
    Vec::new()
}

fn is_for_a_row(state: &State, key: Key) -> bool {
    use Verb::{Check, Copy, Details, Export, Incident, Mark, MarkAll, Open, Play, Readers, WriteFile};
    let Meaning::Does(verb) = state.settings.keymap.meaning(&[key], state.screen) else { return false };
    let acts = matches!(verb, Details | Open | Check | Export | Mark | MarkAll | Readers | Play | Incident);
    acts || matches!(verb, Copy | WriteFile)
}

/// Wipes the keys, and takes everything decrypted off the screen.
pub fn lock(state: &mut State) {
    state.popups.retain(|popup| match popup {
        Popup::Record(_) | Popup::Confirm(_) => false,
        Popup::Form(purpose, _) => *purpose == Purpose::Unlock,
        _ => true,
    });
    (state.identity_path, state.filled) = (None, None);
    state.detail = opening::Detail::default();
    state.ahead.keys.clear();
    state.send_new(Errand { command: Command::Lock, tag: Tag::Lock });
}

pub fn due(state: &State) -> Option<Timestamp> {
    let after = state.settings.lock_after?;
    let open = state.identity.as_ref().is_some_and(|identity| identity.unlocked);
    let begun = state.work.contains(&Tag::Lock);
    (open && !begun && state.touched.0 > 0).then(|| Timestamp(state.touched.0.saturating_add(after)))
}

pub fn lock_when_due(state: &mut State) {
    if due(state).is_some_and(|at| at <= state.now) {
        let minutes = state.settings.lock_after.unwrap_or(0) / 60_000_000_000;
        state.warn(format!(
            "locked after {minutes} minutes without a key press; a running capture continues, u unlocks"
        ));
        lock(state);
    }
}

/// Nanoseconds.
const RETRY_AFTER: u64 = 5_000_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, EnumCount, EnumIter)]
pub enum Feed {
    Site,
    Identity,
    Keys,
    Topics,
    Records,
    Received,
    Grants,
    Chain,
    Audit,
    Gateway,
    Contacts,
    Progress,
    Incidents,
    Robots,
}

impl Feed {
    pub fn touched_by(part: Part) -> &'static [Self] {
        match part {
            Part::Topics => &[Self::Topics],
            Part::Uploads => &[Self::Records, Self::Site, Self::Gateway],
            Part::Grants => &[Self::Grants, Self::Received, Self::Audit],
            Part::Chain => &[Self::Chain, Self::Received, Self::Gateway],
            Part::Health => &[Self::Site, Self::Gateway],
            Part::Identity => &[Self::Identity, Self::Keys, Self::Audit, Self::Robots],
        }
    }
}

#[expect(clippy::struct_excessive_bools, reason = "each is a fact of its own")]
#[derive(Debug, Clone, Default)]
pub struct Slot {
    /// Grows when the request changes, so that older answers are dropped.
    pub generation: u64,
    /// In flight.
    pub outstanding: bool,
    /// Older than the site's data.
    pub stale: bool,
    /// Answered at least once.
    pub loaded: bool,
    /// From an earlier visit to the screen.
    pub left: bool,
    /// The generation that the data answers.
    pub told: u64,
    pub failure: Option<Failure>,
    pub retry_at: Option<Timestamp>,
}

impl Slot {
    pub fn is_answered(&self) -> bool {
        self.loaded && self.told == self.generation
    }
}

#[derive(Debug, Clone)]
pub struct Feeds([Slot; Feed::COUNT]);

impl Default for Feeds {
    fn default() -> Self {
        Self(std::array::from_fn(|_| Slot { stale: true, ..Slot::default() }))
    }
}

impl Feeds {
    pub fn slot(&self, feed: Feed) -> &Slot {
        &self.0[feed as usize]
    }

    pub fn slot_mut(&mut self, feed: Feed) -> &mut Slot {
        &mut self.0[feed as usize]
    }

    pub fn touch(&mut self, part: Part) {
        for feed in Feed::touched_by(part) {
            self.slot_mut(*feed).stale = true;
        }
    }

    pub fn touch_all(&mut self) {
        for slot in &mut self.0 {
            slot.stale = true;
        }
    }

    pub fn touch_failed(&mut self) {
        for slot in self.0.iter_mut().filter(|slot| slot.failure.is_some()) {
            slot.stale = true;
        }
    }

    /// Marks data that went stale while its screen was hidden.
    pub fn look(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.left |= slot.stale && slot.loaded;
    }

    /// The request changed (page, filter): drops the answer in flight.
    pub fn renew(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.generation += 1;
        slot.outstanding = false;
        slot.stale = true;
    }

    /// An act of this console changed the data: an answer in flight may predate it, and is dropped.
    pub fn overtake(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.stale = true;
        if std::mem::take(&mut slot.outstanding) {
            slot.told += u64::from(slot.told == slot.generation);
            slot.generation += 1;
        }
    }

    /// Answers to requests of `former` match none of these.
    pub fn follow(&mut self, former: &Self) {
        for (slot, before) in self.0.iter_mut().zip(&former.0) {
            slot.generation = before.generation + 1;
        }
    }

    /// Requests everything once, even though the view is frozen from now on.
    pub fn gather(&mut self) {
        Feed::iter().for_each(|feed| self.renew(feed));
    }

    /// False for an answer to an older request.
    pub fn answered(&mut self, feed: Feed, generation: u64, failure: Option<Failure>, now: Timestamp) -> bool {
        let slot = self.slot_mut(feed);
        if slot.generation != generation {
            return false;
        }
        slot.outstanding = false;
        if failure.is_none() {
            (slot.loaded, slot.left, slot.told) = (true, false, generation);
        }
        slot.retry_at = failure.as_ref().map(|_| Timestamp(now.0.saturating_add(RETRY_AFTER)));
        slot.failure = failure;
        true
    }

    pub fn retry(&mut self, now: Timestamp) {
        for slot in self.0.iter_mut().filter(|slot| slot.retry_at.is_some_and(|at| at <= now)) {
            slot.retry_at = None;
            slot.stale = true;
        }
    }

    pub fn next_retry(&self) -> Option<Timestamp> {
        self.0.iter().filter_map(|slot| slot.retry_at).min()
    }
}
