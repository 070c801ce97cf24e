//! The Topics screen.

use crate::app::{Feed, Screen, State};
use crate::model::clean;
use crate::screens::{topics::capture::Capture, topics::state::SAMPLES};
use crate::service::reply::TopicRow;
use crate::ui::{Canvas, Column, Layout, Rect, Role, Sheet, empty, graph::line, marks::simulated, row, table, words};

pub const COLUMNS: &[Column] = &[
    Column::name("Topic").named("topic"),
    Column::text("Type", 27).named("type"),
    Column::text("Publishers", 24).named("publishers"),
    Column::text("Pinned", 10).named("pinned"),
    Column::text("Watched", 13).named("watched"),
    Column::text("Kept", 24).named("kept"),
    Column::number("Hz", 7).named("hz"),
    Column::number("kB/s", 8).named("rate"),
    Column::text("Last 16 s", 9).named("line"),
    Column::number("Captured", 9).named("captured"),
    Column::number("Lost", 8).named("lost"),
    Column::number("Age", 6).named("age"),
    Column::text("", 3).below(100),
    Column::text("", 9).from(100),
];

/// Cells of a topic's line, two seconds each.
const CELLS: u16 = 8;

/// Terminal width that fits all topic columns.
const ALL_FROM: u16 = 170;

/// Says which losses the two numbers are where there is room for it.
fn topic_columns(width: u16) -> Vec<Column> {
    let full = |column: &Column| match column.name {
        "lost" if width >= 100 => Column { title: "Lost net/rec", width: 12, most: 12, ..*column },
        _ => *column,
    };
    COLUMNS.iter().map(full).collect()
}

pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    let topics = &state.topics;
    let rows = topics.visible();
    let keys: Vec<String> = rows.iter().map(|row| row.topic.clone()).collect();
    let layout = Layout::new(&topic_columns(area.width), Screen::Topics, &topics.table, area.width);
    let mut note =
        format!("{} of {}, by {}", rows.len(), topics.rows.len(), table::order(Screen::Topics, &topics.table));
    if !topics.table.marks.is_empty() {
        note.push_str(&format!(", {} marked", topics.table.marks.len()));
    }
    note.push_str(&layout.note());
    let cells = |index: usize| rows.get(index).map_or_else(Vec::new, |row| layout.pick(topic_cells(state, row)));
    let empty = empty(state, Feed::Topics, "No topics published yet; they appear here automatically.");
    let (title, columns) = ("Topics", &layout.columns);
    let sheet = Sheet { title, note, columns, keys: &keys, cells: &cells, table: &topics.table, empty, old: false };
    let narrow = area.width < ALL_FROM;
    table::draw(canvas, Rect { height: area.height - u16::from(narrow), ..area }, &sheet);
    if let Some(selected) = topics.selected().filter(|_| narrow) {
        draw_detail(canvas, row(area, area.height - 1), selected);
    }
}

/// Data that a narrow screen's columns leave out; redrawn at every move of the cursor, so without colours.
fn draw_detail(canvas: &mut Canvas, area: Rect, topic: &TopicRow) {
    let publishers = match topic.publishers.as_slice() {
        [] => "nobody".to_owned(),
        names if topic.pins == 0 => names.join(" "),
        names if topic.unpinned.is_empty() => format!("{} (pinned)", names.join(" ")),
        names => format!("{} (NOT PINNED: {})", names.join(" "), topic.unpinned.join(" ")),
    };
    let last = topic.last_message.map(|last| format!(", last {}", last.clock())).unwrap_or_default();
    let type_name = topic.type_name.as_deref().unwrap_or("type not known yet");
    let lost = topic.lost_in_transport + topic.lost_in_recorder;
    let lost = if lost > 0 { format!(", {} lost", words::count(lost)) } else { String::new() };
    let held = match topic.quarantined {
        0 if topic.alarm => String::from(", ALARM: suspect publisher (enter)"),
        0 => String::new(),
        held => format!(", {} QUARANTINED", words::count(held)),
    };
    let captured = words::count(topic.messages);
    let rule = watch_rule(topic).map(|rule| format!(" ({rule})")).unwrap_or_default();
    let detail = format!("{type_name} from {publishers}: {captured} captured{rule}{held}{lost}{last}");
    canvas.put(area, &detail, Role::Body);
}

/// `by /robot*/odom, at most 5/s, 1,204 left out`; `None` if its own name is watched and every message is kept.
pub fn watch_rule(topic: &TopicRow) -> Option<String> {
    let by = topic.watched_by.as_ref().map(|pattern| format!("by {}", clean(pattern, 255)));
    let kept = (!topic.sampling.is_all()).then(|| topic.sampling.to_string());
    let left_out = (topic.left_out > 0).then(|| format!("{} left out", words::count(topic.left_out)));
    let rule: Vec<String> = [by, kept, left_out].into_iter().flatten().filter(|_| topic.watched).collect();
    (!rule.is_empty()).then(|| rule.join(", "))
}

fn topic_cells(state: &State, row: &TopicRow) -> Vec<(String, Role)> {
    let lost = format!("{}/{}", row.lost_in_transport, row.lost_in_recorder);
    let any_lost = row.lost_in_transport + row.lost_in_recorder > 0;
    vec![
        (row.topic.clone(), Role::Body),
        (row.type_name.clone().unwrap_or_default(), Role::Dim),
        (row.publishers.join(" "), Role::Dim),
        pinned(row),
        watched_of(state, row),
        (if row.watched { row.sampling.to_string() } else { String::new() }, Role::Body),
        (words::rate(row.hz), Role::Accent),
        (words::kilobytes(row.bytes_per_second), Role::Body),
        (line(&state.topics.samples(&row.topic, SAMPLES, state.shown_at()), CELLS), Role::Accent),
        (words::count(row.messages), Role::Body),
        (lost, if any_lost { Role::Warning } else { Role::Dim }),
        (row.last_message.map(|last| words::age(last, state.shown_at())).unwrap_or_default(), Role::Dim),
        (if row.simulated { "SIM".to_owned() } else { String::new() }, Role::Dim),
        simulated(row.simulated),
    ]
}

pub fn pinned(row: &TopicRow) -> (String, Role) {
    match row {
        TopicRow { pins: 0, .. } => ("-".to_owned(), Role::Dim),
        TopicRow { unpinned, .. } if unpinned.is_empty() => ("pinned".to_owned(), Role::Good),
        _ => ("NOT PINNED".to_owned(), Role::Warning),
    }
}

/// For a folded robot: how many of its topics.
fn watched_of(state: &State, row: &TopicRow) -> (String, Role) {
    let Some(robot) = state.topics.robot(&row.topic) else { return watched(row) };
    let (count, all) = state.topics.watched_of(robot);
    let (word, role) = watched(row);
    if row.watched && !row.alarm && row.held_up.is_none() { (format!("{count} of {all}"), role) } else { (word, role) }
}

pub fn watched(row: &TopicRow) -> (String, Role) {
    match row {
        TopicRow { alarm: true, .. } => ("ALARM".to_owned(), Role::Bad),
        row => (Capture::of(row).word().to_owned(), capture_role(Capture::of(row))),
    }
}

fn capture_role(capture: Capture) -> Role {
    match capture {
        Capture::Watched => Role::Good,
        Capture::WaitsForKey => Role::Warning,
        Capture::Paused => Role::Accent,
        Capture::Unwatched | Capture::NoPublisher => Role::Dim,
    }
}
