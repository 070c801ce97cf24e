//! Retention and erasing: rules applied, deletions audited, local copies beside a cache deleted.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::task::block_in_place;

use super::Storage;
use crate::command::{ErasureWishes, UploadQuery};
use crate::failure::{input, refused};
use crate::model::{Digest, RecordKind, RecordState, Timestamp, clean, counted};
use crate::pipeline::Owner;
use crate::pipeline::importer::SOURCE;
use crate::pipeline::reader::Reader;
use crate::pipeline::retention::{self, LONGEST_REASON, Retention, Round};
use crate::reply::{ErasureView, Failure, Result};
use crate::site::recordings::RECORDING;
use crate::store::{Erasure, IncidentRow, RecordQuery, RecordRow};

const LOOK: Duration = Duration::from_secs(1);
/// Looks between learning names: robots' records arrive without the names that rules use.
const LEARN: u32 = 10;

const MOST: usize = 100_000;
const PAGE: usize = 10_000;
/// Interval of the checks whether the bytes are gone, and their number.
const ERASING_LOOK: (Duration, u32) = (Duration::from_millis(500), 240);

impl Storage {
    pub async fn keep_retention(self: Arc<Self>) {
        let keeping = self.parts.config.keeping();
        let (mut rules, mut looks) = (Retention::new(keeping.clone()), 0u32);
        while self.parts.life.beat(LOOK).await {
            if let Err(failure) = self.look_for_named() {
                self.parts.hub.warn(&failure.message);
            }
            let learns = !keeping.is_empty() && looks.is_multiple_of(LEARN);
            looks = looks.wrapping_add(1);
            for owner in self.parts.owners.all() {
                if learns && let Err(failure) = self.reading.learn_own_names(&owner.profile).await {
                    self.parts.hub.warn(&failure.message);
                }
                let applied = match keeping.is_empty() {
                    true => self.sweep(&owner).await,
                    false => self.apply(&owner, &mut rules).await,
                };
                if let Err(failure) = applied {
                    self.parts.hub.alarm(&format!("retention of {} is waiting: {}", owner.profile, failure.message));
                }
            }
            if let Err(failure) = self.sweep_told().await {
                self.parts.hub.alarm(&format!(
                    "records that owners erased elsewhere are still here; retrying: {}",
                    failure.message
                ));
            }
        }
    }

    /// Without rules only erased records are left to delete, and mostly there are none.
    async fn sweep(&self, owner: &Owner) -> Result<()> {
        if !self.has_named.load(Ordering::Acquire) {
            return Ok(());
        }
        // Not while an erasure takes over what a rule has named.
        let _one_at_a_time = self.naming.lock().await;
        let deleted = block_in_place(|| retention::delete(&self.parts.plant, owner))?;
        self.tell(owner, &Round { deleted, ..Round::default() }).await
    }

    /// Erasures by owners whose homes join this gateway, whichever profile is open here.
    async fn sweep_told(&self) -> Result<()> {
        if !self.has_named.load(Ordering::Acquire) {
            return Ok(());
        }
        let _one_at_a_time = self.naming.lock().await;
        block_in_place(|| retention::delete_told(&self.parts.plant))?;
        let held = self.parts.plant.ledger.erasures.held_although_erased()?;
        if self.held.swap(held, Ordering::AcqRel) < held {
            let text = format!(
                "erased elsewhere by the owner, but held here by an incident: {}; `authros incident remove NAME --yes` releases \
                 what it holds",
                counted(held, "record")
            );
            self.parts.hub.warn(&text);
        }
        Ok(())
    }

    /// Another process of the store may have named some.
    fn look_for_named(&self) -> Result<()> {
        let named = block_in_place(|| self.parts.plant.ledger.erasures.has_named())?;
        self.has_named.store(named, Ordering::Release);
        Ok(())
    }

    async fn apply(&self, owner: &Owner, rules: &mut Retention) -> Result<()> {
        let _one_at_a_time = self.naming.lock().await;
        let round = block_in_place(|| rules.round(&self.parts.plant, owner))?;
        self.tell(owner, &round).await
    }

    async fn tell(&self, owner: &Owner, round: &Round) -> Result<()> {
        for (topic, count) in &round.named {
            self.parts
                .log
                .write(&owner.profile, "retention", &format!("{topic}: {}", counted(*count, "record")), "named")
                .await?;
        }
        if round.deleted > 0 {
            self.parts.log.write(&owner.profile, "retention", &counted(round.deleted, "record"), "deleted").await?;
        }
        Ok(())
    }

    /// Shows what would be erased, or erases it.
    pub async fn erase(&self, owner: &Owner, wishes: ErasureWishes) -> Result<ErasureView> {
        let reason = clean(wishes.reason.trim(), LONGEST_REASON);
        if reason.is_empty() || wishes.reason.chars().count() > LONGEST_REASON {
            return Err(input(format!("say why in 1 to {LONGEST_REASON} characters: --reason TEXT")));
        }
        let (plant, network) = (&self.parts.plant, self.parts.link.network().await?);
        self.reading.name_asked(owner.address, Some(owner.index()), wishes.topic.as_ref())?;
        let query = self.narrowed(owner, &wishes)?;
        let rows = block_in_place(|| chosen(&Reader { plant, network: &network, reader: owner }, &wishes, &query))?;
        let incidents = plant.ledger.incidents.list(owner.address)?;
        let (view, erasable) = planned(&rows, &incidents);
        if !wishes.sure || erasable.is_empty() {
            return Ok(view);
        }
        if !view.held.is_empty() {
            let names = view.held.join(", ");
            return Err(refused(format!(
                "incidents hold some of these records: {names}; release them with `authros incident remove NAME --yes`, or \
                 choose other records"
            )));
        }
        let (records, topics) = (counted(view.records, "record"), counted(view.topics.len() as u64, "topic"));
        if let Some(shown) = wishes.shown.filter(|shown| *shown != view.records) {
            return Err(refused(format!(
                "repeat the command, with --until if more is being captured: {records} of {topics} would go by now, not the \
                 {shown} that were shown, so nothing was erased"
            )));
        }
        let subject = clean(&format!("{records} of {topics}: {reason}; {}", view.topics.join(" ")), 900);
        self.parts.log.begin(owner, "erase", &subject).await?;
        let erasure = Erasure { at: Timestamp::now(), by: owner.profile.to_string(), reason };
        let digests = erasable.iter().map(|row| row.digest).collect();
        let named = self.name_erased(owner, erasable, erasure).await;
        let named = self.parts.log.end(owner, "erase", &subject, named).await?;
        let left = self.wait_for_erasing(digests).await?;
        Ok(ErasureView { named: named.named, missing: named.missing, deleted: !left, ..view })
    }

    /// Records of the topic, robot and span, by the rules of lists.
    fn narrowed(&self, owner: &Owner, wishes: &ErasureWishes) -> Result<RecordQuery> {
        let (topic, robot) = (wishes.topic.clone(), wishes.robot.clone());
        let asked = UploadQuery { topic, robot, since: wishes.since, until: wishes.until, ..UploadQuery::default() };
        let query = self.reading.of_robot(&[owner.address], asked)?;
        Ok(RecordQuery { owner: Some(owner.address), limit: PAGE, ..query })
    }

    async fn name_erased(&self, owner: &Owner, rows: Vec<RecordRow>, erasure: Erasure) -> Result<retention::Erased> {
        let _one_at_a_time = self.naming.lock().await;
        let named = block_in_place(|| retention::name(&self.parts.plant, owner, &rows, &erasure));
        self.has_named.store(true, Ordering::Release);
        self.parts.hub.stored.notify_waiters();
        Ok(named?)
    }

    /// Waits a while for the deletion; returns whether something is left.
    async fn wait_for_erasing(&self, mut digests: Vec<Digest>) -> Result<bool> {
        for _ in 0..ERASING_LOOK.1 {
            while let Some(last) = digests.last() {
                let retained = self.parts.plant.ledger.retention.find(*last)?;
                if retained.is_some_and(|retained| retained.deleted_at.is_none()) {
                    break;
                }
                digests.pop();
            }
            if digests.is_empty() {
                return Ok(false);
            }
            if !self.parts.life.beat(ERASING_LOOK.0).await {
                break;
            }
        }
        Ok(true)
    }
}

/// Said with every erasure.
const STAYS: [&str; 4] = [
    "copies that readers have fetched",
    "backups, exports and evidence bundles made before",
    "a robot's own disk, until its copies leave by outbox.keep or expire in its ring",
    "the files of a Redis cache, until its server rewrites them, and what a disk keeps of overwritten blocks",
];

fn chosen(reader: &Reader<'_>, wishes: &ErasureWishes, query: &RecordQuery) -> Result<Vec<RecordRow>> {
    let (ledger, owner) = (&reader.plant.ledger, reader.reader.address);
    let mut rows = Vec::new();
    for id in &wishes.records {
        let row = ledger.records.by_id(id)?.filter(|row| row.owner == owner && row.kind.is_content());
        let unknown = || input(format!("there is no message or attachment '{}' of this profile here", clean(id, 70)));
        rows.push(row.ok_or_else(unknown)?);
    }
    if !wishes.records.is_empty() {
        rows.sort_by_key(|row| row.digest);
        rows.dedup_by_key(|row| row.digest);
        return Ok(rows);
    }
    let of_topics = wishes.topic.is_some() || wishes.robot.is_some();
    if !of_topics && wishes.recording.is_none() {
        return Err(input(
            "choose what to erase: --topic, --robot or --recording, with --since and --until, or --record",
        ));
    }
    // A recording includes its attachments; a topic has none.
    let kinds = [RecordKind::Data, RecordKind::Attachment];
    for kind in kinds.into_iter().filter(|kind| !of_topics || *kind == RecordKind::Data) {
        let query = RecordQuery { kind: Some(kind), ..query.clone() };
        rows.extend(chosen_of(reader, wishes.recording.as_deref(), query)?);
        if rows.len() > MOST {
            return Err(too_many());
        }
    }
    Ok(rows)
}

fn too_many() -> Failure {
    input(format!("these are more than {MOST} records; choose a shorter span and repeat the command for the rest"))
}

fn chosen_of(reader: &Reader<'_>, recording: Option<&str>, query: RecordQuery) -> Result<Vec<RecordRow>> {
    let mut rows = Vec::new();
    for row in reader.plant.ledger.records.all(query) {
        let row = row?;
        let is_left_out = match recording {
            Some(recording) => !is_imported(reader, &row, recording)?,
            None => false,
        };
        rows.extend(Some(row).filter(|_| !is_left_out));
        if rows.len() > MOST {
            return Err(too_many());
        }
    }
    Ok(rows)
}

/// Whether an import of a recording sealed it, by its sealed tags. Deleted records cannot be opened.
fn is_imported(reader: &Reader<'_>, row: &RecordRow, recording: &str) -> Result<bool> {
    let opened = reader.own_contents(row)?;
    Ok(opened.is_some_and(|opened| {
        let has = |name: &str, value: &str| opened.head.tags.get(name).is_some_and(|tag| tag == value);
        has(RECORDING, recording) && has(SOURCE.0, SOURCE.1)
    }))
}

/// What would become of these records, and those that can go.
fn planned(rows: &[RecordRow], incidents: &[IncidentRow]) -> (ErasureView, Vec<RecordRow>) {
    let erasable: Vec<RecordRow> = rows.iter().filter(|row| retention::can_be(row)).cloned().collect();
    let holds = |incident: &&IncidentRow| erasable.iter().any(|row| is_held(row, incident));
    let held = incidents.iter().filter(holds).map(|incident| incident.name.to_string()).collect();
    let topics: BTreeSet<String> = erasable.iter().map(|row| clean(&row.topic, 255)).collect();
    let view = ErasureView {
        records: erasable.len() as u64,
        bytes: erasable.iter().map(|row| row.bytes).sum(),
        topics: topics.into_iter().collect(),
        waiting: rows.iter().filter(|row| row.state.is_pending()).count() as u64,
        gone: rows.iter().filter(|row| row.deleted_at.is_some()).count() as u64,
        other: rows.iter().filter(|row| is_other(row)).count() as u64,
        held,
        stays: STAYS.map(ToOwned::to_owned).to_vec(),
        ..ErasureView::default()
    };
    (view, erasable)
}

/// Quarantined, discarded or altered: decided elsewhere.
fn is_other(row: &RecordRow) -> bool {
    row.deleted_at.is_none() && !row.state.is_pending() && row.state != RecordState::Verified
}

fn is_held(row: &RecordRow, incident: &IncidentRow) -> bool {
    let span = &incident.span;
    row.captured_at >= span.since && span.until.is_none_or(|until| row.captured_at < until) && span.is_about(&row.topic)
}
