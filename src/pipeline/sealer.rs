//! Seals captured messages and acknowledges them: one thread, order per topic kept, one fsync
//! for as many records as wait. What fails is kept and tried again; the rings fill meanwhile.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::crypto::compression::{Packed, pack};
use crate::crypto::{SealRequest, SealedRecord, fault, seal};
use crate::model::head::Compression;
use crate::model::{Address, Digest, Head, LossReason, RecordKind, RecordState, Timestamp, TopicId, clean};
use crate::ros::Message;
use crate::store::{Hold, NewRecord, StoreError};

use super::epoch::{EpochKeys, SIMULATED, TopicKeys};
use super::losses::{GATHERED, Losses, Lost};
use super::packing::Packing;
use super::recorder::CapturedMessage;
use super::ring::Rings;
use super::session::Sessions;
use super::stages::{Milestone, Stage};
use super::{PipelineError, Plant, quarantine};

/// Messages sealed at most before they are acknowledged together.
const ROUND: usize = 256;
/// Bytes sealed at most before they are acknowledged together.
const ROUND_BYTES: usize = 8 * 1024 * 1024;
/// Between two writings of the losses into the ledger.
const LOSSES_EVERY: Duration = Duration::from_secs(1);
/// How long messages are tried to be stored once the program ends.
const LAST_TRIES: Duration = Duration::from_secs(3);

/// A sealed record on its way into vault and ledger.
struct Ready {
    sealed: SealedRecord,
    row: NewRecord,
    hold: Option<Hold>,
    definition: Option<String>,
    item: Option<usize>,
}

/// A round ended in a panic; what it was about is not acknowledged.
struct Panicked;

/// Seals everything that comes through the rings.
pub struct Sealer {
    plant: Plant,
    sessions: Arc<Sessions>,
    losses: Arc<Losses>,
    /// Bytes of records that may wait in the ledger for a vault that does not take them.
    backlog: u64,
    losses_at: Instant,
    boot_id: [u8; 16],
    seqs: HashMap<(Address, TopicId), u64>,
    definitions: HashSet<String>,
    hashes: HashMap<Arc<str>, Digest>,
    /// `None` = messages are sealed as they are.
    packing: Option<Packing>,
}

/// Definitions whose hash is remembered at most.
const MOST_HASHES: usize = 1024;

impl Sealer {
    /// A sealer over `plant`; `sessions` learn which records they wait for, `losses` what became none. Up to `backlog`
    /// bytes of records may wait in the ledger for a vault that does not take them.
    pub fn new(plant: Plant, sessions: Arc<Sessions>, losses: Arc<Losses>, backlog: u64) -> Self {
        Self {
            plant,
            sessions,
            losses,
            backlog,
            losses_at: Instant::now(),
            boot_id: boot_id(),
            seqs: HashMap::new(),
            definitions: HashSet::new(),
            hashes: HashMap::new(),
            packing: Some(Packing::default()),
        }
    }

    /// Seals messages as they are, without compression.
    pub fn without_compression(self) -> Self {
        Self { packing: None, ..self }
    }

    /// Works until the rings are closed and empty. `acknowledged` is called after each round.
    pub fn run(&mut self, rings: &Rings<CapturedMessage>, acknowledged: &dyn Fn()) {
        let mut closed_at = None;
        while let Some(items) = rings.take(ROUND, ROUND_BYTES, LOSSES_EVERY) {
            if !items.is_empty() {
                self.store(&items, rings, &mut closed_at);
                acknowledged();
            }
            drop(items);
            self.tell_losses(false);
        }
        self.tell_losses(true);
    }

    /// Tries until the messages are acknowledged. Where that panics, each is tried by itself, and the one over which it
    /// panics again is given up and counted: it must not take its neighbours with it.
    fn store(&mut self, items: &[CapturedMessage], rings: &Rings<CapturedMessage>, closed_at: &mut Option<Instant>) {
        if self.try_to_store(items, rings, closed_at).is_ok() {
            return;
        }
        self.plant.observer.alert(true, "sealing failed by a fault of the program, it is tried again".to_owned());
        for item in items {
            if self.try_to_store(std::slice::from_ref(item), rings, closed_at).is_err() {
                self.lose(item, LossReason::Fault);
            }
        }
    }

    /// When the program ends, not for ever: then they are counted as lost.
    fn try_to_store(
        &mut self,
        items: &[CapturedMessage],
        rings: &Rings<CapturedMessage>,
        closed_at: &mut Option<Instant>,
    ) -> Result<(), Panicked> {
        let mut pause = Duration::from_millis(100);
        let names = loop {
            let error = match catch_unwind(AssertUnwindSafe(|| self.round(items))) {
                Ok(Ok(names)) => break names,
                Ok(Err(error)) => error,
                Err(_) => return Err(Panicked),
            };
            self.losses.blame(cause(&error));
            let text = format!("captured messages cannot be stored, they wait in memory: {error}");
            self.plant.observer.alert(true, text);
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
        // From here on they are acknowledged: whatever fails, they must not be sealed a second time.
        self.losses.blame(LossReason::Memory);
        fault::point("appended");
        self.note_definitions(names);
        self.plant.observer.records_changed();
        Ok(())
    }

    /// Remembers which definitions are stored; one that is not remembered is sealed once more, which is no harm.
    fn note_definitions(&mut self, names: Vec<String>) {
        for name in names {
            match self.plant.ledger.put_setting(&name, "sent") {
                Ok(()) => drop(self.definitions.insert(name)),
                Err(error) => self.plant.observer.alert(false, format!("a definition is stored again: {error}")),
            }
        }
    }

    fn lose(&self, item: &CapturedMessage, reason: LossReason) {
        let held = item.doubt.is_some();
        item.sessions.iter().for_each(|session| session.dropped(&item.message.topic, held));
        self.losses.note(&item.author, Lost::message(&item.message), reason);
    }

    /// Writes what was lost into the ledger, once a second, and seals gap records of what is a few seconds old; at the
    /// `end` of all.
    fn tell_losses(&mut self, end: bool) {
        if !end && self.losses_at.elapsed() < LOSSES_EVERY {
            return;
        }
        self.losses_at = Instant::now();
        let age = if end { 0 } else { u64::try_from(GATHERED.as_nanos()).unwrap_or(0) };
        let by = Timestamp(Timestamp::now().0.saturating_sub(age));
        let told = self.losses.write(&self.plant).map_err(PipelineError::from);
        match told.and_then(|()| self.losses.tell(&self.plant, by)) {
            Ok(told) => self.seqs.extend(told.into_iter().map(|(owner, topic, seq)| ((owner, topic), seq))),
            Err(error) => {
                // Of a stream whose number was taken all the same the ledger knows.
                self.seqs.clear();
                let text = format!("lost messages are counted, but not yet told of in gap records: {error}");
                self.plant.observer.alert(true, text);
            }
        }
    }

    /// Seals and stores; the definitions that went with it.
    fn round(&mut self, items: &[CapturedMessage]) -> Result<Vec<String>, PipelineError> {
        let begun = Instant::now();
        let mut seqs = HashMap::new();
        let (mut ready, mut keyless) = (Vec::with_capacity(items.len()), Vec::new());
        for (index, item) in items.iter().enumerate() {
            let keys = item.author.sealing().filter(|keys| keys.topic(&item.message.topic).is_some());
            let Some(keys) = keys else {
                keyless.push(item);
                continue;
            };
            self.seal_definition(item, &keys, &mut seqs, &mut ready)?;
            let packed = self.packing.as_mut().and_then(|packing| packing.pack(&item.message));
            let one = self.seal_one(item, &keys, RecordKind::Data, &item.message.body, packed, &mut seqs)?;
            ready.push(Ready { item: Some(index), definition: None, ..one });
        }
        self.spent(Stage::Seal, begun);
        let mut names = Vec::new();
        if !ready.is_empty() {
            fault::point("sealed");
            let captured: Vec<Timestamp> = ready
                .iter()
                .filter_map(|one| one.item.and_then(|index| items.get(index)))
                .map(|item| item.message.captured_at)
                .collect();
            let begun = Instant::now();
            names = self.acknowledge(items, ready)?;
            self.spent(Stage::Commit, begun);
            if let Some(stages) = self.plant.observer.stages() {
                stages.reached(Milestone::Durable, captured);
            }
        }
        self.seqs.extend(seqs);
        keyless.into_iter().for_each(|item| self.lose(item, LossReason::Key));
        Ok(names)
    }

    fn spent(&self, stage: Stage, begun: Instant) {
        if let Some(stages) = self.plant.observer.stages() {
            stages.spent(stage, begun.elapsed());
        }
    }

    fn seal_definition(
        &mut self,
        item: &CapturedMessage,
        keys: &EpochKeys,
        seqs: &mut HashMap<(Address, TopicId), u64>,
        ready: &mut Vec<Ready>,
    ) -> Result<(), PipelineError> {
        let topic = covered(keys, &item.message.topic)?;
        let digest = self.definition_digest(&item.message.definition);
        // A quarantined definition is none for those who may never see it.
        let held = if item.doubt.is_some() { ":quarantined" } else { "" };
        let name =
            format!("definition:{}:{}:{}:{}:{digest}{held}", keys.domain, item.author.address, keys.epoch, topic.id);
        let waiting = ready.iter().any(|one| one.definition.as_ref() == Some(&name));
        if waiting || self.definitions.contains(&name) {
            return Ok(());
        }
        if self.plant.ledger.setting(&name)?.is_none() {
            let body = item.message.definition.as_bytes();
            let one = self.seal_one(item, keys, RecordKind::Definition, body, pack(body, None), seqs)?;
            ready.push(Ready { item: None, definition: Some(name), ..one });
        } else {
            self.definitions.insert(name);
        }
        Ok(())
    }

    fn definition_digest(&mut self, definition: &Arc<str>) -> Digest {
        if let Some(digest) = self.hashes.get(definition) {
            return *digest;
        }
        if self.hashes.len() >= MOST_HASHES {
            self.hashes.clear();
        }
        let digest = Digest(self.plant.provider.sm3(&[definition.as_bytes()]));
        self.hashes.insert(Arc::clone(definition), digest);
        digest
    }

    fn seal_one(
        &self,
        item: &CapturedMessage,
        keys: &EpochKeys,
        kind: RecordKind,
        body: &[u8],
        packed: Option<Packed>,
        seqs: &mut HashMap<(Address, TopicId), u64>,
    ) -> Result<Ready, PipelineError> {
        let message = &*item.message;
        let topic = covered(keys, &message.topic)?;
        let tags = tags(item);
        let compression = packed.as_ref().map_or(Compression::None, |packed| packed.compression);
        let owner = item.author.address;
        let seq = self.next_seq(owner, topic.id, seqs)?;
        let request = SealRequest {
            domain: keys.domain,
            owner,
            signer: &keys.signing,
            epoch: keys.epoch,
            topic_key: &topic.key,
            recorder: self.plant.ledger.recorder(),
            seq,
            topic_id: topic.id,
            kind,
            filters: keys.filters(&message.type_name, &tags),
            captured_at: message.captured_at,
            head: &Head { compression, ..self.head(item, body.len(), tags) },
            body: packed.as_ref().map_or(body, |packed| &packed.bytes),
        };
        let sealed = seal(self.plant.provider, &request)?;
        seqs.insert((owner, topic.id), seq);
        let row = self.row(message, item, &sealed, keys, kind, seq, topic.id, body.len());
        let hold = item.doubt.map(|doubt| quarantine::hold(sealed.digest, doubt, &message.origin));
        Ok(Ready { sealed, row, hold, definition: None, item: None })
    }

    fn next_seq(
        &self,
        owner: Address,
        topic: TopicId,
        seqs: &HashMap<(Address, TopicId), u64>,
    ) -> Result<u64, PipelineError> {
        let key = (owner, topic);
        match seqs.get(&key).or_else(|| self.seqs.get(&key)) {
            Some(last) => Ok(last + 1),
            None => Ok(self.plant.ledger.next_seq(owner, topic)?),
        }
    }

    fn head(&self, item: &CapturedMessage, length: usize, tags: BTreeMap<String, String>) -> Head {
        let message = &*item.message;
        Head {
            topic: message.topic.to_string(),
            type_name: message.type_name.to_string(),
            md5sum: message.md5sum.to_string(),
            definition: self.hashes.get(&message.definition).copied().unwrap_or(Digest([0; 32])),
            caller_id: message.caller_id.to_string(),
            boot_id: self.boot_id,
            compression: Compression::None,
            plain_length: length as u64,
            tags,
        }
    }

    #[allow(clippy::too_many_arguments, reason = "one column of the row each, used at one place")]
    fn row(
        &self,
        message: &Message,
        item: &CapturedMessage,
        sealed: &SealedRecord,
        keys: &EpochKeys,
        kind: RecordKind,
        seq: u64,
        topic_id: TopicId,
        length: usize,
    ) -> NewRecord {
        let durable = self.plant.vault.durable();
        NewRecord {
            digest: sealed.digest,
            owner: item.author.address,
            topic_id,
            seq,
            foreign: None,
            epoch: keys.epoch,
            kind,
            signer: keys.signer,
            signature: sealed.signature,
            filters: keys.filters(&message.type_name, &tags(item)),
            topic: message.topic.to_string(),
            type_name: message.type_name.to_string(),
            bytes: length as u64,
            captured_at: message.captured_at,
            simulated: item.simulated,
            state: match item.doubt {
                Some(_) => RecordState::Quarantined,
                None if durable => RecordState::Stored,
                None => RecordState::Sealed,
            },
            local_copy: (!durable).then(|| sealed.blob.clone()),
        }
    }

    /// A vault that takes nothing must not fill the disk.
    fn keep_backlog(&self) -> Result<(), StoreError> {
        if self.plant.vault.durable() {
            return Ok(());
        }
        let waiting = self.plant.ledger.backlog()?;
        if waiting <= self.backlog { Ok(()) } else { Err(StoreError::Backlog { waiting, limit: self.backlog }) }
    }

    fn acknowledge(&self, items: &[CapturedMessage], ready: Vec<Ready>) -> Result<Vec<String>, PipelineError> {
        self.plant.ledger.takes_records()?;
        self.keep_backlog()?;
        if self.plant.vault.durable() {
            let entries: Vec<_> = ready.iter().map(|one| (one.sealed.digest, one.sealed.blob.as_slice())).collect();
            self.plant.vault.put(&entries)?;
            fault::point("vault-put");
        }
        // Sessions wait before the append: verification may be quicker than this thread.
        for one in &ready {
            if let Some(item) = one.item.and_then(|index| items.get(index)).filter(|item| item.doubt.is_none()) {
                self.sessions.wait(one.sealed.digest, &item.message.topic, &item.sessions);
            }
        }
        let (mut rows, mut names, mut holds) = (Vec::with_capacity(ready.len()), Vec::new(), Vec::new());
        for one in ready {
            rows.push(one.row);
            names.extend(one.definition);
            holds.extend(one.hold);
        }
        self.plant.ledger.append_held(rows, holds)?;
        Ok(names)
    }
}

/// Why messages wait, as a gap record tells it of those that did not fit any more.
fn cause(error: &PipelineError) -> LossReason {
    match error {
        PipelineError::Store(StoreError::DiskFull { .. }) => LossReason::Disk,
        PipelineError::Store(StoreError::Backlog { .. }) => LossReason::Backlog,
        _ => LossReason::Memory,
    }
}

/// The keys of a topic that the round has found to be covered.
fn covered(keys: &EpochKeys, topic: &str) -> Result<Arc<TopicKeys>, PipelineError> {
    keys.topic(topic).ok_or_else(|| PipelineError::Uncovered(clean(topic, 255)))
}

fn tags(item: &CapturedMessage) -> BTreeMap<String, String> {
    let mut tags: BTreeMap<String, String> =
        item.sessions.iter().flat_map(|session| session.tags().iter().cloned()).collect();
    if let Some(rule) = &item.rule {
        tags.extend(rule.all_tags());
    }
    if item.simulated {
        tags.insert(SIMULATED.0.to_owned(), SIMULATED.1.to_owned());
    }
    if let Some(doubt) = item.doubt {
        tags.insert(quarantine::TAG.to_owned(), doubt.word().to_owned());
    }
    tags
}

fn boot_id() -> [u8; 16] {
    let text = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let bytes = crate::model::bytes::unhex(&text.trim().replace('-', ""));
    bytes.and_then(|bytes| bytes.try_into().ok()).unwrap_or_default()
}
