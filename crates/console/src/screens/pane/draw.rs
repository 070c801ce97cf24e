//! The pane beside a list on a wide terminal: the row under the cursor.

use crate::app::{Lookup, Screen, State, history::Sample};
use crate::model::{Timestamp, clean};
use crate::popups::{provenance, publishers, record::draw::inside, record::draw::record_lines};
use crate::screens::grants::state::{earlier, end, is_active, is_given, scope, soon};
use crate::screens::{
    pane, records::state::Records, robots::draw::row_facts, topics::draw::watch_rule, topics::draw::watched,
    topics::state::KEPT_SAMPLES,
};
use crate::service::reply::{GrantRow, SenderView, TopicRow};
use crate::ui::{
    Canvas, Fact, Piece, Rect, Role, below, graph, graph::Graph, graph::Scale, marks::notice_level, put_lines,
    right_of, row, words, words::wrap,
};

const LABEL: u16 = 12;
const HEIGHT: u16 = 8;

/// Returns the space left for the list.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) -> Rect {
    if !pane::follow::is_shown(state) {
        return area;
    }
    let list = Rect { width: pane::follow::list_width(state).min(area.width), ..area };
    let pane = right_of(area, list.width);
    for line in 0..pane.height {
        canvas.put(row(pane, line), "│", Role::Border);
    }
    draw_row(canvas, right_of(pane, 2), state);
    list
}

fn draw_row(canvas: &mut Canvas, area: Rect, state: &State) {
    match state.screen {
        Screen::Topics => draw_topic(canvas, area, state),
        Screen::Records => draw_steps(canvas, area, state),
        Screen::Received => draw_opened(canvas, area, state),
        Screen::Grants => drop(facts(canvas, area, "Grant", &grant(state))),
        Screen::Robots => draw_gateway(canvas, area, state),
        Screen::Log => draw_line(canvas, area, state),
        Screen::Overview | Screen::Keys | Screen::Chain => {}
    }
}

/// Wraps values; returns the rows taken.
fn facts(canvas: &mut Canvas, area: Rect, title: &str, facts: &[(&str, String)]) -> u16 {
    canvas.put(area, title, Role::Title);
    if facts.is_empty() {
        canvas.put(row(area, 1), "Nothing selected.", Role::Dim);
    }
    let mut place = 1;
    for (name, text) in facts.iter().filter(|(_, text)| !text.is_empty()) {
        canvas.put(row(area, place), name, Role::Dim);
        for line in wrap(&clean(text, 2_000), area.width.saturating_sub(LABEL)) {
            canvas.put(right_of(row(area, place), LABEL), &line, Role::Body);
            place += 1;
        }
    }
    place
}

fn draw_topic(canvas: &mut Canvas, area: Rect, state: &State) {
    let Some(topic) = state.topics.selected() else { return };
    let taken = facts(canvas, area, &topic.topic, &about(topic)) + 1;
    let samples = state.topics.samples(&topic.topic, KEPT_SAMPLES, state.shown_at());
    let thousands = |sample: Sample| Sample::level(sample.mean / 1_000.0);
    let values: Vec<Option<Sample>> = samples.into_iter().map(|sample| sample.map(thousands)).collect();
    let here = below(area, taken);
    canvas.put(here, "kB/s over the last minute", Role::Title);
    let place = Rect { height: HEIGHT.min(here.height.saturating_sub(1)), ..below(here, 1) };
    let scale = Scale::around(&values);
    graph::draw(canvas, place, &Graph { values: &values, scale, role: Role::Accent, marks: true });
    let lines: Vec<Vec<Piece>> =
        publishers::coverage_lines(state, &topic.topic).into_iter().map(|(text, role)| vec![(text, role)]).collect();
    put_lines(canvas, below(here, place.height + 2), &lines, 0);
}

fn about(topic: &TopicRow) -> Vec<(&'static str, String)> {
    let held = if topic.quarantined > 0 { words::count(topic.quarantined) } else { String::new() };
    vec![
        ("type", topic.type_name.clone().unwrap_or_else(|| "not known yet".to_owned())),
        ("capture", watched(topic).0),
        ("rule", watch_rule(topic).unwrap_or_default()),
        ("simulated", if topic.simulated { "yes".to_owned() } else { String::new() }),
        ("publishers", topic.publishers.join(" ")),
        ("not read", topic.unreached.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")),
        ("not pinned", if topic.pins > 0 { topic.unpinned.join(" ") } else { String::new() }),
        ("pins", words::count(topic.pins)),
        ("rate", format!("{} Hz, {} kB/s", words::rate(topic.hz), words::kilobytes(topic.bytes_per_second))),
        ("captured", words::count(topic.messages)),
        ("quarantined", held),
        ("lost", format!("{} in transport, {} in the recorder", topic.lost_in_transport, topic.lost_in_recorder)),
        ("last", topic.last_message.map(Timestamp::in_milliseconds).unwrap_or_default()),
    ]
}

/// The list's own data, and a hint to move the cursor.
fn draw_record(canvas: &mut Canvas, area: Rect, state: &State, records: &Records, hint: &str) {
    let key = state.row_key();
    let Some(record) = records.rows.iter().find(|row| Some(&row.id) == key.as_ref()) else { return };
    canvas.put(area, &format!("Record {}", record.id), Role::Title);
    let mut lines = record_lines(record);
    lines.push(Vec::new());
    lines.push(vec![(hint.to_owned(), Role::Dim)]);
    put_lines(canvas, below(area, 1), &lines, 0);
}

fn draw_steps(canvas: &mut Canvas, area: Rect, state: &State) {
    match &state.detail.steps {
        Some(Lookup { answer: Some(Ok(view)), id, .. }) => {
            canvas.put(area, &format!("Provenance of record {id}"), Role::Title);
            put_lines(canvas, below(area, 1), &provenance::provenance_lines(view, area.width), 0);
        }
        Some(Lookup { answer: Some(Err(failure)), .. }) => drop(canvas.put_wrapped(area, &failure.message, Role::Bad)),
        _ => draw_record(canvas, area, state, &state.records, "Select a record to see its provenance."),
    }
}

fn draw_opened(canvas: &mut Canvas, area: Rect, state: &State) {
    match &state.detail.opening {
        Some(opening) => match &opening.lookup.answer {
            Some(Ok(view)) => {
                canvas.put(area, &format!("Record {}", opening.lookup.id), Role::Title);
                inside(canvas, below(area, 1), opening, view);
            }
            Some(Err(failure)) => drop(canvas.put_wrapped(area, &failure.message, Role::Bad)),
            None => draw_record(canvas, area, state, &state.received, "Opening…"),
        },
        None if state.is_locked() => {
            draw_record(canvas, area, state, &state.received, "Locked: press u to unlock and read records.");
        }
        None => draw_record(canvas, area, state, &state.received, "Select a record to open it here."),
    }
}

fn grant(state: &State) -> Vec<(&'static str, String)> {
    let Some(row) = state.grants.selected() else { return Vec::new() };
    let topics = if row.topics.is_empty() { scope(&row.topics) } else { row.topics.join(" ") };
    vec![
        ("state", row.state.word().to_owned()),
        (if is_given(row) { "given to" } else { "got from" }, row.name.clone().unwrap_or_default()),
        ("reader", row.grantee.to_string()),
        ("owner", row.owner.to_string()),
        ("fingerprint", row.fingerprint.clone().unwrap_or_else(|| "not registered".to_owned())),
        ("topics", topics),
        ("opens", opened(state, row)),
        ("epoch", row.epoch.to_string()),
        ("ends", ends(row, state.shown_at())),
        ("block", row.block.to_string()),
        ("transaction", row.transaction.to_string()),
    ]
}

fn opened(state: &State, row: &GrantRow) -> String {
    match row.opens {
        Some(opens) => format!("{}{}", opens.words(|moment| state.times().meaning(moment)), earlier(row)),
        None if is_active(row) => "not known here".to_owned(),
        None => "nothing any more".to_owned(),
    }
}

fn ends(row: &GrantRow, now: Timestamp) -> String {
    let left = soon(row.expires, now).filter(|_| is_active(row)).map(|left| format!(" ({left})"));
    format!("{}{}", end(row.expires), left.unwrap_or_default())
}

fn draw_gateway(canvas: &mut Canvas, area: Rect, state: &State) {
    let plain = |facts: Vec<Fact>| facts.into_iter().map(|(name, text, _)| (name, text)).collect::<Vec<_>>();
    let (title, told) = match state.gateway.selected() {
        None => ("Sender", Vec::new()),
        Some(member) => {
            let robot = member.robot.map(|robot| plain(row_facts(robot, state.shown_at())));
            let title = if robot.is_some() { "Robot" } else { "Sender" };
            let told = robot.into_iter().chain(member.sender.map(sender)).flatten();
            (title, [("name", member.name())].into_iter().chain(told).collect())
        }
    };
    facts(canvas, area, title, &told);
}

fn sender(row: &SenderView) -> Vec<(&'static str, String)> {
    let moment = |at: Option<Timestamp>| at.map(|at| at.to_string()).unwrap_or_default();
    vec![
        ("account", row.account.to_string()),
        ("sessions", row.sessions.to_string()),
        ("from", row.peer.clone().unwrap_or_default()),
        ("since", moment(row.since)),
        ("last frame", moment(row.last)),
        ("frames", words::count(row.frames)),
        ("bytes", words::size(row.bytes)),
    ]
}

fn draw_line(canvas: &mut Canvas, area: Rect, state: &State) {
    let Some(line) = state.log.selected() else { return };
    canvas.put(area, &format!("{}  {}  {}", line.at, line.level.word(), line.key), Role::Dim);
    let role = if line.level == crate::service::NoticeLevel::Info { Role::Body } else { notice_level(line.level).1 };
    let lines: Vec<Vec<Piece>> = wrap(&line.text, area.width).into_iter().map(|text| vec![(text, role)]).collect();
    put_lines(canvas, below(area, 2), &lines, 0);
}
