//! A large message sent ahead of the network code, in fragments at a rate that subscribers can take. The network code
//! sends all fragments at once, of which the usual receive buffer of 208 kB keeps few; it repairs them slowly. What comes
//! ahead is the same to a subscriber (same writer, number, size of fragments), so what follows at once is known already,
//! and acknowledged. Decision 088.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant, SystemTime};

use rustdds::GUID;
use rustdds::bytes::Bytes;

/// Longer messages are sent ahead, bytes; shorter ones fit the receive buffers of all kinds of DDS at once.
pub const LARGE: usize = 64 << 10;
/// Bytes of a fragment: as the network code makes them, since a subscriber may put both together.
const FRAGMENT: usize = 256;
/// Fragments in a datagram: to this machine, and to another one, where it must not be larger than a packet.
const NEAR: usize = 128;
const FAR: usize = 5;
/// Bytes a second at first, at least and at most.
const FIRST_RATE: f64 = 80e6;
const RATES: (f64, f64) = (8e6, 120e6);
/// The longest that one message may take, seconds.
const LONGEST: f64 = 2.0;
/// How long one call sends before others have their turn.
const SLICE: Duration = Duration::from_millis(20);
/// Time that was not used for sending is made up for by this much.
const SLACK: Duration = Duration::from_millis(1);
/// Shorter pauses are not made.
const SHORTEST_PAUSE: Duration = Duration::from_micros(200);
/// The most addresses that one message is sent to.
const MOST_ADDRESSES: usize = 16;
/// The network code's vendor id.
const VENDOR: [u8; 2] = [1, 18];

/// The addresses of each subscriber of a topic.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Addresses(Vec<Vec<SocketAddr>>);

impl Addresses {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Adds those of one subscriber.
    pub fn add(&mut self, of_one: impl Iterator<Item = SocketAddr>) {
        let own: Vec<SocketAddr> = of_one.filter(SocketAddr::is_ipv4).take(MOST_ADDRESSES).collect();
        if !own.is_empty() && self.0.len() < MOST_ADDRESSES {
            self.0.push(own);
        }
    }

    /// Where a message is sent to, and how many fragments a datagram may have: of each subscriber one address on this machine,
    /// since all lead to the same socket; or else all.
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

/// Whether an address is one of this machine: the one from which it would be sent to.
fn is_here(to: SocketAddr) -> bool {
    let from = || {
        let socket = UdpSocket::bind((IpAddr::V4(Ipv4Addr::UNSPECIFIED), 0))?;
        socket.connect(to)?;
        socket.local_addr()
    };
    from().is_ok_and(|from: SocketAddr| from.ip() == to.ip())
}

/// How fast it goes.
pub struct Rate(f64);

impl Default for Rate {
    fn default() -> Self {
        Self(FIRST_RATE)
    }
}

impl Rate {
    /// It was too fast.
    pub fn slower(&mut self) {
        self.0 = (self.0 / 2.0).max(RATES.0);
    }

    /// It was not.
    pub fn faster(&mut self) {
        self.0 = (self.0 * 1.1).min(RATES.1);
    }

    /// The time that this many bytes of a message of this length may take.
    #[expect(clippy::cast_precision_loss, reason = "lengths of messages are below 2^53")]
    fn time(&self, bytes: usize, length: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / self.0.max(length as f64 / LONGEST))
    }
}

/// One message on its way.
pub struct Ahead {
    message: Bytes,
    head: Vec<u8>,
    writer: [u8; 4],
    number: i64,
    ways: Vec<(SocketAddr, usize)>,
    /// The place among the ways, and the fragment that is next, from 0.
    place: usize,
    fragment: usize,
    due: Instant,
}

impl Ahead {
    /// A message, with its header of four bytes, that gets this number from its writer.
    pub fn new(message: Bytes, (writer, number): (GUID, i64), to: &Addresses) -> Self {
        let id = writer.to_bytes();
        let mut head = [b"RTPS".as_slice(), &[2, 4], &VENDOR, &id[..12]].concat();
        head.extend(time_of_writing());
        let writer = [id[12], id[13], id[14], id[15]];
        Self { message, head, writer, number, ways: to.ways(), place: 0, fragment: 0, due: Instant::now() }
    }

    /// Sends for a moment; true when all is sent.
    pub fn advance(&mut self, socket: &UdpSocket, rate: &Rate) -> bool {
        let begun = Instant::now();
        while let Some((to, most)) = self.ways.get(self.place).copied() {
            if begun.elapsed() >= SLICE {
                return false;
            }
            let datagram = self.datagram(most);
            // Whatever is lost, here or later, comes once more from the network code.
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

    /// The next fragments, as a datagram.
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
            // DATA_FRAG, little endian; from the end of the length on, 32 bytes stand before the fragments.
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

/// The submessage that tells when a message was written.
fn time_of_writing() -> Vec<u8> {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let seconds = u32::try_from(now.as_secs()).unwrap_or(u32::MAX);
    let fraction = (u64::from(now.subsec_nanos()) << 32) / 1_000_000_000;
    let fraction = u32::try_from(fraction).unwrap_or(u32::MAX);
    [[9, 1, 8, 0], seconds.to_le_bytes(), fraction.to_le_bytes()].concat()
}

#[cfg(test)]
mod tests {
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
