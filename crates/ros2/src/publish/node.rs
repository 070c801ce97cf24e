//! The node of this publisher in the graph of ROS 2: a message on a topic of its own names it and lists its writers. Its
//! form is that of Iron and later, told apart from Humble's by the type hash that goes with it; nodes of Humble can stop over the
//! other form, so it is published only where somebody else publishes it and nobody publishes Humble's.

use rustdds::bytes::Bytes;
use rustdds::discovery::DiscoveredWriterData;
use rustdds::no_key::DataWriter;
use rustdds::policy::{DataRepresentation, Durability, History};
use rustdds::qos::policy::XCDR_DATA_REPRESENTATION;
use rustdds::{DomainParticipant, Duration, GUID, Publisher, QosPolicyBuilder, RTPSEntity, TopicKind};

use super::writing::Encoded;
use crate::names;

/// The node's name, in the root namespace.
const NAME: &str = "authros_bridge";
const TYPE: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// What the graph was told of this node.
#[derive(Default)]
pub struct Node {
    writer: Option<DataWriter<Bytes, Encoded<1>>>,
    told: Vec<GUID>,
}

impl Node {
    /// Tells the graph of these writers, if that is news and harms nobody among the writers of the domain.
    pub fn tell(
        &mut self,
        (participant, publisher): (&DomainParticipant, &Publisher),
        there: &[DiscoveredWriterData],
        writers: Vec<GUID>,
    ) {
        if !is_welcome(there.iter().filter(|writer| of_others(writer, participant)).map(|writer| &*writer.user_data)) {
            // What was published is no longer kept for late subscribers.
            *self = Self::default();
            return;
        }
        if writers == self.told {
            return;
        }
        if self.writer.is_none() {
            self.writer = begin(participant, publisher);
        }
        let message = Bytes::from(message(participant.guid(), &writers));
        if self.writer.as_ref().is_some_and(|writer| writer.write(message, None).is_ok()) {
            self.told = writers;
        }
    }
}

fn of_others(writer: &DiscoveredWriterData, participant: &DomainParticipant) -> bool {
    let data = &writer.publication_topic_data;
    data.topic_name == names::NODES && data.key.to_bytes()[..12] != participant.guid().to_bytes()[..12]
}

/// Whether what others say beside their lists of nodes shows that they use this form, all of them.
fn is_welcome<'a>(mut told: impl Iterator<Item = &'a [u8]>) -> bool {
    let is_new = |told: &[u8]| names::type_hash(told).is_some();
    told.next().is_some_and(is_new) && told.all(is_new)
}

fn begin(participant: &DomainParticipant, publisher: &Publisher) -> Option<DataWriter<Bytes, Encoded<1>>> {
    let policies = QosPolicyBuilder::new()
        .durability(Durability::TransientLocal)
        .history(History::KeepLast { depth: 1 })
        .reliable(Duration::from_millis(100))
        .build()
        .with_data_representation(DataRepresentation { value: vec![XCDR_DATA_REPRESENTATION] });
    let topic = participant.create_topic(names::NODES.into(), TYPE.into(), &policies, TopicKind::NoKey).ok()?;
    publisher.create_datawriter_no_key(&topic, Some(policies)).ok()
}

/// `rmw_dds_common`'s `ParticipantEntitiesInfo` with one node, without the four bytes of header.
fn message(participant: GUID, writers: &[GUID]) -> Vec<u8> {
    let mut body = participant.to_bytes().to_vec();
    let put_count = |body: &mut Vec<u8>, count: usize| {
        body.resize(body.len().next_multiple_of(4), 0);
        body.extend(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
    };
    put_count(&mut body, 1);
    for text in ["/", NAME] {
        put_count(&mut body, text.len() + 1);
        body.extend(text.bytes().chain([0]));
    }
    put_count(&mut body, 0);
    put_count(&mut body, writers.len());
    body.extend(writers.iter().flat_map(|writer| writer.to_bytes()));
    body
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nodes::Nodes;

    #[test]
    fn the_message_names_the_node_of_each_writer() {
        let participant = GUID::GUID_UNKNOWN;
        let writers = [GUID::GUID_UNKNOWN, GUID::GUID_UNKNOWN];
        let mut nodes = Nodes::default();
        nodes.take(&participant.to_bytes(), &[vec![0, 1, 0, 0], message(participant, &writers)].concat());
        assert_eq!(nodes.of(&writers[0].to_bytes()), Some("/authros_bridge"));
    }

    #[test]
    fn nodes_of_humble_are_spared() {
        let new: &[u8] = b"typehash=RIHS01_0000000000000000000000000000000000000000000000000000000000000000;";
        assert!(is_welcome([new, new].into_iter()));
        for told in [vec![], vec![b"".as_slice()], vec![new, b""], vec![b"", new]] {
            assert!(!is_welcome(told.into_iter()));
        }
    }
}
