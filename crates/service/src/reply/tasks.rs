//! Answers about the site's background tasks.

use serde::{Deserialize, Serialize};

/// The state of a background task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskState {
    /// At work.
    Running,
    /// It failed, and is restarted after a pause.
    Resting,
}

/// One background task of the site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskView {
    /// Its name, followed by the profile's if each profile has one: `verifier`, `anchorer default`.
    pub name: String,
    /// Its state.
    pub state: TaskState,
    /// The number of restarts.
    pub restarts: u64,
    /// During the pause: whole seconds until it is restarted.
    pub next_try: Option<u64>,
    /// Why it ended the last time, cleaned.
    pub reason: Option<String>,
}
