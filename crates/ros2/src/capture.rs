//! The loop: graph, wishes and samples, in one thread. The two threads of the network code are separate.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufWriter, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use rustdds::mio1::{Events, Poll, Token, Waker};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, DomainParticipantStatusListener,
    Publisher, QosPolicies, RTPSEntity, StatusEvented, Subscriber,
};

use crate::describing::{Describing, Question};
use crate::farewell::{Departures, Farewell};
use crate::graph::{self, Graph};
use crate::nodes::Nodes;
use crate::pipe::read::{Quality, Told, Wish};
use crate::pipe::{LONGEST_PAYLOAD, VERSION, send};
use crate::reading::{Reading, Subject, Taken};
use crate::{Ros2Error, names, quality, threads, wishes};

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
        let wishes = wishes::listen(from, waker)?;
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
        let participant = names::hex(&graph::prefix(&self.participant.guid().to_bytes()));
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
            self.wanted.iter().map(|topic| names::dds_topic(topic)).chain([names::NODES.to_owned()]).collect();
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
        let Some(topic) = names::topic(dds_topic) else { return Ok(()) };
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
            if topic == names::NODES {
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
        send(self.out, &Told::Sample { writer: names::hex(&writer), number, sent, arrived }, &bytes)?;
        Ok(())
    }
}
