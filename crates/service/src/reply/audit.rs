//! What is told of the audit log.

use serde::{Deserialize, Serialize};

use crate::model::Timestamp;

/// One line of the audit log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditView {
    /// Its number.
    pub line: u64,
    /// When.
    pub at: Timestamp,
    /// Which profile.
    pub profile: String,
    /// What was done.
    pub action: String,
    /// To what, cleaned.
    pub subject: String,
    /// How it ended.
    pub outcome: String,
}

/// What a check of the audit log found.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditCheck {
    /// Whether nothing is wrong.
    pub ok: bool,
    /// Lines whose chain of hashes holds; 0 where it is broken.
    pub lines: u64,
    /// Heads of this profile that were compared.
    pub heads: u64,
    /// Of these on the chain, confirmed.
    pub anchored: u64,
    /// Lines below the newest of these heads.
    pub covered: u64,
    /// The first line that is wrong.
    pub broken_line: Option<u64>,
    /// What is wrong with it.
    pub text: Option<String>,
    /// Records of heads that fail their own checks, with the reason.
    pub unusable: Vec<String>,
}
