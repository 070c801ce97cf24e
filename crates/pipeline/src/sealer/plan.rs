//! The plan of a round, made in order before anything is sealed: keys, numbers, definitions that go first, and what to
//! compress. The result does not depend on which thread seals what when.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use crate::crypto::compression::{Packed, pack};
use crate::epoch::{EpochKeys, TopicKeys};
use crate::model::{Address, Digest, RecordKind, RecorderPrefix, SignerId, TopicId};
use crate::ros::{Definition, Message};
use crate::{PipelineError, Plant, Result, recorder::CapturedMessage, store::notes::StoredDefinition};

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

// Which captured messages are compressed before they are sealed. Learns per topic whether that pays, so that topics of
// JPEGs cost only an occasional try.

/// The longest pause between two tries on a topic where compression does not pay, messages.
const LONGEST_PAUSE: u32 = 256;

/// The most topics and definitions remembered.
const MOST_KNOWN: usize = 1024;

#[derive(Debug, Default)]
struct Habit {
    /// Messages to skip before the next try.
    waits: u32,
    /// How many were skipped the last time.
    pause: u32,
}

#[derive(Debug, Default)]
pub struct Packing {
    habits: HashMap<Arc<str>, Habit>,
    definitions: HashMap<Arc<str>, Option<Arc<Definition>>>,
}

#[derive(Debug)]
pub struct Try {
    definition: Option<Arc<Definition>>,
}

impl Try {
    pub fn pack(&self, message: &Message) -> Option<Packed> {
        let matrix = self.definition.as_ref().and_then(|definition| definition.matrix(&message.body));
        pack(&message.body, matrix.as_ref())
    }
}

impl Packing {
    /// Pass each outcome to [`Self::learn`], topic by topic in the order of messages.
    pub fn decide(&mut self, message: &Message) -> Option<Try> {
        let habit = entry(&mut self.habits, &message.topic);
        if habit.waits > 0 {
            habit.waits -= 1;
            return None;
        }
        if habit.pause > 0 {
            // Until the outcome is known, the last one is assumed: others of its round are not tried in vain.
            habit.waits = next_pause(habit.pause);
        }
        if self.definitions.len() >= MOST_KNOWN && !self.definitions.contains_key(&message.definition) {
            self.definitions.clear();
        }
        let parsed = || {
            let (name, text) = (&message.type_name, &message.definition);
            let parse = if name.contains("/msg/") { Definition::parse_ros2 } else { Definition::parse };
            parse(name, text).ok().map(Arc::new)
        };
        let definition = self.definitions.entry(Arc::clone(&message.definition)).or_insert_with(parsed).clone();
        Some(Try { definition })
    }

    pub fn learn(&mut self, topic: &Arc<str>, paid: bool) {
        let habit = entry(&mut self.habits, topic);
        habit.pause = if paid { 0 } else { next_pause(habit.pause) };
        habit.waits = habit.pause;
    }
}

fn next_pause(pause: u32) -> u32 {
    (pause * 2).clamp(1, LONGEST_PAUSE)
}

fn entry<'a>(habits: &'a mut HashMap<Arc<str>, Habit>, topic: &Arc<str>) -> &'a mut Habit {
    if habits.len() >= MOST_KNOWN && !habits.contains_key(topic) {
        habits.clear();
    }
    habits.entry(Arc::clone(topic)).or_default()
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

#[cfg(test)]
mod packing_tests {
    use super::*;
    use crate::model::Timestamp;
    use crate::pipeline::fixture;

    fn message(topic: &str, body: Vec<u8>) -> Message {
        fixture::message(topic, Timestamp(1), body)
    }

    #[test]
    fn what_never_pays_is_tried_ever_more_rarely_and_what_pays_each_time() {
        let mut packing = Packing::default();
        let mut pack = |message: Message| {
            let packed = packing.decide(&message).map(|tried| tried.pack(&message));
            packed.iter().for_each(|packed| packing.learn(&message.topic, packed.is_some()));
            packed.flatten()
        };
        let mut state = 7u32;
        let mut noise = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            state.to_le_bytes()[3]
        };
        let noise: Vec<u8> = (0..2000).map(|_| noise()).collect();
        for _ in 0..600 {
            assert_eq!(pack(message("/noise", noise.clone())), None);
            assert!(pack(message("/zeros", vec![0; 2000])).is_some_and(|packed| packed.bytes.len() < 100));
        }
        // Once it pays again, the next try finds it.
        let found = (0..=LONGEST_PAUSE).filter(|_| pack(message("/noise", vec![0; 2000])).is_some()).count();
        assert!(found > 0);
        assert!((0..100).all(|_| pack(message("/noise", vec![0; 2000])).is_some()), "from then on each time");
    }

    #[test]
    fn a_round_in_which_nothing_is_known_yet_tries_no_more_than_one_of_what_did_not_pay() {
        let mut packing = Packing::default();
        let one = message("/noise", vec![0; 200]);
        for round in 0..8 {
            let tried = (0..100).filter(|_| packing.decide(&one).is_some()).count();
            assert!(if round == 0 { tried == 100 } else { tried <= 2 }, "{tried} in round {round}");
            (0..tried).for_each(|_| packing.learn(&one.topic, false));
        }
        assert_eq!(packing.habits["/noise"].pause, LONGEST_PAUSE);
    }
}
