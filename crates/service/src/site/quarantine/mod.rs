//! Quarantine: messages listed, released or discarded by the operator, and counted on the chain before.

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::reading::own::record_view;
use crate::command::Held;
use crate::model::{Digest, ErrorKind, ProfileName, RecordState, Timestamp, TopicPattern, clean, counted};
use crate::pipeline::{Author, Owner, Shown, quarantine};
use crate::reply::{DecidedView, Failure, HeldView, Part, QuarantineView, Result, input};
use crate::site::{Parts, Reading};
use crate::store::{HeldQuery, HeldRow, RecordRow};

/// How long a discard waits for the quarantine records to be in a block.
const PATIENCE: Duration = Duration::from_secs(60);
const LOOK: Duration = Duration::from_secs(1);
const MOST: usize = 100_000;

pub(in crate::site) struct Quarantine {
    parts: Parts,
    reading: Arc<Reading>,
    /// Quarantine records are sealed one at a time.
    reporting: tokio::sync::Mutex<()>,
}

impl Quarantine {
    pub fn new(parts: &Parts, reading: &Arc<Reading>) -> Self {
        Self { parts: parts.clone(), reading: Arc::clone(reading), reporting: tokio::sync::Mutex::default() }
    }

    /// Seals the due quarantine records, minute by minute.
    pub async fn keep(self: Arc<Self>) {
        while self.parts.life.beat(LOOK).await {
            // Counted once records are acknowledged again.
            if self.parts.plant.ledger.records.takes_records().is_err() {
                continue;
            }
            for owner in self.parts.owners.all() {
                if let Err(failure) = self.report(&owner.author, quarantine::minute(Timestamp::now())).await {
                    let (profile, why) = (&owner.profile, failure.message);
                    self.parts.hub.alarm(&format!("quarantined messages of {profile} are not counted yet: {why}"));
                }
            }
        }
    }

    /// Counts what was quarantined before this minute.
    async fn report(&self, author: &Author, before: u64) -> Result<()> {
        let _one_at_a_time = self.reporting.lock().await;
        block_in_place(|| quarantine::report(&self.parts.plant, author, before))?;
        Ok(())
    }

    /// While held, no quarantined record is counted or discarded.
    pub async fn quiet(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.reporting.lock().await
    }

    /// Needs no passphrase.
    pub fn view(&self, profile: &ProfileName, topic: Option<TopicPattern>, limit: usize) -> Result<QuarantineView> {
        let owner = self.parts.owners.address_of(profile)?;
        let (name, limit) = (topic.as_ref().map(ToString::to_string), limit.clamp(1, 1000));
        let query = HeldQuery { topic: name, messages: true, newest_first: true, limit, ..HeldQuery::default() };
        let ledger = &self.parts.plant.ledger;
        let rows = ledger.quarantine.held(owner, &query)?;
        let counts = ledger.counts.by_state(Some(owner))?;
        let is_wanted = |name: &str| topic.as_ref().is_none_or(|topic| topic.matches(name));
        let wanted = counts.topics.iter().filter(|counts| is_wanted(&counts.topic));
        let keys = self.reading.own_keys();
        let shown = self.reading.compared(rows.iter().map(|row| row.record.clone()).collect(), &keys, &[])?;
        let view = |(row, shown): (HeldRow, Shown)| HeldView {
            record: record_view(&shown, false),
            reason: row.reason,
            publisher: clean(&row.publisher, 400),
            report: row.report,
        };
        Ok(QuarantineView {
            messages: wanted.map(|topic| topic.quarantined).sum(),
            records: rows.into_iter().zip(shown).map(view).collect(),
        })
    }

    fn held(&self, owner: &Owner, topic: Option<String>) -> Result<Vec<HeldRow>> {
        let query = HeldQuery { topic, limit: MOST, ..HeldQuery::default() };
        Ok(self.parts.plant.ledger.quarantine.held(owner.address, &query)?)
    }

    /// Quarantined records named by a person; definitions only by topic.
    async fn named(&self, owner: &Owner, held: &Held) -> Result<Vec<HeldRow>> {
        let mut rows = self.held(owner, held.topic.as_ref().map(ToString::to_string))?;
        if held.topic.is_some() {
            return Ok(rows);
        }
        let mut wanted = BTreeSet::new();
        for id in &held.ids {
            let row = self.reading.find_record(id)?;
            if row.owner != owner.address || row.state != RecordState::Quarantined {
                return Err(input(format!(
                    "record {} is not in quarantine (it is {}); `authros topics quarantine list` shows those that are",
                    row.id,
                    row.state.word()
                )));
            }
            wanted.insert(row.digest);
        }
        rows.retain(|row| wanted.contains(&row.record.digest));
        Ok(rows)
    }

    /// Lets quarantined messages be anchored; the tag in their sealed head stays.
    pub async fn release(&self, owner: &Owner, held: Held) -> Result<DecidedView> {
        let rows = self.named(owner, &held).await?;
        let released = self.release_rows(owner, &held, &rows);
        self.audited(owner, "release quarantined", &rows, released).await?;
        self.parts.hub.stored.notify_waiters();
        let messages = messages(&rows);
        let text = format!("{} released: anchored like others, with the tag kept", counted(messages, "message"));
        Ok(DecidedView { decision: "released".to_owned(), messages, reports: Vec::new(), text })
    }

    async fn release_rows(&self, owner: &Owner, held: &Held, rows: &[HeldRow]) -> Result<()> {
        // The quarantine record comes first, so that it counts everything held.
        self.report(&owner.author, u64::MAX).await?;
        let digests: Vec<Digest> = self.with_definitions(owner, rows)?.into_iter().collect();
        self.parts.plant.ledger.quarantine.release(&digests)?;
        self.decided(owner, held)
    }

    /// A released message needs its definition, quarantined with its first message.
    fn with_definitions(&self, owner: &Owner, rows: &[HeldRow]) -> Result<BTreeSet<Digest>> {
        let topics: BTreeSet<&String> = rows.iter().map(|row| &row.record.topic).collect();
        let mut digests: BTreeSet<Digest> = rows.iter().map(|row| row.record.digest).collect();
        for topic in topics {
            let held = self.held(owner, Some(topic.clone()))?;
            digests.extend(held.iter().filter(|row| !row.is_message()).map(|row| row.record.digest));
        }
        Ok(digests)
    }

    /// Deletes quarantined messages, once the quarantine records that count them are on the chain.
    pub async fn discard(&self, owner: &Owner, held: Held) -> Result<DecidedView> {
        let rows = self.named(owner, &held).await?;
        self.report(&owner.author, u64::MAX).await?;
        // Read again: the reports are known only now.
        let mut rows_now = self.named(owner, &held).await?;
        let known: BTreeSet<Digest> = rows.iter().map(|row| row.record.digest).collect();
        rows_now.retain(|row| row.is_message() && known.contains(&row.record.digest));
        let reports = self.anchored_reports(&rows_now).await?;
        let discarded = self.discard_rows(owner, &held, &rows_now);
        self.audited(owner, "discard quarantined", &rows_now, discarded).await?;
        let messages = messages(&rows_now);
        let text = format!(
            "{} discarded; digests remain, counted on the chain in {}",
            counted(messages, "message"),
            counted(reports.len() as u64, "quarantine record")
        );
        Ok(DecidedView { decision: "discarded".to_owned(), messages, reports, text })
    }

    async fn discard_rows(&self, owner: &Owner, held: &Held, rows: &[HeldRow]) -> Result<()> {
        let digests: Vec<Digest> = rows.iter().map(|row| row.record.digest).collect();
        // A backup taken now must not see the bytes gone while the rows are not.
        let one_at_a_time = self.reporting.lock().await;
        block_in_place(|| quarantine::discard(&self.parts.plant, &digests))?;
        drop(one_at_a_time);
        self.decided(owner, held)
    }

    /// The quarantine records that count these, as soon as all are in a block.
    async fn anchored_reports(&self, rows: &[HeldRow]) -> Result<Vec<Digest>> {
        let reports: BTreeSet<Digest> = rows.iter().filter_map(|row| row.report).collect();
        let reports: Vec<Digest> = reports.into_iter().collect();
        let counted = rows.iter().all(|row| row.report.is_some());
        let is_standing = |row: &RecordRow| (RecordState::Mined..=RecordState::Verified).contains(&row.state);
        let deadline = Instant::now() + PATIENCE;
        while counted && !self.parts.life.is_stopping() {
            let found = self.parts.plant.ledger.records.find_all(&reports)?;
            if found.iter().all(|row| row.as_ref().is_some_and(is_standing)) {
                return Ok(reports);
            }
            if Instant::now() >= deadline {
                break;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        let text = "nothing was discarded: the quarantine records that count these messages are not on the chain yet; \
                    check `authros chain status`, then repeat the command";
        Err(Failure::new(ErrorKind::Incomplete, text))
    }

    /// Runs the deed between two log lines for each topic.
    async fn audited(
        &self,
        owner: &Owner,
        action: &str,
        rows: &[HeldRow],
        deed: impl Future<Output = Result<()>>,
    ) -> Result<()> {
        let topics: BTreeSet<&str> = rows.iter().map(|row| row.record.topic.as_str()).collect();
        let deed_of = |topic: &str| {
            let of_topic = || rows.iter().filter(|row| row.record.topic == topic && row.is_message());
            let (count, first) = (of_topic().count(), of_topic().next().map_or("none", |row| row.record.id.as_str()));
            (action, format!("{topic}: {} starting with {first}", counted(count as u64, "message")))
        };
        let deeds: Vec<(&str, String)> = topics.into_iter().map(deed_of).collect();
        self.parts.log.deeds(&owner.profile, &deeds, deed).await
    }

    /// Deciding about whole topics closes their alarms.
    fn decided(&self, owner: &Owner, held: &Held) -> Result<()> {
        let pins = &self.parts.plant.ledger.pins;
        let raised: BTreeSet<String> = pins.alarms(owner.address, None)?.into_iter().map(|alarm| alarm.topic).collect();
        for topic in raised.iter().filter(|name| held.topic.as_ref().is_some_and(|topic| topic.matches(name))) {
            pins.close_alarms(owner.address, topic)?;
        }
        self.parts.hub.changed(Part::Topics);
        self.parts.hub.changed(Part::Uploads);
        Ok(())
    }
}

fn messages(rows: &[HeldRow]) -> u64 {
    rows.iter().filter(|row| row.is_message()).count() as u64
}
