//! Orders of the site, in their order, for the writers of the domain.

mod writing;

use std::collections::{BTreeMap, HashMap};
use std::io::{BufWriter, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use rustdds::discovery::{DiscoveredReaderData, DiscoveredWriterData};
use rustdds::policy::{DataRepresentation, Durability, History};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, DomainParticipantStatusListener, GUID,
    Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity, StatusEvented, TopicKind, bytes::Bytes, no_key::DataWriter,
    qos::policy::XCDR_DATA_REPRESENTATION,
};
use writing::{Addresses, Outlet as _, Queue, Writing};

use crate::farewell::{Departures, Farewell};
use crate::graph::{self, PROGRAM, Prefix};
use crate::pipe::write::{Order, Report, Topic};
use crate::pipe::{VERSION, send, write};
use crate::{Ros2Error, capture, member};

pub use writing::Encoded;

/// The longest wait for an order, and the longest while a message waits for subscribers.
const BEAT: Duration = Duration::from_millis(50);
const SHORT_BEAT: Duration = Duration::from_millis(1);
const ALIVE: Duration = Duration::from_millis(500);
/// Discovery before anything is announced: Fast DDS is found after up to 1.3 s.
const LOOK_AROUND: Duration = Duration::from_millis(1500);
/// Discovery goes on while a participant was found this recently or has not told what it reads, up to this limit: a
/// busy machine is late, and a reader found after the first message does not get it.
const STILL_FINDING: Duration = Duration::from_millis(500);
const LONGEST_LOOK: Duration = Duration::from_secs(4);
/// Interval at which writers learn their subscribers.
const SHOWING: Duration = Duration::from_millis(100);
const PATIENCE: Duration = Duration::from_secs(5);
/// Time for the last messages to leave this machine.
const SENDING: Duration = Duration::from_millis(200);
/// Time for a best-effort subscriber to find a writer that has found it.
const MEETING: Duration = Duration::from_millis(500);
const MOST_WRITERS: usize = 4096;

/// Publishes in `domain` until the orders end or `stop` is set. Leaves the domain on every way out.
pub fn run(
    (domain, confined): (u16, bool),
    from: impl Read + Send + 'static,
    to: impl Write,
    stop: &AtomicBool,
) -> Result<(), Ros2Error> {
    let mut out = BufWriter::new(to);
    let result = Child::begin(domain, from, &mut out).and_then(|mut child| {
        let result = child.run((domain, confined), stop);
        child.farewell.say();
        capture::leave_soon();
        result
    });
    if let Err(error) = &result {
        // If the pipe itself broke, nobody hears it.
        drop(send(&mut out, &Report::Failed { reason: error.to_string() }, &[]));
    }
    drop(out.flush());
    result
}

struct Wanted {
    writer: u32,
    topic: Topic,
    size: usize,
    alone: bool,
    patient: bool,
}

struct Welcome {
    writer: u32,
    since: Instant,
    /// A latched topic needs not wait for the other side.
    latched: bool,
}

struct Child<'a, W: Write> {
    // In drop order.
    writings: BTreeMap<u32, Writing>,
    publisher: Publisher,
    listener: DomainParticipantStatusListener,
    node: Node,
    participant: DomainParticipant,
    socket: Rc<UdpSocket>,
    /// When writers learned their subscribers last.
    shown: Option<Instant>,
    /// Messages that nobody was asked, or can be asked any more, to acknowledge; and the last report.
    unconfirmed: u64,
    reported: (u32, u64),
    departures: Departures,
    farewell: Farewell,
    orders: Receiver<(Order, Vec<u8>)>,
    joined: Instant,
    wanted: Vec<Wanted>,
    welcomes: Vec<Welcome>,
    audience: Audience,
    queue: Queue,
    /// When it was ordered to leave.
    leaving: Option<Instant>,
    has_left: bool,
    out: &'a mut W,
}

impl<'a, W: Write> Child<'a, W> {
    fn begin(domain: u16, from: impl Read + Send + 'static, out: &'a mut W) -> Result<Self, Ros2Error> {
        let join = |error: &dyn std::fmt::Debug| Ros2Error::join(domain, error);
        let participant = DomainParticipantBuilder::new(domain).build().map_err(|error| join(&error))?;
        let publisher = participant.create_publisher(&QosPolicies::qos_none()).map_err(|error| join(&error))?;
        let listener = participant.status_listener();
        let audience = Audience::new(participant.guid());
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0));
        let socket = Rc::new(socket.map_err(|error| Ros2Error::system("open a socket", &error))?);
        let own = participant.guid().to_bytes();
        Ok(Self {
            writings: BTreeMap::new(),
            publisher,
            listener,
            node: Node::default(),
            participant,
            socket,
            shown: None,
            unconfirmed: 0,
            reported: (0, 0),
            departures: Departures::new(domain, &own),
            farewell: Farewell::new(domain, &own),
            orders: write::orders(from).map_err(|error| Ros2Error::system("start a thread", &error))?,
            joined: Instant::now(),
            wanted: Vec::new(),
            welcomes: Vec::new(),
            audience,
            queue: Queue::default(),
            leaving: None,
            has_left: false,
            out,
        })
    }

    fn run(&mut self, (domain, confined): (u16, bool), stop: &AtomicBool) -> Result<(), Ros2Error> {
        send(self.out, &Report::Hello { version: VERSION, domain, confined }, &[])?;
        let participant = graph::hex(&prefix(self.participant.guid()));
        send(self.out, &Report::Joined { participant }, &[])?;
        let mut alive = None::<Instant>;
        loop {
            self.out.flush().map_err(crate::pipe::PipeError::from)?;
            if !self.take_orders()? || stop.load(Ordering::Acquire) {
                return Ok(());
            }
            while let Some(news) = self.listener.try_recv_status() {
                self.audience.hear(news);
            }
            self.announce()?;
            self.show();
            self.welcome()?;
            self.pump()?;
            self.departures.go_on(self.audience.present());
            self.leave()?;
            if alive.is_none_or(|last| last.elapsed() >= ALIVE) {
                if !member::threads_run(1) {
                    return Err(Ros2Error::Threads);
                }
                self.tell();
                send(self.out, &Report::Alive, &[])?;
                alive = Some(Instant::now());
            }
        }
    }

    fn pump(&mut self) -> Result<(), Ros2Error> {
        let taken = self.queue.pump(&mut self.writings, Instant::now());
        self.unconfirmed += u64::from(taken.unconfirmed);
        self.writings.values_mut().for_each(Writing::settle);
        let now = (self.unacknowledged(), self.unconfirmed);
        if taken.messages > 0 || now != self.reported {
            let (messages, dropped, (unacknowledged, unconfirmed)) = (taken.messages, taken.dropped, now);
            send(self.out, &Report::Taken { messages, dropped, unacknowledged, unconfirmed }, &[])?;
            self.reported = now;
        }
        Ok(())
    }

    fn unacknowledged(&self) -> u32 {
        let total: usize = self.writings.values().map(Writing::unacknowledged).sum();
        u32::try_from(total).unwrap_or(u32::MAX)
    }

    fn show(&mut self) {
        if self.writings.is_empty() || self.shown.is_some_and(|last| last.elapsed() < SHOWING) {
            return;
        }
        self.shown = Some(Instant::now());
        let readers = self.participant.discovered_readers();
        self.writings.values_mut().for_each(|writing| self.audience.show(&readers, writing));
    }

    fn tell(&mut self) {
        if !self.writings.is_empty() {
            let own = self.writings.values().map(Writing::id).collect();
            self.node.tell((&self.participant, &self.publisher), &self.participant.discovered_writers(), own);
        }
    }

    fn take_orders(&mut self) -> Result<bool, Ros2Error> {
        let is_behind = self.writings.values().any(|writing| writing.unacknowledged() > 0);
        let is_busy = !self.queue.is_empty() || !self.welcomes.is_empty() || is_behind;
        let waits = is_busy || self.leaving.is_some() && !self.has_left;
        let mut patience = if waits { SHORT_BEAT } else { BEAT };
        loop {
            match self.orders.recv_timeout(patience) {
                Ok((order, payload)) => self.take_order(order, payload)?,
                Err(error) => return Ok(error == RecvTimeoutError::Timeout),
            }
            patience = Duration::ZERO;
        }
    }

    fn take_order(&mut self, order: Order, payload: Vec<u8>) -> Result<(), Ros2Error> {
        match order {
            Order::Advertise { writer, .. } if self.wanted.len() + self.writings.len() >= MOST_WRITERS => {
                self.refuse(writer, format!("there are already {MOST_WRITERS} publishers, the limit"), false)?;
            }
            Order::Advertise { writer, topic, size, alone, patient } => {
                let size = usize::try_from(size).unwrap_or(usize::MAX);
                self.wanted.push(Wanted { writer, topic, size, alone, patient });
            }
            Order::Publish { writer } => self.queue.push(writer, payload),
            Order::Withdraw { writer } => {
                self.queue.forget(writer);
                self.wanted.retain(|wanted| wanted.writer != writer);
                self.welcomes.retain(|welcome| welcome.writer != writer);
                // Whether subscribers got the last of it is unknown from here on.
                if let Some(gone) = self.writings.remove(&writer) {
                    self.unconfirmed += gone.unacknowledged() as u64;
                    self.departures.tell(gone.id().to_bytes());
                }
            }
            Order::Outrun => self.queue.outrun(&mut self.writings),
            Order::Leave => self.leaving = Some(Instant::now()),
        }
        Ok(())
    }

    /// Announces wanted topics after discovery.
    fn announce(&mut self) -> Result<(), Ros2Error> {
        let looked = self.joined.elapsed();
        let is_done = looked >= LOOK_AROUND && self.audience.is_settled(STILL_FINDING) || looked >= LONGEST_LOOK;
        if self.wanted.is_empty() || !is_done {
            return Ok(());
        }
        self.shown = None;
        for wanted in std::mem::take(&mut self.wanted) {
            let Wanted { writer, topic, size, alone, patient } = wanted;
            if alone && let Some(other) = self.audience.rival(&self.participant, &topic.name) {
                let name = &topic.name;
                self.refuse(writer, format!("{other} already publishes {name} there"), true)?;
                continue;
            }
            let others = self.writings.values().map(|writing| writing.kept).sum();
            match Writing::begin((&self.participant, &self.publisher, &self.socket), &topic, (size, others)) {
                Ok(writing) => {
                    self.writings.insert(writer, writing);
                    if patient {
                        let latched = topic.offer.latched;
                        self.welcomes.push(Welcome { writer, since: Instant::now(), latched });
                    } else {
                        send(self.out, &Report::Ready { writer }, &[])?;
                    }
                }
                Err(reason) => self.refuse(writer, reason, false)?,
            }
        }
        Ok(())
    }

    fn refuse(&mut self, writer: u32, reason: String, occupied: bool) -> Result<(), Ros2Error> {
        self.queue.forget(writer);
        let reason = reason.chars().take(500).collect();
        send(self.out, &Report::Refused { writer, reason, occupied }, &[])?;
        Ok(())
    }

    /// Reports topics whose subscribers have found them.
    fn welcome(&mut self) -> Result<(), Ros2Error> {
        if self.welcomes.is_empty() {
            return Ok(());
        }
        let readers = self.participant.discovered_readers();
        let (audience, writings) = (&self.audience, &self.writings);
        let is_ready = |welcome: &Welcome| {
            let Some(writing) = writings.get(&welcome.writer) else { return true };
            let found = audience.has_found(&readers, writing);
            let waited = welcome.since.elapsed();
            // Reliable subscribers acknowledge when they hear of the writer; the others get time for it.
            let hear = || writing.has_caught_up() && (!writing.has_best_effort || waited >= MEETING);
            found.is_some_and(|known| known == 0 || welcome.latched || hear()) || waited >= PATIENCE
        };
        let (ready, waiting): (Vec<Welcome>, Vec<Welcome>) = self.welcomes.drain(..).partition(is_ready);
        self.welcomes = waiting;
        if !ready.is_empty() {
            self.shown = None;
            self.show();
        }
        for Welcome { writer, .. } in ready {
            send(self.out, &Report::Ready { writer }, &[])?;
        }
        Ok(())
    }

    /// Reports once when everything has arrived.
    fn leave(&mut self) -> Result<(), Ros2Error> {
        let Some(since) = self.leaving.filter(|_| !self.has_left && self.queue.is_empty()) else { return Ok(()) };
        let last = self.queue.last_written.map_or(since, |last| last.max(since));
        if last.elapsed() >= SENDING && self.unacknowledged() == 0 {
            self.has_left = true;
            send(self.out, &Report::Left, &[])?;
        }
        Ok(())
    }
}

const MOST: usize = 20_000;

pub struct Audience {
    own: [u8; 12],
    /// The others, and whether each has announced a reader or writer: a node of ROS 2 has one from its start.
    participants: HashMap<[u8; 12], bool>,
    /// By our writer: the subscribers it has met, and whether it serves them.
    met: HashMap<GUID, HashMap<GUID, bool>>,
    /// When a participant or endpoint was found last.
    found: Instant,
}

fn prefix(id: GUID) -> Prefix {
    graph::prefix(&id.to_bytes())
}

impl Audience {
    pub fn new(own: GUID) -> Self {
        Self { own: prefix(own), participants: HashMap::new(), met: HashMap::new(), found: Instant::now() }
    }

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

    pub fn present(&self) -> impl Iterator<Item = Prefix> {
        self.participants.keys().copied()
    }

    /// Whether everybody present has announced something, and nobody was found for a while.
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

    /// Number of a topic's known subscribers, if all of them have been met.
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

    /// Tells a writer its served subscribers' addresses, and whether some do not acknowledge.
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

    /// Describes another publisher of the topic.
    pub fn rival(&self, participant: &DomainParticipant, topic: &str) -> Option<String> {
        let dds_topic = graph::dds_topic(topic);
        let writers = participant.discovered_writers();
        let id = writers.iter().find_map(|writer| {
            let data = &writer.publication_topic_data;
            (data.topic_name == dds_topic && prefix(data.key) != self.own).then(|| data.key.to_bytes())
        })?;
        Some(format!("a {} publisher", graph::vendor(id)))
    }
}

const NAME: &str = "authros_bridge";
const TYPE: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

#[derive(Default)]
pub struct Node {
    writer: Option<DataWriter<Bytes, Encoded<1>>>,
    told: Vec<GUID>,
}

impl Node {
    /// Tells the graph these writers if they are news, and the form suits every other node.
    pub fn tell(
        &mut self,
        (participant, publisher): (&DomainParticipant, &Publisher),
        there: &[DiscoveredWriterData],
        writers: Vec<GUID>,
    ) {
        if !is_welcome(there.iter().filter(|writer| of_others(writer, participant)).map(|writer| &*writer.user_data)) {
            // Ends the list kept for late subscribers.
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
    data.topic_name == graph::NODES && data.key.to_bytes()[..12] != participant.guid().to_bytes()[..12]
}

/// Whether all others show this form beside their lists of nodes.
fn is_welcome<'a>(mut told: impl Iterator<Item = &'a [u8]>) -> bool {
    let is_new = |told: &[u8]| graph::type_hash(told).is_some();
    told.next().is_some_and(is_new) && told.all(is_new)
}

fn begin(participant: &DomainParticipant, publisher: &Publisher) -> Option<DataWriter<Bytes, Encoded<1>>> {
    let policies = QosPolicyBuilder::new()
        .durability(Durability::TransientLocal)
        .history(History::KeepLast { depth: 1 })
        .reliable(rustdds::Duration::from_millis(100))
        .build()
        .with_data_representation(DataRepresentation { value: vec![XCDR_DATA_REPRESENTATION] });
    let topic = participant.create_topic(graph::NODES.into(), TYPE.into(), &policies, TopicKind::NoKey).ok()?;
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
        assert_eq!((audience.is_settled(Duration::ZERO), audience.present().count()), (true, 1), "our own");
    }
}

#[cfg(test)]
mod node_tests {
    use super::*;
    use crate::graph::Nodes;

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
