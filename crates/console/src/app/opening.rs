//! An opened record over the screen or beside the list: its faces, their keys, its files.

use strum::IntoStaticStr;
use zeroize::Zeroizing;

use super::keymap::Key;
use super::perform::{copy, perform};
use super::popup::{Lookup, Popup, scrolled};
use super::verb::{Contents, Effect, Errand, Tag, Verb};
use super::{Screen, State};
use crate::model::{Timestamp, TopicName};
use crate::service::command::ViewPath;
use crate::service::reply::{CoverageView, OpenedView, PathView, Provenance};
use crate::service::{Command, Failure};

/// Records of a requested path.
const PATH: usize = 200;

pub const BYTES_A_LINE: usize = 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoStaticStr)]
pub enum Face {
    #[strum(serialize = "Values")]
    Readable,
    /// Points of a plane, or the path over the topic's records.
    Plot,
    Picture,
    Fields,
    Bytes,
}

impl Face {
    pub fn title(self) -> &'static str {
        self.into()
    }

    /// The first is shown first.
    pub fn of(view: &OpenedView) -> Vec<Self> {
        let readable = view.readable.as_ref();
        let has = |found: bool, face| found.then_some(face);
        let faces = [
            has(readable.is_some_and(|readable| readable.picture.is_some()), Self::Picture),
            has(readable.is_some(), Self::Readable),
            has(readable.is_some_and(|readable| readable.plot.is_some()), Self::Plot),
            has(true, Self::Fields),
            has(!view.beginning.is_empty(), Self::Bytes),
        ];
        faces.into_iter().flatten().collect()
    }
}

#[derive(Debug)]
pub struct Opening {
    pub lookup: Lookup<OpenedView>,
    pub face: usize,
    /// Whether a picture or plot fills the window.
    pub alone: bool,
    pub path: Option<Lookup<PathView>>,
}

impl Opening {
    pub fn new(id: &str) -> Self {
        Self { lookup: Lookup::new(id), face: 0, alone: false, path: None }
    }

    pub fn shown(&self) -> Face {
        let faces = self.lookup.found().map(Face::of).unwrap_or_default();
        faces.get(self.face).copied().unwrap_or(Face::Fields)
    }

    pub fn hints(&self) -> Vec<(&'static str, &'static str)> {
        let Some(view) = self.lookup.found() else { return vec![("q", "close")] };
        let mut hints = vec![("tab", "next view"), ("n p", "next/prev")];
        hints.push(if self.is_drawn() { ("enter", "larger") } else { ("up down", "scroll") });
        if writable(view).is_some() {
            hints.extend([("W", "save"), ("y", "copy digest")]);
        }
        hints.push(("q", "close"));
        hints
    }

    pub fn is_drawn(&self) -> bool {
        matches!(self.shown(), Face::Picture | Face::Plot)
    }

    fn turn(&mut self, back: bool) {
        let count = self.lookup.found().map_or(1, |view| Face::of(view).len());
        self.face = (self.face + if back { count - 1 } else { 1 }) % count;
        self.lookup.scroll = 0;
    }

    /// Requests the path once, when it is to be shown.
    fn wants_path(&mut self) -> Option<Errand> {
        let plot = self.lookup.found()?.readable.as_ref()?.plot.as_ref()?;
        if self.shown() != Face::Plot || !plot.path || plot.points.len() > 1 || self.path.is_some() {
            return None;
        }
        let id = self.lookup.id.clone();
        self.path = Some(Lookup::new(&id));
        let command = ViewPath { id: id.clone(), records: PATH }.into();
        Some(Errand { command, tag: Tag::Path(id) })
    }

    fn lines(&self) -> usize {
        let Some(view) = self.lookup.found() else { return 0 };
        match self.shown() {
            Face::Readable => view.readable.as_ref().map_or(0, |readable| {
                readable.lines.len() + readable.tables.iter().map(|table| table.rows.len() + 3).sum::<usize>()
            }),
            Face::Fields => view.fields.len() + 8,
            Face::Bytes => view.beginning.len().div_ceil(BYTES_A_LINE),
            Face::Plot | Face::Picture => 0,
        }
    }
}

pub fn key(state: &mut State, mut opening: Opening, key: Key) {
    match key {
        Key::Tab | Key::Right => opening.turn(false),
        Key::BackTab | Key::Left => opening.turn(true),
        Key::Enter if opening.is_drawn() => opening.alone = !opening.alone,
        Key::Char('n') => return neighbour(state, Popup::Record(opening), 1),
        Key::Char('p') => return neighbour(state, Popup::Record(opening), -1),
        Key::Char('W') => match opening.lookup.found().map(writable) {
            Some(Some(file)) => {
                state.effects.push(Effect::WriteFiles { base: None, directory: None, files: vec![file] });
            }
            Some(None) => state
                .inform(format!("too large to save here; use `authros records open {} --out FILE`", opening.lookup.id)),
            None => {}
        },
        Key::Char('y') => {
            let digest = opening.lookup.found().map(|view| view.record.digest.to_hex());
            digest.into_iter().for_each(|digest| copy(state, digest));
        }
        _ => match scrolled(opening.lookup.scroll, key, state.page_rows()) {
            Some(scroll) => opening.lookup.scroll = scroll.min(opening.lines()),
            None => return,
        },
    }
    let path = opening.wants_path();
    state.popups.push(Popup::Record(opening));
    path.into_iter().for_each(|errand| state.send(errand));
}

pub fn neighbour(state: &mut State, popup: Popup, by: isize) {
    let before = state.row_key();
    let keys = state.row_keys();
    let moved = state.table_mut().is_some_and(|table| table.step(&keys, by));
    if !moved || state.row_key() == before {
        state.popups.push(popup);
        let place = if by > 0 { "last" } else { "first" };
        return state.inform(format!("this is the {place} record of the page"));
    }
    super::table::stand(state);
    perform(state, if matches!(popup, Popup::Record(_)) { Verb::Open } else { Verb::Details });
}

pub fn opened(state: &mut State, id: &str, answer: Result<Box<OpenedView>, Failure>) {
    let Some(opening) = find(state, id) else { return };
    opening.lookup.answer = Some(answer);
    opening.wants_path().into_iter().for_each(|errand| state.send(errand));
}

pub fn path_found(state: &mut State, id: &str, answer: Result<PathView, Failure>) {
    if let Some(path) = find(state, id).and_then(|opening| opening.path.as_mut()) {
        path.answer = Some(answer.map(Box::new));
    }
}

fn find<'a>(state: &'a mut State, id: &str) -> Option<&'a mut Opening> {
    state.popups.iter_mut().find_map(|popup| match popup {
        Popup::Record(opening) if opening.lookup.id == id => Some(opening),
        _ => None,
    })
}

/// The picture, or else the bytes, or else the fields; `None` if too long.
fn writable(view: &OpenedView) -> Option<Contents> {
    let plain = |character: char| if character.is_ascii_alphanumeric() { character } else { '_' };
    let stem: String = view.record.topic.trim_matches('/').chars().map(plain).collect();
    let named = |extension: &str, bytes: &[u8]| Contents {
        name: format!("{stem}-{}.{extension}", view.record.seq),
        bytes: Zeroizing::new(bytes.to_vec()),
    };
    if let Some(picture) = &view.picture {
        let extension = if picture.starts_with(b"\x89PNG") { "png" } else { "jpg" };
        return Some(named(extension, picture));
    }
    match &view.body {
        Some(body) => Some(named("bin", body)),
        None if view.message.is_null() || view.record.bytes > 4 << 20 => None,
        None => Some(named("json", view.message.to_string().as_bytes())),
    }
}

/// Terminal width from which there is a pane.
pub const WIDE_FROM: u16 = 140;
/// Columns that the list beside a pane keeps.
const LIST: u16 = 84;
/// Columns of the widest pane.
const WIDEST: u16 = 84;
/// How long the cursor rests before a record is requested, nanoseconds.
const REST: u64 = 300_000_000;
/// Nanoseconds between requests for a topic's coverage.
const COVERAGE_EVERY: u64 = 30_000_000_000;
const PARTS: usize = 60;

#[derive(Debug, Default)]
pub struct Detail {
    about: Option<(Screen, String)>,
    due: Option<Timestamp>,
    pub steps: Option<Lookup<Provenance>>,
    pub opening: Option<Opening>,
    /// A topic, and when it has records.
    pub coverage: Option<(String, Result<Box<CoverageView>, Failure>)>,
}

pub fn coverage_of(topic: &TopicName) -> Errand {
    let command = Command::TopicCoverage { topic: topic.clone(), robot: None, since: None, until: None, parts: PARTS };
    Errand { command, tag: Tag::Beside(Screen::Topics, topic.to_string()) }
}

/// Waits while another answer is outstanding.
pub fn due(state: &State) -> Option<Timestamp> {
    state.detail.due.filter(|_| may_ask(state))
}

/// One record at a time; nothing behind a popup or while keys are being wiped.
fn may_ask(state: &State) -> bool {
    state.popups.is_empty() && !state.work.iter().any(|tag| matches!(tag, Tag::Beside(..) | Tag::Lock))
}

pub fn is_shown(state: &State) -> bool {
    state.size.0 >= WIDE_FROM && state.screen.has_table()
}

pub fn list_width(state: &State) -> u16 {
    let whole = state.size.0;
    if is_shown(state) { whole - (whole / 2).min(WIDEST).min(whole.saturating_sub(LIST)) } else { whole }
}

/// Only a record that the cursor was moved to, not just the newest.
fn wanted(state: &State) -> Option<(Screen, String)> {
    let open = state.identity.as_ref().is_some_and(|identity| identity.unlocked);
    let tells = match state.screen {
        Screen::Topics => state.identity.as_ref().is_some_and(|identity| identity.exists),
        Screen::Records => true,
        Screen::Received => open,
        _ => false,
    };
    let aimed = state.table().is_some_and(|table| table.is_bound() && !table.filtering);
    if !tells || !aimed || !is_shown(state) || !state.popups.is_empty() {
        return None;
    }
    Some((state.screen, state.row_key()?))
}

/// Sends a request once the cursor rests.
pub fn follow(state: &mut State) {
    if state.popups.is_empty() {
        let wanted = wanted(state);
        if wanted != state.detail.about {
            let due = wanted.as_ref().map(|_| Timestamp(state.now.0.saturating_add(REST)));
            // Coverage names its topic, so it stays until another topic's arrives.
            let coverage = state.detail.coverage.take();
            state.detail = Detail { about: wanted, due, coverage, ..Detail::default() };
        }
    }
    let rested = state.detail.due.is_some_and(|due| due <= state.now);
    let may_ask = may_ask(state);
    let Some((screen, id)) = state.detail.about.clone().filter(|_| rested && may_ask) else { return };
    state.detail.due = None;
    if screen == Screen::Topics {
        let topic = id.parse::<TopicName>().ok().filter(|_| state.topics.robot(&id).is_none());
        return topic.into_iter().for_each(|topic| state.send(coverage_of(&topic)));
    }
    let command = if screen == Screen::Records {
        // The previous details stay until the new answer arrives.
        state.detail.steps =
            state.detail.steps.take().filter(|steps| steps.id == id).or_else(|| Some(Lookup::new(&id)));
        Command::ShowUpload { id: id.clone() }
    } else {
        state.detail.opening = Some(Opening::new(&id));
        Command::OpenShared { id: id.clone() }
    };
    state.send(Errand { command, tag: Tag::Beside(screen, id) });
}

/// Requests a record in the pane again unless it is in its final state.
pub fn touch(state: &mut State) {
    let found = state.detail.steps.as_ref().and_then(Lookup::found);
    let goes_on = found.is_some_and(|found| !super::update::is_settled(found.record.state));
    if goes_on && state.detail.due.is_none() && !state.is_frozen() {
        state.detail.due = Some(Timestamp(state.now.0.saturating_add(REST)));
    }
}

pub fn looked_up(state: &mut State, id: &str, answer: Result<Provenance, Failure>) {
    if let Some(steps) = state.detail.steps.as_mut().filter(|steps| steps.id == id) {
        steps.answer = Some(answer.map(Box::new));
    }
}

/// No event reports coverage, so it is requested again after a while.
pub fn covered(state: &mut State, topic: &str, answer: Result<CoverageView, Failure>) {
    state.detail.coverage = Some((topic.to_owned(), answer.map(Box::new)));
    let beside = state.detail.about.as_ref().is_some_and(|(screen, id)| *screen == Screen::Topics && id == topic);
    if beside && !state.is_frozen() {
        state.detail.due = Some(Timestamp(state.now.0.saturating_add(COVERAGE_EVERY)));
    }
}

pub fn opened_beside(state: &mut State, id: &str, answer: Result<Box<OpenedView>, Failure>) {
    if let Some(opening) = state.detail.opening.as_mut().filter(|opening| opening.lookup.id == id) {
        opening.lookup.answer = Some(answer);
    }
}
