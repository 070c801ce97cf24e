//! A robot with its topics and the text of its policy.

use ratatui::layout::Rect;

use super::framed;
use super::incidents::draw_told;
use super::lookup::pad;
use crate::app::State;
use crate::app::popup::Lookup;
use crate::model::clean;
use crate::service::reply::RobotView;
use crate::ui::canvas::{Canvas, columns};
use crate::ui::policies::{self, Fact};
use crate::ui::theme::Role;
use crate::ui::words::{count, wrap};

type Line = (String, Role);

/// Columns of the names of facts.
const LABEL: u16 = 10;
/// The greatest width of a window.
const WIDEST: u16 = 110;
/// Columns of the numbers of a topic.
const NUMBER: usize = 9;

/// Draws a robot.
pub fn draw_robot(canvas: &mut Canvas, area: Rect, state: &State, lookup: &Lookup<RobotView>) {
    let width = width(area);
    let lines = match &lookup.answer {
        None => vec![("Asking…".to_owned(), Role::Dim)],
        Some(Err(failure)) => {
            wrap(&clean(&failure.message, 500), width).into_iter().map(|line| (line, Role::Bad)).collect()
        }
        Some(Ok(view)) => {
            let mut lines = told(&policies::facts(view, state.shown_at()), width);
            lines.extend(topics(view, width));
            lines.extend(text(view, width));
            lines
        }
    };
    let name = lookup.found().map_or(lookup.id.as_str(), |view| view.row.name.as_str());
    draw(canvas, area, &format!("Robot {}", clean(name, 64)), &lines, lookup.scroll);
}

fn width(area: Rect) -> u16 {
    WIDEST.min(area.width.saturating_sub(6))
}

fn draw(canvas: &mut Canvas, area: Rect, title: &str, lines: &[Line], scroll: usize) {
    let widest = lines.iter().map(|(line, _)| columns(line)).max().unwrap_or(0);
    let height = u16::try_from(lines.len()).unwrap_or(u16::MAX);
    let inner = framed(canvas, area, title, widest.clamp(40, width(area).max(40)), height);
    draw_told(canvas, inner, lines, scroll);
}

/// Names and words; a name that repeats is said once.
fn told(facts: &[Fact], width: u16) -> Vec<Line> {
    let mut lines = Vec::new();
    let mut before = "";
    for (name, text, role) in facts {
        for (place, part) in wrap(&clean(text, 2_000), width.saturating_sub(LABEL)).into_iter().enumerate() {
            let label = if place == 0 && *name != before { *name } else { "" };
            lines.push((format!("{}{part}", pad(label, LABEL)), *role));
        }
        before = name;
    }
    lines
}

/// What the robot recorded, by topic.
fn topics(view: &RobotView, width: u16) -> Vec<Line> {
    if view.topics.is_empty() {
        return vec![Line::default(), ("Nothing of it was recorded yet.".to_owned(), Role::Dim)];
    }
    let numbers = |cells: [String; 4]| cells.iter().map(|cell| format!(" {cell:>NUMBER$}")).collect::<String>();
    let name = usize::from(width).saturating_sub(4 * (NUMBER + 1)).min(48);
    let heads = ["messages", "verified", "waiting", "lost"].map(str::to_owned);
    let mut lines = vec![Line::default(), (format!("{:name$}{}", "topic", numbers(heads)), Role::Title)];
    for topic in &view.topics {
        let cells = [topic.records, topic.verified, topic.waiting, topic.lost].map(count);
        let role = if topic.lost > 0 { Role::Warning } else { Role::Body };
        let shown = pad(&clean(&topic.topic, name), u16::try_from(name).unwrap_or(u16::MAX));
        lines.push((format!("{shown}{}", numbers(cells)), role));
    }
    lines
}

/// The policy as it was set.
fn text(view: &RobotView, width: u16) -> Vec<Line> {
    let mut lines = vec![Line::default()];
    if view.policy.is_empty() {
        let why = if view.row.wanted == 0 { "No policy was set" } else { "The policy was cleared" };
        lines.push((format!("{why}: the robot's own settings count alone."), Role::Dim));
        return lines;
    }
    lines.push((format!("Policy {}, as it was set:", view.row.wanted), Role::Title));
    let parts = view.policy.trim_end().lines().flat_map(|line| wrap(&clean(line, 500), width));
    lines.extend(parts.map(|line| (line, Role::Body)));
    lines
}
