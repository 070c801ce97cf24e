//! Commands about incidents: spans of time and topics of own records, kept together.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::model::{IncidentName, Timestamp, TopicName};
use crate::service::reply::IncidentView;

requests! {
    /// One of these; needs no keyring.
    #[serde(rename_all = "snake_case", tag = "incident")]
    enum IncidentCommand by Command::OfIncident;
    /// Keep a span together: retention does not delete its records.
    OpenIncident {
        /// Its name.
        name: IncidentName,
        /// Records captured at this time or later.
        since: Timestamp,
        /// Records captured before this time; `None` = until it is closed.
        until: Option<Timestamp>,
        /// Of these topics; empty = of all.
        topics: Vec<TopicName>,
        /// A description.
        note: Option<String>,
        /// Robots whose rings are asked for it; then the keyring is needed.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        robots: Vec<String>,
    } => IncidentView;
    /// All incidents of the profile, each with what it holds.
    ListIncidents => Vec<IncidentView>;
    /// One of them.
    ShowIncident {
        /// Its name.
        name: IncidentName,
    } => IncidentView;
    /// Add a note.
    NoteIncident {
        /// Its name.
        name: IncidentName,
        /// The note.
        text: String,
    } => IncidentView;
    /// End its span now; its records stay held.
    CloseIncident {
        /// Its name.
        name: IncidentName,
    } => IncidentView;
    /// Remove it: its records are subject to retention again.
    RemoveIncident {
        /// Its name.
        name: IncidentName,
    } => Vec<IncidentView>;
}
