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

/// What erasing would take, or took.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ErasureView {
    /// Messages that can be erased.
    pub records: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Their topics. Cleaned.
    pub topics: Vec<String>,
    /// Chosen, but not verified yet: they stay for now.
    pub waiting: u64,
    /// Chosen, and deleted or erased earlier.
    pub gone: u64,
    /// Chosen, but quarantined, discarded or altered: they stay.
    pub other: u64,
    /// Incidents that hold some of them: nothing is erased while they do.
    pub held: Vec<String>,
    /// Named in signed retention records; 0 = it was only shown.
    pub named: u64,
    /// Not named, because their bytes are missing or altered.
    pub missing: u64,
    /// Whether the bytes of those named are gone; otherwise they go when the retention records are confirmed.
    pub deleted: bool,
    /// What erasing does not reach, in words.
    pub stays: Vec<String>,
}
