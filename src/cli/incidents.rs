//! `incident`: spans of time and topics of own records, held from retention; what there is of them, for people.

use clap::Subcommand;

use super::parse::{self, usage};
use super::{plan::Plan, show::or_dash};
use crate::model::{Timestamp, counted};
use crate::service::Failure;
use crate::service::command::{CloseIncident, ListIncidents, NoteIncident, OpenIncident, RemoveIncident, ShowIncident};
use crate::service::reply::{IncidentView, SpanCoverageView};
use authros_output::{Output, table};

/// `incident …`
#[derive(Debug, Subcommand)]
pub enum IncidentVerb {
    /// Open an incident: retention keeps the records of this time span and these topics until it is removed
    Open {
        /// Name: letters, digits, '.', '-' and '_'
        name: String,
        /// Start: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
        #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
        since: String,
        /// End; same format [default: when it is closed]
        #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
        until: Option<String>,
        /// Topics, one or more, or patterns, which also cover topics that appear later [default: all]
        #[arg(long, visible_alias = "topic", value_name = "TOPIC", num_args = 1.., value_delimiter = ',')]
        topics: Vec<String>,
        /// Description
        #[arg(long, value_name = "TEXT")]
        note: Option<String>,
        /// Robots to request the span from, out of their rings: names of enrolled devices
        #[arg(long = "robot", value_name = "NAME", num_args = 1.., value_delimiter = ',')]
        rings_of: Vec<String>,
    },
    /// List incidents and what each holds, newest first
    List,
    /// Show an incident: its notes, and its records by topic
    Show {
        /// Its name
        name: String,
    },
    /// Add a note to an incident
    Note {
        /// Its name
        name: String,
        /// Text of the note
        text: String,
    },
    /// Close an incident: its span ends now, its records stay held
    Close {
        /// Its name
        name: String,
    },
    /// Remove an incident: retention may then delete what only it held
    Remove {
        /// Its name
        name: String,
        /// Confirm the removal
        #[arg(long)]
        yes: bool,
    },
}

pub fn plan(verb: IncidentVerb, output: &Output) -> Result<Plan, Failure> {
    Ok(match verb {
        IncidentVerb::Open { name, since, until, topics, note, rings_of } => {
            let (name, topics) = (parse::value(&name)?, parse::values(&topics)?);
            let times = parse::Times::now(output);
            let (since, until) = (times.begin(&since)?, times.until(until.as_deref())?);
            let question = OpenIncident { name, since, until, topics, note, robots: rings_of };
            // The owner signs the notices that ask robots.
            if question.robots.is_empty() { Plan::kept(question) } else { Plan::unlocked(question) }
        }
        IncidentVerb::List => Plan::kept(ListIncidents),
        IncidentVerb::Show { name } => Plan::kept(ShowIncident { name: parse::value(&name)? }),
        IncidentVerb::Note { name, text } => Plan::kept(NoteIncident { name: parse::value(&name)?, text }),
        IncidentVerb::Close { name } => Plan::kept(CloseIncident { name: parse::value(&name)? }),
        IncidentVerb::Remove { name, yes: true } => Plan::kept(RemoveIncident { name: parse::value(&name)? }),
        IncidentVerb::Remove { .. } => {
            return Err(usage("what retention then deletes cannot be restored; add --yes to confirm"));
        }
    })
}

fn state(incident: &IncidentView) -> &'static str {
    if incident.open { "open" } else { "closed" }
}

pub fn all(incidents: &[IncidentView]) -> String {
    if incidents.is_empty() {
        return "no incidents; open one with `authros incident open NAME --since 10m`".to_owned();
    }
    let row = |incident: &IncidentView| {
        [
            incident.name.to_string(),
            state(incident).to_owned(),
            incident.since.in_milliseconds(),
            or_dash(incident.until.map(Timestamp::in_milliseconds)),
            incident.coverage.iter().filter(|topic| topic.records > 0).count().to_string(),
            incident.records.to_string(),
            incident.bytes.to_string(),
        ]
    };
    table(&["incident", "", "from", "to", "topics", "records", "bytes"], incidents.iter().rev().map(row))
}

pub fn incident(view: &IncidentView) -> String {
    let to = view.until.map_or_else(|| "now, until it is closed".to_owned(), Timestamp::in_milliseconds);
    let mut lines = vec![
        format!("{} ({}): {} to {to}", view.name, state(view), view.since.in_milliseconds()),
        format!("{}, {}, held from retention", counted(view.records, "record"), counted(view.bytes, "byte")),
    ];
    // Indented, so that no further line of a note looks like a note of its own.
    lines.extend(
        view.notes.iter().map(|note| format!("{}  {}", note.at.in_milliseconds(), note.text.replace('\n', "\n    "))),
    );
    let row = |one: &SpanCoverageView| {
        let [records, lost, quarantined, deleted] =
            [one.records, one.lost, one.quarantined, one.deleted].map(|count| count.to_string());
        [one.topic.clone(), records, or_dash(one.first), or_dash(one.last), lost, quarantined, deleted]
    };
    if !view.coverage.is_empty() {
        let head = ["topic", "records", "first", "last", "lost", "quarantined", "deleted earlier"];
        lines.push(table(&head, view.coverage.iter().map(row)));
    }
    let empty = view.coverage.iter().filter(|one| one.records + one.quarantined == 0);
    lines.extend(empty.map(|one| {
        format!("there are no records of {} in that span; check the name and whether it is watched", one.topic)
    }));
    lines.join("\n")
}
