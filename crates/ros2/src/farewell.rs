//! Leaving so that every DDS sees it: rustdds says that an endpoint or a participant is gone in a form that Fast DDS drops,
//! and a reliable writer there waits for a reader that is gone until its node dies (decision 085).

use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::graph::{self, Id, Prefix};
use crate::rtps::{self, Channel, Message, Said};

/// The group and the first port on which participants announce themselves.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
const FIRST_PORT: u16 = 7400;
const PORTS_PER_DOMAIN: u16 = 250;
/// Participants of this machine that hear no group are spoken to by their port: the first, the distance, the number.
const FIRST_UNICAST: u16 = 10;
const UNICAST_STEP: u16 = 2;
const MOST_LOCAL: u16 = 32;
/// The most addresses of this machine that are used.
const MOST_INTERFACES: usize = 16;
/// The longest datagram that is read.
const LONGEST: usize = 4096;
/// The most datagrams read at a time.
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

/// Interval between repetitions, while the first few seconds last and after that.
const SOON: Duration = Duration::from_millis(150);
const YOUNG: Duration = Duration::from_secs(3);
const LATER: Duration = Duration::from_secs(1);
/// How long an acknowledgement is waited for.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long a herald stays that has nothing to tell: endpoints leave one after the other.
const IDLE: Duration = Duration::from_secs(3);
/// Seconds that a herald is remembered if it vanishes.
const LEASE: i32 = 10;
/// The most endpoints of one herald, and of one datagram.
const MOST_GONE: usize = 4096;
const AT_ONCE: usize = 16;
/// The most participants whose addresses are remembered.
const MOST_PEERS: usize = 4096;

/// Sockets that reach everybody in a domain.
struct Voices {
    domain: u16,
    /// One for each address of this machine: bound to it, a datagram to the group leaves there.
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

    /// Sends to everybody. What cannot be sent is sent the next time.
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

    /// Says that a participant is gone.
    fn bury(&self, participant: &Prefix) {
        let mut message = Message::new(participant);
        // More than any number that it can have used, and more than the last time, over a restart too.
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

/// Says for a participant that was killed that it is gone. Takes four seconds.
pub fn bury(domain: u16, participant: &Prefix) {
    repeat(domain, participant, OF_BURYING);
}

/// Says at its end that a participant is gone.
pub struct Farewell {
    domain: u16,
    participant: Prefix,
}

impl Farewell {
    /// For a participant that has just joined.
    pub fn new(domain: u16, own: &Id) -> Self {
        Self { domain, participant: graph::prefix(own) }
    }

    /// Says it now: what follows may take its time or hang.
    pub fn say(&self) {
        Voices::open(self.domain).bury(&self.participant);
    }
}

impl Drop for Farewell {
    fn drop(&mut self) {
        repeat(self.domain, &self.participant, OF_LEAVING);
    }
}

/// How ids of Fast DDS begin.
const FAST_DDS: [u8; 2] = [1, 15];

/// Another participant, as a herald knows it.
#[derive(Default)]
struct Peer {
    at: Vec<SocketAddrV4>,
    /// Of readers and of writers: the first number that it does not have.
    lacks: [i64; 2],
}

/// A participant that exists to say which endpoints of another are gone: rustdds numbers its own announcements.
struct Herald {
    voices: Voices,
    socket: UdpSocket,
    prefix: Prefix,
    /// Readers and writers that are gone; the first has number 1.
    gone: [Vec<Id>; 2],
    peers: HashMap<Prefix, Peer>,
    added: Instant,
    spoken: Option<Instant>,
    round: u32,
}

const CHANNELS: [Channel; 2] = [rtps::READERS, rtps::WRITERS];

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

    /// Whether a participant has to be told more.
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
            let Some((from, said)) = buffer.get(..length).and_then(|bytes| rtps::read(bytes, &self.prefix)) else {
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
                        let kind = usize::from(channel == rtps::WRITERS);
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

    /// What a participant has to be told next.
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

/// The endpoints of this program's participant that are to leave, until the others have acknowledged it.
pub struct Departures {
    domain: u16,
    own: Prefix,
    heralds: u32,
    herald: Option<Herald>,
    /// Those who have to be told.
    others: Vec<Prefix>,
}

impl Departures {
    /// Nothing leaves yet.
    pub fn new(domain: u16, own: &Id) -> Self {
        Self { domain, own: graph::prefix(own), heralds: 0, herald: None, others: Vec::new() }
    }

    /// An endpoint leaves. A reader must go on until [`Self::is_telling`] is false, or a writer waits for it.
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

    /// Whether somebody may not know yet that an endpoint left.
    pub fn is_telling(&self, id: &Id) -> bool {
        self.herald.as_ref().is_some_and(|herald| herald.is_telling(id, &self.others))
    }

    /// Goes on telling the present participants; only Fast DDS needs it.
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
