//! One reader of a topic, and the samples that it takes as they are.

use std::time::Instant;

use crate::Ros2Error;
use crate::graph::Id;
use crate::quality::{self, Raw, RawAdapter, RawDecoder, Request};
use rustdds::mio1::{Interest, Registry, Token};
use rustdds::no_key::SimpleDataReader;
use rustdds::with_key::{DataReader, Sample};
use rustdds::{DomainParticipant, QosPolicies, RTPSEntity, ReadCondition, Subscriber, Timestamp, Topic, TopicKind};

/// The most samples taken before another topic has its turn, and about how many bytes.
const TURN: usize = 256;
const TURN_BYTES: usize = 4 << 20;

/// A sample on its way to the site.
pub struct Taken {
    pub writer: Id,
    pub number: i64,
    /// When it was published, nanoseconds.
    pub sent: Option<u64>,
    /// When it arrived, nanoseconds.
    pub arrived: u64,
    pub bytes: Vec<u8>,
}

/// What is read: a topic, and a type that its writers use.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Subject {
    /// The topic's DDS name.
    pub dds_topic: String,
    /// The type's DDS name.
    pub dds_type: String,
    /// Whether the writers say that it has a key: they take only readers that say so, too.
    pub keyed: bool,
}

impl Subject {
    fn kind(&self) -> TopicKind {
        if self.keyed { TopicKind::WithKey } else { TopicKind::NoKey }
    }
}

/// How the network code reads.
enum Port {
    Plain(Box<SimpleDataReader<Raw, RawAdapter>>),
    Keyed(Box<DataReader<Raw, RawAdapter>>),
}

impl Port {
    fn open(
        subscriber: &Subscriber,
        topic: &Topic,
        (policies, latched): (QosPolicies, bool),
        keyed: bool,
    ) -> Result<Self, Ros2Error> {
        if !keyed {
            let reader = subscriber.create_simple_datareader_no_key(topic, Some(policies));
            return reader.map(Box::new).map(Self::Plain).map_err(refused);
        }
        let reader = subscriber.create_datareader::<Raw, RawAdapter>(topic, Some(quality::of_keyed(&policies)));
        let mut reader = reader.map_err(refused)?;
        if !latched {
            // What is in the topic's cache already belongs to another reader; nobody is matched yet.
            drop(reader.take(usize::MAX, ReadCondition::any()));
        }
        Ok(Self::Keyed(Box::new(reader)))
    }
}

pub struct Reading {
    pub subject: Subject,
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
    port: Port,
}

fn refused(error: impl std::fmt::Debug) -> Ros2Error {
    Ros2Error::System { action: "make a reader", reason: format!("{error:?}") }
}

impl Reading {
    pub fn begin(
        (participant, subscriber): (&DomainParticipant, &Subscriber),
        subject: Subject,
        request: Request,
        (registry, token): (&Registry, Token),
    ) -> Result<Self, Ros2Error> {
        let (depth, begun) = (quality::FIRST_DEPTH, Timestamp::now());
        let policies = quality::policies(request, depth);
        let (name, type_name) = (subject.dds_topic.clone(), subject.dds_type.clone());
        let topic = participant.create_topic(name, type_name, &policies, subject.kind()).map_err(refused)?;
        let mut port = Port::open(subscriber, &topic, (policies, request.latched), subject.keyed)?;
        match &mut port {
            Port::Plain(reader) => registry.register(&mut **reader, token, Interest::READABLE),
            Port::Keyed(reader) => registry.register(&mut **reader, token, Interest::READABLE),
        }
        .map_err(|error| Ros2Error::system("wait for samples", &error))?;
        Ok(Self { subject, request, ready: true, retires: None, leaves: false, begun, largest: 0, depth, port })
    }

    /// Its id in the domain.
    pub fn id(&self) -> Id {
        match &self.port {
            Port::Plain(reader) => reader.guid().to_bytes(),
            Port::Keyed(reader) => reader.guid().to_bytes(),
        }
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
        let (topic, type_name) = (self.subject.dds_topic.clone(), self.subject.dds_type.clone());
        // The topic's cache takes over the greater depth when the topic is created again.
        if participant.create_topic(topic, type_name, &policies, self.subject.kind()).is_ok() {
            self.depth = depth;
        }
    }

    /// Takes what is available, but no more than one turn's worth.
    pub fn take(&mut self, into: &mut Vec<Taken>) {
        let before = into.len();
        self.ready = match &mut self.port {
            Port::Plain(reader) => {
                let is_old = |received: Timestamp| received < self.begun && !self.request.latched;
                take_plain(reader, is_old, into)
            }
            Port::Keyed(reader) => take_keyed(reader, into),
        };
        let taken = into.iter().skip(before).map(|sample| sample.bytes.len());
        self.largest = taken.max().unwrap_or(0).max(self.largest);
    }

    /// No longer waited for.
    pub fn end(mut self, registry: &Registry) {
        drop(match &mut self.port {
            Port::Plain(reader) => registry.deregister(&mut **reader),
            Port::Keyed(reader) => registry.deregister(&mut **reader),
        });
    }
}

/// Takes samples that are not too old for this reader; whether there may be more.
fn take_plain(
    reader: &SimpleDataReader<Raw, RawAdapter>,
    is_old: impl Fn(Timestamp) -> bool,
    into: &mut Vec<Taken>,
) -> bool {
    reader.drain_read_notifications();
    let (mut bytes, before) = (0, into.len());
    while into.len() - before < TURN && bytes < TURN_BYTES {
        match reader.try_take_one_with(RawDecoder) {
            Ok(Some(change)) if is_old(change.receive_instant) => {}
            Ok(Some(change)) => {
                let writer = change.writer_guid().to_bytes();
                let number = i64::from(change.sequence_number);
                let sent = change.source_timestamp().and_then(nanoseconds);
                let arrived = nanoseconds(change.receive_instant).unwrap_or(0);
                let sample = change.into_value().0;
                bytes += sample.len();
                into.push(Taken { writer, number, sent, arrived, bytes: sample });
            }
            Ok(None) => return false,
            // A sample that cannot be taken is skipped; its number is then missing, and counted.
            Err(_) => bytes += TURN_BYTES / TURN,
        }
    }
    true
}

/// Takes all that the topic's cache has: the network code takes it out of there at once. What only says that a key is gone is no
/// message. When a sample arrived is not told: it counts as arrived now.
fn take_keyed(reader: &mut DataReader<Raw, RawAdapter>, into: &mut Vec<Taken>) -> bool {
    // An error is a sample that cannot be taken; those behind it are there the next time.
    let Ok(samples) = reader.take(usize::MAX, ReadCondition::any()) else { return true };
    let arrived = nanoseconds(Timestamp::now()).unwrap_or(0);
    for sample in samples {
        let (writer, number) = {
            let identity = sample.sample_info().sample_identity();
            (identity.writer_guid.to_bytes(), i64::from(identity.sequence_number))
        };
        let sent = sample.sample_info().source_timestamp().and_then(nanoseconds);
        if let Sample::Value(Raw(bytes)) = sample.into_value() {
            into.push(Taken { writer, number, sent, arrived, bytes });
        }
    }
    false
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
