//! Seals captured messages and acknowledges them: a round is planned in order, sealed on several cores and acknowledged
//! in order, with one fsync. What fails is kept and tried again; the rings fill meanwhile.

pub(super) mod plan;
mod sealing;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use crate::crypto::fault;
use crate::model::{LossReason, RecordKind, Timestamp};
use crate::store::StoreError;
use crate::store::notes::StoredDefinition;

use super::disk_ring::SharedRing;
use super::losses::{GATHERED, InMemory, Losses, Lost};
use super::recorder::CapturedMessage;
use super::ring::{Rings, Weighted};
use super::session::Sessions;
use super::stages::{Milestone, Stage};
use super::{PipelineError, Plant, Result};

use self::plan::{Planner, Task};
use self::sealing::{Ready, seal_all};

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

#[cfg(test)]
mod tests;
