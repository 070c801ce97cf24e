//! Leaves so that every DDS sees it: Fast DDS drops the form in which rustdds says that an endpoint is gone, and its
//! reliable writers wait for the reader until its node dies (decision 018). So the RTPS messages for it are written
//! here, with the key in the inline QoS, and the answers read.

use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::graph::{self, Id, Prefix};

/// Group and first port of announcements.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
const FIRST_PORT: u16 = 7400;
const PORTS_PER_DOMAIN: u16 = 250;
/// Ports of local participants that hear no group: the first, the distance, the count.
const FIRST_UNICAST: u16 = 10;
const UNICAST_STEP: u16 = 2;
const MOST_LOCAL: u16 = 32;
const MOST_INTERFACES: usize = 16;
const LONGEST: usize = 4096;
const MOST_HEARD: usize = 256;

/// Pauses before each repetition, for networks that lose datagrams.
const OF_LEAVING: &[Duration] = &[Duration::ZERO, Duration::from_millis(50), Duration::from_millis(150)];
const OF_BURYING: &[Duration] = &[
    Duration::ZERO,
    Duration::from_millis(200),
    Duration::from_millis(500),
    Duration::from_secs(1),
    Duration::from_secs(2),
];

/// Intervals between repetitions, in the first seconds and later.
const SOON: Duration = Duration::from_millis(150);
const YOUNG: Duration = Duration::from_secs(3);
const LATER: Duration = Duration::from_secs(1);
/// Limit of an acknowledgement.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time an idle herald stays: endpoints leave one after the other.
const IDLE: Duration = Duration::from_secs(3);
/// Seconds until others forget a herald that vanishes.
const LEASE: i32 = 10;
/// Limits of endpoints for one herald, and for one datagram.
const MOST_GONE: usize = 4096;
const AT_ONCE: usize = 16;
const MOST_PEERS: usize = 4096;

struct Voices {
    domain: u16,
    /// One for each address of this machine: datagrams to the group leave from it.
    each: Vec<(Ipv4Addr, UdpSocket)>,
}

fn own_addresses() -> Vec<Ipv4Addr> {
    let found = nix::ifaddrs::getifaddrs().into_iter().flatten();
    let mut found: Vec<Ipv4Addr> = found.filter_map(|one| Some(one.address?.as_sockaddr_in()?.ip())).collect();
    found.truncate(MOST_INTERFACES);
    found
}

impl Voices {
    fn open(domain: u16) -> Self {
        let bound = |ip: Ipv4Addr| {
            let socket = UdpSocket::bind((ip, 0)).ok()?;
            socket.set_nonblocking(true).ok()?;
            Some((ip, socket))
        };
        Self { domain, each: own_addresses().into_iter().filter_map(bound).collect() }
    }

    fn shout(&self, message: &Message) {
        let first = FIRST_PORT.saturating_add(self.domain.saturating_mul(PORTS_PER_DOMAIN));
        for (ip, socket) in &self.each {
            drop(socket.send_to(message.bytes(), (GROUP, first)));
            if ip.is_loopback() {
                for local in 0..MOST_LOCAL {
                    let port = first.saturating_add(FIRST_UNICAST + UNICAST_STEP * local);
                    drop(socket.send_to(message.bytes(), (*ip, port)));
                }
            }
        }
    }

    fn bury(&self, participant: &Prefix) {
        let mut message = Message::new(participant);
        // Exceeds every number that it used, and the one of the last time, over a restart too.
        let number = SystemTime::now().duration_since(UNIX_EPOCH).map_or(1 << 40, |time| time.as_millis());
        message.participant_gone(i64::try_from(number).unwrap_or(1 << 40), participant);
        self.shout(&message);
    }
}

fn repeat(domain: u16, participant: &Prefix, pauses: &[Duration]) {
    let voices = Voices::open(domain);
    for pause in pauses {
        std::thread::sleep(*pause);
        voices.bury(participant);
    }
}

/// Announces that a killed participant is gone. Takes four seconds.
pub fn bury(domain: u16, participant: &Prefix) {
    repeat(domain, participant, OF_BURYING);
}

/// Announces at its end that a participant is gone.
pub struct Farewell {
    domain: u16,
    participant: Prefix,
}

impl Farewell {
    pub fn new(domain: u16, own: &Id) -> Self {
        Self { domain, participant: graph::prefix(own) }
    }

    /// Says it now: what follows may take time or hang.
    pub fn say(&self) {
        Voices::open(self.domain).bury(&self.participant);
    }
}

impl Drop for Farewell {
    fn drop(&mut self) {
        repeat(self.domain, &self.participant, OF_LEAVING);
    }
}

const FAST_DDS: [u8; 2] = [1, 15];

#[derive(Default)]
struct Peer {
    at: Vec<SocketAddrV4>,
    /// Of readers and of writers: the first number that it does not have.
    lacks: [i64; 2],
}

/// A participant that announces which endpoints of another are gone: rustdds numbers its own announcements.
struct Herald {
    voices: Voices,
    socket: UdpSocket,
    prefix: Prefix,
    /// Gone readers and writers; the first has number 1.
    gone: [Vec<Id>; 2],
    peers: HashMap<Prefix, Peer>,
    added: Instant,
    spoken: Option<Instant>,
    round: u32,
}

const CHANNELS: [Channel; 2] = [READERS, WRITERS];

fn is_writer(id: &Id) -> bool {
    matches!(id.last().map(|kind| kind & 0x3f), Some(2 | 3))
}

fn number(place: usize) -> i64 {
    i64::try_from(place).map_or(i64::MAX, |place| place.saturating_add(1))
}

impl Herald {
    fn begin(domain: u16, prefix: Prefix) -> std::io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            voices: Voices::open(domain),
            socket,
            prefix,
            gone: [Vec::new(), Vec::new()],
            peers: HashMap::new(),
            added: Instant::now(),
            spoken: None,
            round: 0,
        })
    }

    fn is_owed(&self, to: &Prefix) -> bool {
        let lacks = self.peers.get(to).map_or([1, 1], |peer| peer.lacks);
        self.gone.iter().zip(lacks).any(|(gone, lacks)| lacks.max(1) <= number(gone.len()).saturating_sub(1))
    }

    /// Whether a participant may not know yet that this endpoint is gone.
    fn is_telling(&self, id: &Id, to: &[Prefix]) -> bool {
        let kind = usize::from(is_writer(id));
        let place = self.gone.get(kind).and_then(|gone| gone.iter().position(|one| one == id));
        let lacks = |to| self.peers.get(to).and_then(|peer: &Peer| peer.lacks.get(kind)).copied().unwrap_or(1);
        place.is_some_and(|place| to.iter().any(|to| lacks(to) <= number(place)))
    }

    fn hear(&mut self) {
        let mut buffer = [0; LONGEST];
        for _ in 0..MOST_HEARD {
            let Ok((length, _)) = self.socket.recv_from(&mut buffer) else { return };
            let Some((from, said)) = buffer.get(..length).and_then(|bytes| read(bytes, &self.prefix)) else {
                continue;
            };
            if self.peers.len() >= MOST_PEERS && !self.peers.contains_key(&from) {
                continue;
            }
            let peer = self.peers.entry(from).or_default();
            for said in said {
                match said {
                    Said::Reached(at) => peer.at = at,
                    Said::Has(channel, below) => {
                        let kind = usize::from(channel == WRITERS);
                        peer.lacks.get_mut(kind).into_iter().for_each(|lacks| *lacks = below.max(*lacks));
                    }
                }
            }
        }
    }

    fn speak(&mut self, to: &[Prefix]) {
        let interval = if self.added.elapsed() < YOUNG { SOON } else { LATER };
        let is_early = self.spoken.is_some_and(|spoken| spoken.elapsed() < interval);
        if is_early || !to.iter().any(|to| self.is_owed(to)) {
            return;
        }
        (self.spoken, self.round) = (Some(Instant::now()), self.round.saturating_add(1));
        let port = self.socket.local_addr().map_or(0, |address| address.port());
        let at: Vec<_> = self.voices.each.iter().map(|(ip, _)| SocketAddrV4::new(*ip, port)).collect();
        let mut here = Message::new(&self.prefix);
        here.participant_here(i64::from(self.round), &self.prefix, &at, LEASE);
        self.voices.shout(&here);
        for peer in to.iter().filter(|to| self.is_owed(to)).filter_map(|to| self.peers.get(to)) {
            let message = self.owed(peer);
            for at in &peer.at {
                drop(self.socket.send_to(message.bytes(), at));
            }
        }
    }

    fn owed(&self, peer: &Peer) -> Message {
        let mut message = Message::new(&self.prefix);
        for ((gone, lacks), channel) in self.gone.iter().zip(peer.lacks).zip(CHANNELS) {
            let from = usize::try_from(lacks.saturating_sub(1)).unwrap_or(0);
            let mut last = None;
            for (place, id) in gone.iter().enumerate().skip(from).take(AT_ONCE) {
                message.gone(channel, number(place), id);
                last = Some(number(place));
            }
            if let Some(last) = last {
                message.heartbeat(channel, last, self.round);
            }
        }
        message
    }
}

impl Drop for Herald {
    fn drop(&mut self) {
        if self.spoken.is_some() {
            self.voices.bury(&self.prefix);
        }
    }
}

/// Leaving endpoints of this program's participant, until the others have acknowledged it.
pub struct Departures {
    domain: u16,
    own: Prefix,
    heralds: u32,
    herald: Option<Herald>,
    /// The participants to tell.
    others: Vec<Prefix>,
}

impl Departures {
    pub fn new(domain: u16, own: &Id) -> Self {
        Self { domain, own: graph::prefix(own), heralds: 0, herald: None, others: Vec::new() }
    }

    /// A reader must go on until [`Self::is_telling`] is false, or a writer waits for it.
    pub fn tell(&mut self, id: Id) {
        if self.herald.is_none() {
            self.heralds = self.heralds.wrapping_add(1);
            let mut prefix = self.own;
            let end = prefix.iter_mut().skip(graph::PROGRAM);
            end.zip(self.heralds.to_be_bytes()).for_each(|(byte, new)| *byte ^= new);
            self.herald = Herald::begin(self.domain, prefix).ok();
        }
        let Some(herald) = &mut self.herald else { return };
        let Some(gone) = herald.gone.get_mut(usize::from(is_writer(&id))) else { return };
        if gone.len() < MOST_GONE {
            gone.push(id);
            herald.added = Instant::now();
        }
    }

    /// Whether a participant may not know yet that the endpoint left.
    pub fn is_telling(&self, id: &Id) -> bool {
        self.herald.as_ref().is_some_and(|herald| herald.is_telling(id, &self.others))
    }

    /// Only Fast DDS needs it.
    pub fn go_on(&mut self, present: impl Iterator<Item = Prefix>) {
        self.others = present.filter(|prefix| prefix.starts_with(&FAST_DDS)).collect();
        let Some(herald) = &mut self.herald else { return };
        herald.hear();
        herald.speak(&self.others);
        let is_owed = self.others.iter().any(|to| herald.is_owed(to));
        if herald.added.elapsed() >= if is_owed { PATIENCE } else { IDLE } {
            self.herald = None;
        }
    }
}

pub type Entity = [u8; 4];

/// A built-in writer and the reader it speaks to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel {
    writer: Entity,
    reader: Entity,
}

const PARTICIPANTS: Channel = Channel { writer: [0, 1, 0, 0xc2], reader: [0, 1, 0, 0xc7] };
pub const WRITERS: Channel = Channel { writer: [0, 0, 3, 0xc2], reader: [0, 0, 3, 0xc7] };
pub const READERS: Channel = Channel { writer: [0, 0, 4, 0xc2], reader: [0, 0, 4, 0xc7] };
const PARTICIPANT: Entity = [0, 0, 1, 0xc1];

/// Protocol 2.4, and rustdds's vendor id: these messages speak for its participants.
const HEADER: &[u8] = b"RTPS\x02\x04\x01\x12";
const VERSION: [u8; 4] = [2, 4, 0, 0];
const VENDOR: [u8; 4] = [1, 0x12, 0, 0];

const ACKNACK: u8 = 0x06;
const HEARTBEAT: u8 = 0x07;
const DESTINATION: u8 = 0x0e;
const DATA: u8 = 0x15;
const LITTLE: u8 = 1;
const INLINE_QOS: u8 = 2;
const PAYLOAD: u8 = 4;

const END: u16 = 1;
const LEASE_TIME: u16 = 0x02;
const PROTOCOL: u16 = 0x15;
const MAKER: u16 = 0x16;
const METATRAFFIC_ADDRESS: u16 = 0x32;
const PARTICIPANT_ID: u16 = 0x50;
const ENDPOINTS: u16 = 0x58;
const KEY_HASH: u16 = 0x70;
const STATUS: u16 = 0x71;
const GONE: [u8; 4] = [0, 0, 0, 3];
/// Announces participants, writers and readers; reads only participants.
const ANNOUNCERS: u32 = 1 | 2 | 4 | 16;
const UDP_V4: i32 = 1;

/// Addresses taken from one announcement.
const MOST_ADDRESSES: usize = 8;
/// Limit of parameters and of submessages.
const MOST_PARTS: usize = 256;

pub struct Message(Vec<u8>);

fn parameter(into: &mut Vec<u8>, id: u16, value: &[u8]) {
    into.extend(id.to_le_bytes());
    into.extend(u16::try_from(value.len()).unwrap_or(0).to_le_bytes());
    into.extend(value);
}

/// High half first, each half little-endian.
fn number_bytes(number: i64) -> [u8; 8] {
    number.cast_unsigned().rotate_left(32).to_le_bytes()
}

impl Message {
    pub fn new(from: &Prefix) -> Self {
        Self([HEADER, from].concat())
    }

    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    fn submessage(&mut self, kind: u8, flags: u8, body: &[u8]) {
        self.0.extend([kind, flags | LITTLE]);
        self.0.extend(u16::try_from(body.len()).unwrap_or(0).to_le_bytes());
        self.0.extend(body);
    }

    fn data(&mut self, channel: Channel, number: i64, flags: u8, content: &[u8]) {
        // Two bytes of flags, and the distance to the content.
        let mut body = vec![0, 0, 16, 0];
        body.extend(channel.reader.iter().chain(&channel.writer));
        body.extend(number_bytes(number));
        body.extend(content);
        self.submessage(DATA, flags, &body);
    }

    pub fn gone(&mut self, channel: Channel, number: i64, id: &Id) {
        let mut content = Vec::new();
        parameter(&mut content, KEY_HASH, id);
        parameter(&mut content, STATUS, &GONE);
        parameter(&mut content, END, &[]);
        self.data(channel, number, INLINE_QOS, &content);
    }

    /// `number` must exceed those of its announcements.
    pub fn participant_gone(&mut self, number: i64, prefix: &Prefix) {
        let mut id = [0; 16];
        prefix.iter().chain(&PARTICIPANT).zip(&mut id).for_each(|(from, to)| *to = *from);
        self.gone(PARTICIPANTS, number, &id);
    }

    /// A participant without endpoints of its own; the lease is in seconds.
    pub fn participant_here(&mut self, number: i64, prefix: &Prefix, at: &[SocketAddrV4], lease: i32) {
        let mut content = vec![0, 3, 0, 0];
        parameter(&mut content, PROTOCOL, &VERSION);
        parameter(&mut content, MAKER, &VENDOR);
        parameter(&mut content, PARTICIPANT_ID, &[prefix.as_slice(), &PARTICIPANT].concat());
        for address in at.iter().take(MOST_ADDRESSES) {
            let port = u32::from(address.port()).to_le_bytes();
            let parts = [&UDP_V4.to_le_bytes(), &port, [0; 12].as_slice(), &address.ip().octets()];
            parameter(&mut content, METATRAFFIC_ADDRESS, &parts.concat());
        }
        parameter(&mut content, ENDPOINTS, &ANNOUNCERS.to_le_bytes());
        parameter(&mut content, LEASE_TIME, &[lease.to_le_bytes(), [0; 4]].concat());
        parameter(&mut content, END, &[]);
        self.data(PARTICIPANTS, number, PAYLOAD, &content);
    }

    /// Asks which numbers up to `last` have arrived; `count` grows with each.
    pub fn heartbeat(&mut self, channel: Channel, last: i64, count: u32) {
        let mut body = [channel.reader, channel.writer].concat();
        body.extend(number_bytes(1).into_iter().chain(number_bytes(last)).chain(count.to_le_bytes()));
        self.submessage(HEARTBEAT, 0, &body);
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Said {
    /// Address of its announcements.
    Reached(Vec<SocketAddrV4>),
    /// It has all numbers of this channel below this one.
    Has(Channel, i64),
}

struct Front<'a> {
    bytes: &'a [u8],
    little: bool,
}

impl<'a> Front<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (found, rest) = self.bytes.split_first_chunk()?;
        self.bytes = rest;
        Some(*found)
    }

    fn short(&mut self) -> Option<u16> {
        let little = self.little;
        self.array().map(|bytes| if little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    }

    fn long(&mut self) -> Option<u32> {
        let little = self.little;
        self.array().map(|bytes| if little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    fn part(&mut self, length: usize) -> Option<&'a [u8]> {
        let (found, rest) = self.bytes.split_at_checked(length)?;
        self.bytes = rest;
        Some(found)
    }
}

/// The sender, and what it says to `own`.
pub fn read(bytes: &[u8], own: &Prefix) -> Option<(Prefix, Vec<Said>)> {
    let mut front = Front { bytes: bytes.strip_prefix(b"RTPS")?, little: true };
    let _version_and_vendor: [u8; 4] = front.array()?;
    let from = front.array()?;
    let (mut said, mut is_ours) = (Vec::new(), true);
    for _ in 0..MOST_PARTS {
        let Some([kind, flags]) = front.array() else { break };
        front.little = flags & LITTLE != 0;
        let length = usize::from(front.short()?);
        let length = if length == 0 { front.bytes.len() } else { length };
        let mut body = Front { bytes: front.part(length)?, little: front.little };
        match kind {
            DESTINATION => is_ours = body.array()? == *own,
            ACKNACK if is_ours => said.extend(has(&mut body)),
            DATA => said.extend(reached(&mut body, flags)),
            _ => {}
        }
    }
    Some((from, said))
}

fn has(body: &mut Front<'_>) -> Option<Said> {
    let _reader: Entity = body.array()?;
    let writer: Entity = body.array()?;
    let channel = [READERS, WRITERS].into_iter().find(|channel| channel.writer == writer)?;
    let (high, low) = (body.long()?, body.long()?);
    Some(Said::Has(channel, ((u64::from(high) << 32) | u64::from(low)).cast_signed()))
}

fn reached(body: &mut Front<'_>, flags: u8) -> Option<Said> {
    let _flags: [u8; 2] = body.array()?;
    let distance = usize::from(body.short()?);
    let mut ids = Front { bytes: body.part(distance)?, little: body.little };
    let _reader: Entity = ids.array()?;
    if ids.array::<4>()? != PARTICIPANTS.writer || flags & PAYLOAD == 0 {
        return None;
    }
    if flags & INLINE_QOS != 0 {
        parameters(body, |_, _| {})?;
    }
    let [_, encoding, _, _] = body.array()?;
    body.little = encoding & 1 != 0;
    let mut found = Vec::new();
    parameters(body, |id, mut value| {
        if id == METATRAFFIC_ADDRESS && found.len() < MOST_ADDRESSES {
            found.extend(address(&mut value));
        }
    })?;
    Some(Said::Reached(found))
}

fn address(value: &mut Front<'_>) -> Option<SocketAddrV4> {
    let (kind, port) = (value.long()?, value.long()?);
    let _unused: [u8; 12] = value.array()?;
    let ip = Ipv4Addr::from(value.array::<4>()?);
    let usable = kind == UDP_V4.unsigned_abs() && !ip.is_unspecified() && !ip.is_broadcast() && !ip.is_multicast();
    usable.then_some(SocketAddrV4::new(ip, u16::try_from(port).ok().filter(|port| *port > 0)?))
}

fn parameters(body: &mut Front<'_>, mut take: impl FnMut(u16, Front<'_>)) -> Option<()> {
    for _ in 0..MOST_PARTS {
        let (id, length) = (body.short()?, body.short()?);
        if id == END {
            return Some(());
        }
        take(id, Front { bytes: body.part(usize::from(length))?, little: body.little });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: Prefix = [7; 12];

    /// As Fast DDS 2.14 sends it, with its trace submessage left out.
    fn acknowledgement() -> Vec<u8> {
        let mut message = b"RTPS\x02\x03\x01\x0f".to_vec();
        message.extend([9; 12]);
        message.extend([0x0e, 1, 12, 0]);
        message.extend(OWN);
        message.extend([6, 3, 24, 0, 0, 0, 4, 0xc7, 0, 0, 4, 0xc2]);
        message.extend([0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 0]);
        message
    }

    #[test]
    fn an_acknowledgement_counts_for_whom_it_is_addressed_to() {
        assert_eq!(read(&acknowledgement(), &OWN), Some(([9; 12], vec![Said::Has(READERS, 2)])));
        assert_eq!(read(&acknowledgement(), &[8; 12]), Some(([9; 12], Vec::new())));
    }

    #[test]
    fn an_announcement_says_where_its_participant_is_reached() {
        let at = [SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410), SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 2), 7412)];
        let mut message = Message::new(&OWN);
        message.participant_here(3, &OWN, &at, 10);
        assert_eq!(read(message.bytes(), &[1; 12]), Some((OWN, vec![Said::Reached(at.to_vec())])));
    }

    #[test]
    fn the_key_of_what_is_gone_stands_in_its_inline_qos() {
        let mut message = Message::new(&OWN);
        message.participant_gone(1 << 33, &OWN);
        let expected: &[u8] = &[
            0x15, 3, 52, 0, 0, 0, 16, 0, 0, 1, 0, 0xc7, 0, 1, 0, 0xc2, 2, 0, 0, 0, 0, 0, 0, 0, 0x70, 0, 16, 0, 7, 7, 7,
            7, 7, 7, 7, 7, 7, 7, 7, 7, 0, 0, 1, 0xc1, 0x71, 0, 4, 0, 0, 0, 0, 3, 1, 0, 0, 0,
        ];
        assert_eq!(message.bytes().split_at(20).1, expected);
    }

    #[test]
    fn hostile_messages_are_left_out() {
        let mut announced = Message::new(&OWN);
        announced.participant_here(1, &OWN, &[SocketAddrV4::new(Ipv4Addr::LOCALHOST, 1)], 10);
        for whole in [acknowledgement(), announced.bytes().to_vec()] {
            for end in 0..whole.len() {
                drop(read(&whole[..end], &OWN));
                let mut changed = whole.clone();
                changed[end] ^= 0xff;
                drop(read(&changed, &OWN));
            }
        }
        let mut nowhere = Message::new(&OWN);
        nowhere.participant_here(1, &OWN, &[SocketAddrV4::new(Ipv4Addr::new(239, 255, 0, 1), 7400)], 10);
        assert_eq!(read(nowhere.bytes(), &OWN), Some((OWN, vec![Said::Reached(Vec::new())])));
    }
}
