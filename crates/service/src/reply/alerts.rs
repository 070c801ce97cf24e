//! Answers about alerts.

use serde::{Deserialize, Serialize};

use crate::model::Timestamp;

/// The severity of an alert.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Somebody should look at it today.
    Warning,
    /// Somebody should look at it now.
    Critical,
}

impl Severity {
    /// In one word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Warning => "warning",
            Self::Critical => "critical",
        }
    }
}

/// An alert, active or ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertView {
    /// The rule, and its subject if there can be several: `disk`, `robot_silent/1f2e3d4c`.
    pub key: String,
    /// Its severity.
    pub severity: Severity,
    /// What happened and what to do, without topics, names and keys.
    pub text: String,
    /// The beginning of the address of one of the site's accounts.
    pub site: String,
    /// Active since.
    pub begun: Timestamp,
}

/// An alert that has ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndedAlert {
    /// Its last state.
    #[serde(flatten)]
    pub alert: AlertView,
    /// When it ended.
    pub ended: Timestamp,
}

/// All active alerts, and those that ended recently.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertsView {
    /// The active ones, by their keys.
    pub alerts: Vec<AlertView>,
    /// Those that ended in the last 15 minutes, newest first; of one process, at most 20.
    pub over: Vec<EndedAlert>,
    /// The destination of alerts, or that there is none.
    pub told: String,
    /// Deliveries that wait.
    pub waiting: u64,
    /// Deliveries dropped for want of room; the next one reports how many.
    pub dropped: u64,
}

/// The result of a test alert.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertTestView {
    /// Where it was sent.
    pub place: String,
    /// The reply, cleaned.
    pub text: String,
}
