//! The plan of a round, made in order before anything is sealed: keys, numbers, definitions that go first, and what to
//! compress. The result does not depend on which thread seals what when.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use crate::model::{Address, Digest, RecordKind, RecorderPrefix, SignerId, TopicId};
use crate::pipeline::epoch::{EpochKeys, TopicKeys};
use crate::pipeline::packing::{Packing, Try};
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::{PipelineError, Plant, Result};
use crate::store::notes::StoredDefinition;

/// The most definition hashes remembered.
const MOST_HASHES: usize = 1024;
/// The most stored definitions remembered; each epoch stores those of its topics anew.
const MOST_DEFINITIONS: usize = 8192;

pub type Stream = (Address, SignerId, TopicId);

pub enum Content {
    Definition(StoredDefinition),
    /// Compressed where that is tried and pays.
    Message(Option<Try>),
}

pub struct Task<'a> {
    pub item: &'a CapturedMessage,
    pub content: Content,
    pub keys: Arc<EpochKeys>,
    pub topic: Arc<TopicKeys>,
    /// The ledger or ring that numbers it.
    pub recorder: RecorderPrefix,
    pub seq: u64,
    /// SM3 of the message's definition.
    pub definition: Digest,
}

impl Task<'_> {
    pub fn is_message(&self) -> bool {
        matches!(self.content, Content::Message(_))
    }

    pub fn definition_id(&self) -> Option<StoredDefinition> {
        match &self.content {
            Content::Definition(definition) => Some(definition.clone()),
            Content::Message(_) => None,
        }
    }
}

#[derive(Default)]
pub struct Plan<'a> {
    pub tasks: Vec<Task<'a>>,
    /// Messages without a key.
    pub keyless: Vec<&'a CapturedMessage>,
    /// Last number assigned in each stream.
    pub seqs: HashMap<Stream, u64>,
    definitions: HashSet<StoredDefinition>,
}

#[derive(Default)]
pub struct Planner {
    /// The last stored number of each stream.
    pub seqs: HashMap<Stream, u64>,
    definitions: HashSet<StoredDefinition>,
    hashes: HashMap<Arc<str>, Digest>,
    /// The last definition of each topic: nearly always the next one too, and then the same text.
    last: HashMap<Arc<str>, (Arc<str>, Digest)>,
    /// `None` = messages are sealed as they are.
    pub packing: Option<Packing>,
}

impl Planner {
    pub fn new() -> Self {
        Self { packing: Some(Packing::default()), ..Self::default() }
    }

    /// Numbers count only once [`Self::seqs`] has them.
    pub fn plan<'a>(&mut self, plant: &Plant, items: &'a [CapturedMessage]) -> Result<Plan<'a>> {
        let mut plan = Plan::default();
        let recorder = plant.ledger.records.recorder();
        for item in items.iter().filter(|item| !item.ring) {
            let keys = item.author.sealing();
            let Some((topic, keys)) = keys.and_then(|keys| Some((keys.topic(&item.message.topic)?, keys))) else {
                plan.keyless.push(item);
                continue;
            };
            // Only messages have a definition.
            let has_definition = matches!(item.kind, RecordKind::Data | RecordKind::Definition);
            let definition = match has_definition {
                true => self.definition_digest(plant, &item.message.topic, &item.message.definition),
                false => Digest([0; 32]),
            };
            let add = |planner: &Self, plan: &mut Plan<'a>, content| {
                let seq = planner.next_seq(plant, (item.author.address, keys.signer, topic.id), plan)?;
                let (keys, topic) = (Arc::clone(&keys), Arc::clone(&topic));
                plan.tasks.push(Task { item, content, keys, topic, recorder, seq, definition });
                Ok::<(), PipelineError>(())
            };
            let unsent = match has_definition {
                true => self.unsent(plant, &plan, item, (&*keys, topic.id, definition))?,
                false => None,
            };
            if let Some(unsent) = unsent {
                plan.definitions.insert(unsent.clone());
                add(self, &mut plan, Content::Definition(unsent))?;
            }
            if item.kind != RecordKind::Definition {
                let tried = self.packing.as_mut().and_then(|packing| packing.decide(&item.message));
                add(self, &mut plan, Content::Message(tried))?;
            }
        }
        Ok(plan)
    }

    /// `None` if the definition is stored or in the plan.
    fn unsent(
        &mut self,
        plant: &Plant,
        plan: &Plan<'_>,
        item: &CapturedMessage,
        (keys, topic, digest): (&EpochKeys, TopicId, Digest),
    ) -> Result<Option<StoredDefinition>> {
        let (owner, held) = (item.author.address, item.doubt.is_some());
        let definition = StoredDefinition { domain: keys.domain, owner, epoch: keys.epoch, topic, digest, held };
        if plan.definitions.contains(&definition) || self.definitions.contains(&definition) {
            return Ok(None);
        }
        if plant.ledger.notes.read(&definition)?.is_none() {
            return Ok(Some(definition));
        }
        self.note_stored(definition);
        Ok(None)
    }

    /// A definition that is forgotten is looked for in the ledger again.
    pub fn note_stored(&mut self, definition: StoredDefinition) {
        if self.definitions.len() >= MOST_DEFINITIONS {
            self.definitions.clear();
        }
        self.definitions.insert(definition);
    }

    /// SM3 of a definition; a text at the same address as the topic's last one is the same.
    pub fn definition_digest(&mut self, plant: &Plant, topic: &Arc<str>, definition: &Arc<str>) -> Digest {
        if let Some((_, digest)) = self.last.get(topic).filter(|(last, _)| Arc::ptr_eq(last, definition)) {
            return *digest;
        }
        let digest = self.hash(plant, definition);
        if self.last.len() >= MOST_HASHES {
            self.last.clear();
        }
        self.last.insert(Arc::clone(topic), (Arc::clone(definition), digest));
        digest
    }

    fn hash(&mut self, plant: &Plant, definition: &Arc<str>) -> Digest {
        if let Some(digest) = self.hashes.get(definition) {
            return *digest;
        }
        if self.hashes.len() >= MOST_HASHES {
            self.hashes.clear();
        }
        let digest = Digest(plant.provider.sm3(&[definition.as_bytes()]));
        self.hashes.insert(Arc::clone(definition), digest);
        digest
    }

    fn next_seq(&self, plant: &Plant, stream: Stream, plan: &mut Plan<'_>) -> Result<u64> {
        let seq = match plan.seqs.get(&stream).or_else(|| self.seqs.get(&stream)) {
            Some(last) => last + 1,
            None => plant.ledger.records.next_seq(stream.0, stream.1, stream.2)?,
        };
        plan.seqs.insert(stream, seq);
        Ok(seq)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Domain;

    #[test]
    fn epoch_after_epoch_no_more_definitions_are_remembered_than_the_bound() {
        let mut planner = Planner::new();
        for epoch in 0..2 * MOST_DEFINITIONS as u64 + 10 {
            planner.note_stored(StoredDefinition {
                domain: Domain([1; 32]),
                owner: Address([2; 20]),
                epoch,
                topic: TopicId([3; 16]),
                digest: Digest([4; 32]),
                held: false,
            });
            assert!(planner.definitions.len() <= MOST_DEFINITIONS);
        }
    }
}
