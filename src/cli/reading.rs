//! Commands about an existing home create none: a mistyped path would look sound, and block a restore. Opened records
//! as text.

use std::path::PathBuf;

use authros_output::table;

use super::args::{ChainVerb, GatewayVerb, Global, IdentityVerb, KeysVerb, RecordsVerb, RobotVerb, TopicsVerb, Verb};
use super::backups::BackupVerb;
use super::evidence::EvidenceVerb;
use super::parties::ContactsVerb;
use super::plan::Plan;
use super::recordings::BagVerb;
use crate::model::{ErrorKind, RecordState, counted, grouped};
use crate::ros::readable::{Plot, Readable, Table, file_of};
use crate::service::command::{OpenShared, ViewFile};
use crate::service::reply::{OpenedView, PathView};
use crate::{paths::Home, service::Failure};

pub fn needs_a_home(global: &Global, verb: Option<&Verb>) -> Result<(), Failure> {
    // An operator works at somebody else's home.
    if global.site_socket.is_some() || verb.is_none_or(makes_a_home) {
        return Ok(());
    }
    let home = match &global.home {
        Some(root) => Home::new(root.clone()),
        None => Home::standard().map_err(|error| Failure::new(error.kind(), error.to_string()))?,
    };
    if home.is_there() {
        return Ok(());
    }
    let root = home.root().display();
    let text = format!(
        "no home at {root}; give its path with --home, or make one there with `authros identity create` or `authros serve`"
    );
    Err(Failure::new(ErrorKind::Input, text))
}

/// Verbs that work without a home, or make one.
#[deny(clippy::wildcard_enum_match_arm)]
fn makes_a_home(verb: &Verb) -> bool {
    match verb {
        // Checks the machine, also before there is a home.
        Verb::Doctor
        | Verb::Capture(_)
        | Verb::Serve(_)
        | Verb::Tour(_)
        | Verb::Console(_)
        // Reads settings without touching a home.
        | Verb::Config(_)
        | Verb::Help { .. }
        | Verb::Complete { .. } => true,
        Verb::Status { .. }
        | Verb::Audit(_)
        | Verb::Received(_)
        | Verb::Grant(_)
        | Verb::Incident(_)
        | Verb::Alerts(_) => false,
        Verb::Bag(verb) => !matches!(verb, BagVerb::Export(_)),
        Verb::Records(verb) => matches!(verb, RecordsVerb::Import { .. }),
        Verb::Identity(verb) => matches!(verb, IdentityVerb::Create | IdentityVerb::Register),
        Verb::Keys(verb) => matches!(verb, KeysVerb::Load { dry_run: false, .. } | KeysVerb::Restore { .. }),
        Verb::Topics(verb) => matches!(verb, TopicsVerb::Watch { .. } | TopicsVerb::Pin(_)),
        Verb::Contacts(verb) => matches!(verb, ContactsVerb::Add { .. }),
        Verb::Robot(verb) => matches!(verb, RobotVerb::Run(_)),
        Verb::Gateway(verb) => matches!(verb, GatewayVerb::Serve { .. } | GatewayVerb::Allow { .. } | GatewayVerb::Join { .. }),
        Verb::Chain(verb) => matches!(verb, ChainVerb::Deploy { .. } | ChainVerb::Serve { .. } | ChainVerb::Genesis(_)),
        Verb::Evidence(verb) => matches!(verb, EvidenceVerb::Verify(_)),
        Verb::Backup(verb) => matches!(verb, BackupVerb::Check { .. } | BackupVerb::Restore { .. }),
    }
}

pub fn open(id: String, out: Option<PathBuf>) -> Plan {
    let Some(path) = &out else { return Plan::unlocked(OpenShared { id }) };
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    Plan { out: Some(path.clone()), ..Plan::unlocked(ViewFile { id, kind: file_of(&name) }) }
}

pub fn without_bytes(view: &mut OpenedView) {
    view.body = None;
    view.picture = None;
    view.file = None;
    view.beginning = Vec::new();
    if let Some(readable) = &mut view.readable {
        readable.picture = None;
    }
}

/// What it is, and whether it holds.
pub fn head(view: &OpenedView) -> Vec<String> {
    let record = &view.record;
    let held = if record.state.word() == RecordState::Quarantined.word() { "  QUARANTINED" } else { "" };
    let verdict = view.verdict.word().to_uppercase();
    let mut lines = vec![
        format!("{}  {}  seq {}  {verdict}{held}", record.id, record.topic, record.seq),
        format!("{}{} captured {}", record.type_name, from(&view.caller_id), record.captured_at.in_milliseconds()),
        format!(
            "{}, sealed as {} ({})",
            counted(record.bytes, "byte"),
            grouped(view.stored),
            compressed(&view.compression)
        ),
    ];
    lines.extend(view.tags.iter().map(|(key, value)| format!("tag {key} = {value}")));
    lines.extend(view.reason.iter().map(|reason| format!("not checked against the chain now: {reason}")));
    lines.extend(view.note.iter().map(|note| format!("note: {note}")));
    lines
}

pub fn opened(view: &OpenedView) -> String {
    let mut lines = head(view);
    if let Some(readable) = &view.readable {
        lines.push(String::new());
        lines.push(readable_text(readable));
        lines.push(String::new());
    }
    lines.extend(view.fields.iter().map(|(path, text)| format!("  {path}: {text}")));
    lines.join("\n")
}

/// Statements and attachments have no publisher.
fn from(caller_id: &str) -> String {
    if caller_id.is_empty() { String::new() } else { format!(" from {caller_id}") }
}

fn compressed(word: &str) -> String {
    match word {
        "none" | "" => String::from("not compressed"),
        word => format!("compressed: {word}"),
    }
}

fn readable_text(view: &Readable) -> String {
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

pub fn path(view: &PathView) -> String {
    let unread = if view.unread > 0 { format!(", {} could not be read", view.unread) } else { String::new() };
    let head = format!("{}: {}{unread}", view.topic, counted(view.records as u64, "record"));
    let Some(Plot { axes, points, .. }) = &view.plot else { return head };
    let rows = points.iter().map(|(x, y)| [format!("{x:.4}"), format!("{y:.4}")]);
    format!("{head}\n{}", table(&[&axes.0, &axes.1], rows))
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::super::args::Arguments;
    use super::*;

    #[test]
    fn the_head_of_a_record_has_its_verdict_and_none_of_its_fields() {
        let view: OpenedView = serde_json::from_value(serde_json::json!({
            "id": "0a", "seq": 7, "topic": "/odom", "type": "nav_msgs/Odometry", "kind": "data", "state": "stored",
            "digest": "00".repeat(32), "bytes": 7, "captured_at": "2026-01-01T00:00:00Z", "epoch": 1,
            "simulated": false, "transaction": null, "block": null, "verdict": "verified", "caller_id": "/driver",
            "tags": [["mission", "harbour"]], "fields": [["pose.x", "1.5"]], "message": null, "compression": "none",
            "stored": 9, "compared": "head",
        }))
        .expect("an opened record");
        let (head, whole) = (head(&view).join("\n"), opened(&view));
        assert!(head.contains("/odom  seq 7  VERIFIED") && head.contains("tag mission = harbour"), "{head}");
        assert!(whole.starts_with(&head) && whole.contains("pose.x: 1.5") && !head.contains("pose.x"), "{whole}");
    }

    #[test]
    fn what_only_looks_is_refused_where_there_is_no_home() {
        let folder = tempfile::tempdir().expect("a folder");
        let missing = folder.path().join("mistyped").display().to_string();
        let refusal = |words: &str| {
            let line = ["authros", "--home", missing.as_str()].into_iter().chain(words.split(' '));
            let arguments = Arguments::try_parse_from(line).unwrap_or_else(|error| panic!("{words}: {error}"));
            needs_a_home(&arguments.global, arguments.verb.as_ref()).err()
        };
        for words in [
            "status",
            "records list",
            "received list",
            "grant list",
            "grant end bob",
            "robot devices",
            "identity show",
            "identity list",
            "keys lock",
            "keys list",
            "keys load --sm2 FILE --dry-run",
            "keys backup --out FILE",
            "keys rotate",
            "topics list",
            "topics pins",
            "topics rules",
            "topics coverage /odom",
            "topics unwatch /odom",
            "contacts list",
            "contacts remove bob",
            "alerts list",
            "alerts test",
            "gateway status",
            "gateway allowed",
            "chain status",
            "backup create FILE",
            "bag export --mcap FILE",
            "chain succession list",
            "chain admin suspend bob",
        ] {
            let failure = refusal(words).unwrap_or_else(|| panic!("{words} is not refused"));
            assert!(failure.kind == ErrorKind::Input && failure.message.contains(&missing), "{words}: {failure:?}");
            assert!(failure.message.contains("identity create"), "{words}: {failure:?}");
        }
        for words in [
            "serve",
            "identity create",
            "identity register",
            "backup restore FILE",
            "evidence verify FILE",
            "help grant",
            "keys load --sm2 FILE",
            "topics watch /odom",
            "contacts add bob 0xBOB",
            "gateway serve",
            "chain genesis --guide",
            "records import OLD",
            "config show",
            "doctor",
        ] {
            assert!(refusal(words).is_none(), "{words}");
        }
    }
}
