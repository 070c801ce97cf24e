//! One writer of one topic. rustdds fixes a writer's encoding by a type, and writes the header's options as zeros. It
//! sends all fragments of a message in one burst, of which the usual receive buffer of 208 kB keeps few, and repairs
//! slowly. So large messages go ahead at a rate that subscribers can take; to them it is the same message (same writer,
//! number, size of fragments), so the burst that follows is already known and acknowledged (decision 018).

use std::collections::{BTreeMap, HashSet, VecDeque};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::task::{Context, Waker};
use std::time::{Duration, Instant, SystemTime};
use std::{convert::Infallible, future::Future, pin::Pin, rc::Rc};

use rustdds::no_key::{DataWriter, SerializerAdapter};
use rustdds::policy::{DataRepresentation, Durability, History, ResourceLimits};
use rustdds::qos::policy::{XCDR_DATA_REPRESENTATION, XCDR2_DATA_REPRESENTATION};
use rustdds::{
    DomainParticipant, GUID, Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity, RepresentationIdentifier, Timestamp,
    TopicKind, WriteOptionsBuilder, bytes::Bytes,
};

use crate::pipe::write::{Offer, Topic};
use crate::{graph, quality};

/// Wait for room in one attempt to write to a reliable topic.
const ATTEMPT: rustdds::Duration = rustdds::Duration::from_millis(5);
/// Messages kept of a latched topic before old ones are cleared.
const LATCHED: usize = 8;
/// The most messages that a subscriber may ask a topic to keep.
const DEEPEST: u32 = 1000;
/// A large message not acknowledged after this time goes ahead again, then after twice as long each time: subscribers
/// are asked every 100 ms.
const AGAIN: std::time::Duration = std::time::Duration::from_millis(250);
/// Then rustdds repairs it.
const MOST_TIMES: u32 = 6;

/// Bodies of one encoding, unchanged.
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Attempt {
    Written,
    /// A subscriber is too far behind.
    Full,
    /// It is going ahead, and must be written afterwards: its number is used.
    Begun,
    /// It cannot be written at all.
    Lost,
}

/// Ready when all reliable subscribers have every message written before it was made.
type Acknowledgement = Pin<Box<dyn Future<Output = ()>>>;

trait Write {
    fn write(&self, body: Bytes) -> Attempt;
    /// Addressed to nobody: subscribers acknowledge it when they hear this writer, and get nothing.
    fn write_for_nobody(&self) -> bool;
    fn acknowledgement(&self) -> Acknowledgement;
    fn is_acknowledged(&self) -> bool;
    fn id(&self) -> GUID;
}

impl<const ID: u16> Write for Rc<DataWriter<Bytes, Encoded<ID>>> {
    fn write(&self, body: Bytes) -> Attempt {
        // Waits for a congested socket, also in best effort.
        let options = WriteOptionsBuilder::new().source_timestamp(Timestamp::now()).best_effort_may_block(true);
        match self.write_with_options(body, options.build()) {
            Ok(_) => Attempt::Written,
            Err(rustdds::dds::WriteError::WouldBlock { .. }) => Attempt::Full,
            Err(_) => Attempt::Lost,
        }
    }

    fn write_for_nobody(&self) -> bool {
        let options = WriteOptionsBuilder::new().to_single_reader(GUID::GUID_UNKNOWN);
        self.write_with_options(Bytes::new(), options.build()).is_ok()
    }

    fn acknowledgement(&self) -> Acknowledgement {
        let writer = Self::clone(self);
        let mut coming: Acknowledgement = Box::pin(async move { drop(writer.async_wait_for_acknowledgments().await) });
        // The first poll notes the last written message.
        if has_come(&mut coming) { Box::pin(std::future::ready(())) } else { coming }
    }

    fn is_acknowledged(&self) -> bool {
        self.wait_for_acknowledgments(std::time::Duration::ZERO).unwrap_or(true)
    }

    fn id(&self) -> GUID {
        self.guid()
    }
}

fn has_come(coming: &mut Acknowledgement) -> bool {
    coming.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_ready()
}

struct Pending {
    acknowledgement: Acknowledgement,
    /// The message and its number, if it went ahead.
    large: Option<(Bytes, i64)>,
    /// When it was sent last, and how often.
    sent: Instant,
    times: u32,
    /// While it is sent again.
    again: Option<Ahead>,
}

pub struct Writing {
    pub dds_topic: String,
    pub dds_type: String,
    encoding: [u8; 2],
    /// Limits of kept messages and bytes.
    room: usize,
    pub kept: usize,
    pub reliable: bool,
    pub is_outrun: bool,
    pub addresses: Addresses,
    /// Whether some subscribers do not acknowledge.
    pub has_best_effort: bool,
    socket: Rc<UdpSocket>,
    rate: Rate,
    next: i64,
    ahead: Option<Ahead>,
    // Before the writer, which these hold too.
    pending: VecDeque<Pending>,
    writer: Box<dyn Write>,
}

impl Writing {
    /// `size` is about the size of its messages; all other topics keep `others` bytes.
    pub fn begin(
        (participant, publisher, socket): (&DomainParticipant, &Publisher, &Rc<UdpSocket>),
        topic: &Topic,
        (size, others): (usize, usize),
    ) -> Result<Self, String> {
        let dds_topic = graph::dds_topic(&topic.name);
        if graph::topic(&dds_topic).is_none() {
            return Err(format!("{} is not a valid ROS 2 topic name; rename it with --remap", topic.name));
        }
        let Some(dds_type) = graph::dds_type(&topic.type_name) else {
            return Err(format!("{} is not a valid ROS 2 type name", topic.type_name));
        };
        let room = room(topic.offer, size, others);
        let policies = policies(topic.offer, room, topic.encoding);
        let made = participant
            .create_topic(dds_topic.clone(), dds_type.clone(), &policies, TopicKind::NoKey)
            .map_err(|error| format!("the topic cannot be created ({error:?})"))?;
        let writer = writer(topic.encoding, publisher, &made, policies)?;
        // Late subscribers of a latched topic would get it.
        let is_asked = topic.offer.reliable && !topic.offer.latched && writer.write_for_nobody();
        Ok(Self {
            dds_topic,
            dds_type,
            encoding: topic.encoding.to_be_bytes(),
            room,
            kept: room * size,
            reliable: topic.offer.reliable,
            is_outrun: false,
            addresses: Addresses::default(),
            has_best_effort: false,
            socket: Rc::clone(socket),
            rate: Rate::default(),
            next: 1 + i64::from(is_asked),
            ahead: None,
            pending: VecDeque::new(),
            writer,
        })
    }

    pub fn id(&self) -> GUID {
        self.writer.id()
    }

    fn written(&mut self, large: Option<(Bytes, i64)>) {
        (self.next, self.ahead) = (self.next + 1, None);
        if self.reliable {
            let acknowledgement = self.writer.acknowledgement();
            self.pending.push_back(Pending { acknowledgement, large, sent: Instant::now(), times: 1, again: None });
        }
    }

    /// Drops acknowledged messages, and sends a large one ahead again that is late.
    pub fn settle(&mut self) {
        while let Some(first) = self.pending.front_mut() {
            if has_come(&mut first.acknowledgement) {
                if first.large.is_some() && first.times == 1 {
                    self.rate.faster();
                }
                self.pending.pop_front();
                continue;
            }
            let Some((message, number)) = &first.large else { return };
            let patience = AGAIN * (1 << (first.times - 1));
            if first.again.is_none() && first.times < MOST_TIMES && first.sent.elapsed() >= patience {
                self.rate.slower();
                let id = (self.writer.id(), *number);
                first.again = Some(Ahead::new(message.clone(), id, &self.addresses));
            }
            if first.again.as_mut().is_some_and(|again| again.advance(&self.socket, &self.rate)) {
                (first.again, first.sent, first.times) = (None, Instant::now(), first.times + 1);
            }
            return;
        }
    }

    pub fn unacknowledged(&self) -> usize {
        self.pending.len()
    }
}

impl Outlet for Writing {
    fn attempt(&mut self, message: &Bytes) -> Attempt {
        if message.len() < 4 || message[..2] != self.encoding || message[2..4] != [0, 0] {
            return Attempt::Lost;
        }
        let is_large = message.len() > LARGE && (self.ahead.is_some() || !self.addresses.is_empty());
        if is_large {
            self.settle();
            // One at a time: a second one would be lost in the first one's burst. A subscriber left behind does not
            // keep it from the others while there is room; once begun, it must find some.
            let most = if self.is_outrun { self.room.saturating_sub(2) } else { 0 };
            if self.ahead.is_none() && self.pending.len() > most {
                return Attempt::Full;
            }
            let id = (self.writer.id(), self.next);
            let ahead = self.ahead.get_or_insert_with(|| Ahead::new(message.clone(), id, &self.addresses));
            if !ahead.advance(&self.socket, &self.rate) {
                return Attempt::Begun;
            }
        }
        match self.writer.write(message.slice(4..)) {
            Attempt::Written => {
                self.written(is_large.then(|| (message.clone(), self.next)));
                Attempt::Written
            }
            Attempt::Full if is_large => Attempt::Begun,
            other => other,
        }
    }

    fn is_unconfirmed(&self) -> bool {
        self.has_best_effort
    }

    fn has_caught_up(&self) -> bool {
        self.writer.is_acknowledged()
    }

    fn outrun(&mut self) -> &mut bool {
        &mut self.is_outrun
    }
}

fn room(offer: Offer, size: usize, others: usize) -> usize {
    let depth = offer.depth.clamp(1, DEEPEST) as usize;
    let room = quality::depth(size, others);
    // A late subscriber is sent all kept messages, so there are few.
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

type Made = Result<Box<dyn Write>, String>;

fn writer(encoding: u16, publisher: &Publisher, topic: &rustdds::Topic, policies: QosPolicies) -> Made {
    fn made<const ID: u16>(publisher: &Publisher, topic: &rustdds::Topic, policies: QosPolicies) -> Made {
        let writer = publisher.create_datawriter_no_key::<Bytes, Encoded<ID>>(topic, Some(policies));
        let writer = writer.map_err(|error| format!("its publisher cannot be created ({error:?})"))?;
        Ok(Box::new(Rc::new(writer)))
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

/// Longer messages go ahead, bytes; every DDS's receive buffer holds shorter ones at once.
pub const LARGE: usize = 64 << 10;
/// Bytes of a fragment, as rustdds makes them: a subscriber may combine both.
const FRAGMENT: usize = 256;
/// Fragments in a datagram: to this machine; to another one, where it must fit a packet.
const NEAR: usize = 128;
const FAR: usize = 5;
/// Bytes a second: at first, at least and at most.
const FIRST_RATE: f64 = 80e6;
const RATES: (f64, f64) = (8e6, 120e6);
/// The longest that one message may take, seconds.
const LONGEST: f64 = 2.0;
/// How long one call sends before others have their turn.
const SLICE: Duration = Duration::from_millis(20);
/// The most unused sending time that is made up for.
const SLACK: Duration = Duration::from_millis(1);
/// Shorter pauses are skipped.
const SHORTEST_PAUSE: Duration = Duration::from_micros(200);
const MOST_ADDRESSES: usize = 16;
/// rustdds's vendor id.
const VENDOR: [u8; 2] = [1, 18];

/// The addresses of each subscriber of a topic.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Addresses(Vec<Vec<SocketAddr>>);

impl Addresses {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn add(&mut self, of_one: impl Iterator<Item = SocketAddr>) {
        let own: Vec<SocketAddr> = of_one.filter(SocketAddr::is_ipv4).take(MOST_ADDRESSES).collect();
        if !own.is_empty() && self.0.len() < MOST_ADDRESSES {
            self.0.push(own);
        }
    }

    /// Destinations, and fragments in a datagram to each: of each subscriber one address on this machine, since all
    /// lead to the same socket; otherwise all.
    fn ways(&self) -> Vec<(SocketAddr, usize)> {
        let mut ways = Vec::new();
        for own in &self.0 {
            let near = own.iter().find(|to| is_here(**to)).map(|to| vec![(*to, NEAR)]);
            for way in near.unwrap_or_else(|| own.iter().map(|to| (*to, FAR)).collect()) {
                if ways.len() < MOST_ADDRESSES && !ways.contains(&way) {
                    ways.push(way);
                }
            }
        }
        ways
    }
}

/// Whether this machine would send to it from the same address.
fn is_here(to: SocketAddr) -> bool {
    let from = || {
        let socket = UdpSocket::bind((IpAddr::V4(Ipv4Addr::UNSPECIFIED), 0))?;
        socket.connect(to)?;
        socket.local_addr()
    };
    from().is_ok_and(|from: SocketAddr| from.ip() == to.ip())
}

pub struct Rate(f64);

impl Default for Rate {
    fn default() -> Self {
        Self(FIRST_RATE)
    }
}

impl Rate {
    pub fn slower(&mut self) {
        self.0 = (self.0 / 2.0).max(RATES.0);
    }

    pub fn faster(&mut self) {
        self.0 = (self.0 * 1.1).min(RATES.1);
    }

    /// Time for this many bytes of a message of this length.
    #[expect(clippy::cast_precision_loss, reason = "lengths of messages are below 2^53")]
    fn time(&self, bytes: usize, length: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / self.0.max(length as f64 / LONGEST))
    }
}

pub struct Ahead {
    message: Bytes,
    head: Vec<u8>,
    writer: [u8; 4],
    number: i64,
    ways: Vec<(SocketAddr, usize)>,
    /// The place among the ways, and the next fragment, from 0.
    place: usize,
    fragment: usize,
    due: Instant,
}

impl Ahead {
    /// `message` has its four bytes of header, and gets this number from its writer.
    pub fn new(message: Bytes, (writer, number): (GUID, i64), to: &Addresses) -> Self {
        let id = writer.to_bytes();
        let mut head = [b"RTPS".as_slice(), &[2, 4], &VENDOR, &id[..12]].concat();
        head.extend(time_of_writing());
        let writer = [id[12], id[13], id[14], id[15]];
        Self { message, head, writer, number, ways: to.ways(), place: 0, fragment: 0, due: Instant::now() }
    }

    /// Sends for a moment; true when everything is sent.
    pub fn advance(&mut self, socket: &UdpSocket, rate: &Rate) -> bool {
        let begun = Instant::now();
        while let Some((to, most)) = self.ways.get(self.place).copied() {
            if begun.elapsed() >= SLICE {
                return false;
            }
            let datagram = self.datagram(most);
            // rustdds repeats whatever is lost.
            drop(socket.send_to(&datagram, to));
            let now = Instant::now();
            let earliest = now.checked_sub(SLACK).unwrap_or(now);
            self.due = self.due.max(earliest) + rate.time(datagram.len(), self.message.len());
            let pause = self.due.saturating_duration_since(now);
            if pause >= SHORTEST_PAUSE {
                std::thread::sleep(pause);
            }
        }
        true
    }

    fn datagram(&mut self, most: usize) -> Vec<u8> {
        let length = self.message.len();
        let from = self.fragment * FRAGMENT;
        let end = (from + most * FRAGMENT).min(length);
        let count = (end - from).div_ceil(FRAGMENT);
        let piece = self.message.slice(from..end);
        let datagram = self.with_head(count, &piece);
        self.fragment += count;
        if end == length {
            (self.place, self.fragment) = (self.place + 1, 0);
        }
        datagram
    }

    fn with_head(&self, count: usize, piece: &[u8]) -> Vec<u8> {
        let short = |number: usize| u16::try_from(number).unwrap_or(u16::MAX).to_le_bytes();
        let long = |number: usize| u32::try_from(number).unwrap_or(u32::MAX).to_le_bytes();
        let number = self.number.to_le_bytes();
        let (low, high) = number.split_at(4);
        let parts: [&[u8]; 13] = [
            &self.head,
            // DATA_FRAG, little endian; after the length, 32 bytes precede the fragments.
            &[0x16, 1],
            &short(32 + piece.len()),
            &[0, 0, 28, 0],
            // To every reader.
            &[0; 4],
            &self.writer,
            high,
            low,
            &long(self.fragment + 1),
            &short(count),
            &short(FRAGMENT),
            &long(self.message.len()),
            piece,
        ];
        parts.concat()
    }
}

/// The submessage with the time of writing.
fn time_of_writing() -> Vec<u8> {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let seconds = u32::try_from(now.as_secs()).unwrap_or(u32::MAX);
    let fraction = (u64::from(now.subsec_nanos()) << 32) / 1_000_000_000;
    let fraction = u32::try_from(fraction).unwrap_or(u32::MAX);
    [[9, 1, 8, 0], seconds.to_le_bytes(), fraction.to_le_bytes()].concat()
}

// Messages waiting to be written, oldest first; nothing overtakes, over all topics.

/// The network code keeps written messages for repair and clears them every six seconds: bytes written within that
/// time.
const MOST_KEPT: usize = 512 << 20;
const KEPT_FOR: Duration = Duration::from_secs(7);

pub trait Outlet {
    fn attempt(&mut self, message: &Bytes) -> Attempt;
    /// Whether some subscribers do not acknowledge.
    fn is_unconfirmed(&self) -> bool;
    fn has_caught_up(&self) -> bool;
    /// Whether it no longer waits for its subscribers.
    fn outrun(&mut self) -> &mut bool;
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Taken {
    pub messages: u32,
    /// Of these, not written because a subscriber is behind.
    pub dropped: u32,
    /// Of these, possibly missed by best-effort subscribers, or taken back.
    pub unconfirmed: u32,
}

#[derive(Default)]
pub struct Queue {
    waiting: VecDeque<(u32, Bytes)>,
    /// Writers that are gone, or never were; messages for writers still to come wait.
    gone: HashSet<u32>,
    written: VecDeque<(Instant, usize)>,
    written_bytes: usize,
    pub last_written: Option<Instant>,
}

impl Queue {
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    pub fn push(&mut self, writer: u32, message: Vec<u8>) {
        self.waiting.push_back((writer, Bytes::from(message)));
    }

    /// Its messages leave the queue unwritten.
    pub fn forget(&mut self, writer: u32) {
        self.gone.insert(writer);
    }

    /// Stops waiting for subscribers that are behind.
    pub fn outrun<O: Outlet>(&self, outlets: &mut BTreeMap<u32, O>) {
        for outlet in outlets.values_mut() {
            *outlet.outrun() = !outlet.has_caught_up();
        }
    }

    pub fn pump<O: Outlet>(&mut self, outlets: &mut BTreeMap<u32, O>, now: Instant) -> Taken {
        self.clear_away(now);
        let mut taken = Taken::default();
        while let Some((writer, message)) = self.waiting.front() {
            let (writer, size) = (*writer, message.len());
            let attempt = match outlets.get_mut(&writer) {
                None if self.gone.contains(&writer) => {
                    taken.unconfirmed += 1;
                    Attempt::Written
                }
                // It is about to be announced.
                None => break,
                Some(_) if self.written_bytes > 0 && self.written_bytes + size > MOST_KEPT => break,
                Some(outlet) => {
                    if *outlet.outrun() && outlet.has_caught_up() {
                        *outlet.outrun() = false;
                    }
                    let attempt = outlet.attempt(message);
                    if attempt == Attempt::Begun || attempt == Attempt::Full && !*outlet.outrun() {
                        break;
                    }
                    if attempt == Attempt::Written {
                        taken.unconfirmed += u32::from(outlet.is_unconfirmed());
                        self.written.push_back((now, size));
                        self.written_bytes += size;
                        self.last_written = Some(now);
                    }
                    attempt
                }
            };
            taken.messages += 1;
            taken.dropped += u32::from(attempt != Attempt::Written);
            self.waiting.pop_front();
        }
        taken
    }

    fn clear_away(&mut self, now: Instant) {
        while let Some((at, size)) = self.written.front().copied()
            && now.saturating_duration_since(at) >= KEPT_FOR
        {
            self.written_bytes -= size;
            self.written.pop_front();
        }
    }
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

#[cfg(test)]
mod ahead_tests {
    use super::*;

    #[test]
    fn fragments_add_up_to_the_message_at_every_subscriber() {
        let receivers: Vec<UdpSocket> = (0..2).map(|_| UdpSocket::bind("127.0.0.1:0").expect("a socket")).collect();
        let mut to = Addresses::default();
        for receiver in &receivers {
            let local = receiver.local_addr().expect("an address");
            to.add([SocketAddr::from(([192, 0, 2, 1], 9)), local].into_iter());
            to.add([local].into_iter());
        }
        assert_eq!(to.ways().len(), 2, "one address of this machine each, once");
        let message: Bytes = (0..70_001_u32).map(|at| u8::try_from(at % 251).expect("small")).collect();
        let writer = GUID::GUID_UNKNOWN;
        let mut ahead = Ahead::new(message.clone(), (writer, (7 << 32) + 9), &to);
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        while !ahead.advance(&socket, &Rate::default()) {}
        for receiver in &receivers {
            let (mut got, mut buffer) = (Vec::new(), vec![0; 1 << 16]);
            while got.len() < message.len() {
                let length = receiver.recv(&mut buffer).expect("received");
                let (head, piece) = buffer[..length].split_at(32 + 4 + 32);
                assert_eq!(&head[..8], b"RTPS\x02\x04\x01\x12");
                assert_eq!(
                    (&head[32..34], usize::from(head[34]) + (usize::from(head[35]) << 8)),
                    ([0x16, 1].as_slice(), length - 36)
                );
                assert_eq!(&head[48..56], [7, 0, 0, 0, 9, 0, 0, 0]);
                assert_eq!(head[56..60], u32::try_from(got.len() / 256 + 1).expect("small").to_le_bytes());
                assert_eq!(head[64..68], 70_001_u32.to_le_bytes());
                got.extend_from_slice(piece);
            }
            assert!(got == message);
        }
    }

    #[test]
    fn the_rate_has_bounds_and_no_message_takes_longer_than_two_seconds() {
        let mut rate = Rate::default();
        for _ in 0..50 {
            rate.slower();
        }
        assert!(rate.time(64 << 20, 64 << 20) <= Duration::from_millis(2001));
        assert_eq!(rate.time(8_000_000, 8_000_000), Duration::from_secs(1));
        for _ in 0..50 {
            rate.faster();
        }
        assert_eq!(rate.time(120_000_000, 1), Duration::from_secs(1));
    }
}

#[cfg(test)]
mod queue_tests {
    use super::*;

    /// Its capacity in messages.
    #[derive(Default)]
    struct Fake {
        room: usize,
        got: Vec<Bytes>,
        outrun: bool,
    }

    impl Outlet for Fake {
        fn attempt(&mut self, message: &Bytes) -> Attempt {
            if self.room == 0 {
                return Attempt::Full;
            }
            self.room -= 1;
            self.got.push(message.clone());
            Attempt::Written
        }

        fn is_unconfirmed(&self) -> bool {
            false
        }

        fn has_caught_up(&self) -> bool {
            self.room > 0
        }

        fn outrun(&mut self) -> &mut bool {
            &mut self.outrun
        }
    }

    fn queue(messages: &[(u32, u8)]) -> Queue {
        let mut queue = Queue::default();
        messages.iter().for_each(|(writer, byte)| queue.push(*writer, vec![*byte]));
        queue
    }

    fn outlets(rooms: &[usize]) -> BTreeMap<u32, Fake> {
        (1..).zip(rooms.iter().map(|room| Fake { room: *room, ..Fake::default() })).collect()
    }

    #[test]
    fn nothing_overtakes_a_message_that_waits() {
        let (mut queue, mut outlets, now) = (queue(&[(1, 1), (1, 2), (2, 3)]), outlets(&[1, 9]), Instant::now());
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 1, dropped: 0, unconfirmed: 0 });
        assert_eq!(queue.pump(&mut outlets, now), Taken::default());
        assert!(outlets[&2].got.is_empty() && !queue.is_empty());
        outlets.get_mut(&1).expect("there").room = 1;
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 2, dropped: 0, unconfirmed: 0 });
        assert_eq!((outlets[&1].got.len(), outlets[&2].got.len()), (2, 1));
    }

    #[test]
    fn a_writer_that_is_outrun_loses_messages_until_it_has_caught_up() {
        let (mut queue, mut outlets, now) = (queue(&[(1, 1), (2, 2), (1, 3)]), outlets(&[0, 9]), Instant::now());
        queue.outrun(&mut outlets);
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 3, dropped: 2, unconfirmed: 0 });
        outlets.get_mut(&1).expect("there").room = 1;
        queue.push(1, vec![4]);
        queue.push(1, vec![5]);
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 1, dropped: 0, unconfirmed: 0 });
        assert!(!queue.is_empty(), "it is waited for again");
    }

    #[test]
    fn what_is_taken_back_is_never_written() {
        let (mut queue, mut outlets, now) = (queue(&[(1, 1), (2, 2), (1, 3)]), outlets(&[9, 9]), Instant::now());
        queue.forget(1);
        outlets.remove(&1);
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 3, dropped: 0, unconfirmed: 2 });
        assert_eq!(outlets[&2].got, [Bytes::from_static(&[2])]);
    }

    #[test]
    fn memory_is_bounded_by_what_is_written_within_seconds() {
        let (mut queue, mut outlets, now) = (Queue::default(), outlets(&[9]), Instant::now());
        for _ in 0..3 {
            // Zeros of which no page is touched.
            queue.push(1, vec![0; MOST_KEPT / 2]);
        }
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 2, dropped: 0, unconfirmed: 0 });
        assert_eq!(queue.pump(&mut outlets, now + KEPT_FOR / 2), Taken::default());
        assert_eq!(queue.pump(&mut outlets, now + KEPT_FOR), Taken { messages: 1, dropped: 0, unconfirmed: 0 });
    }
}
