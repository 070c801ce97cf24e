//! One reader of a topic, and the samples it takes.

use std::time::Instant;

use crate::Ros2Error;
use crate::graph::Id;
use crate::quality::{self, Raw, RawAdapter, RawDecoder, Request};
use rustdds::mio1::{Interest, Registry, Token};
use rustdds::no_key::SimpleDataReader;
use rustdds::with_key::{DataReader, Sample};
use rustdds::{DomainParticipant, QosPolicies, RTPSEntity, ReadCondition, Subscriber, Timestamp, Topic, TopicKind};

/// Samples, and about how many bytes, before another topic has its turn.
const TURN: usize = 256;
const TURN_BYTES: usize = 4 << 20;

pub struct Taken {
    pub writer: Id,
    pub number: i64,
    /// Nanoseconds since 1970.
    pub sent: Option<u64>,
    /// Nanoseconds since 1970.
    pub arrived: u64,
    pub bytes: Vec<u8>,
}

/// A topic, and a type that its writers use.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Subject {
    pub dds_topic: String,
    pub dds_type: String,
    /// Writers whose type has a key accept only readers that say so too.
    pub keyed: bool,
}

impl Subject {
    fn kind(&self) -> TopicKind {
        if self.keyed { TopicKind::WithKey } else { TopicKind::NoKey }
    }
}

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
            // The topic's cache already holds samples of another reader; nobody is matched yet.
            drop(reader.take(usize::MAX, ReadCondition::any()));
        }
        Ok(Self::Keyed(Box::new(reader)))
    }
}

pub struct Reading {
    pub subject: Subject,
    pub request: Request,
    pub ready: bool,
    /// When it leaves, if another has replaced it.
    pub retires: Option<Instant>,
    /// It goes on only so that no writer waits for it; its samples are dropped.
    pub leaves: bool,
    /// Older samples in the topic's cache belong to another reader, unless it is latched.
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

    pub fn id(&self) -> Id {
        match &self.port {
            Port::Plain(reader) => reader.guid().to_bytes(),
            Port::Keyed(reader) => reader.guid().to_bytes(),
        }
    }

    pub fn kept(&self) -> usize {
        self.depth * self.largest
    }

    /// Keeps as many samples as the bytes allow. A topic's number only grows.
    pub fn deepen(&mut self, participant: &DomainParticipant, others: usize) {
        let depth = quality::depth(self.largest, others);
        if self.largest == 0 || depth < self.depth.saturating_mul(2) {
            return;
        }
        let policies = quality::policies(self.request, depth);
        let (topic, type_name) = (self.subject.dds_topic.clone(), self.subject.dds_type.clone());
        // Creating the topic again gives its cache the greater depth.
        if participant.create_topic(topic, type_name, &policies, self.subject.kind()).is_ok() {
            self.depth = depth;
        }
    }

    /// At most one turn's worth.
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

    pub fn end(mut self, registry: &Registry) {
        drop(match &mut self.port {
            Port::Plain(reader) => registry.deregister(&mut **reader),
            Port::Keyed(reader) => registry.deregister(&mut **reader),
        });
    }
}

/// Skips samples too old for this reader; whether there may be more.
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
            // A sample that cannot be taken is skipped; its missing number is counted.
            Err(_) => bytes += TURN_BYTES / TURN,
        }
    }
    true
}

/// Takes everything: rustdds empties the topic's cache in any case. A sample that only ends a key is no message.
/// rustdds does not tell the arrival: it is now.
fn take_keyed(reader: &mut DataReader<Raw, RawAdapter>, into: &mut Vec<Taken>) -> bool {
    // An error is a sample that cannot be taken; the next take returns those behind it.
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
