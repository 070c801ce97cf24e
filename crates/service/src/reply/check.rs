//! What is told of the whole store: its audit, its back-up, the doctor's findings.

use serde::{Deserialize, Serialize};

pub use crate::pipeline::record_audit::{FindingKind, RecordAudit, RecordFinding};

/// What a back-up holds, or what was restored from one.
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
    /// What is not in it, in words.
    pub notes: Vec<String>,
}

/// How one thing is that the doctor looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckStatus {
    /// As it should be.
    Ok,
    /// Works, and something should be done.
    Warn,
    /// Does not work.
    Fail,
}

/// One thing that the doctor looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorCheck {
    /// What was looked at.
    pub name: String,
    /// How it is.
    pub status: CheckStatus,
    /// What was found, cleaned.
    pub detail: String,
    /// What to do; empty where nothing has to be done.
    pub advice: String,
}

/// All that the doctor looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoctorView {
    /// Whether nothing fails.
    pub ok: bool,
    /// One by one.
    pub checks: Vec<DoctorCheck>,
}
