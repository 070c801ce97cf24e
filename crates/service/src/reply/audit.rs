//! Answers about the audit log.

use serde::{Deserialize, Serialize};

use crate::model::Timestamp;

/// One line of the audit log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditView {
    /// Its number.
    pub line: u64,
    /// Its time.
    pub at: Timestamp,
    /// The profile.
    pub profile: String,
    /// The operator who did it, if it was not the profile's owner.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// The deed.
    pub action: String,
    /// Its object, cleaned.
    pub subject: String,
    /// Its outcome.
    pub outcome: String,
}

impl AuditView {
    /// Who did it: the profile, or `profile/operator`.
    pub fn by(&self) -> String {
        match &self.operator {
            Some(operator) => format!("{}/{operator}", self.profile),
            None => self.profile.clone(),
        }
    }
}

/// The result of a check of the audit log.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditCheck {
    /// Whether nothing is wrong.
    pub ok: bool,
    /// Lines in the unbroken hash chain; 0 if it is broken.
    pub lines: u64,
    /// Heads of this profile that were compared.
    pub heads: u64,
    /// Of these, confirmed on the chain.
    pub anchored: u64,
    /// Lines below the newest of these heads.
    pub covered: u64,
    /// The first line that is wrong.
    pub broken_line: Option<u64>,
    /// The reason.
    pub text: Option<String>,
    /// Records of heads that fail their own checks, with the reasons.
    pub unusable: Vec<String>,
}
