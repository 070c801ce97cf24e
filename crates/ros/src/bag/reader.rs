//! Reads a bag chunk by chunk, in file order. A chunk is unpacked and checked before any of its messages is returned; a
//! damaged one is skipped as a whole.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::{self, BufRead, Read, Seek, SeekFrom};
use std::sync::Arc;

use super::{Fields, LONGEST_CONNECTION, LONGEST_HEADER, MAGIC, Op, connection, sized};
use crate::recording::{
    Channel, Chunk, ChunkCompression, Findings, LARGEST_CHUNK, MOST_CHANNEL_BYTES, MOST_CHANNELS, RecordedMessage,
    RecordingFormat, RecordingReader, TOO_LARGE, go_to, read_at, unpack,
};
use crate::{Result, RosError, tcpros::LONGEST_MESSAGE};

/// Limit of chunk positions kept from the index.
const MOST_PLACES: usize = 1 << 20;

enum Found {
    Record { header: Vec<u8>, data: u64, length: u64 },
    End,
    Damage(&'static str),
}

#[derive(Debug)]
pub struct BagReader<R> {
    file: R,
    length: u64,
    position: u64,
    chunk: Chunk,
    /// Messages of the last whole chunk, until its index is met.
    chunk_messages: Option<ChunkMessages>,
    /// Chunks not met yet, by the index at the end.
    places: BTreeSet<u64>,
    connections: HashMap<u32, Arc<Channel>>,
    connection_bytes: usize,
    findings: Findings,
    /// How many messages a complete index counts.
    counted: Option<u64>,
    met: u64,
    ended: bool,
}

impl<R: BufRead + Seek> RecordingReader for BagReader<R> {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>> {
        loop {
            if let Some(message) = self.next_in_chunk() {
                return Ok(Some(message));
            }
            if self.ended {
                if let Some(place) = std::mem::take(&mut self.places).first() {
                    let text = format!("the index at the end names a chunk at byte {place}, but there is none");
                    self.findings.note(self.length, &text);
                }
                self.findings.compare(self.length, "messages", self.counted.take(), self.met);
                return Ok(None);
            }
            let outside = self.advance().map_err(RosError::unreadable)?;
            if outside.is_some() {
                return Ok(outside);
            }
        }
    }

    fn findings(&self) -> &Findings {
        &self.findings
    }

    fn progress(&self) -> (u64, u64) {
        (self.position.min(self.length), self.length)
    }
}

impl<R: BufRead + Seek> BagReader<R> {
    pub fn open(mut file: R) -> Result<Self> {
        let length = file.seek(SeekFrom::End(0)).map_err(RosError::unreadable)?;
        if read_at(&mut file, 0, MAGIC.len() as u64).map_err(RosError::unreadable)? != MAGIC {
            return Err(RosError::recording("it does not start like a bag of version 2.0"));
        }
        let mut reader = Self {
            file,
            length,
            position: MAGIC.len() as u64,
            chunk: Chunk::default(),
            chunk_messages: None,
            places: BTreeSet::new(),
            connections: HashMap::new(),
            connection_bytes: 0,
            findings: Findings::default(),
            counted: None,
            met: 0,
            ended: false,
        };
        reader.read_index()?;
        Ok(reader)
    }

    /// A damaged chunk may have held the only other copy of these connections.
    fn read_index(&mut self) -> Result<()> {
        let Found::Record { header, .. } = self.look(self.position).map_err(RosError::unreadable)? else {
            return Ok(());
        };
        let Some(fields) = Fields::parse(&header).filter(|fields| fields.op() == Some(Op::BagHeader)) else {
            return Ok(());
        };
        if fields.bytes("encryptor").is_some_and(|name| !name.is_empty()) {
            return Err(RosError::recording("it is encrypted; decrypt it with `rosbag decrypt` first"));
        }
        let Some(mut at) = fields.u64("index_pos").filter(|at| *at > 0) else {
            self.findings.unfinished = true;
            return Ok(());
        };
        if at > self.length {
            self.findings.note(self.length, &format!("the bag is cut off: its index should start at byte {at}"));
        }
        let mut counted = 0_u64;
        while let Found::Record { header, data, length } = self.look(at).map_err(RosError::unreadable)? {
            let Some(fields) = Fields::parse(&header) else { return Ok(()) };
            let is_sound = match fields.op() {
                Some(Op::ChunkInfo) => {
                    counted += self.counted_in(data, length).map_err(RosError::unreadable)?;
                    self.counted = (data + length == self.length).then_some(counted);
                    let place = chunk_position(&fields, length);
                    self.places.extend(place.filter(|_| self.places.len() < MOST_PLACES));
                    place.is_some()
                }
                Some(Op::Connection) => {
                    let most = length.min(LONGEST_CONNECTION as u64 + 1);
                    let bytes = read_at(&mut self.file, data, most).map_err(RosError::unreadable)?;
                    self.learn(&fields, &bytes)
                }
                _ => break,
            };
            if !is_sound {
                self.findings.note(at, "a record of the index at the end is damaged");
            }
            at = data + length;
        }
        if at < self.length {
            self.findings.note(at, "the index at the end is damaged from here on");
        } else if at > self.length && self.findings.damages.is_empty() {
            self.findings.note(self.length, "the bag is cut off in its index");
        }
        Ok(())
    }

    fn counted_in(&mut self, data: u64, length: u64) -> std::io::Result<u64> {
        let bytes = read_at(&mut self.file, data, length.min(8 * MOST_CHANNELS as u64))?;
        let counts = bytes.chunks_exact(8).filter_map(|pair| pair.last_chunk::<4>());
        Ok(counts.map(|count| u64::from(u32::from_le_bytes(*count))).sum())
    }

    /// `false` if it is damaged. A number described twice means the later description from there on; a different one is
    /// damage: rosbag reads the index alone, so the number would stand for two things.
    fn learn(&mut self, fields: &Fields<'_>, data: &[u8]) -> bool {
        let Some((number, channel, is_whole)) = connection(fields, data).filter(|_| data.len() <= LONGEST_CONNECTION)
        else {
            return false;
        };
        if let Some(known) = self.connections.get(&number) {
            if **known == channel {
                return true;
            }
            let [before, here] = [&known.topic, &channel.topic].map(|topic| crate::model::clean(topic, 80));
            let text = format!(
                "connection {number} is '{before}' before and '{here}' here: the file contradicts itself; from here on the newer \
                 description counts"
            );
            self.findings.note(self.position, &text);
        }
        self.connection_bytes += channel.size();
        if self.connections.len() >= MOST_CHANNELS || self.connection_bytes > MOST_CHANNEL_BYTES {
            return false;
        }
        if !is_whole {
            self.findings.note(self.position, "fields of a connection's header are too long to keep");
        }
        self.connections.insert(number, Arc::new(channel));
        true
    }

    fn look(&mut self, at: u64) -> std::io::Result<Found> {
        let left = self.length.saturating_sub(at);
        if left == 0 {
            return Ok(Found::End);
        }
        let Some(header_length) = self.length_at(at)? else {
            return Ok(Found::Damage("it ends in the middle of a record"));
        };
        if header_length > LONGEST_HEADER as u64 || header_length + 8 > left {
            return Ok(Found::Damage("there is no bag record here"));
        }
        let header = read_at(&mut self.file, at + 4, header_length)?;
        if Fields::parse(&header).and_then(|fields| fields.op()).is_none() {
            return Ok(Found::Damage("there is no bag record here"));
        }
        let data = at + 4 + header_length + 4;
        let length = self.length_at(at + 4 + header_length)?.unwrap_or(0);
        Ok(Found::Record { header, data, length })
    }

    fn length_at(&mut self, at: u64) -> std::io::Result<Option<u64>> {
        let bytes = read_at(&mut self.file, at, 4)?;
        Ok(bytes.first_chunk().map(|bytes| u64::from(u32::from_le_bytes(*bytes))))
    }

    /// Fills the chunk, or returns a message outside any chunk.
    fn advance(&mut self) -> std::io::Result<Option<RecordedMessage>> {
        let start = self.position;
        let (header, data, length) = match self.look(start)? {
            Found::End => {
                self.end_chunk_messages(start);
                self.ended = true;
                return Ok(None);
            }
            Found::Damage(why) => {
                self.search(start, start + 1, why)?;
                return Ok(None);
            }
            Found::Record { header, data, length } => (header, data, length),
        };
        let Some(fields) = Fields::parse(&header) else { return Ok(None) };
        self.position = data + length;
        if fields.op() != Some(Op::Index) {
            self.end_chunk_messages(start);
        }
        match fields.op() {
            Some(Op::Chunk) => self.read_chunk(&fields, start, data, length)?,
            Some(Op::Index) => self.read_index_record(&fields, start, data)?,
            Some(Op::Connection) if length <= LONGEST_CONNECTION as u64 => {
                let bytes = read_at(&mut self.file, data, length)?;
                if !self.learn(&fields, &bytes) {
                    self.findings.note(start, "a connection record that cannot be used was skipped");
                }
            }
            Some(Op::Message) if self.position <= self.length && length > LONGEST_MESSAGE as u64 => {
                self.met += 1;
                let channel = fields.u32("conn").and_then(|number| self.connections.get(&number));
                self.findings.leave_out(channel.map_or("", |channel| &*channel.topic), TOO_LARGE);
            }
            Some(Op::Message) if self.position <= self.length => {
                let body = read_at(&mut self.file, data, length)?;
                return Ok(self.message(&fields, body, false));
            }
            Some(Op::Message | Op::Connection) => self.search(start, data, "it is cut off or damaged here")?,
            _ if self.position > self.length => self.search(start, data, "it is cut off or damaged here")?,
            _ => {}
        }
        Ok(None)
    }

    /// The index behind a chunk must be of its messages.
    fn read_index_record(&mut self, fields: &Fields<'_>, start: u64, data: u64) -> std::io::Result<()> {
        let version = fields.u32("ver").filter(|version| *version == 1);
        let Some((connection, count)) = version.and(fields.u32("conn")).zip(fields.u32("count")) else {
            if self.position > self.length {
                return self.search(start, data, "it is cut off or damaged here");
            }
            self.chunk_messages = None;
            self.findings.note(start, "the index of a chunk is damaged here");
            return Ok(());
        };
        // Some recorders wrote a wrong length here; like rosbag, go by the count.
        let size = u64::from(count) * ENTRY as u64;
        self.position = data + size;
        if self.position > self.length {
            return self.search(start, data, "it is cut off or damaged here");
        }
        let Some(mut messages) = self.chunk_messages.take() else { return Ok(()) };
        let agrees = messages.count(connection) == u64::from(count)
            && messages.take(connection, &read_at(&mut self.file, data, size)?);
        if agrees {
            self.chunk_messages = Some(messages);
        } else {
            let text =
                format!("the index of connection {connection} is not of the messages before it: one was altered");
            self.findings.note(start, &text);
        }
        Ok(())
    }

    /// The last chunk has no further index: a killed recorder may not have written it.
    fn end_chunk_messages(&mut self, at: u64) {
        let left = self.chunk_messages.take().and_then(|messages| messages.left());
        if let Some(connection) = left.filter(|_| !self.findings.unfinished) {
            self.findings.note(at, &format!("the index of connection {connection} is missing behind its chunk"));
        }
    }

    fn message(&mut self, fields: &Fields<'_>, body: Vec<u8>, guarded: bool) -> Option<RecordedMessage> {
        self.met += 1;
        let Some(number) = fields.u32("conn") else {
            self.findings.leave_out("", "it names no connection");
            return None;
        };
        let Some(channel) = self.connections.get(&number) else {
            self.findings.leave_out("", &format!("no record of the bag describes its connection {number}"));
            return None;
        };
        let Some(time) = fields.time("time") else {
            self.findings.leave_out(&channel.topic, "it has no time");
            return None;
        };
        self.findings.unguarded += u64::from(!guarded);
        Some(RecordedMessage { channel: Arc::clone(channel), time, sent: None, body })
    }

    /// Continues at the next chunk after `from`, and reports the skipped part.
    fn search(&mut self, damaged: u64, from: u64, why: &str) -> std::io::Result<()> {
        self.chunk_messages = None;
        let next = next_chunk(&mut self.file, from)?;
        let end = next.unwrap_or(self.length);
        let skipped = end.saturating_sub(damaged);
        self.findings.note(damaged, &format!("{why}: {skipped} bytes were skipped"));
        self.position = end;
        self.ended = next.is_none();
        Ok(())
    }

    fn read_chunk(&mut self, fields: &Fields<'_>, start: u64, data: u64, length: u64) -> std::io::Result<()> {
        self.places.remove(&start);
        let size = fields.u32("size").map_or(0, u64::from);
        let Some(compression) = chunk_compression(fields) else {
            self.findings.note(start, "a chunk with an unknown compression was skipped");
            return Ok(());
        };
        let unfinished = size == 0 && length == 0;
        if unfinished && compression == ChunkCompression::None {
            // The recorder was killed: the chunk's records follow, but its length was never written.
            self.position = data;
            return Ok(());
        }
        let (limit, length) =
            if unfinished { (LARGEST_CHUNK as u64, self.length.saturating_sub(data)) } else { (size, length) };
        if limit > LARGEST_CHUNK as u64 {
            self.findings.note(start, &format!("a chunk of {size} bytes was skipped; the limit is {LARGEST_CHUNK}"));
            return Ok(());
        }
        go_to(&mut self.file, data)?;
        let mut bytes = std::mem::take(&mut self.chunk.bytes);
        bytes.clear();
        let limit = usize::try_from(limit).unwrap_or(usize::MAX);
        let unpacked = unpack(compression, self.file.by_ref().take(length), limit, &mut bytes);
        let missing = unfinished || data + length > self.length;
        let whole = unpacked.is_ok() && (bytes.len() as u64 == size || unfinished);
        let guarded = unpacked.as_ref().is_ok_and(|guarded| *guarded);
        self.chunk = Chunk { bytes, at: 0, position: data, cut: missing && !whole, guarded };
        if whole && !missing {
            self.chunk_messages = Some(ChunkMessages::default());
            return Ok(());
        }
        if missing && next_chunk(&mut self.file, data)?.is_none() {
            self.findings.note(start, "the bag ends in the middle of a chunk; everything before that was read");
            self.position = self.length;
            return Ok(());
        }
        let why = unpacked.err().unwrap_or_else(|| format!("it does not unpack to {size} bytes"));
        self.chunk.bytes.clear();
        // Continues behind the damaged chunk if a record begins there, otherwise at the next chunk.
        if self.position <= self.length && !matches!(self.look(self.position)?, Found::Damage(_)) {
            let skipped = self.position - start;
            self.findings.note(start, &format!("a damaged chunk of {skipped} bytes was skipped: {why}"));
            return Ok(());
        }
        self.search(start, data, &format!("a chunk is damaged ({why})"))
    }

    fn next_in_chunk(&mut self) -> Option<RecordedMessage> {
        while self.chunk.at < self.chunk.bytes.len() {
            let chunk = std::mem::take(&mut self.chunk);
            let record = chunk.bytes.get(chunk.at..).and_then(sized);
            let Some((header, (data, rest))) = record.and_then(|(header, rest)| Some((header, sized(rest)?))) else {
                self.end_chunk(chunk);
                return None;
            };
            let found = match Fields::parse(header).map(|fields| (fields.op(), fields)) {
                Some((Some(Op::Message), fields)) => {
                    if let Some(messages) = &mut self.chunk_messages {
                        messages.add(&fields, chunk.at);
                    }
                    Some(self.message(&fields, data.to_vec(), chunk.guarded))
                }
                Some((Some(Op::Connection), fields)) if self.learn(&fields, data) => Some(None),
                _ => None,
            };
            let at = chunk.bytes.len() - rest.len();
            let Some(message) = found else {
                self.end_chunk(chunk);
                return None;
            };
            self.chunk = Chunk { at, ..chunk };
            if message.is_some() {
                return message;
            }
        }
        None
    }

    fn end_chunk(&mut self, chunk: Chunk) {
        self.chunk_messages = None;
        self.chunk = chunk.end(&mut self.findings, "bag");
    }
}

const ENTRY: usize = 12;

/// Messages of one connection in a chunk, or its index entries; in any order.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Entries {
    count: u64,
    /// Sum of their digests, which are no secret: a forger of a bag can forge its index as well.
    sum: u64,
}

impl Entries {
    fn add(&mut self, entry: [u8; ENTRY]) {
        let number = |part: Option<&[u8; 8]>| part.map_or(0, |bytes| u64::from_le_bytes(*bytes));
        let (time, offset) = (number(entry.first_chunk()), number(entry.last_chunk()));
        self.count += 1;
        self.sum = self.sum.wrapping_add(mixed(mixed(time).wrapping_add(offset)));
    }
}

/// SplitMix64, so that sums of different entries differ.
fn mixed(number: u64) -> u64 {
    let number = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let number = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    number ^ (number >> 31)
}

#[derive(Debug, Default)]
pub(super) struct ChunkMessages(BTreeMap<u32, Entries>);

impl ChunkMessages {
    pub fn add(&mut self, fields: &Fields<'_>, offset: usize) {
        let time: Option<[u8; 8]> = fields.bytes("time").and_then(|bytes| bytes.try_into().ok());
        let (Some(connection), Some(time)) = (fields.u32("conn"), time) else { return };
        let mut entry = [0; ENTRY];
        entry[..8].copy_from_slice(&time);
        entry[8..].copy_from_slice(&u32::try_from(offset).unwrap_or(u32::MAX).to_le_bytes());
        self.0.entry(connection).or_default().add(entry);
    }

    pub fn count(&self, connection: u32) -> u64 {
        self.0.get(&connection).map_or(0, |entries| entries.count)
    }

    /// Whether the connection's index has exactly its messages; these are then done.
    pub fn take(&mut self, connection: u32, index: &[u8]) -> bool {
        let mut entries = Entries::default();
        index.as_chunks::<ENTRY>().0.iter().for_each(|entry| entries.add(*entry));
        self.0.remove(&connection).unwrap_or_default() == entries
    }

    pub fn left(&self) -> Option<u32> {
        self.0.keys().next().copied()
    }
}

/// A chunk's position by the index at the end; `None` if it is not as rosbag writes it.
fn chunk_position(fields: &Fields<'_>, length: u64) -> Option<u64> {
    let is_whole = fields.u32("ver") == Some(1)
        && fields.u32("count").is_some_and(|count| u64::from(count) * 8 == length)
        && ["start_time", "end_time"].iter().all(|name| fields.time(name).is_some());
    fields.u64("chunk_pos").filter(|_| is_whole)
}

/// Part of every chunk header: a field of four bytes, `op=` and the chunk's code.
const MARK: &[u8] = b"\x04\0\0\0op=\x05";

/// The greatest distance from the start of a chunk record to the mark, bytes.
const LONGEST_LEAD: u64 = 64;

const LONGEST: usize = 128;

const WINDOW: usize = 64 * 1024;

fn chunk_compression(fields: &Fields<'_>) -> Option<ChunkCompression> {
    let word = std::str::from_utf8(fields.bytes("compression")?).ok()?;
    word.parse().ok().filter(|compression| RecordingFormat::Bag.takes(*compression))
}

/// The first chunk record at or after `from`.
fn next_chunk(file: &mut (impl Read + Seek), from: u64) -> io::Result<Option<u64>> {
    let mut at = from;
    let mut window = Vec::with_capacity(WINDOW);
    loop {
        window.clear();
        file.seek(SeekFrom::Start(at))?;
        file.by_ref().take(WINDOW as u64).read_to_end(&mut window)?;
        let marks = window.windows(MARK.len()).enumerate().filter(|(_, bytes)| *bytes == MARK);
        for mark in marks.map(|(index, _)| at + index as u64).collect::<Vec<_>>() {
            if let Some(start) = start_of_chunk(file, from, mark)? {
                return Ok(Some(start));
            }
        }
        if window.len() < WINDOW {
            return Ok(None);
        }
        at += (WINDOW - MARK.len() + 1) as u64;
    }
}

fn start_of_chunk(file: &mut (impl Read + Seek), from: u64, mark: u64) -> io::Result<Option<u64>> {
    let first = from.max(mark.saturating_sub(LONGEST_LEAD));
    let mut bytes = Vec::with_capacity(LONGEST * 2);
    file.seek(SeekFrom::Start(first))?;
    file.by_ref().take(LONGEST as u64 * 2).read_to_end(&mut bytes)?;
    let lead = usize::try_from(mark - first).unwrap_or(0);
    // The nearest start that gives a valid header is the right one.
    let starts = (0..=lead.saturating_sub(4)).rev().filter(|start| start + 4 <= lead);
    let is_chunk =
        |start: &usize| bytes.get(*start..).and_then(sized).is_some_and(|(header, _)| is_chunk_header(header));
    Ok(starts.into_iter().find(is_chunk).map(|start| first + start as u64))
}

fn is_chunk_header(header: &[u8]) -> bool {
    header.len() <= LONGEST
        && Fields::parse(header).is_some_and(|fields| {
            fields.op() == Some(Op::Chunk) && chunk_compression(&fields).is_some() && fields.u32("size").is_some()
        })
}
