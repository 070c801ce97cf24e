//! A robot's policy: set from a file, or cleared.

use std::path::{Path, PathBuf};

use crate::app::{
    Confirm, Effect, Errand, Feed, Field, Form, Line, PathKind, Popup, Purpose, State, Tag, Wrong, completion,
};
use crate::config::{RingWish, RobotPolicy};
use crate::model::{clean, counted};
use crate::screens::{robots, robots::state::MOST_NAMES};
use crate::service::{command::SetRobotPolicy, reply::RobotRow};

const ROBOT: usize = 0;
const FILE: usize = 1;

/// Characters of a device id that identify a robot.
const LEAST_DEVICE: usize = 8;

pub fn begin(state: &mut State) {
    let name = robots::keys::under_cursor(state).map(|row| robots::keys::called(state, row)).unwrap_or_default();
    ask(state, &name);
}

pub fn ask(state: &mut State, name: &str) {
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
    form.focus == ROBOT && completion::complete_from(form, &names)
}

/// Asks the question, or first reads the file.
pub fn submit(state: &mut State, form: &Form) -> Result<(), Wrong> {
    let robot = named(state, form)?;
    match completion::of_line(form, FILE, &state.settings) {
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
    if completion::of_line(form, FILE, &state.settings).as_deref() != Some(path) {
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
