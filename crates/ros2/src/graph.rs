//! The participants and writers of the domain; changes are reported to the site.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use rustdds::discovery::DiscoveredWriterData;

use crate::names;
use crate::nodes::Nodes;
use crate::pipe::read::{Counts, Quality, Told, Writer};
use crate::quality;

/// The most writers reported.
const MOST_WRITERS: usize = 20_000;

/// An id of DDS.
pub type Id = [u8; 16];
/// The common prefix of one participant's ids.
pub type Prefix = [u8; 12];

/// A writer as DDS names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Its topic.
    pub dds_topic: String,
    /// Its type.
    pub dds_type: String,
    /// Whether its type has a key.
    pub keyed: bool,
    /// Its offer.
    pub quality: Quality,
    /// In the site's form; `None` if it is not of ROS 2.
    pub told: Option<Writer>,
}

/// The present writers and participants.
#[derive(Default)]
pub struct Graph {
    own: Prefix,
    participants: BTreeSet<Prefix>,
    writers: BTreeMap<Id, Found>,
    /// Ids known to the site, including those of writers that are gone.
    known: HashSet<Id>,
}

/// How much of a prefix the participants of one program have in common: its own, and those that say what of it is gone.
pub const PROGRAM: usize = 8;

/// The prefix of an id.
pub fn prefix(id: &Id) -> Prefix {
    let mut prefix = [0; 12];
    prefix.copy_from_slice(&id[..12]);
    prefix
}

impl Graph {
    /// Nobody is known yet; `own` is this process's participant.
    pub fn new(own: &Id) -> Self {
        Self { own: prefix(own), ..Self::default() }
    }

    /// A participant appeared.
    pub fn came(&mut self, participant: &[u8]) {
        if let Ok(found) = Prefix::try_from(participant)
            && found.get(..PROGRAM) != self.own.get(..PROGRAM)
            && self.participants.len() < MOST_WRITERS
        {
            self.participants.insert(found);
        }
    }

    /// A participant is gone.
    pub fn left(&mut self, participant: &[u8]) {
        self.participants.retain(|known| known[..] != *participant);
    }

    /// The present participants.
    pub fn participants(&self) -> impl Iterator<Item = Prefix> {
        self.participants.iter().copied()
    }

    /// Whether a participant is present, by the prefix of its ids.
    pub fn is_there(&self, participant: &[u8]) -> bool {
        self.participants.iter().any(|known| known[..] == *participant)
    }

    /// Writers of a topic, by its DDS name.
    pub fn of_topic<'a>(&'a self, dds_topic: &'a str) -> impl Iterator<Item = &'a Found> {
        self.writers.values().filter(move |found| found.dds_topic == dds_topic)
    }

    /// The id of a writer of a topic and type, by their DDS names.
    pub fn writer_of(&self, dds_topic: &str, dds_type: &str) -> Option<Id> {
        let is_it = |found: &Found| found.dds_topic == dds_topic && found.dds_type == dds_type;
        self.writers.iter().find_map(|(id, found)| is_it(found).then_some(*id))
    }

    /// Whether this writer was reported to the site.
    pub fn knows(&self, id: &Id) -> bool {
        self.known.contains(id)
    }

    /// Takes the present writers; returns what to report.
    pub fn look(&mut self, now: &[DiscoveredWriterData], nodes: &Nodes) -> Vec<Told> {
        let mut told = Vec::new();
        let mut there = BTreeMap::new();
        let is_naming = |writer: &&DiscoveredWriterData| writer.publication_topic_data.topic_name == names::NODES;
        let naming = now.iter().filter(is_naming);
        let naming: BTreeSet<Prefix> =
            naming.map(|writer| prefix(&writer.publication_topic_data.key.to_bytes())).collect();
        for writer in now.iter().take(MOST_WRITERS) {
            let id = writer.publication_topic_data.key.to_bytes();
            if prefix(&id) == self.own {
                continue;
            }
            let mut found = found(id, writer, nodes);
            if let Some(told) = &mut found.told {
                told.naming = naming.contains(&prefix(&id));
            }
            if self.writers.get(&id) != Some(&found)
                && let Some(writer) = &found.told
            {
                self.know(id);
                told.push(Told::WriterHere(writer.clone()));
            }
            there.insert(id, found);
        }
        let gone = self.writers.iter().filter(|(id, found)| found.told.is_some() && !there.contains_key(*id));
        told.extend(gone.map(|(id, _)| Told::WriterGone { id: names::hex(id) }));
        let seen: BTreeSet<Prefix> = there.keys().map(prefix).collect();
        seen.iter().for_each(|participant| self.came(participant));
        self.writers = there;
        told
    }

    /// Reports a writer that is known only from its samples: the rest of what it is will be announced.
    pub fn by_sample(&mut self, id: Id, dds_topic: &str, dds_type: &str) -> Option<Told> {
        let quality = Quality::default();
        let writer = writer(id, dds_topic, dds_type, (None, quality), None)?;
        self.know(id);
        Some(Told::WriterHere(Writer { naming: true, ..writer }))
    }

    fn know(&mut self, id: Id) {
        if self.known.len() >= 2 * MOST_WRITERS {
            let writers = &self.writers;
            self.known.retain(|id| writers.contains_key(id));
        }
        self.known.insert(id);
    }

    /// Their counts.
    pub fn counts(&self) -> Counts {
        let count = |number: usize| u32::try_from(number).unwrap_or(u32::MAX);
        let own = self.writers.values().filter(|found| found.told.is_some()).count();
        let foreign =
            self.writers.values().filter(|found| found.told.is_none() && is_foreign(&found.dds_topic)).count();
        Counts { participants: count(self.participants.len()), writers: count(own), foreign: count(foreign) }
    }
}

/// Services, and ROS 2's own topics, belong to ROS 2 although they are not topics that a user names.
fn is_foreign(dds_topic: &str) -> bool {
    !["rt/", "rq/", "rr/", "rs/", "ra/"].iter().any(|own| dds_topic.starts_with(own)) && dds_topic != names::NODES
}

fn found(id: Id, writer_data: &DiscoveredWriterData, nodes: &Nodes) -> Found {
    let data = &writer_data.publication_topic_data;
    let quality = quality::offered(data);
    let hash = names::type_hash(&writer_data.user_data);
    let told = writer(id, &data.topic_name, &data.type_name, (hash, quality), nodes.of(&id));
    let (dds_topic, dds_type) = (data.topic_name.clone(), data.type_name.clone());
    // The last byte says what kind of endpoint it is: of the writers, 2 has a key, and 3 none.
    let keyed = id[15] & 0x3f == 2;
    Found { dds_topic, dds_type, keyed, quality, told }
}

fn writer(
    id: Id,
    dds_topic: &str,
    dds_type: &str,
    (type_hash, quality): (Option<String>, Quality),
    node: Option<&str>,
) -> Option<Writer> {
    Some(Writer {
        id: names::hex(&id),
        topic: names::topic(dds_topic)?,
        type_name: names::type_name(dds_type)?,
        type_hash,
        quality,
        node: node.map(str::to_owned),
        naming: false,
        vendor: names::vendor(id),
    })
}
