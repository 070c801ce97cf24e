//! Seals captured messages and acknowledges them: a round is planned in order, sealed on several cores and acknowledged
//! in order, with one fsync. What fails is kept and tried again; the rings fill meanwhile.

pub(super) mod plan;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use crate::crypto::compression::{Packed, pack};
use crate::crypto::pool::{each, helpers_for};
use crate::crypto::{SealRequest, fault, seal};
use crate::losses::{GATHERED, InMemory, Losses, Lost};
use crate::model::head::{Compression, SIMULATED};
use crate::model::{Head, LossReason, RecordKind, RecordState, Timestamp, TopicId};
use crate::ring::{Rings, Weighted};
use crate::sealer::plan::{Content, Plan, Planner, Task};
use crate::stages::{Milestone, Stage};
use crate::store::{DiskRing, Hold, KnownDefinition, NewRecord, RingRecord, StoreError};
use crate::{PipelineError, Plant, Result, importer, quarantine};
use crate::{disk_ring::SharedRing, recorder::CapturedMessage, session::Sessions, store::notes::StoredDefinition};

/// Messages, and below bytes, sealed before they are acknowledged together.
const ROUND: usize = 256;
const ROUND_BYTES: usize = 8 * 1024 * 1024;
/// A round of this many messages suggests that more are coming.
const SOME: usize = 8;
/// The longest time that a round collects messages.
const LONGEST_GATHERING: Duration = Duration::from_millis(10);
/// Between two writings of the losses into the ledger.
const LOSSES_EVERY: Duration = Duration::from_secs(1);
/// How long storing messages is tried once the program ends.
const LAST_TRIES: Duration = Duration::from_secs(3);

/// A round ended in a panic; its messages are not acknowledged.
struct Panicked;

pub struct Sealer {
    plant: Plant,
    sessions: Arc<Sessions>,
    losses: Arc<Losses>,
    losses_at: Instant,
    boot_id: [u8; 16],
    planner: Planner,
    /// Takes messages of topics that nobody watches.
    ring: Arc<OnceLock<SharedRing>>,
}

impl Sealer {
    pub fn new(plant: Plant, sessions: Arc<Sessions>, losses: Arc<Losses>) -> Self {
        let planner = Planner::new();
        Self { plant, sessions, losses, losses_at: Instant::now(), boot_id: boot_id(), planner, ring: Arc::default() }
    }

    pub fn without_compression(mut self) -> Self {
        self.planner.packing = None;
        self
    }

    #[must_use]
    pub fn with_ring(self, ring: Arc<OnceLock<SharedRing>>) -> Self {
        Self { ring, ..self }
    }

    /// Works until the rings are closed and empty. `acknowledged` is called after each round.
    pub fn run(&mut self, rings: &Rings<CapturedMessage>, acknowledged: &dyn Fn()) {
        let mut closed_at = None;
        while let Some(items) = rings.take(ROUND, ROUND_BYTES, LOSSES_EVERY) {
            let (begun, taken) = (Instant::now(), items.len());
            let bytes = items.iter().map(Weighted::weight).sum();
            if !items.is_empty() {
                self.store(&items, rings, &mut closed_at);
                self.keep_in_ring(&items);
                acknowledged();
            }
            drop(items);
            self.tell_losses(false);
            std::thread::sleep(gathering((taken, bytes), begun.elapsed(), rings.capacity()));
        }
        self.tell_losses(true);
    }

    /// Tries until the messages are acknowledged. If that panics, each is tried alone, and one that panics again is
    /// given up and counted: it must not take the others with it.
    fn store(&mut self, items: &[CapturedMessage], rings: &Rings<CapturedMessage>, closed_at: &mut Option<Instant>) {
        if items.iter().all(|item| item.ring) || self.try_to_store(items, rings, closed_at).is_ok() {
            return;
        }
        self.plant.observer.alert(true, "sealing failed because of a bug in the program; retrying".to_owned());
        for item in items {
            if self.try_to_store(std::slice::from_ref(item), rings, closed_at).is_err() {
                self.lose(item, LossReason::Fault);
            }
        }
    }

    /// Gives up when the program ends; then the messages count as lost.
    fn try_to_store(
        &mut self,
        items: &[CapturedMessage],
        rings: &Rings<CapturedMessage>,
        closed_at: &mut Option<Instant>,
    ) -> Result<(), Panicked> {
        let mut pause = Duration::from_millis(100);
        let names = loop {
            let tried = match self.plant.ledger.records.takes_records() {
                // What waits is noted, and nothing but room changes anything.
                Err(full) if self.losses.is_noted() => Ok(Err(full.into())),
                _ => {
                    // Before it is stored: what is acknowledged must not count as lost after a crash.
                    self.note_waiting(InMemory::default());
                    catch_unwind(AssertUnwindSafe(|| self.round(items)))
                }
            };
            let error = match tried {
                Ok(Ok(names)) => break names,
                Ok(Err(error)) => error,
                Err(_) => return Err(Panicked),
            };
            self.losses.blame(cause(&error));
            let text = format!("captured messages cannot be stored; they wait in memory and are retried: {error}");
            self.plant.observer.alert(true, text);
            let mut waiting = InMemory::default();
            items.iter().for_each(|item| waiting.add(item));
            rings.each_waiting(|item| waiting.add(item));
            self.note_waiting(waiting);
            if rings.is_closed() {
                let end = *closed_at.get_or_insert_with(Instant::now) + LAST_TRIES;
                if Instant::now() >= end {
                    items.iter().for_each(|item| self.lose(item, LossReason::End));
                    return Ok(());
                }
                pause = Duration::from_millis(200);
            }
            self.tell_losses(false);
            std::thread::sleep(pause);
            pause = (pause * 2).min(Duration::from_secs(2));
        };
        // From here on they are acknowledged: whatever fails, they must not be sealed again.
        self.losses.blame(LossReason::Memory);
        fault::point("appended");
        self.note_definitions(names);
        self.plant.observer.records_changed();
        Ok(())
    }

    /// Notes what would die with the process, or that nothing would.
    fn note_waiting(&self, waiting: InMemory) {
        if waiting.is_empty() && !self.losses.is_noted() {
            return;
        }
        if let Err(error) = self.losses.note_waiting(waiting) {
            let text =
                format!("messages waiting in memory cannot be noted, so a crash would leave them uncounted: {error}");
            self.plant.observer.alert(true, text);
        }
    }

    /// Remembers which definitions are stored; one that is not remembered is sealed once more, which is no harm.
    fn note_definitions(&mut self, definitions: Vec<StoredDefinition>) {
        for definition in definitions {
            match self.plant.ledger.notes.write(&definition, &()) {
                Ok(()) => self.planner.note_stored(definition),
                Err(error) => self.plant.observer.alert(false, format!("a definition is stored again: {error}")),
            }
        }
    }

    fn lose(&self, item: &CapturedMessage, reason: LossReason) {
        if item.kind == RecordKind::Definition {
            return;
        }
        let held = item.doubt.is_some();
        item.sessions.iter().for_each(|session| session.dropped(&item.message.topic, held));
        self.losses.note(&item.author, Lost::message(&item.message), reason);
    }

    /// Writes losses to the ledger once a second, and seals gap records for older ones; at the `end`, for all.
    fn tell_losses(&mut self, end: bool) {
        if !end && self.losses_at.elapsed() < LOSSES_EVERY {
            return;
        }
        self.losses_at = Instant::now();
        let age = if end { 0 } else { u64::try_from(GATHERED.as_nanos()).unwrap_or(0) };
        let by = Timestamp(Timestamp::now().0.saturating_sub(age));
        let told = self.losses.write(&self.plant).map_err(PipelineError::from);
        match told.and_then(|()| self.losses.tell(&self.plant, by)) {
            Ok(told) => self.planner.seqs.extend(told),
            Err(error) => {
                // Numbers may have been used: the ledger knows.
                self.planner.seqs.clear();
                let text = format!("lost messages are counted, but not yet reported in gap records: {error}");
                self.plant.observer.alert(true, text);
                if end && let Err(error) = self.losses.note_waiting(InMemory::default()) {
                    self.plant.observer.alert(true, error.to_string());
                }
            }
        }
    }

    /// Returns the definitions that were stored.
    fn round(&mut self, items: &[CapturedMessage]) -> Result<Vec<StoredDefinition>> {
        let begun = Instant::now();
        let plan = self.planner.plan(&self.plant, items)?;
        let ready = seal_all(&self.plant, self.boot_id, &plan.tasks)?;
        self.spent(Stage::Seal, begun);
        if !ready.is_empty() {
            fault::point("sealed");
            self.learn(&plan.tasks, &ready);
            let begun = Instant::now();
            self.acknowledge(&plan.tasks, ready)?;
            self.spent(Stage::Commit, begun);
            if let Some(stages) = self.plant.observer.stages() {
                let messages = plan.tasks.iter().filter(|task| task.is_message());
                stages.reached(Milestone::Durable, messages.map(|task| task.item.message.captured_at));
            }
        }
        self.planner.seqs.extend(plan.seqs);
        plan.keyless.into_iter().for_each(|item| self.lose(item, LossReason::Key));
        Ok(plan.tasks.iter().filter_map(Task::definition_id).collect())
    }

    fn learn(&mut self, tasks: &[Task<'_>], ready: &[Ready]) {
        let Some(packing) = &mut self.planner.packing else { return };
        for (task, one) in tasks.iter().zip(ready) {
            if let Some(paid) = one.paid {
                packing.learn(&task.item.message.topic, paid);
            }
        }
    }

    fn spent(&self, stage: Stage, begun: Instant) {
        if let Some(stages) = self.plant.observer.stages() {
            stages.spent(stage, begun.elapsed());
        }
    }

    fn acknowledge(&self, tasks: &[Task<'_>], ready: Vec<Ready>) -> Result<()> {
        let (rows, holds): (Vec<_>, Vec<_>) = ready.into_iter().map(|one| (one.row, one.hold)).unzip();
        let sound = |task: &&Task<'_>| task.is_message() && task.item.doubt.is_none();
        let kept = self.plant.keep(rows, |rows| {
            // Sessions wait from before the append: verification may be faster than this thread.
            for (task, row) in tasks.iter().zip(&rows).filter(|(task, _)| sound(task)) {
                self.sessions.wait(row.digest, &task.item.message.topic, &task.item.sessions);
            }
            self.plant.ledger.quarantine.append_held(rows, holds.into_iter().flatten().collect())
        });
        kept?;
        for task in tasks.iter().filter(sound) {
            task.item.sessions.iter().for_each(|session| session.acknowledge(1));
        }
        Ok(())
    }
}

/// How long the next round collects messages, so that more records share the cost of a commit. Zero after few messages,
/// after a full round, or if as many again might not fit into the rings.
fn gathering((taken, bytes): (usize, usize), took: Duration, capacity: usize) -> Duration {
    let more = (SOME..ROUND).contains(&taken) && bytes < ROUND_BYTES && bytes <= capacity / 4;
    if more { took.min(LONGEST_GATHERING) } else { Duration::ZERO }
}

fn cause(error: &PipelineError) -> LossReason {
    match error {
        PipelineError::Store(StoreError::DiskFull { .. }) => LossReason::Disk,
        _ => LossReason::Memory,
    }
}

fn boot_id() -> [u8; 16] {
    let text = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let bytes = crate::model::bytes::unhex(&text.trim().replace('-', ""));
    bytes.and_then(|bytes| bytes.try_into().ok()).unwrap_or_default()
}

// Seals the records of a round in parallel, each independently of the others and of the order of threads.

pub struct Ready {
    pub row: NewRecord,
    pub hold: Option<Hold>,
    /// Whether compressing it paid, if that was tried.
    pub paid: Option<bool>,
}

pub fn seal_all(plant: &Plant, boot_id: [u8; 16], tasks: &[Task<'_>]) -> Result<Vec<Ready>> {
    let bytes = tasks.iter().map(|task| task.body().len()).sum();
    each(tasks, helpers_for(tasks.len(), bytes), |task| task.seal(plant, boot_id)).into_iter().collect()
}

impl Task<'_> {
    fn body(&self) -> &[u8] {
        match self.content {
            Content::Definition(_) => self.item.message.definition.as_bytes(),
            Content::Message(_) => &self.item.message.body,
        }
    }

    fn kind(&self) -> RecordKind {
        match self.content {
            Content::Definition(_) => RecordKind::Definition,
            Content::Message(_) => self.item.kind,
        }
    }

    fn pack(&self) -> Option<Packed> {
        match &self.content {
            Content::Definition(_) => pack(self.body(), None),
            Content::Message(tried) => tried.as_ref().and_then(|tried| tried.pack(&self.item.message)),
        }
    }

    fn seal(&self, plant: &Plant, boot_id: [u8; 16]) -> Result<Ready> {
        let (message, body, tags) = (&*self.item.message, self.body(), tags(self.item));
        let packed = self.pack();
        let filters = self.topic.filters(&message.type_name, &tags);
        let compression = packed.as_ref().map_or(Compression::None, |packed| packed.compression);
        let head = self.head(boot_id, compression, tags);
        let request = SealRequest {
            domain: self.keys.domain,
            owner: self.item.author.address,
            signer: &self.keys.signing,
            epoch: self.keys.epoch,
            topic_key: &self.topic.key,
            recorder: self.recorder,
            seq: self.seq,
            topic_id: self.topic.id,
            kind: self.kind(),
            filters,
            captured_at: message.captured_at,
            head: &head,
            body: packed.as_ref().map_or(body, |packed| &packed.bytes),
        };
        let sealed = seal(plant.provider, &request)?;
        let hold = self.item.doubt.map(|doubt| quarantine::hold(sealed.digest, doubt, &message.origin));
        let mut row = NewRecord::sealed(sealed).named(&head);
        if hold.is_some() {
            row.state = RecordState::Quarantined;
        }
        let tried = matches!(self.content, Content::Message(Some(_)));
        Ok(Ready { row, hold, paid: tried.then_some(packed.is_some()) })
    }

    fn head(&self, boot_id: [u8; 16], compression: Compression, tags: BTreeMap<String, String>) -> Head {
        let message = &*self.item.message;
        Head {
            topic: message.topic.to_string(),
            type_name: message.type_name.to_string(),
            md5sum: message.md5sum.to_string(),
            definition: self.definition,
            caller_id: message.caller_id.to_string(),
            boot_id,
            compression,
            plain_length: self.body().len() as u64,
            tags,
        }
    }
}

fn tags(item: &CapturedMessage) -> BTreeMap<String, String> {
    let mut tags: BTreeMap<String, String> =
        item.sessions.iter().flat_map(|session| session.tags().iter().cloned()).collect();
    tags.extend(item.message.tags.iter().cloned());
    if let Some(rule) = &item.rule {
        tags.extend(rule.all_tags());
    }
    if item.message.latching {
        tags.insert(importer::LATCHING.to_owned(), "1".to_owned());
    }
    if item.simulated {
        tags.insert(SIMULATED.0.to_owned(), SIMULATED.1.to_owned());
    }
    if let Some(doubt) = item.doubt {
        tags.insert(quarantine::TAG.to_owned(), doubt.word().to_owned());
    }
    tags
}

/// A record, its number, the definition that it is, and its topic.
type Numbered = (RingRecord, u64, Option<KnownDefinition>, TopicId);

impl Sealer {
    /// A failure counts as lost: nothing waits for the ring.
    pub(super) fn keep_in_ring(&mut self, items: &[CapturedMessage]) {
        let items: Vec<&CapturedMessage> = items.iter().filter(|item| item.ring).collect();
        let Some(ring) = self.ring.get().cloned().filter(|_| !items.is_empty()) else {
            return items.into_iter().for_each(|item| self.lose(item, LossReason::Memory));
        };
        let most = lock(&ring).round_bytes();
        for round in rounds(&items, most) {
            let kept = catch_unwind(AssertUnwindSafe(|| self.ring_round(&ring, round)));
            let reason = match kept {
                Ok(Ok(())) => continue,
                Ok(Err(error)) => {
                    let text = format!("messages of unwatched topics could not be stored in the ring: {error}");
                    self.plant.observer.alert(false, text);
                    cause(&error)
                }
                Err(_) => LossReason::Fault,
            };
            round.iter().for_each(|item| self.lose(item, reason));
        }
    }

    /// Either all messages that have a key get into the ring, or none.
    fn ring_round(&mut self, ring: &SharedRing, items: &[&CapturedMessage]) -> Result<()> {
        let mut ring = lock(ring);
        if let Err(full) = self.plant.ledger.records.takes_records() {
            // The disk belongs to what is acknowledged.
            ring.shrink()?;
            return Err(full.into());
        }
        let incoming = items.iter().map(|item| (item.weight() + item.message.definition.len()) as u64).sum();
        let now = ring.now();
        ring.begin_round(incoming, now)?;
        let plan = self.ring_plan(&mut ring, items);
        let ready = seal_all(&self.plant, self.boot_id, &plan.tasks)?;
        self.learn(&plan.tasks, &ready);
        let records: Vec<Numbered> =
            plan.tasks.iter().zip(ready).filter_map(|(task, one)| record(task, one.row)).collect();
        ring.append(&records)?;
        drop(ring);
        plan.keyless.into_iter().for_each(|item| self.lose(item, LossReason::Key));
        Ok(())
    }

    /// Like the plan of the ledger's records, with the ring's numbers, and with its definitions in every file.
    fn ring_plan<'a>(&mut self, ring: &mut DiskRing, items: &[&'a CapturedMessage]) -> Plan<'a> {
        let mut plan = Plan::default();
        for item in items.iter().copied() {
            if ring.is_too_large(item.message.body.len()) {
                ring.refuse(&item.message.topic);
                continue;
            }
            let keys = item.author.sealing();
            let Some((topic, keys)) = keys.and_then(|keys| Some((keys.topic(&item.message.topic)?, keys))) else {
                plan.keyless.push(item);
                continue;
            };
            let definition = self.planner.definition_digest(&self.plant, &item.message.topic, &item.message.definition);
            let known = (topic.id, keys.epoch, definition);
            let place = (item.author.address, keys.signer, topic.id);
            let planned = |task: &Task<'_>| known_definition(task) == Some(known);
            let mut contents = Vec::with_capacity(2);
            if !ring.has_definition(&known) && !plan.tasks.iter().any(planned) {
                let (domain, owner, epoch) = (keys.domain, item.author.address, keys.epoch);
                let (topic, digest, held) = (topic.id, definition, false);
                contents.push(Content::Definition(StoredDefinition { domain, owner, epoch, topic, digest, held }));
            }
            let tried = self.planner.packing.as_mut().and_then(|packing| packing.decide(&item.message));
            contents.push(Content::Message(tried));
            for content in contents {
                let seq = plan.seqs.get(&place).map_or_else(|| ring.next_number(topic.id), |last| last + 1);
                plan.seqs.insert(place, seq);
                let (keys, topic) = (Arc::clone(&keys), Arc::clone(&topic));
                plan.tasks.push(Task { item, content, keys, topic, recorder: ring.recorder(), seq, definition });
            }
        }
        plan
    }
}

fn rounds<'a, 'b>(items: &'b [&'a CapturedMessage], most: u64) -> Vec<&'b [&'a CapturedMessage]> {
    let (mut rounds, mut rest) = (Vec::new(), items);
    while !rest.is_empty() {
        let mut bytes = 0;
        let fits = |item: &&&CapturedMessage| {
            bytes += item.weight() as u64;
            bytes <= most
        };
        let count = rest.iter().take_while(fits).count().max(1);
        let (round, behind) = rest.split_at(count);
        rounds.push(round);
        rest = behind;
    }
    rounds
}

fn known_definition(task: &Task<'_>) -> Option<KnownDefinition> {
    (!task.is_message()).then_some((task.topic.id, task.keys.epoch, task.definition))
}

fn record(task: &Task<'_>, row: NewRecord) -> Option<Numbered> {
    let record = RingRecord {
        digest: row.digest,
        signature: row.signature,
        topic: row.topic,
        type_name: row.type_name,
        captured_at: row.captured_at,
        is_definition: !task.is_message(),
        simulated: row.simulated,
        plain_length: row.bytes,
        blob: row.blob?,
    };
    Some((record, row.seq, known_definition(task), row.topic_id))
}

fn lock(ring: &SharedRing) -> std::sync::MutexGuard<'_, DiskRing> {
    ring.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
