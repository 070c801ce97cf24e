//! One action in, the state changed, effects out; never waits, never fails.

use strum::IntoEnumIterator as _;

use crate::app::{
    Action, Effect, Errand, Feed, Key, Popup, Screen, State, Tag, Verb, acts, ahead, chord_label, history,
    keymap::Meaning, lock, rows, standing, tour, when,
};
use crate::model::{Clock, Timestamp};
use crate::popups;
use crate::popups::{form, form::policy, incidents, quit};
use crate::screens::{
    log::state::MOST_AUDIT, log::state::Source, pane, records::state::Records, records::state::is_settled, robots,
};
use crate::service::command::{AuditQuery, ListIncidents, ListRobots, RecordingProgress};
use crate::service::{Command, Event, NoticeLevel, Part};

/// Nanoseconds between requests for the progress of imports and exports.
const PROGRESS_EVERY: u64 = 1_000_000_000;

/// Claims the profile and requests what is on screen.
pub fn start(state: &mut State) -> Vec<Effect> {
    state.send(Errand { command: Command::OpenConsole, tag: Tag::OpenConsole });
    pull(state);
    std::mem::take(&mut state.effects)
}

impl State {
    /// The next moment at which time alone changes the screen.
    pub fn deadline(&self) -> Option<Timestamp> {
        let ages = Some(()).filter(|()| self.screen == Screen::Topics && !self.is_frozen());
        let moments = [
            self.toasts.next_expiry(),
            self.feeds.next_retry(),
            self.rates.still_at(),
            lock::due(self),
            ahead::gives_up_at(self),
            ages.and_then(|()| self.topics.older_at(self.now)),
            self.alerts.forgotten_at(),
            pane::follow::due(self),
            when::moves_at(self),
            self.progress_asked_at(),
            incidents::keys::asked_at(self),
            robots::keys::asked_at(self),
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
}

pub fn update(state: &mut State, action: Action) -> Vec<Effect> {
    if matches!(action, Action::Key(_) | Action::Paste(_) | Action::Click { .. } | Action::Do(_)) {
        state.touched = state.now;
    }
    if matches!(action, Action::Paste(_) | Action::Click { .. } | Action::Do(_)) {
        state.ahead.keys.clear();
    }
    act(state, action);
    for key in ahead::ready(state) {
        pressed(state, key);
    }
    state.topics.refresh(false);
    robots::keys::forget_if_locked(state);
    standing::refresh(state);
    tour::follow::follow(state);
    if quit::is_over(state) {
        state.effects.push(Effect::Quit);
    }
    pane::follow::follow(state);
    pull(state);
    std::mem::take(&mut state.effects)
}

fn act(state: &mut State, action: Action) {
    match action {
        Action::Do(verb) => acts::perform(state, verb),
        Action::Key(key) => pressed(state, key),
        Action::Answered { tag, result } => acts::answered(state, &tag, *result),
        Action::Told(event) => told(state, event),
        Action::Paste(text) => match state.popups.last_mut() {
            Some(popup) => popup.paste(&text),
            None => rows::filter_paste(state, &text),
        },
        Action::Resize { columns, rows } => resize(state, columns, rows),
        Action::Tick(now) => tick(state, now),
        Action::Missed => state.feeds.touch_all(),
        Action::FilesWritten(Ok(place)) => state.inform(format!("written: {place}")),
        Action::FilesWritten(Err(error)) => state.complain(error),
        Action::Fault(error) => {
            state.log.keep(state.now, NoticeLevel::Error, &error, Source::Site, None);
            state.toasts.push(NoticeLevel::Error, error, state.now, None);
        }
        Action::PathsFound(sought, found) => form::keys::found(state, &sought, found),
        Action::TextRead(path, read) => policy::text_read(state, &path, read),
        Action::ThemeIs(name) => state.theme = name,
        Action::Wheel { up } => wheel(state, up),
        Action::Click { column, row } => click(state, column, row),
        Action::Resumed => {
            state.feeds.touch_all();
            state.inform("resumed; a site hosted by this console was stopped meanwhile");
        }
    }
}

fn popup_pressed(state: &mut State, key: Key) {
    if let Some(verb) = popups::key(state, key) {
        acts::perform(state, verb);
    }
}

fn pressed(state: &mut State, key: Key) {
    state.greeted = true;
    // Both take precedence over any popup.
    for verb in [Verb::Suspend, Verb::Redraw] {
        if state.settings.keymap.is(key, verb, state.screen) {
            return acts::perform(state, verb);
        }
    }
    if !state.popups.is_empty() {
        return popup_pressed(state, key);
    }
    if state.table().is_some_and(|table| table.filtering) && key != Key::Control('c') {
        return filter_or_move(state, key);
    }
    if ahead::keeps(state, key) {
        return;
    }
    match state.settings.keymap.meaning(&[key], state.screen) {
        Meaning::Does(verb) => acts::perform(state, verb),
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
            rows::restart_records(state);
        }
        Key::Up => acts::perform(state, Verb::Up),
        Key::Down => acts::perform(state, Verb::Down),
        _ => rows::filter_key(state, key),
    }
}

fn told(state: &mut State, event: Event) {
    match event {
        Event::Changed { part } => {
            state.feeds.touch(part);
            if part == Part::Uploads {
                pane::follow::touch(state);
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
        (Feed::Incidents, incidents::keys::asked_at(state)),
        (Feed::Robots, robots::keys::asked_at(state)),
    ];
    for (feed, _) in again.into_iter().filter(|(_, at)| at.is_some_and(|at| at <= now)) {
        state.feeds.slot_mut(feed).stale = true;
    }
    lock::when_due(state);
}

/// One request per feed at a time.
fn pull(state: &mut State) {
    let clock = Clock { now: state.frozen.unwrap_or(state.now), ..state.times() };
    state.records.note_filter(&clock);
    state.received.note_filter(&clock);
    let mut wanted = vec![Feed::Site, Feed::Identity];
    wanted.extend(state.screen.feeds());
    wanted.extend(state.popups.iter().flat_map(Popup::feeds));
    wanted.extend(tour::follow::wants_grants(state).then_some(Feed::Grants));
    wanted.extend(robots::keys::wanted(state));
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
        Feed::Robots => robots::keys::is_open(state).then(|| ListRobots.into()),
    }
}

/// Rows above a list: header, screens, title, columns.
const ABOVE: u16 = 4;

fn wheel(state: &mut State, up: bool) {
    if state.popups.is_empty() {
        return acts::perform(state, if up { Verb::Up } else { Verb::Down });
    }
    popup_pressed(state, if up { Key::Up } else { Key::Down });
}

fn click(state: &mut State, column: u16, row: u16) {
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
            rows::select(state, wanted);
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
