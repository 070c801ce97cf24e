//! Seals the records of a round in parallel, each independently of the others and of the order of threads.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, PoisonError};

use super::plan::{Content, Plan, Task};
use super::{Sealer, cause};
use crate::crypto::compression::{Packed, pack};
use crate::crypto::pool::{each, helpers_for};
use crate::crypto::{SealRequest, seal};
use crate::disk_ring::SharedRing;
use crate::model::head::{Compression, SIMULATED};
use crate::model::{Head, LossReason, RecordKind, RecordState, TopicId};
use crate::recorder::CapturedMessage;
use crate::ring::Weighted as _;
use crate::store::notes::StoredDefinition;
use crate::store::{DiskRing, Hold, KnownDefinition, NewRecord, RingRecord};
use crate::{Plant, Result, importer, quarantine};

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
