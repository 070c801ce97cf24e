//! rosbag 2.0: damaged chunks are skipped and reported; an index, if any, must agree with the messages. Format:
//! <http://wiki.ros.org/Bags/Format/2.0>. The content of a bag is untrusted.

mod reader;

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, SeekFrom, Write};
use std::sync::Arc;

use crate::recording::{
    BAG_TOPIC, CHUNK_THRESHOLD, Channel, ChunkCompression, Encoding, LARGEST_CHUNK, MOST_CHANNELS, RecordingFormat,
    kept_about, pack,
};
use crate::{Result, RosError, model::Timestamp, tcpros::LONGEST_MESSAGE};

pub use reader::BagReader;

pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// A bag's own records have short fields, bytes.
const LONGEST_HEADER: usize = 64 * 1024;

/// It holds a definition, bytes.
const LONGEST_CONNECTION: usize = 2 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::FromRepr)]
#[repr(u8)]
enum Op {
    Message = 2,
    BagHeader = 3,
    Index = 4,
    Chunk = 5,
    ChunkInfo = 6,
    Connection = 7,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Fields<'a>(Vec<(&'a [u8], &'a [u8])>);

impl<'a> Fields<'a> {
    /// `None` if the bytes are not exactly fields.
    pub fn parse(mut bytes: &'a [u8]) -> Option<Self> {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let (field, rest) = sized(bytes)?;
            let equals = field.iter().position(|byte| *byte == b'=').filter(|at| *at > 0)?;
            fields.push((field.get(..equals)?, field.get(equals + 1..)?));
            bytes = rest;
        }
        Some(Self(fields))
    }

    pub fn bytes(&self, name: &str) -> Option<&'a [u8]> {
        self.0.iter().find(|(field, _)| *field == name.as_bytes()).map(|(_, value)| *value)
    }

    pub fn text(&self, name: &str) -> Option<Arc<str>> {
        self.bytes(name).map(|bytes| String::from_utf8_lossy(bytes).into())
    }

    pub fn u32(&self, name: &str) -> Option<u32> {
        self.bytes(name)?.try_into().ok().map(u32::from_le_bytes)
    }

    pub fn u64(&self, name: &str) -> Option<u64> {
        self.bytes(name)?.try_into().ok().map(u64::from_le_bytes)
    }

    /// Seconds and nanoseconds, as one number.
    pub fn time(&self, name: &str) -> Option<Timestamp> {
        let bytes: [u8; 8] = self.bytes(name)?.try_into().ok()?;
        let [seconds, nanoseconds] =
            [bytes.first_chunk::<4>()?, bytes.last_chunk::<4>()?].map(|b| u32::from_le_bytes(*b));
        Some(Timestamp(u64::from(seconds) * 1_000_000_000 + u64::from(nanoseconds)))
    }

    fn others(&self) -> impl Iterator<Item = (Arc<str>, Arc<str>)> {
        let text = |bytes: &[u8]| -> Arc<str> { String::from_utf8_lossy(bytes).into() };
        let others = self.0.iter().map(move |(name, value)| (text(name), text(value)));
        others.filter(|(name, _)| !OWN.contains(&&**name) && &**name != BAG_TOPIC)
    }

    pub fn op(&self) -> Option<Op> {
        let [code] = self.bytes("op")? else { return None };
        Op::from_repr(*code)
    }
}

fn sized(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

/// Fields that a channel has fields for.
const OWN: [&str; 6] = ["topic", "type", "md5sum", "message_definition", "callerid", "latching"];

fn connection(fields: &Fields<'_>, data: &[u8]) -> Option<(u32, Channel, bool)> {
    let about = Fields::parse(data)?;
    let topic = fields.text("topic")?;
    let latching = about.text("latching");
    let named = about.text("topic").unwrap_or_default();
    let mut others: Vec<(Arc<str>, Arc<str>)> = Vec::new();
    others.extend(latching.iter().filter(|value| ***value != *"1").map(|value| ("latching".into(), Arc::clone(value))));
    others.extend((named != topic).then(|| (BAG_TOPIC.into(), named)));
    others.extend(about.others());
    let (others, is_whole) = kept_about(others);
    let channel = Channel {
        topic: Arc::clone(&topic),
        type_name: about.text("type")?,
        md5sum: about.text("md5sum")?,
        definition: about.text("message_definition")?,
        caller_id: about.text("callerid").unwrap_or_default(),
        latching: latching.as_ref().is_some_and(|value| &**value == "1"),
        encoding: Encoding::Ros1,
        about: others,
    };
    Some((fields.u32("conn")?, channel, is_whole))
}

fn put_fields(out: &mut Vec<u8>, fields: &[(&str, &[u8])]) {
    let length: usize = fields.iter().map(|(name, value)| 4 + name.len() + 1 + value.len()).sum();
    put_length(out, length);
    for (name, value) in fields {
        put_length(out, name.len() + 1 + value.len());
        out.extend_from_slice(name.as_bytes());
        out.push(b'=');
        out.extend_from_slice(value);
    }
}

/// Nothing written here is longer than the format's 32 bits.
fn put_length(out: &mut Vec<u8>, length: usize) {
    out.extend_from_slice(&u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
}

fn put_connection(out: &mut Vec<u8>, number: u32, channel: &Channel) {
    let number = number.to_le_bytes();
    put_fields(out, &[("op", &[Op::Connection as u8]), ("conn", &number), ("topic", channel.topic.as_bytes())]);
    let named = channel.about.get(BAG_TOPIC).unwrap_or(&channel.topic);
    let mut about: Vec<(&str, &[u8])> = Vec::with_capacity(8);
    about.extend((!named.is_empty()).then_some(("topic", named.as_bytes())));
    about.extend([
        ("type", channel.type_name.as_bytes()),
        ("md5sum", channel.md5sum.as_bytes()),
        ("message_definition", channel.definition.as_bytes()),
    ]);
    about.extend((!channel.caller_id.is_empty()).then_some(("callerid", channel.caller_id.as_bytes())));
    let latching = channel.about.get("latching").map(|value| &**value).or(channel.latching.then_some("1"));
    about.extend(latching.map(|value| ("latching", value.as_bytes())));
    let is_writable = |name: &str| !OWN.contains(&name) && name != BAG_TOPIC && !name.is_empty() && !name.contains('=');
    let others = channel.about.iter().filter(|(name, _)| is_writable(name));
    about.extend(others.map(|(name, value)| (&**name, value.as_bytes())));
    put_fields(out, &about);
}

fn time_bytes(time: Timestamp) -> [u8; 8] {
    let seconds = u32::try_from(time.0 / 1_000_000_000).unwrap_or(u32::MAX);
    let nanoseconds = u32::try_from(time.0 % 1_000_000_000).unwrap_or(0);
    ((u64::from(nanoseconds) << 32) | u64::from(seconds)).to_le_bytes()
}

/// With its padding, without lengths.
const HEADER_LENGTH: usize = 4096;

#[derive(Debug)]
struct ChunkInfo {
    position: u64,
    span: (Timestamp, Timestamp),
    counts: Vec<(u32, u32)>,
}

#[derive(Debug)]
pub struct BagWriter<W> {
    out: W,
    position: u64,
    compression: ChunkCompression,
    numbers: HashMap<Arc<Channel>, u32>,
    connections: Vec<Arc<Channel>>,
    chunk: Vec<u8>,
    span: Option<(Timestamp, Timestamp)>,
    index: BTreeMap<u32, Vec<(Timestamp, usize)>>,
    chunks: Vec<ChunkInfo>,
}

impl<W: Write + Seek> BagWriter<W> {
    pub fn begin(out: W, compression: ChunkCompression) -> Result<Self> {
        if !RecordingFormat::Bag.takes(compression) {
            return Err(RosError::recording(&format!("a bag cannot be compressed with {compression}")));
        }
        let mut writer = Self {
            out,
            position: 0,
            compression,
            numbers: HashMap::new(),
            connections: Vec::new(),
            chunk: Vec::new(),
            span: None,
            index: BTreeMap::new(),
            chunks: Vec::new(),
        };
        writer.put(MAGIC)?;
        writer.put(&bag_header(0, 0, 0))?;
        Ok(writer)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(RosError::unwritable)?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    pub fn write(&mut self, channel: &Arc<Channel>, time: Timestamp, body: &[u8]) -> Result<()> {
        if channel.encoding != Encoding::Ros1 {
            return Err(RosError::recording("a bag can only hold ROS 1 messages; write MCAP instead"));
        }
        if body.len() > LONGEST_MESSAGE || time.0 / 1_000_000_000 > u64::from(u32::MAX) {
            return Err(RosError::recording("a message is too large, or its time does not fit into a bag"));
        }
        let number = self.number(channel)?;
        self.index.entry(number).or_default().push((time, self.chunk.len()));
        let (first, last) = self.span.unwrap_or((time, time));
        self.span = Some((first.min(time), last.max(time)));
        let conn = number.to_le_bytes();
        put_fields(&mut self.chunk, &[("op", &[Op::Message as u8]), ("conn", &conn), ("time", &time_bytes(time))]);
        put_length(&mut self.chunk, body.len());
        self.chunk.extend_from_slice(body);
        if self.chunk.len() >= CHUNK_THRESHOLD { self.end_chunk() } else { Ok(()) }
    }

    fn number(&mut self, channel: &Arc<Channel>) -> Result<u32> {
        if let Some(number) = self.numbers.get(channel) {
            return Ok(*number);
        }
        if self.connections.len() >= MOST_CHANNELS {
            return Err(RosError::recording(&format!("a bag cannot hold more than {MOST_CHANNELS} connections")));
        }
        let number = u32::try_from(self.connections.len()).unwrap_or(u32::MAX);
        self.numbers.insert(Arc::clone(channel), number);
        self.connections.push(Arc::clone(channel));
        put_connection(&mut self.chunk, number, channel);
        Ok(number)
    }

    fn end_chunk(&mut self) -> Result<()> {
        let Some(span) = self.span.take() else { return Ok(()) };
        debug_assert!(self.chunk.len() <= LARGEST_CHUNK, "a message and less than the threshold before it");
        let packed = pack(self.compression, &self.chunk).map_err(|error| RosError::recording(&error))?;
        let position = self.position;
        let mut head = Vec::with_capacity(64);
        let size = u32::try_from(self.chunk.len()).unwrap_or(u32::MAX).to_le_bytes();
        let compression = self.compression.word().as_bytes();
        put_fields(&mut head, &[("op", &[Op::Chunk as u8]), ("compression", compression), ("size", &size)]);
        put_length(&mut head, packed.len());
        self.put(&head)?;
        self.put(&packed)?;
        let index = std::mem::take(&mut self.index);
        let mut counts = Vec::with_capacity(index.len());
        for (number, entries) in index {
            self.put_index(number, &entries)?;
            counts.push((number, u32::try_from(entries.len()).unwrap_or(u32::MAX)));
        }
        self.chunks.push(ChunkInfo { position, span, counts });
        self.chunk.clear();
        Ok(())
    }

    fn put_index(&mut self, number: u32, entries: &[(Timestamp, usize)]) -> Result<()> {
        let mut record = Vec::with_capacity(64 + entries.len() * 12);
        let count = u32::try_from(entries.len()).unwrap_or(u32::MAX).to_le_bytes();
        let (conn, version) = (number.to_le_bytes(), 1_u32.to_le_bytes());
        put_fields(&mut record, &[("op", &[Op::Index as u8]), ("ver", &version), ("conn", &conn), ("count", &count)]);
        put_length(&mut record, entries.len() * 12);
        for (time, offset) in entries {
            record.extend_from_slice(&time_bytes(*time));
            put_length(&mut record, *offset);
        }
        self.put(&record)
    }

    /// Writes the last chunk and the index, and returns the file.
    pub fn finish(mut self) -> Result<W> {
        self.end_chunk()?;
        let index_position = self.position;
        for (number, channel) in std::mem::take(&mut self.connections).iter().enumerate() {
            let mut record = Vec::new();
            put_connection(&mut record, u32::try_from(number).unwrap_or(u32::MAX), channel);
            self.put(&record)?;
        }
        for info in std::mem::take(&mut self.chunks) {
            self.put(&chunk_info(&info))?;
            self.chunks.push(info);
        }
        let header = bag_header(index_position, self.numbers.len(), self.chunks.len());
        self.out.seek(SeekFrom::Start(MAGIC.len() as u64)).map_err(RosError::unwritable)?;
        self.put(&header)?;
        self.out.seek(SeekFrom::End(0)).map_err(RosError::unwritable)?;
        self.out.flush().map_err(RosError::unwritable)?;
        Ok(self.out)
    }
}

fn bag_header(index: u64, connections: usize, chunks: usize) -> Vec<u8> {
    let mut record = Vec::with_capacity(HEADER_LENGTH + 8);
    let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes();
    put_fields(
        &mut record,
        &[
            ("op", &[Op::BagHeader as u8]),
            ("index_pos", &index.to_le_bytes()),
            ("conn_count", &count(connections)),
            ("chunk_count", &count(chunks)),
        ],
    );
    let padding = HEADER_LENGTH.saturating_sub(record.len() - 4);
    put_length(&mut record, padding);
    record.resize(record.len() + padding, b' ');
    record
}

fn chunk_info(info: &ChunkInfo) -> Vec<u8> {
    let mut record = Vec::with_capacity(160 + info.counts.len() * 8);
    let count = u32::try_from(info.counts.len()).unwrap_or(u32::MAX).to_le_bytes();
    put_fields(
        &mut record,
        &[
            ("op", &[Op::ChunkInfo as u8]),
            ("ver", &1_u32.to_le_bytes()),
            ("chunk_pos", &info.position.to_le_bytes()),
            ("start_time", &time_bytes(info.span.0)),
            ("end_time", &time_bytes(info.span.1)),
            ("count", &count),
        ],
    );
    put_length(&mut record, info.counts.len() * 8);
    for (number, messages) in &info.counts {
        record.extend_from_slice(&number.to_le_bytes());
        record.extend_from_slice(&messages.to_le_bytes());
    }
    record
}
