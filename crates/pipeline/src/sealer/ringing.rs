//! Messages of topics that nobody watches, on their way into the ring on the disk: sealed like others, under the ring's
//! own recorder, and never waited for. What cannot be kept is counted, and the ledger's records go on.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, PoisonError};

use super::plan::{Content, Plan, Task};
use super::sealing::seal_all;
use super::{Sealer, cause};
use crate::model::{LossReason, TopicId};
use crate::pipeline::PipelineError;
use crate::pipeline::disk_ring::SharedRing;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Weighted as _;
use crate::store::{DiskRing, KnownDefinition, NewRecord, RingRecord};

/// A record with its number, the definition that it is, and its topic.
type Numbered = (RingRecord, u64, Option<KnownDefinition>, TopicId);

impl Sealer {
    /// Seals what is for the ring. What fails is counted as lost: nothing waits for the ring.
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
                    let text = format!("messages of topics that nobody watches did not get into the ring: {error}");
                    self.plant.observer.alert(false, text);
                    cause(&error)
                }
                Err(_) => LossReason::Fault,
            };
            round.iter().for_each(|item| self.lose(item, reason));
        }
    }

    /// One round; either all of its messages that have a key are in the ring, or none.
    fn ring_round(&mut self, ring: &SharedRing, items: &[&CapturedMessage]) -> Result<(), PipelineError> {
        let mut ring = lock(ring);
        if let Err(full) = self.plant.ledger.takes_records() {
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
                let owner = item.author.address;
                contents.push(Content::ring_definition((keys.domain, owner, keys.epoch), topic.id, definition));
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

/// The items in rounds of about so many bytes.
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
        blob: row.local_copy?,
    };
    Some((record, row.seq, known_definition(task), row.topic_id))
}

fn lock(ring: &SharedRing) -> std::sync::MutexGuard<'_, DiskRing> {
    ring.lock().unwrap_or_else(PoisonError::into_inner)
}
