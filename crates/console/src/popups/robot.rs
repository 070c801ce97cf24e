//! A robot's window.

use crate::app::{Errand, Key, Lookup, Popup, State, Tag};
use crate::model::clean;
use crate::popups::{form::policy, incidents::draw::from_to};
use crate::screens::{grants::state::day, robots};
use crate::service::reply::{RobotRow, RobotView, coverage_legend};
use crate::service::{Failure, command::ShowRobot};
use crate::ui::{
    Canvas, Fact, Piece, Rect, Role, columns, draw_told, frame, frame::LOOKUP_WIDEST, framed, pad, rows, words::count,
    words::wrap,
};

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

fn show(name: &str) -> Errand {
    Errand { command: ShowRobot { name: name.to_owned() }.into(), tag: Tag::Robot(name.to_owned()) }
}

pub fn open(state: &mut State) {
    let Some(name) = robots::keys::under_cursor(state).map(|row| robots::keys::called(state, row)) else { return };
    state.popups.push(Popup::Robot(Lookup::new(&name)));
    state.send_new(show(&name));
}

pub fn answered(state: &mut State, name: &str, answer: Result<RobotView, Failure>) {
    state.tell(name, answer, |popup| if let Popup::Robot(lookup) = popup { Some(lookup) } else { None });
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
        Key::Char('p') if !state.settings.read_only => policy::ask(state, &name),
        Key::Char('y') => {
            let line = state.command_line(&format!("robot show {name}"));
            state.copy(line);
        }
        _ => {}
    }
}

pub fn set(state: &mut State, name: &str, view: RobotView) {
    let what = if view.policy.is_empty() { "is cleared" } else { "is set" };
    state.inform(format!("the policy of {} {what} as version {}", view.row.name, view.row.wanted));
    if let Some(row) = state.gateway.robots.iter_mut().find(|row| row.device == view.row.device) {
        row.clone_from(&view.row);
    }
    answered(state, name, Ok(view));
}

const ROBOT_LABEL: u16 = 10;
const NUMBER: usize = 9;

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, lookup: &Lookup<RobotView>) {
    let width = LOOKUP_WIDEST.min(area.width.saturating_sub(6));
    let whole = |view: &RobotView| {
        [told(&robots::draw::facts(view, state.shown_at()), width), topics(state, view, width), robot_text(view, width)]
            .concat()
    };
    let lines = frame::answered(lookup, width, whole, |line| line);
    let name = lookup.found().map_or(lookup.id.as_str(), |view| view.row.name.as_str());
    let widest = lines.iter().map(|(line, _)| columns(line)).max().unwrap_or(0).clamp(40, width.max(40));
    let inner = framed(canvas, area, &format!("Robot {}", clean(name, 64)), widest, rows(lines.len()));
    draw_told(canvas, inner, &lines, lookup.scroll);
}

/// Says a repeated name once.
fn told(facts: &[Fact], width: u16) -> Vec<Piece> {
    let mut lines = Vec::new();
    let mut before = "";
    for (name, text, role) in facts {
        for (place, part) in wrap(&clean(text, 2_000), width.saturating_sub(ROBOT_LABEL)).into_iter().enumerate() {
            let label = if place == 0 && *name != before { *name } else { "" };
            lines.push((format!("{}{part}", pad(label, ROBOT_LABEL)), *role));
        }
        before = name;
    }
    lines
}

/// Counts of each topic, and below them from when to when there are records, with the holes.
fn topics(state: &State, view: &RobotView, width: u16) -> Vec<Piece> {
    if view.topics.is_empty() {
        return vec![Piece::default(), ("Nothing was recorded by this robot yet.".to_owned(), Role::Dim)];
    }
    let numbers = |cells: [String; 4]| cells.iter().map(|cell| format!(" {cell:>NUMBER$}")).collect::<String>();
    let name = usize::from(width).saturating_sub(4 * (NUMBER + 1)).min(48);
    let heads = ["messages", "verified", "waiting", "lost"].map(str::to_owned);
    let mut lines = vec![Piece::default(), (format!("{:name$}{}", "topic", numbers(heads)), Role::Title)];
    for topic in &view.topics {
        let cells = [topic.records, topic.verified, topic.waiting, topic.lost].map(count);
        let role = if topic.lost > 0 { Role::Warning } else { Role::Body };
        let shown = pad(&clean(&topic.topic, name), rows(name));
        lines.push((format!("{shown}{}", numbers(cells)), role));
        if let (Some(first), Some(last)) = (topic.first, topic.last) {
            lines.push((format!("  {}  {}", topic.strip, from_to(state, first, last)), Role::Accent));
        }
    }
    lines.extend(view.covered.map(|span| {
        let signs: String = view.topics.iter().map(|topic| topic.strip.as_str()).collect();
        let meaning = format!("{} per sign since {} UTC: {}", span.part(), day(span.since), coverage_legend(&signs));
        (meaning, Role::Dim)
    }));
    lines
}

fn robot_text(view: &RobotView, width: u16) -> Vec<Piece> {
    let mut lines = vec![Piece::default()];
    if view.policy.is_empty() {
        let why = if view.row.wanted == 0 { "No policy was set" } else { "The policy was cleared" };
        lines.push((format!("{why}: only the robot's own settings apply."), Role::Dim));
        return lines;
    }
    lines.push((format!("Policy {}, as it was set:", view.row.wanted), Role::Title));
    let parts = view.policy.trim_end().lines().flat_map(|line| wrap(&clean(line, 500), width));
    lines.extend(parts.map(|line| (line, Role::Body)));
    lines
}
