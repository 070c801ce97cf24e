//! Policies of robots on screen: their standing, the window of a robot, setting and clearing.

use std::path::{Path, PathBuf};

use super::form::{Field, Form, Line, Wrong};
use super::granting::complete_from;
use super::keymap::Key;
use super::palette::{self, PathKind};
use super::perform::copy;
use super::popup::{Confirm, Lookup, Popup, Purpose, tell};
use super::update::Feed;
use super::verb::{Effect, Errand, Tag};
use super::{Screen, State};
use crate::config::{RingWish, RobotPolicy};
use crate::model::{Timestamp, clean, counted};
use crate::service::Failure;
use crate::service::command::{SetRobotPolicy, ShowRobot};
use crate::service::reply::{RobotRow, RobotView};

/// Nanoseconds between requests on the screen of robots, and elsewhere; only when records came meanwhile.
const ASKED_EVERY: u64 = 5_000_000_000;
const DRIFT_EVERY: u64 = 30_000_000_000;
const ROBOT: usize = 0;
const FILE: usize = 1;
const MOST_NAMES: usize = 5;
/// The site's word for a robot that has not taken its policy yet.
const WAITING: &str = "waiting";
/// Characters of a device id that identify a robot.
const LEAST_DEVICE: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Standing {
    /// Works by another policy, and will not change without help.
    Wrong,
    /// Does not work by it yet.
    Drifts,
    InForce,
    Unset,
}

impl Standing {
    pub fn of(row: &RobotRow) -> Self {
        match row {
            RobotRow { drift: true, .. } if row.standing == WAITING => Self::Drifts,
            RobotRow { drift: true, .. } => Self::Wrong,
            RobotRow { wanted: 0, .. } => Self::Unset,
            _ => Self::InForce,
        }
    }
}

/// The words of `robot show`.
pub fn words(row: &RobotRow) -> String {
    let standing = clean(&row.standing, 40);
    match (Standing::of(row), row.running.unwrap_or_default()) {
        (Standing::Unset, _) => "-".to_owned(),
        (Standing::Wrong, running) if running > row.wanted => format!("runs {running}, not known here"),
        (Standing::InForce, _) | (_, 0) => format!("policy {} {standing}", row.wanted),
        (_, running) => format!("policy {} {standing}, runs {running}", row.wanted),
    }
}

pub fn searched(row: &RobotRow) -> String {
    let drift = if row.drift { "outdated" } else { "" };
    format!("{} {} {drift} {}", words(row), row.standing, row.device.to_hex())
}

/// Wrong ones first, then waiting ones, older versions first.
pub fn urgency(row: &RobotRow) -> (u8, u64) {
    (Standing::of(row) as u8, row.wanted)
}

/// The site knows robots' reports only with an open keyring.
pub fn is_open(state: &State) -> bool {
    state.identity.as_ref().is_some_and(|identity| identity.exists && identity.unlocked)
}

pub fn wanted(state: &State) -> Option<Feed> {
    let asks = |popup: &Popup| matches!(popup, Popup::Robot(_) | Popup::Form(Purpose::SetPolicy, _));
    let seen = matches!(state.screen, Screen::Overview | Screen::Robots) || state.popups.iter().any(asks);
    (is_open(state) && seen).then_some(Feed::Robots)
}

/// `None` = not before an event.
pub fn asked_at(state: &State) -> Option<Timestamp> {
    let slot = state.feeds.slot(Feed::Robots);
    let waits = slot.loaded && !slot.outstanding && !slot.stale && slot.failure.is_none();
    let moved = state.gateway.robots_told && !state.gateway.robots.is_empty() && !state.is_frozen();
    let every = if state.screen == Screen::Robots { ASKED_EVERY } else { DRIFT_EVERY };
    let due = Timestamp(state.gateway.robots_at.0.saturating_add(every));
    wanted(state).filter(|_| waits && moved).map(|_| due)
}

/// Forgets the robots of a locked keyring: they would grow old unnoticed.
pub fn forget_if_locked(state: &mut State) {
    if state.is_locked() && !state.is_frozen() && state.feeds.slot(Feed::Robots).loaded {
        state.feeds.renew(Feed::Robots);
        state.feeds.slot_mut(Feed::Robots).loaded = false;
        state.gateway.set_robots(Vec::new(), None, state.now);
    }
}

/// Refreshes the window of a robot that changed.
pub fn listed(state: &mut State, rows: Vec<RobotRow>) {
    let (owner, now) = (state.address(), state.now);
    state.gateway.set_robots(rows, owner, now);
    let Some(Popup::Robot(lookup)) = state.popups.last() else { return };
    let before = lookup.found().map(|view| &view.row);
    let row = state.gateway.robots.iter().find(|row| before.is_some_and(|before| before.device == row.device));
    let moved = row.is_some() && row != before;
    let errand = show(&lookup.id);
    if moved && !state.is_frozen() {
        state.send_new(errand);
    }
}

/// Drifting robots as an alert: since when, and in words.
pub fn drift(state: &State) -> Option<(Timestamp, String)> {
    let drifting: Vec<&RobotRow> = state.gateway.robots.iter().filter(|row| row.drift).collect();
    let since = drifting.iter().filter_map(|row| row.drift_since).min().unwrap_or(state.now);
    match drifting.as_slice() {
        [] => None,
        [one] => Some((since, format!("robot {} is out of date: {} (8, then enter)", one.name, words(one)))),
        several => {
            let names: Vec<String> = several.iter().take(MOST_NAMES).map(|row| row.name.to_string()).collect();
            let more = several.len().saturating_sub(MOST_NAMES);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let robots = several.len();
            Some((since, format!("{robots} robots do not run their policies: {}{more} (8)", names.join(", "))))
        }
    }
}

pub fn under_cursor(state: &State) -> Option<&RobotRow> {
    state.gateway.selected().filter(|_| state.screen == Screen::Robots)?.robot
}

/// The name, or the device id if another robot has the name too.
fn called(state: &State, row: &RobotRow) -> String {
    let alone = state.gateway.robots.iter().filter(|other| other.name == row.name).count() <= 1;
    if alone { row.name.to_string() } else { row.device.to_hex() }
}

fn show(name: &str) -> Errand {
    Errand { command: ShowRobot { name: name.to_owned() }.into(), tag: Tag::Robot(name.to_owned()) }
}

pub fn open(state: &mut State) {
    let Some(name) = under_cursor(state).map(|row| called(state, row)) else { return };
    state.popups.push(Popup::Robot(Lookup::new(&name)));
    state.send_new(show(&name));
}

pub fn shown(state: &mut State, name: &str, answer: Result<RobotView, Failure>) {
    tell(state, name, answer, |popup| if let Popup::Robot(lookup) = popup { Some(lookup) } else { None });
}

pub fn hints(state: &State) -> Vec<(&'static str, &'static str)> {
    let changes = (!state.settings.read_only).then_some(("p", "set policy"));
    changes.into_iter().chain([("y", "copy command"), ("up down", "scroll"), ("q", "close")]).collect()
}

pub fn key(state: &mut State, mut lookup: Lookup<RobotView>, key: Key) {
    let length = |view: &RobotView| {
        14 + view.gateway.iter().map(|gateway| gateway.addresses.len()).sum::<usize>()
            + view.topics.len() * 2
            + view.overruled.len() * 3
            + view.policy.lines().count()
    };
    if !lookup.scrolls(key, state.page_rows(), length) {
        return;
    }
    let name = lookup.id.clone();
    state.popups.push(Popup::Robot(lookup));
    match key {
        Key::Char('p') if !state.settings.read_only => ask(state, &name),
        Key::Char('y') => {
            let line = palette::of_words(state, &format!("robot show {name}"));
            copy(state, line);
        }
        _ => {}
    }
}

pub fn begin(state: &mut State) {
    let name = under_cursor(state).map(|row| called(state, row)).unwrap_or_default();
    ask(state, &name);
}

fn ask(state: &mut State, name: &str) {
    let lines = vec![
        Line::text("Robot", "name of a robot", Field::offering(name)),
        Line::text("File", "path to a TOML file; empty = clear the policy", Field::default()).path(PathKind::File),
    ];
    let notes = vec![
        "Watched topics, rules and ring, over the robot's own settings.".to_owned(),
        "Signed by your account; applied at the robot's next connection.".to_owned(),
    ];
    let mut form = Form::new("Set a robot's policy", notes, lines);
    form.focus = usize::from(!name.is_empty());
    state.popups.push(Popup::Form(Purpose::SetPolicy, form));
}

pub fn complete(state: &State, form: &mut Form) -> bool {
    let names: Vec<String> = state.gateway.robots.iter().map(|row| row.name.to_string()).collect();
    form.focus == ROBOT && complete_from(form, &names)
}

/// Asks the question, or first reads the file.
pub fn submit(state: &mut State, form: &Form) -> Result<(), Wrong> {
    let robot = named(state, form)?;
    match palette::of_line(form, FILE, &state.settings) {
        Some(path) => {
            state.reading = Some(path.clone());
            state.effects.push(Effect::ReadText(path));
        }
        None => {
            let question = question(state, &robot, None, String::new());
            state.popups.push(Popup::Confirm(question));
        }
    }
    Ok(())
}

fn named(state: &State, form: &Form) -> Result<String, Wrong> {
    let name = form.text(ROBOT).trim();
    if name.is_empty() {
        return Err((ROBOT, "enter the robot's name; tab completes it".to_owned()));
    }
    let is_it = |row: &RobotRow| {
        row.name.as_str() == name || name.len() >= LEAST_DEVICE && row.device.to_hex().starts_with(name)
    };
    let loaded = state.feeds.slot(Feed::Robots).loaded;
    if loaded && !state.gateway.robots.iter().any(is_it) {
        let names: Vec<&str> = state.gateway.robots.iter().take(MOST_NAMES).map(|row| row.name.as_str()).collect();
        let known = if names.is_empty() { "none is enrolled".to_owned() } else { format!("try {}", names.join(", ")) };
        return Err((ROBOT, format!("no robot of this profile is called '{}'; {known}", clean(name, 64))));
    }
    Ok(name.to_owned())
}

/// Asks the question, or reports an error in the form that named the file.
pub fn text_read(state: &mut State, path: &Path, read: Result<String, String>) {
    if state.reading.take_if(|reading| reading.as_path() == path).is_none() {
        return;
    }
    let Some(Popup::Form(Purpose::SetPolicy, form)) = state.popups.last() else { return };
    if palette::of_line(form, FILE, &state.settings).as_deref() != Some(path) {
        return;
    }
    let asked = named(state, form).and_then(|robot| {
        let text = read.map_err(|error| (FILE, error))?;
        if text.trim().is_empty() {
            let why = "this file is empty; to give the robot back its own settings, leave the line empty";
            return Err((FILE, why.to_owned()));
        }
        let policy = RobotPolicy::read(&text).map_err(|error| (FILE, error.to_string()))?;
        let said = summary(&policy);
        let mut question = question(state, &robot, Some(path.to_owned()), text);
        question.lines.splice(2..2, said);
        Ok(question)
    });
    match asked {
        Ok(question) => state.popups.push(Popup::Confirm(question)),
        Err((line, error)) => {
            if let Some(Popup::Form(_, form)) = state.popups.last_mut() {
                form.refuse(line, error);
            }
        }
    }
}

/// What a policy sets, and what it leaves to the robot.
fn summary(policy: &RobotPolicy) -> [String; 3] {
    let own = || "as the robot's own settings say".to_owned();
    let watched = policy.watched.as_ref().map_or_else(own, |topics| match topics.len() {
        0 => "none".to_owned(),
        count => {
            let names: Vec<&str> = topics.iter().take(MOST_NAMES).map(|topic| topic.as_str()).collect();
            let more = count.saturating_sub(MOST_NAMES);
            format!("{}{}", names.join(" "), if more > 0 { format!(" and {more} more") } else { String::new() })
        }
    });
    let rules = policy.rules.as_ref().map_or_else(own, |rules| counted(rules.0.len() as u64, "rule"));
    let ring = match &policy.ring {
        RingWish::Own => own(),
        RingWish::Off => "none".to_owned(),
        RingWish::Keep(ring) => format!("{} of {}", ring.limits, ring.topics),
    };
    [format!("Watches  {watched}"), format!("Topics   {rules}"), format!("Ring     {ring}")]
}

fn question(state: &State, robot: &str, file: Option<PathBuf>, text: String) -> Confirm {
    let row = state.gateway.robots.iter().find(|row| row.name.as_str() == robot || row.device.to_hex() == robot);
    let version = row.map(|row| row.wanted.max(row.running.unwrap_or_default()).saturating_add(1));
    let number = version.map(|version| format!("This is version {version}, signed by your account."));
    let mut lines = vec![format!("Robot    {}", clean(robot, 64))];
    let (title, yes) = match &file {
        Some(file) => {
            lines.push(format!("File     {}", clean(&file.display().to_string(), 300)));
            lines.push("It overrides the robot's own settings from its next connection on.".to_owned());
            ("Set this policy?", "set it")
        }
        None => {
            lines.push("The robot goes back to its own settings at its next connection.".to_owned());
            ("Clear the policy?", "clear it")
        }
    };
    lines.extend(number);
    let tag = Tag::SetPolicy(robot.to_owned(), file);
    let errand = Errand { command: SetRobotPolicy { name: robot.to_owned(), text }.into(), tag };
    Confirm { title: title.to_owned(), lines, yes, typed: None, errand }
}

pub fn set(state: &mut State, name: &str, view: RobotView) {
    let what = if view.policy.is_empty() { "is cleared" } else { "is set" };
    state.inform(format!("the policy of {} {what} as version {}", view.row.name, view.row.wanted));
    if let Some(row) = state.gateway.robots.iter_mut().find(|row| row.device == view.row.device) {
        row.clone_from(&view.row);
    }
    shown(state, name, Ok(view));
}
