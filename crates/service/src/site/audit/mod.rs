//! The audit log, and the audit of the records themselves.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap};
use std::fmt::Display;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::runtime::Handle;

use super::reading::own::OwnKeys;
use crate::command::UploadQuery;
use crate::hub::Hub;
use crate::model::{Address, OperatorName, ProfileName, Timestamp, clean, counted, locked};
use crate::pipeline::record_audit::{self, RecordAudit, Scope, scrub_round};
use crate::pipeline::{Owner, PipelineError, Reader, audit_head, recorder_heads};
use crate::reply::{AuditCheck, AuditView, ExportedFile, Failure, Result, internal};
use crate::site::{Parts, blocking};
use crate::store::{AuditEntry, AuditLine, AuditLog, AuditQuery, Reserve};

/// A failure of one check does not hide the result of the other.
fn both<T>(log: Result<Option<T>>, recorder: Result<Option<T>>) -> Result<Option<T>> {
    match (log, recorder) {
        (Err(log), Err(recorder)) => Err(Failure::new(log.kind, format!("{}; {}", log.message, recorder.message))),
        (log, recorder) => Ok(recorder?.or(log?)),
    }
}

const LOOK: Duration = Duration::from_secs(1);
const REFILL: Duration = Duration::from_secs(60);

pub(super) struct Audit {
    parts: Parts,
    /// Space for a revoke on a full disk.
    reserve: Arc<Reserve>,
    seen: Mutex<BTreeMap<Address, Instant>>,
}

impl Audit {
    pub fn new(parts: &Parts, reserve: &Arc<Reserve>) -> Self {
        Self { parts: parts.clone(), reserve: Arc::clone(reserve), seen: Mutex::default() }
    }

    pub async fn keep(self: Arc<Self>) {
        let mut refill = Instant::now();
        while !self.parts.life.is_stopping() {
            if !self.parts.life.beat(LOOK).await {
                return;
            }
            self.parts.log.write_counted(Some(Timestamp::now())).await;
            if !self.reserve.is_held()
                && refill.elapsed() >= REFILL
                && self.parts.plant.ledger.records.takes_records().is_ok()
            {
                refill = Instant::now();
                drop(blocking(&self, |audit| Ok(audit.reserve.refill()?)).await);
            }
        }
    }

    /// States the heads of the log and of recorders for the chain.
    pub async fn keep_heads(self: Arc<Self>) {
        while self.parts.life.beat(LOOK).await {
            for owner in self.parts.owners.all() {
                self.anchor_heads(&owner).await;
            }
        }
    }

    async fn anchor_heads(self: &Arc<Self>, owner: &Arc<Owner>) {
        let Some(network) = self.parts.link.network_now() else { return };
        // Keys that are being changed must not sign.
        let Ok(_one_at_a_time) = owner.changes.try_lock() else { return };
        let (of, every) = (Arc::clone(owner), self.parts.config.audit_every);
        let stated = blocking(self, move |audit| {
            let log = audit_head::state_head(&audit.parts.plant, &network, audit.parts.log.lines(), &of, every);
            let keys = of.sealing().filter(|keys| keys.domain == network.domain);
            let recorder = keys.map_or(Ok(None), |keys| {
                let mut all = locked(&audit.seen);
                let mut seen = all.get(&of.address).copied();
                let stated = recorder_heads::state(&audit.parts.plant, of.address, &keys, every, &mut seen);
                all.extend(seen.map(|seen| (of.address, seen)));
                stated
            });
            both(log.map_err(Failure::from), recorder.map_err(Failure::from))
        })
        .await;
        match stated {
            Ok(Some(_)) => self.parts.hub.stored.notify_waiters(),
            Ok(None) => {}
            Err(failure) => {
                let (profile, why) = (&owner.profile, failure.message);
                let text = format!("heads of the audit log and of the recorder are not anchored for {profile}: {why}");
                self.parts.hub.alarm(&text);
            }
        }
    }

    pub async fn verify(self: &Arc<Self>, owner: Option<Arc<Owner>>) -> Result<AuditCheck> {
        let walked = blocking(self, |audit| Ok(audit.parts.log.lines().verify())).await?;
        let (lines, mut broken) = walked.map_or_else(|fault| (0, Some(fault)), |lines| (lines, None));
        let mut check = AuditCheck { lines, ..AuditCheck::default() };
        if let Some(owner) = owner {
            let network = self.parts.link.network().await?;
            let reader = Reader { plant: &self.parts.plant, network: &network, reader: &owner };
            let heads = audit_head::heads(&reader).await?;
            check.heads = heads.good.len() as u64;
            check.anchored = heads.anchored as u64;
            check.unusable = heads.bad.iter().map(|(id, why)| format!("{id}: {}", clean(why, 200))).collect();
            match blocking(self, move |audit| Ok(audit.parts.log.lines().compare(&heads.good))).await? {
                Ok(covered) => check.covered = covered,
                Err(fault) => broken = broken.filter(|walked| walked.line <= fault.line).or(Some(fault)),
            }
        }
        check.ok = broken.is_none() && check.unusable.is_empty();
        check.broken_line = broken.as_ref().map(|fault| fault.line);
        check.text = broken.map(|fault| clean(&fault.to_string(), 300));
        Ok(check)
    }
}

tokio::task_local! {
    static OPERATOR: OperatorName;
}

pub async fn acting_as<Work: Future>(operator: OperatorName, work: Work) -> Work::Output {
    OPERATOR.scope(operator, work).await
}

pub fn is_operator() -> bool {
    OPERATOR.try_with(|_| ()).is_ok()
}

/// The profile, or `profile/operator`, as the log names it.
fn doer(profile: &str) -> String {
    OPERATOR.try_with(|operator| by(profile, operator)).unwrap_or_else(|_| profile.to_owned())
}

pub fn by(profile: impl Display, operator: &OperatorName) -> String {
    format!("{profile}/{operator}")
}

const SHARE_EVERY: Duration = Duration::from_secs(5);
const MOST_AT_ONCE: usize = 256;

impl Audit {
    pub async fn records(
        self: &Arc<Self>,
        profile: &ProfileName,
        is_pinned: bool,
        deep: bool,
        since: Option<Timestamp>,
    ) -> Result<RecordAudit> {
        let network = if is_pinned { Some(self.parts.link.network().await) } else { None };
        let runtime = Handle::current();
        let running = self.parts.runs.begin(profile, "this home", "auditing", "records");
        blocking(self, move |audit| {
            let keys = Arc::new(OwnKeys::of(&audit.parts.owners));
            running.run.expect(if since.is_none() { audit.parts.plant.ledger.inspection.size()? } else { 0 });
            let (since, looked_at) = (since.unwrap_or_default(), running.run.counter());
            let scope = Scope { deep, since, accounts: audit.parts.owners.accounts(), keys, looked_at };
            let chain = network.as_ref().map(|network| network.as_ref().map_err(|failure| failure.message.clone()));
            Ok(record_audit::audit(&audit.parts.plant, chain, audit.parts.log.lines(), &scope, &runtime)?)
        })
        .await
    }

    pub async fn keep_scrubbing(self: Arc<Self>) {
        let percent = self.parts.config.scrub_percent;
        let mut due = 0.0_f64;
        while percent > 0 && self.parts.life.beat(SHARE_EVERY).await {
            let Some(network) = self.parts.link.network_now() else { continue };
            let Ok(records) = blocking(&self, |audit| Ok(audit.parts.plant.ledger.inspection.size()?)).await else {
                continue;
            };
            #[expect(clippy::cast_precision_loss, reason = "a share of them")]
            let (records, percent) = (records as f64, percent as f64);
            due = (due + records * percent / 100.0 * SHARE_EVERY.as_secs_f64() / 3600.0).min(records);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small and not negative")]
            let mut share = due as usize;
            while share > 0 && !self.parts.life.is_stopping() {
                let (most, network) = (share.min(MOST_AT_ONCE), network.clone());
                let done = blocking(&self, move |audit| Ok(scrub_round(&audit.parts.plant, &network, most)?)).await;
                if let Err(failure) = done {
                    self.parts.hub.warn(&format!("the scrubber waits: {}", failure.message));
                    break;
                }
                share -= most;
                #[expect(clippy::cast_precision_loss, reason = "at most a few hundred")]
                let most = most as f64;
                due -= most;
            }
        }
    }
}

/// The most counters; beyond it, refusals count under [`OTHERS`].
const MOST: usize = 1024;
/// The most queries remembered; beyond it, each gets a line of its own.
const MOST_QUERIES: usize = 256;
pub const OTHERS: &str = "other peers";

const MINUTE: u64 = 60_000_000_000;

/// The minute since 1970, the peer, and the constant code.
pub type Refusal = (u64, String, String);

#[derive(Debug, Default)]
pub struct Refusals {
    counts: Mutex<BTreeMap<Refusal, u64>>,
    asked: Mutex<HashMap<(String, String), (Timestamp, u64)>>,
}

impl Refusals {
    pub fn add(&self, at: Timestamp, peer: &str, code: &str) -> bool {
        let mut counts = locked(&self.counts);
        let (peer, code) = (clean(peer, 100), clean(code, 60));
        let mut key = (at.0 / MINUTE, peer, code);
        if counts.len() >= MOST && !counts.contains_key(&key) {
            OTHERS.clone_into(&mut key.1);
        }
        if counts.len() >= 2 * MOST && !counts.contains_key(&key) {
            // Codes are constants of the program: reached only after many minutes without a ledger.
            "refused".clone_into(&mut key.2);
        }
        let count = counts.entry(key).or_default();
        *count += 1;
        *count == 1
    }

    pub fn take(&self, now: Option<Timestamp>) -> Vec<(Refusal, u64)> {
        let mut counts = locked(&self.counts);
        let running = match now {
            Some(now) => counts.split_off(&(now.0 / MINUTE, String::new(), String::new())),
            None => BTreeMap::new(),
        };
        std::mem::replace(&mut *counts, running).into_iter().collect()
    }

    pub fn put_back(&self, refusals: Vec<(Refusal, u64)>) {
        let mut counts = locked(&self.counts);
        for (key, count) in refusals {
            *counts.entry(key).or_default() += count;
        }
    }

    pub fn is_new_query(&self, at: Timestamp, profile: &str, query: &str) -> bool {
        let mut asked = locked(&self.asked);
        let key = (profile.to_owned(), query.to_owned());
        if let Some((_, times)) = asked.get_mut(&key).filter(|(first, _)| at.0.saturating_sub(first.0) < MINUTE) {
            *times += 1;
            return false;
        }
        if asked.len() < MOST_QUERIES {
            asked.entry(key).or_insert((at, 0));
        }
        true
    }

    pub fn forget_query(&self, profile: &str, query: &str) {
        locked(&self.asked).remove(&(profile.to_owned(), query.to_owned()));
    }

    pub fn repeated(&self, now: Option<Timestamp>) -> Vec<((String, String), u64)> {
        let mut asked = locked(&self.asked);
        let ended = |first: &Timestamp| now.is_none_or(|now| now.0.saturating_sub(first.0) >= MINUTE);
        let taken = asked.extract_if(|_, (first, _)| ended(first));
        let mut again: Vec<_> =
            taken.map(|(query, (_, times))| (query, times)).filter(|(_, times)| *times > 0).collect();
        again.sort();
        again
    }
}

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

    /// One deed with several subjects.
    pub async fn deeds<T>(
        self: &Arc<Self>,
        profile: &ProfileName,
        deeds: &[(&str, String)],
        deed: impl Future<Output = Result<T>>,
    ) -> Result<T> {
        for (action, subject) in deeds {
            self.write(profile, action, subject, "begun").await?;
        }
        let outcome = deed.await;
        for (action, subject) in deeds {
            // The failure is reported once, below.
            drop(self.ended(profile, action, subject, outcome.as_ref().map(|_| ()).map_err(Clone::clone)).await);
        }
        outcome
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

#[cfg(test)]
mod refusals_tests {
    use super::*;

    #[test]
    fn refusals_are_counted_per_peer_code_and_minute() {
        let refusals = Refusals::default();
        let second = |second: u64| Timestamp::from_seconds(second);
        for at in [60, 61, 119] {
            refusals.add(second(at), "10.0.0.1", "not_granted");
        }
        refusals.add(second(61), "10.0.0.1", "bad_tag");
        refusals.add(second(120), "10.0.0.1", "not_granted");
        assert!(refusals.take(Some(second(119))).is_empty(), "the minute runs");
        let taken = refusals.take(Some(second(120)));
        let told: Vec<_> = taken.iter().map(|((minute, _, code), count)| (*minute, code.as_str(), *count)).collect();
        assert_eq!(told, [(1, "bad_tag", 1), (1, "not_granted", 3)]);
        refusals.put_back(taken);
        assert_eq!(refusals.take(None).len(), 3, "and at the end everything");
        assert!(refusals.take(None).is_empty());
    }

    #[test]
    fn a_crowd_of_peers_takes_bounded_memory_and_none_is_lost() {
        let refusals = Refusals::default();
        for peer in 0..5_000 {
            refusals.add(Timestamp(0), &format!("peer {peer}"), "throttled");
        }
        let taken = refusals.take(None);
        assert_eq!((taken.len(), taken.iter().map(|(_, count)| count).sum::<u64>()), (MOST + 1, 5_000));
        assert!(taken.iter().any(|((_, peer, _), count)| peer == OTHERS && *count == 5_000 - MOST as u64));
    }

    #[test]
    fn an_identical_query_is_a_line_once_a_minute() {
        let refusals = Refusals::default();
        let at = Timestamp::from_seconds;
        assert!(refusals.is_new_query(at(1), "a", "all"));
        assert!(refusals.is_new_query(at(2), "b", "all") && refusals.is_new_query(at(2), "a", "page 2"));
        assert!(!refusals.is_new_query(at(3), "a", "all") && !refusals.is_new_query(at(60), "a", "all"));
        assert!(refusals.repeated(Some(at(60))).is_empty());
        let again = refusals.repeated(Some(at(62)));
        assert_eq!(again, [(("a".to_owned(), "all".to_owned()), 2)]);
        assert!(refusals.is_new_query(at(62), "a", "all"));
        refusals.forget_query("a", "all");
        assert!(refusals.is_new_query(at(62), "a", "all"), "its line was not written");
        for number in 0..1_000 {
            assert!(refusals.is_new_query(at(63), "c", &number.to_string()));
        }
        assert!(refusals.is_new_query(at(63), "c", "999"), "beyond what is remembered each is a line");
    }
}
