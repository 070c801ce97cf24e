//! `alerts`: the active ones, and whether they reach their recipient.

#![deny(clippy::wildcard_enum_match_arm)]

use clap::Subcommand;

use super::connect::ProfileNeed;
use super::verbs::{NEITHER, Plan};
use crate::service::command::{ListAlerts, TestAlert};
use crate::service::reply::{AlertTestView, AlertView, AlertsView, EndedAlert};
use authros_output::table;

/// `alerts …`
#[derive(Debug, Subcommand)]
pub enum AlertsVerb {
    /// Active alerts, and deliveries still pending
    List,
    /// Send a test alert and print the reply
    Test,
}

/// What is asked.
pub fn plan(verb: &AlertsVerb) -> Plan {
    match verb {
        AlertsVerb::List => Plan::new(NEITHER, ProfileNeed::None, ListAlerts),
        AlertsVerb::Test => Plan::new(NEITHER, ProfileNeed::None, TestAlert),
    }
}

/// Alerts that stand, for people.
pub fn standing(view: &AlertsView) -> String {
    let row = |alert: &AlertView| {
        vec![alert.begun.to_string(), alert.severity.word().to_owned(), alert.key.clone(), alert.text.clone()]
    };
    let mut lines = match view.alerts.is_empty() {
        true => vec!["no active alerts".to_owned()],
        false => {
            vec![table(&["since", "severity", "alert", "what"], &view.alerts.iter().map(row).collect::<Vec<_>>())]
        }
    };
    lines.extend(view.over.iter().map(over));
    lines.push(format!("sent to: {}; {} deliveries pending, {} dropped", view.told, view.waiting, view.dropped));
    lines.join("\n")
}

/// One that is over, for people.
pub fn over(ended: &EndedAlert) -> String {
    format!("resolved {}: {}, which began {}", ended.ended, ended.alert.key, ended.alert.begun)
}

/// What came back, for people.
pub fn tested(view: &AlertTestView) -> String {
    format!("{} accepted it: {}", view.place, view.text)
}
