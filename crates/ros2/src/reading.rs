//! One reader of a topic, and the samples it takes.

use std::collections::{HashMap, VecDeque};
use std::time::Instant;

use rustdds::mio1::{Interest, Registry, Token};
use rustdds::no_key::SimpleDataReader;
use rustdds::with_key::{DataReader, Sample};
use rustdds::{DomainParticipant, QosPolicies, RTPSEntity, ReadCondition, Subscriber, Timestamp, Topic, TopicKind};

use crate::quality::{self, Raw, RawAdapter, RawDecoder, Request};
use crate::{Ros2Error, graph::Id};

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

// Moves each writer's messages from one participant of ours to its successor, none lost, doubled or out of order. The
// former one brings a writer's messages until the successor shows that it has the next; from then on the successor
// alone.

/// Bytes of messages that wait for those before them from the former one.
const MOST_HELD: usize = 32 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bringer {
    /// No other participant of ours reads.
    Only,
    Former,
    Successor,
}

#[derive(Default)]
struct Line {
    /// Numbers up to here were passed on before the present bringer's turn; the first message of a writer is 1.
    floor: i64,
    /// The highest number passed on.
    last: i64,
    is_heard: bool,
    is_handed: bool,
    /// The successor's messages beyond a gap.
    held: VecDeque<Taken>,
}

impl Line {
    fn pass(&mut self, sample: Taken, into: &mut Vec<Taken>) {
        self.last = self.last.max(sample.number);
        into.push(sample);
    }

    /// The successor has a message already passed on, or the next one: then it will have all that follow.
    fn is_reached(&self, number: i64) -> bool {
        number <= self.last.saturating_add(1)
    }

    fn hand_over(&mut self, held: &mut usize, into: &mut Vec<Taken>) {
        (self.is_handed, self.floor) = (true, self.last);
        for sample in std::mem::take(&mut self.held) {
            *held -= sample.bytes.len();
            if sample.number > self.floor {
                self.pass(sample, into);
            }
        }
    }
}

#[derive(Default)]
pub struct Lines {
    by_writer: HashMap<Id, Line>,
    held: usize,
}

impl Lines {
    /// Appends to `into`, in order, the messages to pass on now.
    pub fn follow(&mut self, sample: Taken, bringer: Bringer, into: &mut Vec<Taken>) {
        let line = self.by_writer.entry(sample.writer).or_default();
        match bringer {
            Bringer::Former if line.is_handed => {}
            Bringer::Successor if !line.is_handed => {
                let reaches = line.is_reached(sample.number) || self.held + sample.bytes.len() > MOST_HELD;
                if sample.number > line.last {
                    self.held += sample.bytes.len();
                    line.held.push_back(sample);
                }
                if reaches {
                    line.hand_over(&mut self.held, into);
                }
            }
            _ if sample.number <= line.floor => {}
            _ => {
                line.is_heard |= bringer == Bringer::Former;
                line.pass(sample, into);
                if line.held.front().is_some_and(|first| line.is_reached(first.number)) {
                    line.hand_over(&mut self.held, into);
                }
            }
        }
    }

    /// Whether the successor brings the messages of every writer that the former one has heard since.
    pub fn are_handed_over(&self) -> bool {
        self.by_writer.values().all(|line| line.is_handed || !line.is_heard)
    }

    pub fn end(&mut self, into: &mut Vec<Taken>) {
        for line in self.by_writer.values_mut() {
            if !line.is_handed {
                line.hand_over(&mut self.held, into);
            }
            (line.is_handed, line.is_heard) = (false, false);
        }
    }

    /// Forgets writers that are gone, or no longer read.
    pub fn keep(&mut self, is_read: impl Fn(&Id) -> bool) {
        self.by_writer.retain(|id, line| !line.held.is_empty() || is_read(id));
    }
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

#[cfg(test)]
mod handover_tests {
    use super::*;
    use Bringer::{Former, Only, Successor};

    /// What is passed on of one writer's messages, as its participants bring them.
    fn passed(brought: &[(Bringer, i64)]) -> (Vec<i64>, Lines) {
        let (mut lines, mut passed) = (Lines::default(), Vec::new());
        for (bringer, number) in brought {
            lines.follow(sample(*number, 1), *bringer, &mut passed);
        }
        (passed.iter().map(|sample| sample.number).collect(), lines)
    }

    fn sample(number: i64, size: usize) -> Taken {
        Taken { writer: [7; 16], number, sent: None, arrived: 0, bytes: vec![0; size] }
    }

    #[test]
    fn however_two_participants_take_turns_each_message_is_passed_on_once_and_in_order() {
        // The former one brings 1 to 5; the successor comes to know the writer before any of the messages 1 to 6, and
        // brings 8.
        for first in 1..=6 {
            let (former, successor): (Vec<i64>, Vec<i64>) = ((1..=5).collect(), (first..=8).collect());
            let steps = former.len() + successor.len();
            for order in 0..1_u32 << steps {
                if usize::try_from(order.count_ones()) != Ok(successor.len()) {
                    continue;
                }
                let (mut former, mut successor) = (former.iter(), successor.iter());
                let brought: Vec<_> = (0..steps)
                    .filter_map(|step| match (order >> step) & 1 {
                        1 => Some((Successor, *successor.next()?)),
                        _ => Some((Former, *former.next()?)),
                    })
                    .collect();
                let (numbers, lines) = passed(&brought);
                assert_eq!(numbers, (1..=8).collect::<Vec<_>>(), "{brought:?}");
                assert!(lines.are_handed_over(), "{brought:?}");
            }
        }
    }

    #[test]
    fn history_that_a_successor_is_sent_again_is_passed_over_as_long_as_it_reads() {
        let brought = [(Only, 4), (Only, 5), (Successor, 4), (Successor, 5), (Former, 6), (Successor, 6)];
        let (numbers, mut lines) = passed(&brought);
        assert_eq!(numbers, [4, 5, 6]);
        let mut after = Vec::new();
        lines.end(&mut after);
        for number in [5, 7] {
            lines.follow(sample(number, 1), Only, &mut after);
        }
        assert_eq!(after.iter().map(|sample| sample.number).collect::<Vec<_>>(), [7]);
        // Read anew, it is wanted again.
        lines.keep(|_| false);
        lines.follow(sample(4, 1), Only, &mut after);
        assert_eq!(after.len(), 2);
    }

    #[test]
    fn holes_of_a_writer_that_repeats_nothing_hold_nobody_up() {
        let (numbers, _) =
            passed(&[(Former, 2), (Former, 4), (Successor, 3), (Successor, 6), (Former, 5), (Successor, 8)]);
        assert_eq!(numbers, [2, 4, 6, 8], "from 3 on the successor's alone");
    }

    #[test]
    fn what_waits_beyond_a_gap_is_bounded_by_bytes_and_by_the_end() {
        let gap = [(Former, 1), (Successor, 5), (Successor, 6)];
        let (numbers, mut lines) = passed(&gap);
        assert_eq!((numbers, lines.are_handed_over()), (vec![1], false));
        let mut after = Vec::new();
        lines.keep(|_| false);
        lines.end(&mut after);
        assert_eq!(after.len(), 2, "also of a writer that is gone");

        let (_, mut lines) = passed(&gap);
        lines.follow(sample(7, MOST_HELD), Successor, &mut after);
        assert_eq!(after.len(), 5);
        assert!(lines.are_handed_over());
    }
}
