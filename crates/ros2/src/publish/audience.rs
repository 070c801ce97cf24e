//! Who is in the domain: subscribers that have found our topics, and others who publish them.

use std::collections::{HashMap, HashSet};

use rustdds::discovery::DiscoveredReaderData;
use rustdds::{DomainParticipant, DomainParticipantStatusEvent, GUID};

use super::writing::Writing;
use crate::graph::{PROGRAM, Prefix};
use crate::names;

/// The most subscribers and participants remembered.
const MOST: usize = 20_000;

/// Who is there.
pub struct Audience {
    own: [u8; 12],
    participants: HashSet<[u8; 12]>,
    /// By our writer: the subscribers that it serves, or cannot serve.
    met: HashMap<GUID, HashSet<GUID>>,
}

fn prefix(id: GUID) -> [u8; 12] {
    let mut prefix = [0; 12];
    prefix.copy_from_slice(&id.to_bytes()[..12]);
    prefix
}

impl Audience {
    /// Nobody is known yet.
    pub fn new(own: GUID) -> Self {
        Self { own: prefix(own), participants: HashSet::new(), met: HashMap::new() }
    }

    /// Takes news of the domain.
    pub fn hear(&mut self, news: DomainParticipantStatusEvent) {
        use DomainParticipantStatusEvent as News;
        match news {
            News::ParticipantDiscovered { dpd } => {
                let found = prefix(dpd.guid);
                if found.get(..PROGRAM) != self.own.get(..PROGRAM) && self.participants.len() < MOST {
                    self.participants.insert(found);
                }
            }
            News::ParticipantLost { id, .. } => {
                let gone: &[u8] = id.as_ref();
                self.participants.retain(|known| known[..] != *gone);
            }
            News::RemoteReaderMatched { local_writer, remote_reader }
            | News::RemoteReaderQosIncompatible { local_writer, remote_reader, .. }
                if self.met.len() < MOST =>
            {
                self.met.entry(local_writer).or_default().insert(remote_reader);
            }
            _ => {}
        }
    }

    /// The other participants.
    pub fn present(&self) -> impl Iterator<Item = Prefix> {
        self.participants.iter().copied()
    }

    /// The number of other participants.
    pub fn participants(&self) -> u32 {
        u32::try_from(self.participants.len()).unwrap_or(u32::MAX)
    }

    /// The number of a topic's known subscribers, if all of them have been met.
    pub fn has_found(&self, readers: &[DiscoveredReaderData], writing: &Writing) -> Option<usize> {
        let met = self.met.get(&writing.id());
        let mut known = 0;
        for reader in readers {
            let data = &reader.subscription_topic_data;
            let wants = *data.topic_name() == writing.dds_topic && *data.type_name() == writing.dds_type;
            if !wants || prefix(data.key()) == self.own {
                continue;
            }
            known += 1;
            if !met.is_some_and(|met| met.contains(&data.key())) {
                return None;
            }
        }
        Some(known)
    }

    /// Somebody else who publishes a topic, as a description.
    pub fn rival(&self, participant: &DomainParticipant, topic: &str) -> Option<String> {
        let dds_topic = names::dds_topic(topic);
        let writers = participant.discovered_writers();
        let id = writers.iter().find_map(|writer| {
            let data = &writer.publication_topic_data;
            (data.topic_name == dds_topic && prefix(data.key) != self.own).then(|| data.key.to_bytes())
        })?;
        Some(format!("a {} publisher", names::vendor(id)))
    }
}
