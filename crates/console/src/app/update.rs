//! One action in, the state changed, effects out. Never waits, never fails.

use super::action::{Action, Effect, Errand, Tag};
use super::answer::answered;
use super::feed::Feed;
use super::key::{Key, chord_label};
use super::keymap::Meaning;
use super::perform::{perform, wants_grants};
use super::popup::{Popup, Purpose};
use super::popup_keys::{popup_key, popup_paste};
use super::screen::Screen;
use super::screens::log::MOST_AUDIT;
use super::state::State;
use super::verb::Verb;
use super::{ahead, alerts, countdown, cursor, detail, incidents, leaving, lock, mouse, paths, policies, tour};
use crate::model::{RecordState, Timestamp};
use crate::service::command::{AuditQuery, ListIncidents, ListRobots, RecordingProgress};
use crate::service::reply::{Caveat, ShownState};
use crate::service::{Command, Event, NoticeLevel, Operation, Part};

/// The first effects of a console: claim the profile, request what is on screen.
pub fn start(state: &mut State) -> Vec<Effect> {
    let claim = Errand { command: Command::OpenConsole, tag: Tag::OpenConsole };
    let mut effects = vec![state.send(claim)];
    effects.extend(pull(state));
    effects
}

/// Handles one action.
pub fn update(state: &mut State, action: Action) -> Vec<Effect> {
    if matches!(action, Action::Key(_) | Action::Paste(_) | Action::Click { .. } | Action::Do(_)) {
        state.touched = state.now;
    }
    if matches!(action, Action::Paste(_) | Action::Click { .. } | Action::Do(_)) {
        state.ahead.clear();
    }
    let mut effects = act(state, action);
    for key in ahead::ready(state) {
        effects.extend(pressed(state, key));
    }
    state.topics.refresh(false);
    policies::forget_if_locked(state);
    alerts::refresh(state);
    tour::follow(state);
    if leaving::is_over(state) {
        effects.push(Effect::Quit);
    }
    effects.extend(detail::follow(state));
    effects.extend(pull(state));
    effects
}

fn act(state: &mut State, action: Action) -> Vec<Effect> {
    match action {
        Action::Do(verb) => return perform(state, verb),
        Action::Key(key) => return pressed(state, key),
        Action::Answered { tag, result } => return answered(state, &tag, *result),
        Action::Told(event) => return told(state, event),
        Action::Paste(text) if state.popups.is_empty() => cursor::filter_paste(state, &text),
        Action::Paste(text) => popup_paste(state, &text),
        Action::Resize { columns, rows } => resize(state, columns, rows),
        Action::Tick(now) => return tick(state, now),
        Action::Missed => state.feeds.touch_all(),
        Action::FilesWritten(Ok(place)) => state.inform(format!("written: {place}")),
        Action::FilesWritten(Err(error)) => state.complain(error),
        Action::Fault(error) => {
            state.log.notice_about(state.now, NoticeLevel::Error, &error, None);
            state.toasts.push(NoticeLevel::Error, error, state.now);
        }
        Action::PathsFound(sought, found) => paths::found(state, &sought, found),
        Action::TextRead(path, read) => policies::text_read(state, &path, read),
        Action::ThemeIs(name) => state.theme = name,
        Action::Wheel { up } => return mouse::wheel(state, up),
        Action::Click { column, row } => mouse::click(state, column, row),
        Action::Resumed => {
            state.feeds.touch_all();
            state.inform("resumed; a site hosted by this console was stopped meanwhile");
        }
    }
    Vec::new()
}

fn pressed(state: &mut State, key: Key) -> Vec<Effect> {
    state.greeted = true;
    // These two take precedence over any popup.
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
    if ahead::keeps(state, key) {
        return Vec::new();
    }
    match state.settings.keymap.meaning(&[key], state.screen) {
        Meaning::Does(verb) => return perform(state, verb),
        Meaning::Begins(_) => state.popups.push(Popup::Chord(vec![key])),
        Meaning::Nothing => say_where(state, key),
    }
    Vec::new()
}

/// The most screens named for a key; one that works on more is no news.
const MOST_PLACES: usize = 3;

/// A letter of other screens does nothing here, and says where it would.
fn say_where(state: &mut State, key: Key) {
    let means = |screen: &Screen| !matches!(state.settings.keymap.meaning(&[key], *screen), Meaning::Nothing);
    let places: Vec<String> =
        Screen::ALL.into_iter().filter(means).map(|at| format!("{} ({})", at.title(), at.index() + 1)).collect();
    if matches!(key, Key::Char(_)) && (1..=MOST_PLACES).contains(&places.len()) {
        state.inform(format!("{} works on {}", chord_label(&[key]), places.join(", ")));
    }
}

fn filter_or_move(state: &mut State, key: Key) -> Vec<Effect> {
    match key {
        // In an empty filter the arrows go through earlier ones, otherwise through the rows.
        Key::Up | Key::Down if state.table_mut().is_some_and(|table| table.recall(key == Key::Up)) => {
            cursor::restart_records(state);
        }
        Key::Up => return perform(state, Verb::Up),
        Key::Down => return perform(state, Verb::Down),
        _ => cursor::filter_key(state, key),
    }
    Vec::new()
}

fn told(state: &mut State, event: Event) -> Vec<Effect> {
    match event {
        Event::Changed { part } => {
            state.feeds.touch(part);
            if part == Part::Uploads {
                detail::touch(state);
                state.gateway.robots_told = true;
            }
            if part == Part::Uploads { refresh_provenance(state) } else { Vec::new() }
        }
        Event::Notice { at, level, text, about } => {
            if let Some(about) = &about {
                state.toasts.supersede(about);
            }
            state.log.notice_about(at, level, &text, about.clone());
            state.feeds.slot_mut(Feed::Audit).stale = true;
            state.toasts.push_about(level, text, state.now, about);
            Vec::new()
        }
    }
}

/// An open provenance view follows its record until that is verified.
fn refresh_provenance(state: &mut State) -> Vec<Effect> {
    let Some(Popup::Provenance(lookup)) = state.popups.last() else { return Vec::new() };
    let settled = lookup.found().is_some_and(|found| is_settled(found.record.state));
    let (id, tag) = (lookup.id.clone(), Tag::Show(lookup.id.clone()));
    if settled || state.is_frozen() || state.work.contains(&tag) {
        return Vec::new();
    }
    vec![state.send(Errand { command: Command::ShowUpload { id }, tag })]
}

/// Whether a record is in its final state.
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
        state.feeds.renew(Feed::Uploads);
        state.feeds.renew(Feed::Shared);
    }
}

fn tick(state: &mut State, now: Timestamp) -> Vec<Effect> {
    state.now = now;
    if state.touched.0 == 0 {
        state.touched = now;
    }
    state.toasts.expire(now);
    state.feeds.retry(now);
    state.rates.settle(now);
    countdown::tick(state);
    state.ask_for_progress();
    incidents::tick(state);
    policies::tick(state);
    lock::tick(state)
}

/// The tasks popup shows the lanes, imports and exports.
fn wants_tasks(state: &State) -> impl Iterator<Item = Feed> + use<> {
    let asked = matches!(state.popups.last(), Some(Popup::Tasks));
    [Feed::Chain, Feed::Progress].into_iter().filter(move |_| asked)
}

/// A grant is checked against the address book, and completed from it.
fn wants_contacts(state: &State) -> impl Iterator<Item = Feed> + use<> {
    let asks = |popup: &Popup| matches!(popup, Popup::Form(Purpose::Grant, _) | Popup::Contacts(_));
    let asked = state.popups.iter().any(asks);
    [Feed::Contacts, Feed::Topics].into_iter().filter(move |_| asked)
}

/// The list tells of incidents, and the form of a new one knows the names that are taken.
fn wants_incidents(state: &State) -> impl Iterator<Item = Feed> + use<> {
    let asks = |popup: &Popup| matches!(popup, Popup::Incidents(_) | Popup::Form(Purpose::OpenIncident, _));
    let asked = state.popups.iter().any(asks);
    [Feed::Incidents, Feed::Topics].into_iter().filter(move |_| asked)
}

/// Asks for what is on screen and out of date, one question per feed at a time.
fn pull(state: &mut State) -> Vec<Effect> {
    let now = state.frozen.unwrap_or(state.now);
    state.uploads.note_filter(now);
    state.shared.note_filter(now);
    let always = [Feed::Site, Feed::Identity];
    let wanted = always
        .iter()
        .chain(state.screen.feeds())
        .copied()
        .chain(wants_grants(state))
        .chain(wants_contacts(state))
        .chain(wants_incidents(state))
        .chain(policies::wanted(state))
        .chain(wants_tasks(state));
    let mut wanted: Vec<Feed> = wanted.collect();
    if state.is_frozen() {
        // All screens are frozen at one moment; data that is valid for it is not requested again.
        wanted.extend(Feed::ALL);
    }
    wanted.into_iter().filter_map(|feed| ask(state, feed)).collect()
}

fn ask(state: &mut State, feed: Feed) -> Option<Effect> {
    let slot = state.feeds.slot(feed);
    let held = state.holds(feed);
    if !slot.stale || slot.outstanding || held {
        return None;
    }
    let command = question(state, feed)?;
    let slot = state.feeds.slot_mut(feed);
    slot.stale = false;
    slot.outstanding = true;
    Some(Effect::Send(command, Tag::Feed(feed, slot.generation)))
}

/// The command of a feed; `None` while there is nothing to request.
fn question(state: &State, feed: Feed) -> Option<Command> {
    let exists = state.identity.as_ref().is_some_and(|identity| identity.exists);
    let rows = state.page_rows();
    match feed {
        Feed::Site => Some(Command::SiteStatus),
        Feed::Identity => Some(Command::ShowIdentity),
        Feed::Topics => Some(Command::ListTopics),
        Feed::Chain => Some(Command::ChainStatus),
        Feed::Audit => Some(Command::ListAudit(AuditQuery { limit: MOST_AUDIT, ..AuditQuery::default() })),
        Feed::Keys => exists.then_some(Command::ListKeys),
        Feed::Grants => exists.then_some(Command::ListGrants),
        Feed::Uploads => {
            exists.then(|| Command::ListUploads(state.uploads.query(&state.topics.rows, rows, state.frozen)))
        }
        Feed::Shared => exists.then(|| Command::ListShared(state.shared.query(&state.topics.rows, rows, state.frozen))),
        Feed::Contacts => exists.then_some(Command::ListContacts),
        Feed::Incidents => exists.then(|| ListIncidents.into()),
        Feed::Progress => Some(RecordingProgress.into()),
        Feed::Gateway => Some(Command::Operate(Operation::GatewayStatus)),
        Feed::Robots => policies::is_open(state).then(|| ListRobots.into()),
    }
}

/// Information for the message line that is not a toast: the running commands.
pub fn under_way(state: &State) -> Option<String> {
    let mut work = state.work.iter().filter(|tag| tag.is_work());
    let first = work.next()?;
    let more = work.count();
    Some(if more > 0 { format!("{} and {more} more", first.words()) } else { first.words() })
}
