//! Answers about the whole store: its audit, its backup, the doctor's findings.

use serde::{Deserialize, Serialize};

pub use crate::pipeline::record_audit::{FindingKind, RecordAudit, RecordFinding};

/// The content of a backup, or of what was restored from one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BackupView {
    /// The file.
    pub file: String,
    /// Files of the home in it.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Profiles whose keyrings are in it.
    pub profiles: Vec<String>,
    /// What it does not contain, in words.
    pub notes: Vec<String>,
}

/// The state of one thing checked by the doctor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckStatus {
    /// As it should be.
    Ok,
    /// Works, but something should be done.
    Warn,
    /// Does not work.
    Fail,
}

/// One thing checked by the doctor.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorCheck {
    /// Its name.
    pub name: String,
    /// Its state.
    pub status: CheckStatus,
    /// What was found, cleaned.
    pub detail: String,
    /// What to do; empty if nothing has to be done.
    pub advice: String,
}

/// All that the doctor checked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorView {
    /// Whether nothing fails.
    pub ok: bool,
    /// The findings.
    pub checks: Vec<DoctorCheck>,
}
