//! What is told of the site's background tasks.

use serde::{Deserialize, Serialize};

/// How a background task is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskState {
    /// At work.
    Running,
    /// It failed, and is begun again after a pause.
    Resting,
}

/// One background task of the site.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskView {
    /// Its name, with the profile's where each has one: `verifier`, `anchorer default`.
    pub name: String,
    /// How it is.
    pub state: TaskState,
    /// How often it was begun again.
    pub restarts: u64,
    /// While it rests: whole seconds until it is begun again.
    pub next_try: Option<u64>,
    /// Why it ended the last time, cleaned.
    pub reason: Option<String>,
}
