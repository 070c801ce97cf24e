//! The few RTPS messages that rustdds does not send in a form Fast DDS understands: announcing a participant, and saying that
//! an endpoint or a participant is gone with its key in the inline QoS. Also reads the answers to them.

use std::net::{Ipv4Addr, SocketAddrV4};

use crate::graph::{Id, Prefix};

/// An entity's part of an id.
pub type Entity = [u8; 4];

/// A built-in writer and the reader that it speaks to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel {
    writer: Entity,
    reader: Entity,
}

/// Announces participants.
const PARTICIPANTS: Channel = Channel { writer: [0, 1, 0, 0xc2], reader: [0, 1, 0, 0xc7] };
/// Announces writers.
pub const WRITERS: Channel = Channel { writer: [0, 0, 3, 0xc2], reader: [0, 0, 3, 0xc7] };
/// Announces readers.
pub const READERS: Channel = Channel { writer: [0, 0, 4, 0xc2], reader: [0, 0, 4, 0xc7] };
const PARTICIPANT: Entity = [0, 0, 1, 0xc1];

/// Protocol 2.4, and rustdds's vendor id, whose participants these messages speak for.
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
const LEASE: u16 = 0x02;
const PROTOCOL: u16 = 0x15;
const MAKER: u16 = 0x16;
const METATRAFFIC_ADDRESS: u16 = 0x32;
const PARTICIPANT_ID: u16 = 0x50;
const ENDPOINTS: u16 = 0x58;
const KEY_HASH: u16 = 0x70;
const STATUS: u16 = 0x71;
/// Disposed and unregistered.
const GONE: [u8; 4] = [0, 0, 0, 3];
/// Announces participants, writers and readers, and reads nothing but participants.
const ANNOUNCERS: u32 = 1 | 2 | 4 | 16;
const UDP_V4: i32 = 1;

/// The most addresses taken from one announcement.
const MOST_ADDRESSES: usize = 8;
/// More parameters or submessages are not looked at.
const MOST_PARTS: usize = 256;

/// A message under construction.
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
    /// An empty message of a participant.
    pub fn new(from: &Prefix) -> Self {
        Self([HEADER, from].concat())
    }

    /// The bytes to send.
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

    /// Says that an endpoint is gone.
    pub fn gone(&mut self, channel: Channel, number: i64, id: &Id) {
        let mut content = Vec::new();
        parameter(&mut content, KEY_HASH, id);
        parameter(&mut content, STATUS, &GONE);
        parameter(&mut content, END, &[]);
        self.data(channel, number, INLINE_QOS, &content);
    }

    /// Says that a participant is gone, with all that it has. `number` must exceed those of its announcements.
    pub fn participant_gone(&mut self, number: i64, prefix: &Prefix) {
        let mut id = [0; 16];
        prefix.iter().chain(&PARTICIPANT).zip(&mut id).for_each(|(from, to)| *to = *from);
        self.gone(PARTICIPANTS, number, &id);
    }

    /// Announces a participant without endpoints of its own, reached at these addresses, for this many seconds.
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
        parameter(&mut content, LEASE, &[lease.to_le_bytes(), [0; 4]].concat());
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

/// What another participant says to ours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Said {
    /// Where its announcements are to be sent.
    Reached(Vec<SocketAddrV4>),
    /// It has all numbers of this channel below this one.
    Has(Channel, i64),
}

/// Bytes that are read from the front.
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

/// Reads a message; who sent it, and what it says to `own`. Anything else is left out.
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
