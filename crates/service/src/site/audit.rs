//! The audit log as the site writes, anchors, checks and shows it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Site;
use crate::model::{ProfileName, Timestamp, clean};
use crate::pipeline::reader::Reader;
use crate::pipeline::{Owner, PipelineError, audit_head};
use crate::service::command::UploadQuery;
use crate::service::event::NoticeLevel;
use crate::service::failure::internal;
use crate::service::reply::{AuditCheck, AuditView, ExportedFile, Failure};
use crate::store::{AuditEntry, AuditLine, AuditQuery};

/// How often it is looked whether something is to be written or anchored.
const LOOK: Duration = Duration::from_secs(1);
/// How often a lost reserve is tried to be set aside again.
const REFILL: Duration = Duration::from_secs(60);
/// Lines exported at a time.
const PAGE: usize = 1000;

impl Site {
    /// Writes one line; it is durable when this returns.
    pub(crate) async fn record_audit(
        self: &Arc<Self>,
        profile: &ProfileName,
        action: &str,
        subject: &str,
        outcome: &str,
    ) -> Result<(), Failure> {
        let entry = entry(profile.as_str(), action, subject, outcome);
        self.blocking(move |site| Ok(site.audit.append(entry)?)).await
    }

    /// No durable line, no deed: written before what it tells of.
    pub(crate) async fn audit_first(
        self: &Arc<Self>,
        owner: &Owner,
        action: &str,
        subject: &str,
    ) -> Result<(), Failure> {
        self.record_audit(&owner.profile, action, subject, "begun").await
    }

    /// How a deed ended that [`Self::audit_first`] announced.
    pub(super) async fn audit_end<T>(
        self: &Arc<Self>,
        owner: &Owner,
        action: &str,
        subject: &str,
        outcome: Result<T, Failure>,
    ) -> Result<T, Failure> {
        let word = if outcome.is_ok() { "done" } else { "failed" };
        let written = self.record_audit(&owner.profile, action, subject, word).await;
        let done = outcome?;
        // The deed is done and was announced durably; that its end is not written down is told, not taken back.
        if let Err(failure) = written {
            self.hub.notice(NoticeLevel::Error, &failure.message);
        }
        Ok(done)
    }

    /// A page of somebody's list is given out: a line before it, unless the same was asked within a minute.
    pub(super) async fn audit_query(
        self: &Arc<Self>,
        owner: &Owner,
        action: &str,
        query: &UploadQuery,
    ) -> Result<(), Failure> {
        let (profile, text) = (owner.profile.as_str(), query_text(query));
        if !self.refusals.is_new_query(Timestamp::now(), profile, &text) {
            return Ok(());
        }
        let written = self.record_audit(&owner.profile, action, &text, "done").await;
        if written.is_err() {
            self.refusals.forget_query(profile, &text);
        }
        written
    }

    /// Counts a refusal; a line per peer, code and minute tells how many there were. `peer` is a profile's name, or
    /// what is known of a remote peer (no port: each connection has another); `code` is one of the program's. Returns
    /// whether it is the first of its minute.
    pub(crate) fn refused(&self, peer: &str, code: &str) -> bool {
        self.refusals.add(Timestamp::now(), peer, code)
    }

    /// Counts a local refusal where there is one.
    pub(super) fn count_refusal<T>(&self, owner: &Owner, outcome: &Result<T, PipelineError>) {
        if let Err(PipelineError::NotGranted { .. }) = outcome {
            let _first = self.refused(owner.profile.as_str(), "not_granted");
        }
    }

    /// Writes what was counted, anchors the head of the log, sets a lost reserve aside again; until the site ends.
    pub(super) async fn keep_audit(self: Arc<Self>) {
        let mut refill = Instant::now();
        while !self.is_stopping() {
            if !self.beat(LOOK).await {
                return;
            }
            self.write_counted(Some(Timestamp::now())).await;
            for owner in self.all_owners() {
                self.anchor_head(&owner).await;
            }
            if !self.reserve.is_held() && refill.elapsed() >= REFILL && self.plant.ledger.takes_records().is_ok() {
                refill = Instant::now();
                // On a disk that is still full it is tried again.
                drop(self.blocking(|site| Ok(site.reserve.refill()?)).await);
            }
        }
    }

    /// Writes the counters of ended minutes; all of them where `now` is `None`.
    pub(super) async fn write_counted(self: &Arc<Self>, now: Option<Timestamp>) {
        let mut refusals = self.refusals.take(now).into_iter();
        while let Some(((minute, peer, code), count)) = refusals.next() {
            let outcome = format!("{count} in the minute from {}", Timestamp::from_seconds(minute * 60));
            let line = entry(&peer, "refused", &code, &outcome);
            if let Err(failure) = self.blocking(move |site| Ok(site.audit.append(line)?)).await {
                let lost = std::iter::once(((minute, peer, code), count)).chain(refusals).collect();
                self.refusals.put_back(lost);
                self.hub.notice(NoticeLevel::Error, &failure.message);
                break;
            }
        }
        for again in self.refusals.repeated(now) {
            let line = entry(&again.profile, "list shared", &again.query, &format!("{} times again", again.times));
            if let Err(failure) = self.blocking(move |site| Ok(site.audit.append(line)?)).await {
                self.hub.notice(NoticeLevel::Error, &failure.message);
                return;
            }
        }
    }

    async fn anchor_head(self: &Arc<Self>, owner: &Arc<Owner>) {
        let Some(network) = self.network_now() else { return };
        // Keys that are being changed now must not sign; the next look comes soon.
        let Ok(_one_at_a_time) = owner.changes.try_lock() else { return };
        let (of, every) = (Arc::clone(owner), self.config.audit_every);
        let stated = self
            .blocking(move |site| Ok(audit_head::state_head(&site.plant, &network, &site.audit, &of, every)?))
            .await;
        match stated {
            Ok(Some(_)) => self.hub.stored.notify_waiters(),
            Ok(None) => {}
            Err(failure) => {
                let text = format!("the audit log's head is not anchored for {}: {}", owner.profile, failure.message);
                self.hub.notice(NoticeLevel::Error, &text);
            }
        }
    }

    /// The newest lines that match, newest first.
    pub(super) async fn audit_lines(self: &Arc<Self>, query: AuditQuery) -> Result<Vec<AuditView>, Failure> {
        let query = AuditQuery { limit: query.limit.clamp(1, PAGE), ..query };
        let mut lines = self.blocking(move |site| Ok(site.audit.list(&query)?)).await?;
        lines.reverse();
        Ok(lines.into_iter().map(view).collect())
    }

    /// Walks the whole log, and compares it with the heads that this owner anchored.
    pub(super) async fn verify_audit(self: &Arc<Self>, owner: Option<Arc<Owner>>) -> Result<AuditCheck, Failure> {
        let walked = self.blocking(|site| Ok(site.audit.verify())).await?;
        let mut check = AuditCheck { ok: true, ..AuditCheck::default() };
        let mut broken = match walked {
            Ok(lines) => {
                check.lines = lines;
                None
            }
            Err(fault) => Some(fault),
        };
        if let Some(owner) = owner {
            let network = self.network().await?;
            let reader = Reader { plant: &self.plant, network: &network, reader: &owner };
            let heads = audit_head::heads(&reader).await?;
            check.heads = heads.good.len() as u64;
            check.anchored = heads.anchored as u64;
            check.unusable = heads.bad.iter().map(|(id, why)| format!("{id}: {}", clean(why, 200))).collect();
            match self.blocking(move |site| Ok(site.audit.compare(&heads.good))).await? {
                Ok(covered) => check.covered = covered,
                Err(fault) => broken = broken.filter(|walked| walked.line <= fault.line).or(Some(fault)),
            }
        }
        check.ok = broken.is_none() && check.unusable.is_empty();
        check.broken_line = broken.as_ref().map(|fault| fault.line);
        check.text = broken.map(|fault| clean(&fault.to_string(), 300));
        Ok(check)
    }

    /// The whole log as a file for others: one JSON document a line, addresses redacted unless asked for.
    pub(super) async fn export_audit(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        addresses: bool,
    ) -> Result<Vec<ExportedFile>, Failure> {
        self.audit_first(owner, "export audit", if addresses { "with addresses" } else { "redacted" }).await?;
        let bytes = self
            .blocking(move |site| {
                let (mut pages, mut before) = (Vec::new(), None);
                loop {
                    let page = site.audit.list(&AuditQuery { before, limit: PAGE, ..AuditQuery::default() })?;
                    let Some(first) = page.first() else { break };
                    before = Some(first.line);
                    pages.push(page);
                }
                let mut bytes = Vec::new();
                for mut line in pages.into_iter().rev().flatten() {
                    if !addresses {
                        line.entry.action = crate::model::redact_addresses(&line.entry.action);
                        line.entry.subject = crate::model::redact_addresses(&line.entry.subject);
                        line.entry.outcome = crate::model::redact_addresses(&line.entry.outcome);
                    }
                    serde_json::to_writer(&mut bytes, &line).map_err(|error| internal(error.to_string()))?;
                    bytes.push(b'\n');
                }
                Ok(bytes)
            })
            .await?;
        Ok(vec![ExportedFile { name: "audit.jsonl".to_owned(), bytes }])
    }
}

fn entry(profile: &str, action: &str, subject: &str, outcome: &str) -> AuditEntry {
    AuditEntry {
        at: Timestamp::now(),
        profile: clean(profile, 100),
        action: clean(action, 100),
        subject: clean(subject, 200),
        outcome: clean(outcome, 100),
    }
}

fn view(line: AuditLine) -> AuditView {
    AuditView {
        line: line.line,
        at: line.entry.at,
        profile: clean(&line.entry.profile, 100),
        action: clean(&line.entry.action, 100),
        subject: clean(&line.entry.subject, 200),
        outcome: clean(&line.entry.outcome, 100),
    }
}

/// What was asked for, in words: only the filters that are set.
fn query_text(query: &UploadQuery) -> String {
    let mut words = vec!["records".to_owned()];
    words.extend(query.owner.as_ref().map(|owner| format!("of {owner}")));
    words.extend(query.topic.as_ref().map(|topic| format!("topic {topic}")));
    words.extend(query.type_name.as_ref().map(|name| format!("type {name}")));
    words.extend(query.words.iter().map(|word| format!("with {}", clean(word, 40))));
    words.extend(query.tags.iter().map(|(name, value)| format!("tag {}={}", clean(name, 40), clean(value, 40))));
    words.extend(query.kind.map(|kind| format!("kind {}", kind.word())));
    words.extend(query.state.map(|state| format!("state {}", state.word())));
    words.extend(query.since.map(|since| format!("since {since}")));
    words.extend(query.until.map(|until| format!("until {until}")));
    words.extend(query.after.as_ref().map(|after| format!("after {}", clean(after, 40))));
    words.join(" ")
}
