//! One reader for one topic and type, and the samples taken from it at a time.

use std::time::Instant;

use rustdds::mio1::{Interest, Registry, Token};
use rustdds::no_key::SimpleDataReader;
use rustdds::{DomainParticipant, Subscriber, Timestamp, TopicKind};

use crate::Ros2Error;
use crate::graph::Id;
use crate::quality::{self, Request};
use crate::raw::{Raw, RawAdapter, RawDecoder};

/// The most samples taken before another topic has its turn, and about how many bytes.
const TURN: usize = 256;
const TURN_BYTES: usize = 4 << 20;

/// A sample on its way to the site.
pub struct Taken {
    /// Its writer.
    pub writer: Id,
    /// Its number.
    pub number: i64,
    /// When it was published, nanoseconds.
    pub sent: Option<u64>,
    /// When it arrived, nanoseconds.
    pub arrived: u64,
    /// Header and body.
    pub bytes: Vec<u8>,
}

/// A reader.
pub struct Reading {
    /// The topic's DDS name.
    pub dds_topic: String,
    /// The type's DDS name.
    pub dds_type: String,
    /// The request.
    pub request: Request,
    /// Whether there may be something to take.
    pub ready: bool,
    /// When it is to leave, if another has replaced it.
    pub retires: Option<Instant>,
    /// Whether it is leaving: it goes on only so that no writer waits for it, and what it takes is thrown away.
    pub leaves: bool,
    /// When it began: older samples in the topic's cache belong to another reader, unless it is latched.
    begun: Timestamp,
    /// Bytes of the largest sample.
    largest: usize,
    depth: usize,
    reader: SimpleDataReader<Raw, RawAdapter>,
}

fn refused(error: impl std::fmt::Debug) -> Ros2Error {
    Ros2Error::System { action: "make a reader", reason: format!("{error:?}") }
}

impl Reading {
    /// Starts reading.
    ///
    /// # Errors
    /// [`Ros2Error::System`] with the words of the network code.
    pub fn begin(
        (participant, subscriber): (&DomainParticipant, &Subscriber),
        (dds_topic, dds_type): (&str, &str),
        request: Request,
        (registry, token): (&Registry, Token),
    ) -> Result<Self, Ros2Error> {
        let (depth, begun) = (quality::FIRST_DEPTH, Timestamp::now());
        let policies = quality::policies(request, depth);
        let topic = participant
            .create_topic(dds_topic.to_owned(), dds_type.to_owned(), &policies, TopicKind::NoKey)
            .map_err(refused)?;
        let mut reader =
            subscriber.create_simple_datareader_no_key::<Raw, RawAdapter>(&topic, Some(policies)).map_err(refused)?;
        registry
            .register(&mut reader, token, Interest::READABLE)
            .map_err(|error| Ros2Error::system("wait for samples", &error))?;
        let (dds_topic, dds_type) = (dds_topic.to_owned(), dds_type.to_owned());
        Ok(Self {
            dds_topic,
            dds_type,
            request,
            ready: true,
            retires: None,
            leaves: false,
            begun,
            largest: 0,
            depth,
            reader,
        })
    }

    /// Its id in the domain.
    pub fn id(&self) -> Id {
        self.reader.guid().to_bytes()
    }

    /// Bytes that may be kept of this topic.
    pub fn kept(&self) -> usize {
        self.depth * self.largest
    }

    /// From now on as many samples are kept as the bytes allow. The number kept of a topic only ever grows.
    pub fn deepen(&mut self, participant: &DomainParticipant, others: usize) {
        let depth = quality::depth(self.largest, others);
        if self.largest == 0 || depth < self.depth.saturating_mul(2) {
            return;
        }
        let policies = quality::policies(self.request, depth);
        let (topic, type_name) = (self.dds_topic.clone(), self.dds_type.clone());
        // The topic's cache takes over the greater depth when the topic is created again.
        if participant.create_topic(topic, type_name, &policies, TopicKind::NoKey).is_ok() {
            self.depth = depth;
        }
    }

    /// Takes what is available, but no more than one turn's worth.
    pub fn take(&mut self, into: &mut Vec<Taken>) {
        self.reader.drain_read_notifications();
        let (mut bytes, before) = (0, into.len());
        while into.len() - before < TURN && bytes < TURN_BYTES {
            match self.reader.try_take_one_with(RawDecoder) {
                Ok(Some(change)) if change.receive_instant < self.begun && !self.request.latched => {}
                Ok(Some(change)) => {
                    let writer = change.writer_guid().to_bytes();
                    let number = i64::from(change.sequence_number);
                    let sent = change.source_timestamp().and_then(nanoseconds);
                    let arrived = nanoseconds(change.receive_instant).unwrap_or(0);
                    let sample = change.into_value().0;
                    bytes += sample.len();
                    self.largest = self.largest.max(sample.len());
                    into.push(Taken { writer, number, sent, arrived, bytes: sample });
                }
                Ok(None) => {
                    self.ready = false;
                    return;
                }
                // A sample that cannot be taken is skipped; its number is then missing, and counted.
                Err(_) => bytes += TURN_BYTES / TURN,
            }
        }
    }

    /// No longer waited for.
    pub fn end(mut self, registry: &Registry) {
        drop(registry.deregister(&mut self.reader));
    }
}

/// Nanoseconds since 1970; `None` for an invalid time.
fn nanoseconds(time: Timestamp) -> Option<u64> {
    if time == Timestamp::INVALID || time == Timestamp::ZERO || time == Timestamp::INFINITE {
        return None;
    }
    let ticks = time.to_ticks();
    let fraction = ((ticks & 0xffff_ffff) * 1_000_000_000 + (1 << 31)) >> 32;
    Some((ticks >> 32) * 1_000_000_000 + fraction)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_come_back_to_the_nanosecond() {
        for whole in [1_u64, 999_999_999, 1_500_000_000_123_456_789, 1_795_000_000_000_000_001] {
            let fraction = ((whole % 1_000_000_000) << 32) / 1_000_000_000;
            let ticks = ((whole / 1_000_000_000) << 32) + fraction;
            assert_eq!(nanoseconds(Timestamp::from_ticks(ticks)), Some(whole));
        }
        assert_eq!(nanoseconds(Timestamp::INVALID), None);
    }
}
