//! The loop: graph, wishes and samples, in one thread. The two threads of the network code are separate, and so is the one
//! that reads the site's wishes from the pipe; the pipe's end is the last wish.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufWriter, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use crate::describing::{Describing, Question};
use crate::farewell::{Departures, Farewell};
use crate::graph::{self, Graph, Id, Nodes};
use crate::pipe::read::{Quality, Told, Wish};
use crate::pipe::{LONGEST_PAYLOAD, VERSION, receive, send};
use crate::quality::{self, Raw, RawAdapter, RawDecoder, Request};
use crate::{Ros2Error, threads};
use rustdds::mio1::{Events, Interest, Poll, Registry, Token, Waker};
use rustdds::no_key::SimpleDataReader;
use rustdds::with_key::{DataReader, Sample};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, DomainParticipantStatusListener,
    Publisher, QosPolicies, RTPSEntity, ReadCondition, StatusEvented, Subscriber, Timestamp, Topic, TopicKind,
};

const WAKE: Token = Token(0);
const STATUS: Token = Token(1);
const FIRST: usize = 2;

/// The longest wait.
const BEAT: Duration = Duration::from_millis(100);
/// Interval between looks at the graph if no change was reported.
const LOOK: Duration = Duration::from_secs(1);
/// Interval between signs of life, and between looks at the threads.
const ALIVE: Duration = Duration::from_millis(500);
/// How long a replaced reader continues beside the new one, until writers have found the new one.
const OVERLAP: Duration = Duration::from_secs(2);
/// How long leaving the domain may take before the process ends anyway.
const LEAVING: Duration = Duration::from_secs(2);
/// The most topics read at once.
const MOST_TOPICS: usize = 4096;

/// Reads `domain` until the wishes end or `stop` is set; tells whether it is confined. Leaves the domain on every way out.
///
/// # Errors
/// [`Ros2Error`] if the domain cannot be joined, the pipe breaks or the network threads are gone.
pub fn run(
    (domain, confined): (u16, bool),
    from: impl Read + Send + 'static,
    to: impl Write,
    stop: &AtomicBool,
) -> Result<(), Ros2Error> {
    let mut out = BufWriter::with_capacity(256 << 10, to);
    send(&mut out, &Told::Hello { version: VERSION, domain, confined }, &[])?;
    out.flush().map_err(crate::pipe::PipeError::from)?;
    let result = Child::begin(domain, from, &mut out).and_then(|mut child| {
        let result = child.joined().and_then(|()| child.run(stop));
        child.farewell.say();
        leave_soon();
        result
    });
    if let Err(error) = &result {
        // If the pipe itself broke, nobody hears it.
        drop(send(&mut out, &Told::Failed { reason: error.to_string() }, &[]));
    }
    drop(out.flush());
    result
}

/// Leaving waits for threads that may be gone: in the end the process ends without it.
pub(crate) fn leave_soon() {
    let end = || {
        std::thread::sleep(LEAVING);
        std::process::exit(3);
    };
    drop(std::thread::Builder::new().name("leaving".into()).spawn(end));
}

struct Child<'a, W: Write> {
    // In drop order.
    readings: BTreeMap<usize, Reading>,
    describing: Describing,
    subscriber: Subscriber,
    publisher: Publisher,
    listener: DomainParticipantStatusListener,
    participant: DomainParticipant,
    departures: Departures,
    farewell: Farewell,
    poll: Poll,
    wishes: Receiver<Option<Wish>>,
    wanted: BTreeSet<String>,
    refused: BTreeSet<String>,
    graph: Graph,
    nodes: Nodes,
    next: usize,
    out: &'a mut W,
}

impl<'a, W: Write> Child<'a, W> {
    fn begin(domain: u16, from: impl Read + Send + 'static, out: &'a mut W) -> Result<Self, Ros2Error> {
        let system = |error: std::io::Error| Ros2Error::system("wait for events", &error);
        let poll = Poll::new().map_err(system)?;
        let waker = Arc::new(Waker::new(poll.registry(), WAKE).map_err(system)?);
        let wishes = listen(from, waker)?;
        let join = |error: &dyn std::fmt::Debug| Ros2Error::join(domain, error);
        let participant = DomainParticipantBuilder::new(domain).build().map_err(|error| join(&error))?;
        let subscriber = participant.create_subscriber(&QosPolicies::qos_none()).map_err(|error| join(&error))?;
        let publisher = participant.create_publisher(&QosPolicies::qos_none()).map_err(|error| join(&error))?;
        let mut listener = participant.status_listener();
        poll.registry().register(&mut listener, STATUS, rustdds::mio1::Interest::READABLE).map_err(system)?;
        let own = participant.guid().to_bytes();
        let graph = Graph::new(&own);
        Ok(Self {
            readings: BTreeMap::new(),
            describing: Describing::default(),
            subscriber,
            publisher,
            listener,
            participant,
            departures: Departures::new(domain, &own),
            farewell: Farewell::new(domain, &own),
            poll,
            wishes,
            wanted: BTreeSet::new(),
            refused: BTreeSet::new(),
            graph,
            nodes: Nodes::default(),
            next: FIRST,
            out,
        })
    }

    /// The site must know whom to say farewell for if this process is killed.
    fn joined(&mut self) -> Result<(), Ros2Error> {
        let participant = graph::hex(&graph::prefix(&self.participant.guid().to_bytes()));
        send(self.out, &Told::Joined { participant }, &[])?;
        Ok(())
    }

    fn run(&mut self, stop: &AtomicBool) -> Result<(), Ros2Error> {
        let mut events = Events::with_capacity(256);
        let (mut looked, mut alive) = (None::<Instant>, None::<Instant>);
        let due = |last: Option<Instant>, every| last.is_none_or(|last| last.elapsed() >= every);
        loop {
            self.wait(&mut events)?;
            if stop.load(Ordering::Acquire) {
                return Ok(());
            }
            let mut changed = self.listen();
            match self.take_wishes() {
                None => return Ok(()),
                Some(new) => changed |= new,
            }
            if changed || due(looked, LOOK) {
                // A lost notification costs no more than this.
                self.readings.values_mut().for_each(|reading| reading.ready = true);
                self.look()?;
                looked = Some(Instant::now());
            }
            self.take()?;
            let parts = (&self.participant, &self.subscriber, &self.publisher);
            for (told, text) in self.describing.go_on(parts, &self.graph, &mut self.departures) {
                send(self.out, &told, &text)?;
            }
            self.departures.go_on(self.graph.participants());
            if due(alive, ALIVE) {
                if !threads::run() {
                    return Err(Ros2Error::Threads);
                }
                send(self.out, &Told::Alive(self.graph.counts()), &[])?;
                alive = Some(Instant::now());
            }
            self.out.flush().map_err(crate::pipe::PipeError::from)?;
        }
    }

    fn wait(&mut self, events: &mut Events) -> Result<(), Ros2Error> {
        let more = self.readings.values().any(|reading| reading.ready);
        match self.poll.poll(events, Some(if more { Duration::ZERO } else { BEAT })) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::Interrupted => return Ok(()),
            Err(error) => return Err(Ros2Error::system("wait for events", &error)),
        }
        for event in &*events {
            if let Some(reading) = self.readings.get_mut(&event.token().0) {
                reading.ready = true;
            }
        }
        Ok(())
    }

    /// News of the graph; whether there were any.
    fn listen(&mut self) -> bool {
        use DomainParticipantStatusEvent as News;
        let mut changed = false;
        while let Some(news) = self.listener.try_recv_status() {
            match news {
                News::ParticipantDiscovered { dpd } => self.graph.came(&dpd.guid.to_bytes()[..12]),
                News::ParticipantLost { id, .. } => self.graph.left(id.as_ref()),
                News::WriterDetected { .. } | News::WriterLost { .. } | News::RemoteWriterQosIncompatible { .. } => {}
                _ => continue,
            }
            changed = true;
        }
        changed
    }

    /// New wishes; whether there were any, `None` if there will be no more.
    fn take_wishes(&mut self) -> Option<bool> {
        let mut changed = false;
        while let Ok(wish) = self.wishes.try_recv() {
            changed = true;
            match wish? {
                Wish::Watch { topic } if self.wanted.len() < MOST_TOPICS => {
                    self.wanted.insert(topic);
                }
                Wish::Watch { .. } => {}
                Wish::Describe { node, type_name, type_hash } => {
                    self.describing.ask(Question { node, type_name, type_hash });
                }
                Wish::Unwatch { topic } => {
                    self.wanted.remove(&topic);
                    self.refused.remove(&topic);
                }
            }
        }
        Some(changed)
    }

    /// Looks at the graph, reports changes, and adapts the readers to it.
    fn look(&mut self) -> Result<(), Ros2Error> {
        let writers = self.participant.discovered_writers();
        for told in self.graph.look(&writers, &self.nodes) {
            send(self.out, &told, &[])?;
        }
        let graph = &self.graph;
        self.nodes.keep(|participant| graph.is_there(participant));
        self.fit()
    }

    /// One reader for each wanted topic and type, requesting what every writer offers.
    fn fit(&mut self) -> Result<(), Ros2Error> {
        let wanted: BTreeSet<String> =
            self.wanted.iter().map(|topic| graph::dds_topic(topic)).chain([graph::NODES.to_owned()]).collect();
        let now = Instant::now();
        let ended = |reading: &Reading| {
            !wanted.contains(&reading.subject.dds_topic) || reading.retires.is_some_and(|retires| retires <= now)
        };
        for reading in self.readings.values_mut().filter(|reading| !reading.leaves && ended(reading)) {
            self.departures.tell(reading.id());
            (reading.leaves, reading.retires) = (true, Some(now));
        }
        let departures = &self.departures;
        let has_left = |reading: &Reading| reading.leaves && !departures.is_telling(&reading.id());
        let gone: Vec<usize> =
            self.readings.iter().filter(|(_, reading)| has_left(reading)).map(|(key, _)| *key).collect();
        for key in gone {
            if let Some(reading) = self.readings.remove(&key) {
                let id = reading.id();
                reading.end(self.poll.registry());
                // Once more: somebody may have heard of it only after that it leaves.
                self.departures.tell(id);
            }
        }
        for topic in &wanted {
            let mut offers: BTreeMap<Subject, Vec<Quality>> = BTreeMap::new();
            for found in self.graph.of_topic(topic) {
                let (dds_topic, dds_type) = (topic.clone(), found.dds_type.clone());
                let subject = Subject { dds_topic, dds_type, keyed: found.keyed };
                offers.entry(subject).or_default().push(found.quality);
            }
            for (subject, offers) in offers {
                self.fit_one(subject, &offers)?;
            }
        }
        Ok(())
    }

    fn fit_one(&mut self, subject: Subject, offers: &[Quality]) -> Result<(), Ros2Error> {
        let request = quality::request(offers.iter().copied());
        let mut current = self.readings.values_mut().filter(|reading| reading.subject == subject);
        if current.any(|reading| reading.retires.is_none() && reading.request == request) {
            return Ok(());
        }
        let parts = (&self.participant, &self.subscriber);
        let token = Token(self.next);
        match Reading::begin(parts, subject.clone(), request, (self.poll.registry(), token)) {
            Ok(reading) => {
                let retires = Some(Instant::now() + OVERLAP);
                let former = self.readings.values_mut().filter(|reading| reading.subject == subject);
                former.for_each(|reading| reading.retires = reading.retires.or(retires));
                self.readings.insert(self.next, reading);
                self.next += 1;
                Ok(())
            }
            Err(error) => self.refuse(&subject.dds_topic, &error),
        }
    }

    fn refuse(&mut self, dds_topic: &str, error: &Ros2Error) -> Result<(), Ros2Error> {
        let Some(topic) = graph::topic(dds_topic) else { return Ok(()) };
        if self.refused.insert(topic.clone()) {
            let reason: String = error.to_string().chars().take(500).collect();
            send(self.out, &Told::Refused { topic, reason }, &[])?;
        }
        Ok(())
    }

    /// Gives one turn to every topic that has something.
    fn take(&mut self) -> Result<(), Ros2Error> {
        let ready: Vec<usize> =
            self.readings.iter().filter(|(_, reading)| reading.ready).map(|(key, _)| *key).collect();
        let mut taken = Vec::new();
        let mut nodes_changed = false;
        for key in ready {
            let Some(reading) = self.readings.get_mut(&key) else { continue };
            reading.take(&mut taken);
            if reading.leaves {
                taken.clear();
                continue;
            }
            let Subject { dds_topic: topic, dds_type: type_name, .. } = reading.subject.clone();
            if topic == graph::NODES {
                taken.drain(..).for_each(|sample| self.nodes.take(&sample.writer, &sample.bytes));
                nodes_changed = true;
                continue;
            }
            let all: usize = self.readings.values().map(Reading::kept).sum();
            if let Some(reading) = self.readings.get_mut(&key) {
                reading.deepen(&self.participant, all.saturating_sub(reading.kept()));
            }
            for sample in taken.drain(..) {
                self.pass_on(sample, &topic, &type_name)?;
            }
        }
        if nodes_changed { self.look() } else { Ok(()) }
    }

    fn pass_on(&mut self, sample: Taken, dds_topic: &str, dds_type: &str) -> Result<(), Ros2Error> {
        if !self.graph.knows(&sample.writer) {
            let told = self.graph.look(&self.participant.discovered_writers(), &self.nodes);
            let by_sample = !self.graph.knows(&sample.writer);
            let by_sample = by_sample.then(|| self.graph.by_sample(sample.writer, dds_topic, dds_type)).flatten();
            for told in told.into_iter().chain(by_sample) {
                send(self.out, &told, &[])?;
            }
        }
        if sample.bytes.len() > LONGEST_PAYLOAD as usize {
            let reason = format!("a message of {} bytes exceeds the limit of {LONGEST_PAYLOAD}", sample.bytes.len());
            return self.refuse(dds_topic, &Ros2Error::System { action: "take a message", reason });
        }
        let Taken { writer, number, sent, arrived, bytes } = sample;
        send(self.out, &Told::Sample { writer: graph::hex(&writer), number, sent, arrived }, &bytes)?;
        Ok(())
    }
}

/// Starts reading. `None` arrives when the pipe has ended; every arrival wakes.
pub fn listen(mut from: impl Read + Send + 'static, waker: Arc<Waker>) -> Result<Receiver<Option<Wish>>, Ros2Error> {
    let (sender, receiver) = channel();
    let read = move || {
        loop {
            let wish = receive::<Wish>(&mut from).ok().flatten().map(|(wish, _)| wish);
            let ended = wish.is_none();
            if sender.send(wish).is_err() || waker.wake().is_err() || ended {
                break;
            }
        }
    };
    let started = std::thread::Builder::new().name("wishes".into()).spawn(read);
    started.map_err(|error| Ros2Error::system("start a thread", &error))?;
    Ok(receiver)
}

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
    /// Header and body.
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

/// A reader.
pub struct Reading {
    /// What it reads.
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
    /// Starts reading.
    ///
    /// # Errors
    /// [`Ros2Error::System`] with the words of the network code.
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
