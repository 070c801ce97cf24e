//! Opened records on the command line: their readable form, their fields, their path; the files they become.

use std::path::PathBuf;

use super::connect::ProfileNeed;
use super::lists::in_milliseconds;
use super::show::Question;
use super::verbs::{CHAIN, Plan};
use crate::model::RecordState;
use crate::ros::readable::{Plot, Readable, Table, file_of};
use crate::service::command::{OpenShared, ViewFile};
use crate::service::reply::{OpenedView, PathView};
use authros_output::table;

/// A plan about shared records.
pub fn plan(question: impl Into<Question>) -> Plan {
    Plan::new(CHAIN, ProfileNeed::Unlocked, question)
}

/// `shared open`, with a file if one is to be written.
pub fn open(id: String, out: Option<PathBuf>) -> Plan {
    let Some(path) = &out else { return plan(OpenShared { id }) };
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    Plan { out: Some(path.clone()), ..plan(ViewFile { id, kind: file_of(&name) }) }
}

/// Removes what is only for screens or for files.
pub fn without_bytes(view: &mut OpenedView) {
    view.body = None;
    view.picture = None;
    view.file = None;
    view.beginning = Vec::new();
    if let Some(readable) = &mut view.readable {
        readable.picture = None;
    }
}

/// An opened record: its description, its readable form, every field.
pub fn opened(view: &OpenedView) -> String {
    let record = &view.record;
    let held = if record.state.word() == RecordState::Quarantined.word() { "  QUARANTINED" } else { "" };
    let verdict = view.verdict.word().to_uppercase();
    let mut lines = vec![
        format!("{}  {}  seq {}  {verdict}{held}", record.id, record.topic, record.seq),
        format!("{}{} captured {}", record.type_name, from(&view.caller_id), in_milliseconds(record.captured_at)),
        format!("{} bytes, sealed as {} ({})", record.bytes, view.stored, compressed(&view.compression)),
    ];
    lines.extend(view.tags.iter().map(|(key, value)| format!("tag {key} = {value}")));
    lines.extend(view.reason.iter().map(|reason| format!("not checked against the chain now: {reason}")));
    lines.extend(view.note.iter().map(|note| format!("note: {note}")));
    if let Some(readable) = &view.readable {
        lines.push(String::new());
        lines.push(self::readable(readable));
        lines.push(String::new());
    }
    lines.extend(view.fields.iter().map(|(path, text)| format!("  {path}: {text}")));
    lines.join("\n")
}

/// Statements and attachments are of no publisher.
fn from(caller_id: &str) -> String {
    if caller_id.is_empty() { String::new() } else { format!(" from {caller_id}") }
}

fn compressed(word: &str) -> String {
    match word {
        "none" | "" => String::from("not compressed"),
        word => format!("compressed: {word}"),
    }
}

fn readable(view: &Readable) -> String {
    let width = view.lines.iter().map(|(label, _)| label.chars().count()).max().unwrap_or(0);
    let mut parts: Vec<String> = view.lines.iter().map(|(label, value)| format!("{label:width$}  {value}")).collect();
    parts.extend(view.tables.iter().map(tabled));
    if let Some(plot) = &view.plot {
        parts.push(format!("{}: {} points ({}; {})", plot.title, plot.points.len(), plot.axes.0, plot.axes.1));
    }
    parts.join("\n")
}

fn tabled(view: &Table) -> String {
    let columns = view.rows.iter().map(Vec::len).chain([view.head.len()]).max().unwrap_or(0);
    let head: Vec<&str> = (0..columns).map(|at| view.head.get(at).map_or("", String::as_str)).collect();
    format!("{}\n{}", view.title, table(&head, &view.rows))
}

/// A path, point by point.
pub fn path(view: &PathView) -> String {
    let unread = if view.unread > 0 { format!(", {} could not be read", view.unread) } else { String::new() };
    let head = format!("{}: {} records{unread}", view.topic, view.records);
    let Some(Plot { axes, points, .. }) = &view.plot else { return head };
    let rows: Vec<Vec<String>> = points.iter().map(|(x, y)| vec![format!("{x:.4}"), format!("{y:.4}")]).collect();
    format!("{head}\n{}", table(&[&axes.0, &axes.1], &rows))
}
