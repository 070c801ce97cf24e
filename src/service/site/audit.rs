//! The audit log as the site writes and shows it.

use std::sync::Arc;

use super::Site;
use crate::model::{ProfileName, Timestamp, clean};
use crate::pipeline::Owner;
use crate::service::reply::{AuditView, Failure};
use crate::store::AuditEntry;

impl Site {
    /// Writes one line; it is durable when this returns.
    pub(super) async fn record_audit(
        self: &Arc<Self>,
        profile: &ProfileName,
        action: &str,
        subject: &str,
        outcome: &str,
    ) -> Result<(), Failure> {
        let entry = AuditEntry {
            at: Timestamp::now(),
            profile: profile.to_string(),
            action: clean(action, 100),
            subject: clean(subject, 200),
            outcome: clean(outcome, 100),
        };
        self.blocking(move |site| Ok(site.audit.append(entry)?)).await
    }

    /// No durable line, no deed: written before what it tells of.
    pub(super) async fn audit_first(
        self: &Arc<Self>,
        owner: &Owner,
        action: &str,
        subject: &str,
    ) -> Result<(), Failure> {
        self.record_audit(&owner.profile, action, subject, "begun").await
    }

    /// The newest lines, newest first.
    pub(super) async fn audit_lines(self: &Arc<Self>, limit: usize) -> Result<Vec<AuditView>, Failure> {
        let lines = self.blocking(move |site| Ok(site.audit.tail(limit.clamp(1, 1000))?)).await?;
        let view = |line: crate::store::AuditLine| AuditView {
            line: line.line,
            at: line.entry.at,
            profile: clean(&line.entry.profile, 40),
            action: clean(&line.entry.action, 100),
            subject: clean(&line.entry.subject, 200),
            outcome: clean(&line.entry.outcome, 100),
        };
        Ok(lines.into_iter().map(view).collect())
    }
}
