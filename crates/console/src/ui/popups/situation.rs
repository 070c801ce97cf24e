//! The present state: who can read, who publishes a topic, what is running, how a robot is.

use ratatui::layout::Rect;

use super::framed;
use super::incidents::draw_told;
use super::record::pad;
use crate::app::feed::Feed;
use crate::app::popup::{Lookup, readers};
use crate::app::screens::grants::{day, end, is_active, is_given, scope};
use crate::app::screens::log::{LogLine, level_word};
use crate::app::{State, Tag};
use crate::model::clean;
use crate::pipeline::sender::LaneState;
use crate::service::NoticeLevel;
use crate::service::reply::{AlarmView, GrantRow, PinView, PinsView, RobotView, TaskState, TaskView};
use crate::ui::bars;
use crate::ui::canvas::{Canvas, columns, row};
use crate::ui::gateway::{self, Fact};
use crate::ui::theme::Role;
use crate::ui::words::{self, count, wrap};

type Line = (String, Role);

/// Draws lines in a frame, from the `scroll`-th on.
fn draw_lines(canvas: &mut Canvas, area: Rect, title: &str, lines: &[Line], scroll: usize) {
    let width = area.width.saturating_sub(6).min(100);
    let wrapped: Vec<Line> = lines
        .iter()
        .flat_map(|(text, role)| words::wrap(&clean(text, 1_000), width).into_iter().map(|line| (line, *role)))
        .collect();
    let widest = wrapped.iter().map(|(line, _)| crate::ui::canvas::columns(line)).max().unwrap_or(0);
    let height = u16::try_from(wrapped.len()).unwrap_or(u16::MAX);
    let inner = framed(canvas, area, title, widest.max(40), height);
    let first = scroll.min(wrapped.len().saturating_sub(usize::from(inner.height)));
    for (place, (line, role)) in (0..inner.height).zip(wrapped.iter().skip(first)) {
        canvas.put(row(inner, place), line, *role);
    }
}

/// Draws who can read topics now; no topic = all of them.
pub fn draw_readers(canvas: &mut Canvas, area: Rect, state: &State, topics: &[String]) {
    if topics.is_empty() {
        let lines: Vec<Line> =
            readers(state, "New records of all topics:", None).into_iter().map(|line| (line, Role::Body)).collect();
        return draw_lines(canvas, area, "Who can read this now?", &with_words(lines), 0);
    }
    let mut lines = Vec::new();
    let given: Vec<&GrantRow> = state.grants.rows.iter().filter(|row| is_given(row) && is_active(row)).collect();
    for topic in topics.iter().take(8) {
        lines.push((topic.clone(), Role::Accent));
        lines.push(("  you, while your keyring is unlocked".to_owned(), Role::Body));
        let may = given.iter().filter(|row| row.topics.is_empty() || row.topics.contains(topic));
        lines.extend(may.map(|row| (reader(row), Role::Body)));
    }
    if topics.len() > 8 {
        lines.push((format!("and {} more topics", topics.len() - 8), Role::Dim));
    }
    if state.awaits(Feed::Grants) {
        lines.push(("(the list of grants has not arrived yet)".to_owned(), Role::Warning));
    }
    draw_lines(canvas, area, "Who can read this now?", &with_words(lines), 0);
}

fn with_words(mut lines: Vec<Line>) -> Vec<Line> {
    lines.push((String::new(), Role::Body));
    let text = "Revoking does not undo reads: anyone who read a record may have kept it.";
    lines.push((text.to_owned(), Role::Dim));
    lines
}

fn reader(row: &GrantRow) -> String {
    let name = row.name.as_deref().map_or_else(|| row.grantee.to_string(), |name| format!("{name} {}", row.grantee));
    format!("  {name}, {}, {}", scope(&row.topics), end(row.expires))
}

/// Draws who publishes a topic: pinned, suspect.
pub fn draw_publishers(canvas: &mut Canvas, area: Rect, state: &State, lookup: &Lookup<PinsView>) {
    let lines = match &lookup.answer {
        None => vec![("Asking…".to_owned(), Role::Dim)],
        Some(Err(failure)) => vec![(failure.message.clone(), Role::Bad)],
        Some(Ok(view)) => publishers(state, &lookup.id, view),
    };
    draw_lines(canvas, area, &format!("Publishers of {}", lookup.id), &lines, lookup.scroll);
}

fn publishers(state: &State, topic: &str, view: &PinsView) -> Vec<Line> {
    let mut lines = Vec::new();
    let row = state.topics.rows.iter().find(|row| row.topic == topic);
    let now = row.map_or_else(String::new, |row| row.publishers.join(" "));
    lines.extend(coverage_lines(state, topic));
    lines.push((format!("now     {}", if now.is_empty() { "nobody" } else { &now }), Role::Body));
    if view.pins.is_empty() {
        lines.push(("no publisher is pinned yet: the first one captured will be".to_owned(), Role::Dim));
    }
    lines.extend(view.pins.iter().flat_map(|pin| pinned(pin, &now)));
    lines.extend(view.alarms.iter().flat_map(alarm));
    if let Some(held) = row.map(|row| row.quarantined).filter(|held| *held > 0) {
        lines.push((format!("{held} messages are quarantined: r releases, D discards (on the screen)"), Role::Warning));
    }
    lines
}

/// When there are records of a topic: from when to when, a strip of signs, and their meaning.
pub fn coverage_lines(state: &State, topic: &str) -> Vec<Line> {
    let Some((of, answer)) = &state.detail.coverage else { return Vec::new() };
    match answer {
        _ if of != topic => Vec::new(),
        Err(failure) => vec![(clean(&failure.message, 500), Role::Bad)],
        Ok(view) if view.first.is_none() => vec![("No records of it yet.".to_owned(), Role::Dim), Line::default()],
        Ok(view) => vec![
            (format!("Records from {} to {} UTC", day(view.since), day(view.until)), Role::Title),
            (view.strip(), Role::Accent),
            (view.legend(), Role::Dim),
            Line::default(),
        ],
    }
}

fn pinned(pin: &PinView, now: &str) -> [Line; 2] {
    let publisher = &pin.publisher;
    let there =
        if now.split(' ').any(|name| name == publisher.caller_id) { "publishing now" } else { "not publishing" };
    let since = pin.at.map_or_else(String::new, |at| format!(" since {at}"));
    [
        (format!("pinned  {} at {}, {there}", publisher.caller_id, publisher.host), Role::Good),
        (format!("        {} {}, by {}{since}", publisher.type_name, publisher.md5sum, pin.source), Role::Dim),
    ]
}

fn alarm(alarm: &AlarmView) -> [Line; 2] {
    let (word, role) = if alarm.open { ("ALARM", Role::Bad) } else { ("decided", Role::Dim) };
    [
        (format!("{word}  {}: {}", alarm.publisher, reason(&alarm.reason)), role),
        (format!("        raised {}", alarm.at), Role::Dim),
    ]
}

fn reason(word: &str) -> &str {
    match word {
        "new" => "not among the pinned publishers",
        "host" => "a pinned name on another host",
        "type" => "a pinned name with another type",
        "replaced" => "took over the name of a running publisher",
        "undecided" => "restart or rival: cannot be determined",
        "unconfirmed" => "not confirmed by the master",
        other => other,
    }
}

/// Draws a line of the log, whole.
pub fn draw_line(canvas: &mut Canvas, area: Rect, line: &LogLine) {
    let about = format!("{}  {}  {}", words::moment(line.at), level_word(line.level), line.key);
    let role = if line.level == NoticeLevel::Info { Role::Body } else { bars::notice_level(line.level).1 };
    draw_lines(canvas, area, "Log line", &[(about, Role::Dim), (line.text.clone(), role)], 0);
}

/// Draws what is running, what waits, and for how long.
pub fn draw_tasks(canvas: &mut Canvas, area: Rect, state: &State) {
    let mut lines: Vec<Line> = state.work.iter().map(Tag::words).map(|words| (words, Role::Accent)).collect();
    lines.extend(state.progress.lines(state.shown_at()).into_iter().map(|line| (line, Role::Accent)));
    if lines.is_empty() {
        lines.push(("no commands running".to_owned(), Role::Dim));
    }
    lines.extend(records_on_their_way(state));
    lines.extend(workers(state));
    if let Some(chain) = &state.chain {
        let pending = format!("{:<15} {} pending", "transactions", chain.pending);
        lines.push((pending, if chain.pending > 0 { Role::Warning } else { Role::Body }));
        lines.extend(chain.lanes.iter().filter_map(paused));
    }
    for feed in Feed::ALL {
        let slot = state.feeds.slot(feed);
        if let (Some(failure), Some(at)) = (&slot.failure, slot.retry_at) {
            let seconds = at.0.saturating_sub(state.now.0) / 1_000_000_000;
            lines.push((format!("retry in {seconds} s  {feed:?}: {}", failure.message), Role::Warning));
        }
    }
    draw_lines(canvas, area, "Tasks", &lines, 0);
}

/// The site's background tasks: how many are running, and each that is not or had to be restarted.
fn workers(state: &State) -> Vec<Line> {
    let tasks: &[TaskView] = state.site.as_ref().map_or(&[], |site| &site.tasks);
    let running = tasks.iter().filter(|task| task.state == TaskState::Running).count();
    let mut lines = Vec::new();
    if !tasks.is_empty() {
        lines.push((format!("{:<15} {running} of {} running", "workers", tasks.len()), Role::Body));
    }
    for task in tasks.iter().filter(|task| task.state != TaskState::Running || task.restarts > 0) {
        let next = task.next_try.map_or_else(String::new, |seconds| format!(", retry in {seconds} s"));
        let why = task.reason.as_deref().map_or_else(String::new, |reason| format!(": {reason}"));
        let text = format!("{:<15} restarted {}{next}{why}", task.name, words::times(task.restarts));
        lines.push((text, if task.state == TaskState::Running { Role::Warning } else { Role::Bad }));
    }
    lines
}

fn records_on_their_way(state: &State) -> Vec<Line> {
    let Some(site) = &state.site else { return vec![("the site is starting…".to_owned(), Role::Dim)] };
    let life = &site.life;
    let queue = &site.queue;
    let full = queue.bytes.saturating_mul(100).checked_div(queue.capacity).unwrap_or(0);
    let mut lines = vec![(
        format!(
            "{:<15} {} message{}, {} (buffer {full} % full)",
            "to be stored",
            words::count(queue.messages),
            if queue.messages == 1 { "" } else { "s" },
            words::size(queue.bytes)
        ),
        if full >= 80 { Role::Bad } else { Role::Body },
    )];
    let stations = [
        ("to be anchored", life.stored.saturating_sub(life.anchored)),
        ("to be confirmed", life.anchored.saturating_sub(life.confirmed)),
        ("to be verified", life.confirmed.saturating_sub(life.verified + life.tampered)),
    ];
    lines.extend(stations.into_iter().map(|(what, count)| (format!("{what:<15} {}", words::count(count)), Role::Body)));
    lines.push((left(life.pending, state.rates.captured(), state.rates.verified()), Role::Accent));
    lines
}

/// How long what is pending will take at the present rates.
fn left(pending: u64, captured: f64, verified: f64) -> String {
    if pending == 0 {
        return "all captured records are verified, quarantined or accounted for".to_owned();
    }
    let count = words::count(pending);
    if verified < 0.1 {
        return format!("{count} pending; nothing is being verified right now");
    }
    let records = f64::from(u32::try_from(pending).unwrap_or(u32::MAX));
    let net = verified - captured;
    if captured > 0.1 && net <= 0.1 {
        let behind = records / verified;
        return format!("{count} pending, about {behind:.0} s behind; keeping up");
    }
    format!("{count} pending, done in about {:.0} s", records / net.max(0.1))
}

fn paused(lane: &LaneState) -> Option<Line> {
    let cause = lane.paused.as_ref()?.cause(lane.account);
    Some((format!("paused  {cause}"), Role::Bad))
}

type GatewayLine = (String, Role);

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
            let mut lines = told(&gateway::facts(view, state.shown_at()), width);
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

fn draw(canvas: &mut Canvas, area: Rect, title: &str, lines: &[GatewayLine], scroll: usize) {
    let widest = lines.iter().map(|(line, _)| columns(line)).max().unwrap_or(0);
    let height = u16::try_from(lines.len()).unwrap_or(u16::MAX);
    let inner = framed(canvas, area, title, widest.clamp(40, width(area).max(40)), height);
    draw_told(canvas, inner, lines, scroll);
}

/// Names and words; a name that repeats is said once.
fn told(facts: &[Fact], width: u16) -> Vec<GatewayLine> {
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
fn topics(view: &RobotView, width: u16) -> Vec<GatewayLine> {
    if view.topics.is_empty() {
        return vec![GatewayLine::default(), ("Nothing of it was recorded yet.".to_owned(), Role::Dim)];
    }
    let numbers = |cells: [String; 4]| cells.iter().map(|cell| format!(" {cell:>NUMBER$}")).collect::<String>();
    let name = usize::from(width).saturating_sub(4 * (NUMBER + 1)).min(48);
    let heads = ["messages", "verified", "waiting", "lost"].map(str::to_owned);
    let mut lines = vec![GatewayLine::default(), (format!("{:name$}{}", "topic", numbers(heads)), Role::Title)];
    for topic in &view.topics {
        let cells = [topic.records, topic.verified, topic.waiting, topic.lost].map(count);
        let role = if topic.lost > 0 { Role::Warning } else { Role::Body };
        let shown = pad(&clean(&topic.topic, name), u16::try_from(name).unwrap_or(u16::MAX));
        lines.push((format!("{shown}{}", numbers(cells)), role));
    }
    lines
}

/// The policy as it was set.
fn text(view: &RobotView, width: u16) -> Vec<GatewayLine> {
    let mut lines = vec![GatewayLine::default()];
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_told_as_far_as_it_can_be() {
        assert!(left(0, 0.0, 0.0).starts_with("all"));
        assert!(left(45, 20.0, 0.0).contains("nothing is being verified"));
        assert!(left(45, 20.0, 20.0).contains("about 2 s behind"));
        assert!(left(45, 0.0, 15.0).contains("done in about 3 s"));
    }
}
