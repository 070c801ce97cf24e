//! One participant of ours in the domain: its readers, its questions to nodes, and the leaving of each.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::time::{Duration, Instant};

use rustdds::mio1::{Interest, Registry, Token};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, DomainParticipantStatusListener,
    Publisher, QosPolicies, RTPSEntity, StatusEvented, Subscriber, discovery::DiscoveredWriterData,
};

use crate::farewell::{Departures, Farewell};
use crate::graph::{self, Graph, Prefix};
use crate::pipe::read::{Quality, Told};
use crate::reading::{Reading, Subject, Taken};
use crate::{Ros2Error, describing::Describing, quality};

/// Only wakes: news are checked at every beat.
const STATUS: Token = Token(1);
/// Time a replaced reader goes on, until writers have found the new one.
pub const OVERLAP: Duration = Duration::from_secs(2);
/// Readers made in one go: rustdds's channel takes a hundred, and refuses or forgets the rest.
const AT_ONCE: usize = 64;
const MOST_PARTICIPANTS: usize = 20_000;

pub struct Member {
    // In drop order.
    pub readings: BTreeMap<usize, Reading>,
    pub describing: Describing,
    subscriber: Subscriber,
    publisher: Publisher,
    listener: DomainParticipantStatusListener,
    participant: DomainParticipant,
    departures: Departures,
    pub farewell: Farewell,
    pub participants: BTreeSet<Prefix>,
    pub begun: Instant,
    /// Writers and readers met since it is the only one.
    pub met: usize,
    /// Whether it has every reader it needs.
    pub is_fitted: bool,
    /// Since when it has them, and knows every writer that its predecessor knows.
    pub complete: Option<Instant>,
    /// Whether it leaves because its successor brings everything.
    pub leaves: bool,
}

impl Member {
    pub fn join(domain: u16, registry: &Registry) -> Result<Self, Ros2Error> {
        let join = |error: &dyn std::fmt::Debug| Ros2Error::join(domain, error);
        let participant = DomainParticipantBuilder::new(domain).build().map_err(|error| join(&error))?;
        let subscriber = participant.create_subscriber(&QosPolicies::qos_none()).map_err(|error| join(&error))?;
        let publisher = participant.create_publisher(&QosPolicies::qos_none()).map_err(|error| join(&error))?;
        let mut listener = participant.status_listener();
        let registered = registry.register(&mut listener, STATUS, Interest::READABLE);
        registered.map_err(|error| Ros2Error::system("wait for events", &error))?;
        let own = participant.guid().to_bytes();
        Ok(Self {
            readings: BTreeMap::new(),
            describing: Describing::default(),
            subscriber,
            publisher,
            listener,
            participant,
            departures: Departures::new(domain, &own),
            farewell: Farewell::new(domain, &own),
            participants: BTreeSet::new(),
            begun: Instant::now(),
            met: 0,
            is_fitted: true,
            complete: None,
            leaves: false,
        })
    }

    pub fn prefix(&self) -> Prefix {
        graph::prefix(&self.participant.guid().to_bytes())
    }

    /// News of the graph; whether there were any.
    pub fn listen(&mut self) -> bool {
        use DomainParticipantStatusEvent as News;
        let mut changed = false;
        while let Some(news) = self.listener.try_recv_status() {
            match news {
                News::ParticipantDiscovered { dpd } => self.see(graph::prefix(&dpd.guid.to_bytes())),
                News::ParticipantLost { id, .. } => self.participants.retain(|known| known[..] != *id.as_ref()),
                News::WriterDetected { .. } => self.met += 1,
                News::ReaderDetected { .. } => {
                    self.met += 1;
                    continue;
                }
                News::WriterLost { .. } | News::RemoteWriterQosIncompatible { .. } => {}
                _ => continue,
            }
            changed = true;
        }
        changed
    }

    fn see(&mut self, participant: Prefix) {
        if self.participants.len() < MOST_PARTICIPANTS {
            self.participants.insert(participant);
        }
    }

    pub fn writers(&mut self) -> Vec<DiscoveredWriterData> {
        let found = self.participant.discovered_writers();
        found.iter().for_each(|writer| self.see(graph::prefix(&writer.publication_topic_data.key.to_bytes())));
        found
    }

    /// One reader for each wanted topic and type, requesting what every writer offers. Returns failures by DDS topic.
    pub fn fit(
        &mut self,
        wanted: &BTreeSet<String>,
        graph: &Graph,
        (registry, next): (&Registry, &mut usize),
    ) -> Vec<(String, Ros2Error)> {
        self.dismiss(wanted, registry);
        let (mut refused, before) = (Vec::new(), *next);
        self.is_fitted = true;
        for topic in wanted {
            let mut offers: BTreeMap<Subject, Vec<Quality>> = BTreeMap::new();
            for found in graph.of_topic(topic) {
                let (dds_topic, dds_type) = (topic.clone(), found.dds_type.clone());
                let subject = Subject { dds_topic, dds_type, keyed: found.keyed };
                offers.entry(subject).or_default().push(found.quality);
            }
            for (subject, offers) in offers {
                if *next - before >= AT_ONCE {
                    (self.is_fitted, self.complete) = (false, None);
                    return refused;
                }
                let fitted = self.fit_one(subject, &offers, (registry, &mut *next));
                refused.extend(fitted.err().map(|error| (topic.clone(), error)));
            }
        }
        refused
    }

    /// Makes unwanted readers leave, and ends those that everybody knows to have left.
    fn dismiss(&mut self, wanted: &BTreeSet<String>, registry: &Registry) {
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
                reading.end(registry);
                // Once more: somebody may have heard of it only after it left.
                self.departures.tell(id);
            }
        }
    }

    fn fit_one(
        &mut self,
        subject: Subject,
        offers: &[Quality],
        (registry, next): (&Registry, &mut usize),
    ) -> Result<(), Ros2Error> {
        let request = quality::request(offers.iter().copied());
        let mut current = self.readings.values_mut().filter(|reading| reading.subject == subject);
        if current.any(|reading| reading.retires.is_none() && reading.request == request) {
            return Ok(());
        }
        let parts = (&self.participant, &self.subscriber);
        let reading = Reading::begin(parts, subject.clone(), request, (registry, Token(*next)))?;
        let retires = Some(Instant::now() + OVERLAP);
        let former = self.readings.values_mut().filter(|reading| reading.subject == subject);
        former.for_each(|reading| reading.retires = reading.retires.or(retires));
        self.readings.insert(*next, reading);
        *next += 1;
        Ok(())
    }

    /// Gives one turn to a reader; `kept` is what all readers keep, bytes. `None` if its samples do not count.
    pub fn take(&mut self, key: usize, kept: usize, into: &mut Vec<Taken>) -> Option<Subject> {
        let reading = self.readings.get_mut(&key)?;
        let others = kept.saturating_sub(reading.kept());
        reading.take(into);
        if reading.leaves {
            into.clear();
            return None;
        }
        if reading.subject.dds_topic != graph::NODES {
            reading.deepen(&self.participant, others);
        }
        Some(reading.subject.clone())
    }

    /// Returns reports to the site, with their payloads.
    pub fn go_on(&mut self, graph: &Graph) -> Vec<(Told, Vec<u8>)> {
        let parts = (&self.participant, &self.subscriber, &self.publisher);
        let told = self.describing.go_on(parts, graph, &mut self.departures);
        self.departures.go_on(self.participants.iter().copied());
        told
    }

    pub fn has_left(&self) -> bool {
        self.readings.is_empty() && self.describing.is_idle()
    }
}

// Whether the network threads run. They end when one of their waits is interrupted, as after a suspend, and nothing
// else reports it.

/// Prefix of their names, cut by the system.
const NAME: &str = "RustDDS";
const EXPECTED: usize = 2;

/// `true` if the system lists no threads.
pub fn threads_run(participants: usize) -> bool {
    let Ok(tasks) = fs::read_dir("/proc/self/task") else { return true };
    let named = tasks
        .flatten()
        .filter(|task| fs::read_to_string(task.path().join("comm")).is_ok_and(|name| name.starts_with(NAME)));
    named.count() >= EXPECTED * participants
}
