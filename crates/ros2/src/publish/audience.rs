//! Who is in the domain: subscribers that have found our topics, and others who publish them.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use rustdds::discovery::DiscoveredReaderData;
use rustdds::{DomainParticipant, DomainParticipantStatusEvent, GUID};

use super::ahead::Addresses;
use super::writing::Writing;
use crate::graph::{PROGRAM, Prefix};
use crate::names;

/// The most subscribers and participants remembered.
const MOST: usize = 20_000;

/// Who is there.
pub struct Audience {
    own: [u8; 12],
    /// The others, and whether each has told anything that it reads or writes: a node of ROS 2 has something from its start.
    participants: HashMap<[u8; 12], bool>,
    /// By our writer: the subscribers that it has met, and whether it serves them.
    met: HashMap<GUID, HashMap<GUID, bool>>,
    /// When somebody was found last.
    found: Instant,
}

fn prefix(id: GUID) -> [u8; 12] {
    let mut prefix = [0; 12];
    prefix.copy_from_slice(&id.to_bytes()[..12]);
    prefix
}

impl Audience {
    /// Nobody is known yet.
    pub fn new(own: GUID) -> Self {
        Self { own: prefix(own), participants: HashMap::new(), met: HashMap::new(), found: Instant::now() }
    }

    /// Takes news of the domain.
    pub fn hear(&mut self, news: DomainParticipantStatusEvent) {
        use DomainParticipantStatusEvent as News;
        match news {
            News::ParticipantDiscovered { dpd } => self.came(prefix(dpd.guid), false),
            News::ReaderDetected { reader: endpoint } | News::WriterDetected { writer: endpoint } => {
                self.came(prefix(endpoint.guid), true);
            }
            News::ParticipantLost { id, .. } => {
                let gone: &[u8] = id.as_ref();
                self.participants.retain(|known, _| known[..] != *gone);
            }
            News::RemoteReaderMatched { local_writer, remote_reader } => self.meet((local_writer, remote_reader), true),
            News::RemoteReaderQosIncompatible { local_writer, remote_reader, .. } => {
                self.meet((local_writer, remote_reader), false);
            }
            _ => {}
        }
    }

    fn came(&mut self, participant: Prefix, has_told: bool) {
        self.found = Instant::now();
        if participant.get(..PROGRAM) != self.own.get(..PROGRAM) && self.participants.len() < MOST {
            *self.participants.entry(participant).or_default() |= has_told;
        }
    }

    fn meet(&mut self, (writer, reader): (GUID, GUID), is_served: bool) {
        if self.met.len() < MOST {
            let met = self.met.entry(writer).or_default();
            if met.len() < MOST {
                met.insert(reader, is_served);
            }
        }
    }

    /// The other participants.
    pub fn present(&self) -> impl Iterator<Item = Prefix> {
        self.participants.keys().copied()
    }

    /// The number of other participants.
    pub fn participants(&self) -> u32 {
        u32::try_from(self.participants.len()).unwrap_or(u32::MAX)
    }

    /// Whether everybody who is there has told something, and nobody was found for a while.
    pub fn is_settled(&self, after: Duration) -> bool {
        self.participants.values().all(|has_told| *has_told) && self.found.elapsed() >= after
    }

    fn of<'a>(
        &self,
        readers: &'a [DiscoveredReaderData],
        writing: &Writing,
    ) -> impl Iterator<Item = &'a DiscoveredReaderData> {
        let (topic, kind, own) = (writing.dds_topic.clone(), writing.dds_type.clone(), self.own);
        readers.iter().filter(move |reader| {
            let data = &reader.subscription_topic_data;
            *data.topic_name() == topic && *data.type_name() == kind && prefix(data.key()) != own
        })
    }

    /// The number of a topic's known subscribers, if all of them have been met.
    pub fn has_found(&self, readers: &[DiscoveredReaderData], writing: &Writing) -> Option<usize> {
        let met = self.met.get(&writing.id());
        let mut known = 0;
        for reader in self.of(readers, writing) {
            known += 1;
            if !met.is_some_and(|met| met.contains_key(&reader.subscription_topic_data.key())) {
                return None;
            }
        }
        Some(known)
    }

    /// Tells a writer where the subscribers are that it serves, and whether some of them do not acknowledge.
    pub fn show(&self, readers: &[DiscoveredReaderData], writing: &mut Writing) {
        let met = self.met.get(&writing.id());
        (writing.addresses, writing.has_best_effort) = (Addresses::default(), false);
        let served: Vec<&DiscoveredReaderData> = self
            .of(readers, writing)
            .filter(|reader| met.and_then(|met| met.get(&reader.subscription_topic_data.key())) == Some(&true))
            .collect();
        for reader in served {
            writing.addresses.add(reader.reader_proxy.unicast_locator_list.iter().map(|at| SocketAddr::from(*at)));
            writing.has_best_effort |= !writing.reliable || !reader.subscription_topic_data.qos().is_reliable();
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_participant_that_has_told_nothing_yet_is_waited_for() {
        let mut audience = Audience::new(GUID::from_bytes([1; 16]));
        assert!(audience.is_settled(Duration::ZERO), "nobody is there");
        audience.came([7; 12], false);
        assert!(!audience.is_settled(Duration::ZERO));
        audience.came([7; 12], true);
        assert!(audience.is_settled(Duration::ZERO) && !audience.is_settled(Duration::from_secs(60)));
        audience.came([7; 12], false);
        assert!(audience.is_settled(Duration::ZERO), "it is announced again and again");
        audience.came([1; 12], false);
        assert_eq!((audience.is_settled(Duration::ZERO), audience.participants()), (true, 1), "our own");
    }
}
