//! One writer of one topic. The network code fixes the encoding of a writer's messages by a type; it writes the two
//! bytes after that, the header's options, as zeros.

use std::convert::Infallible;

use rustdds::bytes::Bytes;
use rustdds::no_key::{DataWriter, SerializerAdapter};
use rustdds::policy::{DataRepresentation, Durability, History, ResourceLimits};
use rustdds::qos::policy::{XCDR_DATA_REPRESENTATION, XCDR2_DATA_REPRESENTATION};
use rustdds::{
    DomainParticipant, Duration, GUID, Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity, RepresentationIdentifier,
    Timestamp, TopicKind, WriteOptionsBuilder,
};

use crate::names;
use crate::pipe::write::{Offer, Topic};
use crate::quality;

/// How long one attempt to write to a reliable topic may wait for room.
const ATTEMPT: Duration = Duration::from_millis(5);
/// The most messages of a latched topic that are kept before old ones are cleared away.
const LATCHED: usize = 8;
/// The most messages that a subscriber may ask a topic to keep.
const DEEPEST: u32 = 1000;

/// Bodies of one encoding, passed on as they are.
pub struct Encoded<const ID: u16>;

impl<const ID: u16> SerializerAdapter<Bytes> for Encoded<ID> {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::from_bytes(&ID.to_be_bytes()).unwrap_or(RepresentationIdentifier::CDR_LE)
    }

    fn to_bytes(value: &Bytes) -> Result<Bytes, Infallible> {
        Ok(value.clone())
    }
}

/// The result of an attempt to write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Attempt {
    /// It is on its way.
    Written,
    /// A subscriber is too far behind.
    Full,
    /// It cannot be written at all.
    Lost,
}

trait Write {
    fn write(&self, body: Bytes) -> Attempt;
    fn is_acknowledged(&self) -> bool;
    fn id(&self) -> GUID;
}

impl<const ID: u16> Write for DataWriter<Bytes, Encoded<ID>> {
    fn write(&self, body: Bytes) -> Attempt {
        // A congested socket is waited for, also without acknowledgements.
        let options = WriteOptionsBuilder::new().source_timestamp(Timestamp::now()).best_effort_may_block(true);
        match self.write_with_options(body, options.build()) {
            Ok(_) => Attempt::Written,
            Err(rustdds::dds::WriteError::WouldBlock { .. }) => Attempt::Full,
            Err(_) => Attempt::Lost,
        }
    }

    fn is_acknowledged(&self) -> bool {
        self.wait_for_acknowledgments(std::time::Duration::ZERO).unwrap_or(true)
    }

    fn id(&self) -> GUID {
        self.guid()
    }
}

/// A writer.
pub struct Writing {
    /// The topic's DDS name.
    pub dds_topic: String,
    /// The type's DDS name.
    pub dds_type: String,
    encoding: [u8; 2],
    /// Bytes that may be kept of it.
    kept: usize,
    /// Its subscribers are behind and no longer waited for.
    pub is_outrun: bool,
    writer: Box<dyn Write>,
}

impl Writing {
    /// Announces a topic, whose messages have about this size; all others keep `others` bytes.
    ///
    /// # Errors
    /// The reason, as a clause.
    pub fn begin(
        (participant, publisher): (&DomainParticipant, &Publisher),
        topic: &Topic,
        (size, others): (usize, usize),
    ) -> Result<Self, String> {
        let dds_topic = names::dds_topic(&topic.name);
        if names::topic(&dds_topic).is_none() {
            return Err(format!("{} is no name of a ROS 2 topic; give it another one with --remap", topic.name));
        }
        let Some(dds_type) = names::dds_type(&topic.type_name) else {
            return Err(format!("{} is no name of a ROS 2 type", topic.type_name));
        };
        let room = room(topic.offer, size, others);
        let policies = policies(topic.offer, room, topic.encoding);
        let made = participant
            .create_topic(dds_topic.clone(), dds_type.clone(), &policies, TopicKind::NoKey)
            .map_err(|error| format!("the topic cannot be made ({error:?})"))?;
        let writer = writer(topic.encoding, publisher, &made, policies)?;
        let encoding = topic.encoding.to_be_bytes();
        Ok(Self { dds_topic, dds_type, encoding, kept: room * size, is_outrun: false, writer })
    }

    /// Bytes that may be kept of it.
    pub fn kept(&self) -> usize {
        self.kept
    }

    /// Its id in the domain.
    pub fn id(&self) -> GUID {
        self.writer.id()
    }

    /// Tries to write a message, header included.
    pub fn write(&self, message: &Bytes) -> Attempt {
        if message.len() < 4 || message[..2] != self.encoding || message[2..4] != [0, 0] {
            return Attempt::Lost;
        }
        self.writer.write(message.slice(4..))
    }

    /// Whether all subscribers that asked for it have everything.
    pub fn is_acknowledged(&self) -> bool {
        self.writer.is_acknowledged()
    }
}

/// How many messages may be under way to subscribers.
fn room(offer: Offer, size: usize, others: usize) -> usize {
    let depth = offer.depth.clamp(1, DEEPEST) as usize;
    let room = quality::depth(size, others);
    // Whoever subscribes later is sent all that are kept, so there are few.
    if offer.latched { room.min(depth.max(LATCHED)) } else { room }
}

fn policies(offer: Offer, room: usize, encoding: u16) -> QosPolicies {
    let most = i32::try_from(room).unwrap_or(i32::MAX);
    let depth = i32::try_from(offer.depth.clamp(1, DEEPEST)).unwrap_or(1).min(most);
    let builder = QosPolicyBuilder::new()
        .durability(if offer.latched { Durability::TransientLocal } else { Durability::Volatile })
        .history(History::KeepLast { depth })
        .resource_limits(ResourceLimits { max_samples: most, max_instances: 1, max_samples_per_instance: most });
    let builder = if offer.reliable { builder.reliable(ATTEMPT) } else { builder.best_effort() };
    let of_first = encoding < 6;
    let value = vec![if of_first { XCDR_DATA_REPRESENTATION } else { XCDR2_DATA_REPRESENTATION }];
    builder.build().with_data_representation(DataRepresentation { value })
}

fn writer(
    encoding: u16,
    publisher: &Publisher,
    topic: &rustdds::Topic,
    policies: QosPolicies,
) -> Result<Box<dyn Write>, String> {
    fn made<const ID: u16>(
        publisher: &Publisher,
        topic: &rustdds::Topic,
        policies: QosPolicies,
    ) -> Result<Box<dyn Write>, String> {
        let writer = publisher.create_datawriter_no_key::<Bytes, Encoded<ID>>(topic, Some(policies));
        let writer = writer.map_err(|error| format!("its publisher cannot be made ({error:?})"))?;
        Ok(Box::new(writer))
    }
    let make = match encoding {
        0 => made::<0>,
        1 => made::<1>,
        2 => made::<2>,
        3 => made::<3>,
        6 => made::<6>,
        7 => made::<7>,
        8 => made::<8>,
        9 => made::<9>,
        10 => made::<10>,
        11 => made::<11>,
        _ => return Err(format!("messages of encoding {encoding:04x} cannot be published")),
    };
    make(publisher, topic, policies)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offer(latched: bool, depth: u32) -> Offer {
        Offer { reliable: true, latched, depth }
    }

    #[test]
    fn a_latched_topic_keeps_few_and_large_messages_keep_fewer() {
        assert_eq!(room(offer(true, 1), 100, 0), 8);
        assert_eq!(room(offer(true, 20), 100, 0), 20);
        assert_eq!(room(offer(false, 1), 100, 0), 1000);
        assert_eq!(room(offer(false, 1), 8 << 20, 0), 4);
        assert_eq!(room(offer(true, u32::MAX), 100, 0), 1000);
    }

    #[test]
    fn the_offer_is_said_in_terms_of_dds() {
        let said = policies(Offer { reliable: false, latched: true, depth: 3 }, 8, 7);
        assert_eq!(said.durability(), Some(Durability::TransientLocal));
        assert_eq!(said.history(), Some(History::KeepLast { depth: 3 }));
        assert!(!said.is_reliable());
        assert_eq!(said.data_representation().map(|said| said.value), Some(vec![XCDR2_DATA_REPRESENTATION]));
        let said = policies(offer(false, 0), 4, 1);
        assert!(said.is_reliable() && said.is_volatile());
        assert_eq!(said.data_representation().map(|said| said.value), Some(vec![XCDR_DATA_REPRESENTATION]));
    }
}
