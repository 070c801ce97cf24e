//! The audit log as the site writes and shows it.

use std::sync::Arc;

use super::{Refusals, doer};
use crate::model::{ProfileName, Timestamp, clean, counted};
use crate::pipeline::{Owner, PipelineError};
use crate::service::command::UploadQuery;
use crate::service::failure::internal;
use crate::service::hub::Hub;
use crate::service::reply::{AuditView, ExportedFile, Result};
use crate::site::blocking;
use crate::store::{AuditEntry, AuditLine, AuditLog, AuditQuery};

const PAGE: usize = 1000;
/// Characters; a reason may be a sentence or two.
const LONGEST_OUTCOME: usize = 300;

pub(crate) struct Log {
    lines: AuditLog,
    counted: Refusals,
    hub: Arc<Hub>,
}

impl Log {
    pub fn new(lines: AuditLog, hub: Arc<Hub>) -> Self {
        Self { lines, counted: Refusals::default(), hub }
    }

    pub fn lines(&self) -> &AuditLog {
        &self.lines
    }

    /// Writes one durable line, with the operator if one asked.
    pub(crate) async fn write(
        self: &Arc<Self>,
        profile: &ProfileName,
        action: &str,
        subject: &str,
        outcome: &str,
    ) -> Result<()> {
        self.append(entry(&doer(profile.as_str()), action, subject, outcome)).await
    }

    async fn append(self: &Arc<Self>, entry: AuditEntry) -> Result<()> {
        blocking(self, move |log| Ok(log.lines.append(entry)?)).await
    }

    /// No durable line, no deed.
    pub(crate) async fn begin(self: &Arc<Self>, owner: &Owner, action: &str, subject: &str) -> Result<()> {
        self.write(&owner.profile, action, subject, "begun").await
    }

    pub async fn end<T>(self: &Arc<Self>, owner: &Owner, action: &str, subject: &str, outcome: Result<T>) -> Result<T> {
        self.ended(&owner.profile, action, subject, outcome).await
    }

    /// Brackets a deed with two lines; nothing of it runs unless the first one is durable.
    pub fn deed<'a, T: Send + 'a>(
        self: &'a Arc<Self>,
        profile: &'a ProfileName,
        action: &'a str,
        subject: &'a str,
        deed: impl Future<Output = Result<T>> + Send + 'a,
    ) -> impl Future<Output = Result<T>> + Send + 'a {
        // Some deeds are large futures; a waiting caller holds a pointer.
        let deed = Box::pin(deed);
        async move {
            self.write(profile, action, subject, "begun").await?;
            let outcome = deed.await;
            self.ended(profile, action, subject, outcome).await
        }
    }

    pub async fn ended<T>(
        self: &Arc<Self>,
        profile: &ProfileName,
        action: &str,
        subject: &str,
        outcome: Result<T>,
    ) -> Result<T> {
        let words = match &outcome {
            Ok(_) => "done".to_owned(),
            Err(failure) => format!("failed: {}", failure.message),
        };
        let written = self.write(profile, action, subject, &words).await;
        let done = outcome?;
        // The deed is done and was announced; a failure to log its outcome is reported, not undone.
        if let Err(failure) = written {
            self.hub.alarm(&failure.message);
        }
        Ok(done)
    }

    /// Logs that a page of a list was read, once a minute for the same query.
    pub async fn asked(self: &Arc<Self>, owner: &Owner, action: &str, query: &UploadQuery) -> Result<()> {
        let (doer, text) = (doer(owner.profile.as_str()), query_text(query));
        if !self.counted.is_new_query(Timestamp::now(), &doer, &text) {
            return Ok(());
        }
        let written = self.write(&owner.profile, action, &text, "done").await;
        if written.is_err() {
            self.counted.forget_query(&doer, &text);
        }
        written
    }

    pub fn is_new_query(&self, name: &str, query: &str) -> bool {
        self.counted.is_new_query(Timestamp::now(), name, query)
    }

    pub fn forget_query(&self, name: &str, query: &str) {
        self.counted.forget_query(name, query);
    }

    /// Returns whether it is the first of its minute. `peer` has no port: each connection has another.
    pub(crate) fn refused(&self, peer: &str, code: &str) -> bool {
        self.counted.add(Timestamp::now(), peer, code)
    }

    pub fn count_refusal<T>(&self, owner: &Owner, outcome: &Result<T, PipelineError>) {
        if let Err(PipelineError::NotGranted { .. }) = outcome {
            let _first = self.refused(&doer(owner.profile.as_str()), "not_granted");
        }
    }

    /// Writes the counters of past minutes; all of them if `now` is `None`.
    pub async fn write_counted(self: &Arc<Self>, now: Option<Timestamp>) {
        let mut refusals = self.counted.take(now).into_iter();
        while let Some(((minute, peer, code), count)) = refusals.next() {
            let outcome = format!("{count} in the minute from {}", Timestamp::from_seconds(minute * 60));
            if let Err(failure) = self.append(entry(&peer, "refused", &code, &outcome)).await {
                let lost = std::iter::once(((minute, peer, code), count)).chain(refusals).collect();
                self.counted.put_back(lost);
                self.hub.alarm(&failure.message);
                break;
            }
        }
        for ((profile, query), times) in self.counted.repeated(now) {
            let line = entry(&profile, "list shared", &query, &format!("{} again", counted(times, "time")));
            if let Err(failure) = self.append(line).await {
                self.hub.alarm(&failure.message);
                return;
            }
        }
    }

    pub async fn list(self: &Arc<Self>, query: AuditQuery) -> Result<Vec<AuditView>> {
        let query = AuditQuery { limit: query.limit.clamp(1, PAGE), ..query };
        let mut lines = blocking(self, move |log| Ok(log.lines.list(&query)?)).await?;
        lines.reverse();
        Ok(lines.into_iter().map(view).collect())
    }

    pub async fn export(self: &Arc<Self>, owner: &Owner, addresses: bool) -> Result<Vec<ExportedFile>> {
        let subject = if addresses { "with addresses" } else { "redacted" };
        let bytes = self.deed(&owner.profile, "export audit", subject, self.whole(addresses)).await?;
        Ok(vec![ExportedFile { name: "audit.jsonl".to_owned(), bytes }])
    }

    async fn whole(self: &Arc<Self>, addresses: bool) -> Result<Vec<u8>> {
        blocking(self, move |log| {
            let (mut pages, mut before) = (Vec::new(), None);
            loop {
                let page = log.lines.list(&AuditQuery { before, limit: PAGE, ..AuditQuery::default() })?;
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
        .await
    }
}

fn entry(profile: &str, action: &str, subject: &str, outcome: &str) -> AuditEntry {
    AuditEntry {
        at: Timestamp::now(),
        profile: clean(profile, 100),
        action: clean(action, 100),
        subject: clean(subject, 200),
        outcome: clean(outcome, LONGEST_OUTCOME),
    }
}

fn view(line: AuditLine) -> AuditView {
    let by = clean(&line.entry.profile, 100);
    let (profile, operator) = match by.split_once('/') {
        Some((profile, operator)) => (profile.to_owned(), Some(operator.to_owned())),
        None => (by, None),
    };
    AuditView {
        line: line.line,
        at: line.entry.at,
        profile,
        operator,
        action: clean(&line.entry.action, 100),
        subject: clean(&line.entry.subject, 200),
        outcome: clean(&line.entry.outcome, LONGEST_OUTCOME),
    }
}

fn query_text(query: &UploadQuery) -> String {
    let mut words = vec!["records".to_owned()];
    words.extend(query.owner.as_ref().map(|owner| format!("of {owner}")));
    words.extend(query.topic.as_ref().map(|topic| format!("topic {topic}")));
    words.extend(query.robot.as_ref().map(|robot| format!("robot {}", clean(robot, 64))));
    words.extend(query.type_name.as_ref().map(|name| format!("type {name}")));
    words.extend(query.words.iter().map(|word| format!("with {}", clean(word, 40))));
    words.extend(query.tags.iter().map(|(name, value)| format!("tag {}={}", clean(name, 40), clean(value, 40))));
    words.extend(query.incident.as_ref().map(|name| format!("incident {name}")));
    words.extend(query.kind.map(|kind| format!("kind {}", kind.word())));
    words.extend(query.state.map(|state| format!("state {}", state.word())));
    words.extend(query.since.map(|since| format!("since {since}")));
    words.extend(query.until.map(|until| format!("until {until}")));
    words.extend(query.after.as_ref().map(|after| format!("after {}", clean(after, 40))));
    words.join(" ")
}
