//! What is told of alerts.

use serde::{Deserialize, Serialize};

use crate::model::Timestamp;

/// How bad it is.
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

/// An alert that stands, or stood.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertView {
    /// The rule, and what it is about where there can be several: `disk`, `robot_silent/1f2e3d4c`.
    pub key: String,
    /// How bad it is.
    pub severity: Severity,
    /// What happened and what to do, without topics, names and keys.
    pub text: String,
    /// The beginning of an account of the site that tells it.
    pub site: String,
    /// Since when it stands.
    pub begun: Timestamp,
}

/// An alert that is over.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndedAlert {
    /// As it stood last.
    #[serde(flatten)]
    pub alert: AlertView,
    /// When it was over.
    pub ended: Timestamp,
}

/// All that stand now, and what was over lately.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertsView {
    /// By their keys.
    pub alerts: Vec<AlertView>,
    /// Those that were over in the last 15 minutes, the newest first; of one process, 20 at most.
    #[serde(default)]
    pub over: Vec<EndedAlert>,
    /// Who is told, or that nobody is.
    pub told: String,
    /// Deliveries that wait.
    pub waiting: u64,
    /// Deliveries that found no room; the next one tells how many.
    pub dropped: u64,
}

/// What came of an alert that was sent to try the way.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlertTestView {
    /// Where it was sent.
    pub place: String,
    /// What came back, cleaned.
    pub text: String,
}
