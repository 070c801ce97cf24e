//! Seals captured messages and acknowledges them: one thread, order per topic kept, one fsync
//! for as many records as wait. What fails is kept and tried again; the ring fills meanwhile.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::crypto::{SealRequest, SealedRecord, seal};
use crate::model::head::Compression;
use crate::model::{Address, Digest, Head, RecordKind, RecordState, TopicId, clean};
use crate::ros::Message;
use crate::store::{Hold, NewRecord};

use super::epoch::{EpochKeys, SIMULATED, TopicKeys};
use super::recorder::CapturedMessage;
use super::ring::Ring;
use super::session::Sessions;
use super::stages::{Milestone, Stage};
use super::{PipelineError, Plant, quarantine};

/// Messages sealed at most before they are acknowledged together.
const ROUND: usize = 256;
/// Bytes sealed at most before they are acknowledged together.
const ROUND_BYTES: usize = 8 * 1024 * 1024;

/// A sealed record on its way into vault and ledger.
struct Ready {
    sealed: SealedRecord,
    row: NewRecord,
    hold: Option<Hold>,
    definition: Option<String>,
    item: Option<usize>,
}

/// Seals everything that comes through the ring.
pub struct Sealer {
    plant: Plant,
    sessions: Arc<Sessions>,
    boot_id: [u8; 16],
    seqs: HashMap<(Address, TopicId), u64>,
    definitions: HashSet<String>,
    hashes: HashMap<Arc<str>, Digest>,
}

/// Definitions whose hash is remembered at most.
const MOST_HASHES: usize = 1024;

impl Sealer {
    /// A sealer over `plant`; `sessions` learn which records they wait for.
    pub fn new(plant: Plant, sessions: Arc<Sessions>) -> Self {
        Self {
            plant,
            sessions,
            boot_id: boot_id(),
            seqs: HashMap::new(),
            definitions: HashSet::new(),
            hashes: HashMap::new(),
        }
    }

    /// Works until the ring is closed and empty. `acknowledged` is called after each round.
    pub fn run(&mut self, ring: &Ring<CapturedMessage>, acknowledged: &dyn Fn()) {
        while let Some(items) = ring.take(ROUND, ROUND_BYTES, Duration::from_secs(1)) {
            if items.is_empty() {
                continue;
            }
            let mut pause = Duration::from_millis(100);
            while let Err(error) = self.round(&items) {
                self.plant
                    .observer
                    .alert(true, format!("captured messages cannot be stored, they wait in memory: {error}"));
                std::thread::sleep(pause);
                pause = (pause * 2).min(Duration::from_secs(5));
            }
            acknowledged();
        }
    }

    fn round(&mut self, items: &[CapturedMessage]) -> Result<(), PipelineError> {
        let begun = Instant::now();
        let mut seqs = HashMap::new();
        let mut ready = Vec::with_capacity(items.len());
        for (index, item) in items.iter().enumerate() {
            let keys = item.author.sealing().filter(|keys| keys.topic(&item.message.topic).is_some());
            let Some(keys) = keys else {
                let held = item.doubt.is_some();
                item.sessions.iter().for_each(|session| session.dropped(&item.message.topic, held));
                continue;
            };
            self.seal_definition(item, &keys, &mut seqs, &mut ready)?;
            let body = &item.message.body;
            let one = self.seal_one(item, &keys, RecordKind::Data, body, &mut seqs)?;
            ready.push(Ready { item: Some(index), definition: None, ..one });
        }
        self.spent(Stage::Seal, begun);
        let begun = Instant::now();
        self.acknowledge(items, ready)?;
        self.spent(Stage::Commit, begun);
        if let Some(stages) = self.plant.observer.stages() {
            stages.reached(Milestone::Durable, items.iter().map(|item| item.message.captured_at));
        }
        self.seqs.extend(seqs);
        Ok(())
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
            let one = self.seal_one(item, keys, RecordKind::Definition, body, seqs)?;
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
        seqs: &mut HashMap<(Address, TopicId), u64>,
    ) -> Result<Ready, PipelineError> {
        let message = &*item.message;
        let topic = covered(keys, &message.topic)?;
        let tags = tags(item);
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
            head: &self.head(item, body.len(), tags),
            body,
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

    fn acknowledge(&mut self, items: &[CapturedMessage], ready: Vec<Ready>) -> Result<(), PipelineError> {
        self.plant.ledger.takes_records()?;
        if self.plant.vault.durable() {
            let entries: Vec<_> = ready.iter().map(|one| (one.sealed.digest, one.sealed.blob.as_slice())).collect();
            self.plant.vault.put(&entries)?;
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
        for name in names {
            self.plant.ledger.put_setting(&name, "sent")?;
            self.definitions.insert(name);
        }
        self.plant.observer.records_changed();
        Ok(())
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
