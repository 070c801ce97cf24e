//! MCAP (<https://mcap.dev/spec>). The profile `ros1` is fully supported; ROS 2 messages are raw CDR with their schema.
//! The content of a file is untrusted.

mod reader;

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, Write};
use std::sync::Arc;

use crate::recording::{
    CHUNK_THRESHOLD, Channel, ChunkCompression, Encoding, MOST_CHANNELS, RecordingFormat, Sent, kept_about, pack,
};
use crate::{Result, RosError, model::Timestamp, tcpros::LONGEST_MESSAGE};

pub use reader::McapReader;

pub const MAGIC: &[u8] = b"\x89MCAP0\r\n";

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, strum::FromRepr)]
#[repr(u8)]
enum Code {
    Header = 1,
    Footer = 2,
    Schema = 3,
    Channel = 4,
    Message = 5,
    Chunk = 6,
    MessageIndex = 7,
    ChunkIndex = 8,
    Attachment = 9,
    AttachmentIndex = 10,
    Statistics = 11,
    Metadata = 12,
    MetadataIndex = 13,
    SummaryOffset = 14,
    DataEnd = 15,
}

const LEAD: u64 = 9;

/// Bytes of the footer and of the magic behind it.
const TAIL: u64 = LEAD + 20 + 8;

/// Nanoseconds.
const LATEST: u64 = i64::MAX as u64;

/// Start and checksum of the summary, from a file's last bytes; `None` if they are no footer.
fn footer(tail: &[u8]) -> Option<(u64, u32)> {
    let mut fields = Fields(tail);
    let (code, content) = fields.record()?;
    let mut content = Fields(content);
    let start = content.u64().filter(|_| code == Code::Footer as u8 && fields.0 == MAGIC)?;
    Some((start, content.u64().and(content.u32())?))
}

/// Whether a channel has a field for this entry of its metadata.
fn is_own(key: &str, value: &str) -> bool {
    matches!((key, value), ("md5sum" | "callerid", _) | ("latching", "1"))
}

/// Parses consecutive fields; `None` if the bytes end too early.
#[derive(Debug, Clone, Copy)]
struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (array, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*array)
    }

    pub fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(bytes)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn sized(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        self.bytes(length)
    }

    pub fn text(&mut self) -> Option<Arc<str>> {
        self.sized().map(|bytes| String::from_utf8_lossy(bytes).into())
    }

    /// Names with values, in their order, behind their common length.
    pub fn map(&mut self) -> Option<Vec<(Arc<str>, Arc<str>)>> {
        let mut map = Fields(self.sized()?);
        let mut entries = Vec::new();
        while !map.0.is_empty() {
            entries.push((map.text()?, map.text()?));
        }
        Some(entries)
    }

    pub fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let code = self.u8()?;
        let length = usize::try_from(self.u64()?).ok()?;
        Some((code, self.bytes(length)?))
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Schema {
    pub name: Arc<str>,
    pub encoding: Arc<str>,
    pub text: Arc<str>,
}

impl Schema {
    pub fn size(&self) -> usize {
        self.name.len() + self.encoding.len() + self.text.len() + 64
    }
}

/// The number is never 0.
fn schema(mut fields: Fields<'_>) -> Option<(u16, Schema)> {
    let number = fields.u16().filter(|number| *number > 0)?;
    Some((number, Schema { name: fields.text()?, encoding: fields.text()?, text: fields.text()? }))
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct ChannelRecord {
    pub number: u16,
    pub schema: u16,
    pub topic: Arc<str>,
    encoding: Arc<str>,
    about: BTreeMap<String, Arc<str>>,
}

impl ChannelRecord {
    pub fn parse(mut fields: Fields<'_>) -> Option<Self> {
        let (number, schema) = (fields.u16()?, fields.u16()?);
        let (topic, encoding) = (fields.text()?, fields.text()?);
        let about = fields.map()?.into_iter().map(|(key, value)| (key.to_string(), value)).collect();
        Some(Self { number, schema, topic, encoding, about })
    }

    pub fn size(&self) -> usize {
        let about = self.about.iter().map(|(key, value)| key.len() + value.len());
        self.topic.len() + self.encoding.len() + about.sum::<usize>() + 128
    }

    pub fn others(&self) -> impl Iterator<Item = (Arc<str>, Arc<str>)> {
        let others = self.about.iter().filter(|(key, value)| !is_own(key, value));
        others.map(|(key, value)| (key.as_str().into(), Arc::clone(value)))
    }

    /// The channel with its schema, or why its messages cannot be used. CDR is kept without a definition too: the
    /// bodies are to be proven.
    pub fn with(&self, schema: Option<&Schema>) -> Result<Channel, String> {
        let Some(schema) = schema else {
            return Err(match (&*self.encoding, self.schema) {
                ("ros1" | "cdr", 0) => String::from("its channel names no type (schema 0)"),
                ("ros1" | "cdr", number) => format!("its schema {number} is not in the file"),
                _ => self.foreign(),
            });
        };
        let encoding = match (&*self.encoding, &*schema.encoding) {
            ("ros1", "ros1msg" | "") => Encoding::Ros1,
            ("cdr", "ros2msg" | "") => Encoding::Cdr { idl: false },
            ("cdr", "ros2idl" | "omgidl") => Encoding::Cdr { idl: true },
            ("ros1" | "cdr", other) => return Err(format!("its schema's encoding '{other}' is not of ROS")),
            _ => return Err(self.foreign()),
        };
        let about = |key: &str| self.about.get(key).cloned();
        let definition = if schema.encoding.is_empty() { "".into() } else { Arc::clone(&schema.text) };
        let has_sum = encoding == Encoding::Ros1 && !definition.is_empty();
        let sum = || crate::ros::md5sum(&schema.name, &definition).ok().map(Arc::from);
        let computed = || has_sum.then(sum).flatten();
        Ok(Channel {
            md5sum: about("md5sum").filter(|sum| &**sum != "*").or_else(computed).unwrap_or_else(|| "*".into()),
            caller_id: about("callerid").unwrap_or_default(),
            latching: about("latching").is_some_and(|value| matches!(&*value, "1" | "true")),
            topic: Arc::clone(&self.topic),
            type_name: Arc::clone(&schema.name),
            definition,
            encoding,
            about: kept_about(self.others()).0,
        })
    }

    fn foreign(&self) -> String {
        format!("its encoding '{}' is not of ROS", self.encoding)
    }
}

fn put_record(out: &mut Vec<u8>, code: Code, fill: impl FnOnce(&mut Vec<u8>)) {
    out.push(code as u8);
    let at = out.len();
    out.extend_from_slice(&[0; 8]);
    fill(out);
    let length = (out.len() - at - 8) as u64;
    if let Some(place) = out.get_mut(at..at + 8) {
        place.copy_from_slice(&length.to_le_bytes());
    }
}

fn put_numbers(out: &mut Vec<u8>, numbers: &[u64]) {
    numbers.iter().for_each(|number| out.extend_from_slice(&number.to_le_bytes()));
}

/// Names with values, behind their common length.
fn put_map(out: &mut Vec<u8>, entries: &[(&str, &str)]) {
    put_length(out, entries.iter().map(|(key, value)| 8 + key.len() + value.len()).sum());
    for (key, value) in entries {
        put_text(out, key);
        put_text(out, value);
    }
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    put_length(out, text.len());
    out.extend_from_slice(text.as_bytes());
}

/// Nothing written here is longer.
fn put_length(out: &mut Vec<u8>, length: usize) {
    out.extend_from_slice(&u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
}

fn put_schema(out: &mut Vec<u8>, number: u16, channel: &Channel) {
    put_record(out, Code::Schema, |out| {
        out.extend_from_slice(&number.to_le_bytes());
        put_text(out, &channel.type_name);
        // Without a definition it has no encoding either, as rosbag2 writes it.
        let is_described = !channel.definition.is_empty() || channel.encoding == Encoding::Ros1;
        put_text(out, if is_described { schema_encoding(channel.encoding) } else { "" });
        put_text(out, &channel.definition);
    });
}

fn schema_encoding(encoding: Encoding) -> &'static str {
    match encoding {
        Encoding::Ros1 => "ros1msg",
        Encoding::Cdr { idl: false } => "ros2msg",
        Encoding::Cdr { idl: true } => "ros2idl",
        Encoding::Beside(_) => "",
    }
}

fn put_channel(out: &mut Vec<u8>, number: u16, schema: u16, channel: &Channel) {
    let mut about = vec![("md5sum", &*channel.md5sum)];
    let is_latching = channel.latching && !channel.about.contains_key("latching");
    about.extend((!channel.caller_id.is_empty()).then_some(("callerid", &*channel.caller_id)));
    about.extend(is_latching.then_some(("latching", "1")));
    about.retain(|(key, value)| *key != "md5sum" || *value != "*");
    about.extend(channel.about.iter().map(|(key, value)| (&**key, &**value)));
    put_record(out, Code::Channel, |out| {
        out.extend_from_slice(&number.to_le_bytes());
        out.extend_from_slice(&schema.to_le_bytes());
        put_text(out, &channel.topic);
        put_text(out, if channel.encoding == Encoding::Ros1 { "ros1" } else { "cdr" });
        put_map(out, &about);
    });
}

#[derive(Debug)]
struct ChunkIndex {
    span: (Timestamp, Timestamp),
    position: u64,
    length: u64,
    /// Positions of the channels' message indexes.
    indexes: Vec<(u16, u64)>,
    index_length: u64,
    packed: u64,
    size: u64,
}

#[derive(Debug)]
pub struct McapWriter<W> {
    out: W,
    position: u64,
    compression: ChunkCompression,
    channels: Vec<(u16, Arc<Channel>)>,
    numbers: HashMap<Arc<Channel>, u16>,
    schemas: HashMap<(Arc<str>, &'static str, Arc<str>), u16>,
    counts: BTreeMap<u16, u64>,
    sequence: u32,
    chunk: Vec<u8>,
    span: Option<(Timestamp, Timestamp)>,
    all: Option<(Timestamp, Timestamp)>,
    index: BTreeMap<u16, Vec<(Timestamp, u64)>>,
    chunks: Vec<ChunkIndex>,
    /// Kinds and contents of index records.
    besides: Vec<(Beside, Vec<u8>)>,
    begun: bool,
}

impl<W: Write + Seek> McapWriter<W> {
    pub fn begin(out: W, compression: ChunkCompression) -> Result<Self> {
        if !RecordingFormat::Mcap.takes(compression) {
            return Err(RosError::recording(&format!("MCAP cannot be compressed with {compression}")));
        }
        let mut writer = Self {
            out,
            position: 0,
            compression,
            channels: Vec::new(),
            numbers: HashMap::new(),
            schemas: HashMap::new(),
            counts: BTreeMap::new(),
            sequence: 0,
            chunk: Vec::new(),
            span: None,
            all: None,
            index: BTreeMap::new(),
            chunks: Vec::new(),
            besides: Vec::new(),
            begun: false,
        };
        writer.put(MAGIC)?;
        Ok(writer)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(RosError::unwritable)?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn put_record(&mut self, code: Code, fill: impl FnOnce(&mut Vec<u8>)) -> Result<u64> {
        let mut record = Vec::new();
        put_record(&mut record, code, fill);
        self.put(&record)?;
        Ok(record.len() as u64)
    }

    /// The header's profile depends on the first message.
    fn put_header(&mut self, profile: &str) -> Result<()> {
        if std::mem::replace(&mut self.begun, true) {
            return Ok(());
        }
        let header = |out: &mut Vec<u8>| {
            put_text(out, profile);
            put_text(out, concat!("authros ", env!("CARGO_PKG_VERSION")));
        };
        self.put_record(Code::Header, header).map(drop)
    }

    /// Takes the recording time as the publishing time.
    pub fn write(&mut self, channel: &Arc<Channel>, time: Timestamp, body: &[u8]) -> Result<()> {
        let sequence = self.sequence.wrapping_add(1);
        self.write_sent(channel, time, Sent { time, sequence }, body)
    }

    pub fn write_sent(&mut self, channel: &Arc<Channel>, time: Timestamp, sent: Sent, body: &[u8]) -> Result<()> {
        if body.len() > LONGEST_MESSAGE {
            return Err(RosError::recording("a message is too large"));
        }
        if let Encoding::Beside(kind) = channel.encoding {
            return self.write_beside(kind, body);
        }
        self.put_header(if channel.encoding == Encoding::Ros1 { "ros1" } else { "ros2" })?;
        let number = self.number(channel)?;
        self.index.entry(number).or_default().push((time, self.chunk.len() as u64));
        let wider = |(first, last): (Timestamp, Timestamp)| (first.min(time), last.max(time));
        self.span = Some(wider(self.span.unwrap_or((time, time))));
        self.all = Some(wider(self.all.unwrap_or((time, time))));
        *self.counts.entry(number).or_default() += 1;
        self.sequence = self.sequence.wrapping_add(1);
        put_record(&mut self.chunk, Code::Message, |out| {
            out.extend_from_slice(&number.to_le_bytes());
            out.extend_from_slice(&sent.sequence.to_le_bytes());
            put_numbers(out, &[time.0, sent.time.0]);
            out.extend_from_slice(body);
        });
        if self.chunk.len() >= CHUNK_THRESHOLD { self.end_chunk() } else { Ok(()) }
    }

    fn write_beside(&mut self, kind: Beside, body: &[u8]) -> Result<()> {
        let Some(content) = kind.parse(body) else {
            return Err(RosError::recording(&format!("the data to write is not a valid MCAP {}", kind.word())));
        };
        self.put_header("")?;
        // Earlier messages stay before it.
        self.end_chunk()?;
        let position = self.position;
        let length = self.put_record(kind.code(), |out| out.extend_from_slice(body))?;
        self.besides.push((kind, beside_line(&content, position, length)));
        Ok(())
    }

    fn number(&mut self, channel: &Arc<Channel>) -> Result<u16> {
        if let Some(number) = self.numbers.get(channel) {
            return Ok(*number);
        }
        if self.channels.len() >= MOST_CHANNELS {
            return Err(RosError::recording(&format!("a file cannot hold more than {MOST_CHANNELS} channels")));
        }
        let key = (Arc::clone(&channel.type_name), schema_encoding(channel.encoding), Arc::clone(&channel.definition));
        let next = u16::try_from(self.schemas.len() + 1).unwrap_or(u16::MAX);
        let schema = *self.schemas.entry(key).or_insert(next);
        if schema == next {
            put_schema(&mut self.chunk, schema, channel);
        }
        let number = u16::try_from(self.channels.len()).unwrap_or(u16::MAX);
        put_channel(&mut self.chunk, number, schema, channel);
        self.numbers.insert(Arc::clone(channel), number);
        self.channels.push((schema, Arc::clone(channel)));
        Ok(number)
    }

    fn end_chunk(&mut self) -> Result<()> {
        let Some(span) = self.span.take() else { return Ok(()) };
        let packed = pack(self.compression, &self.chunk).map_err(|error| RosError::recording(&error))?;
        let (position, size) = (self.position, self.chunk.len() as u64);
        let (checksum, word) = (crc32fast::hash(&self.chunk), self.compression_word());
        let length = self.put_record(Code::Chunk, |out| {
            out.reserve(packed.len() + 64);
            put_numbers(out, &[span.0.0, span.1.0, size]);
            out.extend_from_slice(&checksum.to_le_bytes());
            put_text(out, word);
            put_numbers(out, &[packed.len() as u64]);
            out.extend_from_slice(&packed);
        })?;
        let index_start = self.position;
        let mut indexes = Vec::new();
        for (number, entries) in std::mem::take(&mut self.index) {
            indexes.push((number, self.position));
            self.put_record(Code::MessageIndex, |out| {
                out.extend_from_slice(&number.to_le_bytes());
                put_length(out, entries.len() * 16);
                entries.iter().for_each(|(time, offset)| put_numbers(out, &[time.0, *offset]));
            })?;
        }
        let index_length = self.position - index_start;
        let packed = packed.len() as u64;
        self.chunks.push(ChunkIndex { span, position, length, indexes, index_length, packed, size });
        self.chunk.clear();
        Ok(())
    }

    fn compression_word(&self) -> &'static str {
        if self.compression == ChunkCompression::None { "" } else { self.compression.word() }
    }

    /// Writes the last chunk and the summary, and returns the file.
    pub fn finish(mut self) -> Result<W> {
        self.put_header("ros1")?;
        self.end_chunk()?;
        self.put_record(Code::DataEnd, |out| out.extend_from_slice(&[0; 4]))?;
        let start = self.position;
        let mut summary = Vec::new();
        let mut groups = Vec::new();
        let besides = [Code::AttachmentIndex, Code::MetadataIndex];
        for code in [Code::Schema, Code::Channel, Code::Statistics, Code::ChunkIndex].into_iter().chain(besides) {
            let at = summary.len();
            self.put_group(&mut summary, code);
            groups.push((code, start + at as u64, (summary.len() - at) as u64));
        }
        end_summary(&mut summary, start, &groups);
        self.put(&summary)?;
        self.put(MAGIC)?;
        self.out.flush().map_err(RosError::unwritable)?;
        Ok(self.out)
    }

    fn put_group(&self, out: &mut Vec<u8>, code: Code) {
        match code {
            Code::Schema => {
                let mut last = 0;
                for (schema, channel) in &self.channels {
                    if *schema > last {
                        put_schema(out, *schema, channel);
                        last = *schema;
                    }
                }
            }
            Code::Channel => {
                for (number, (schema, channel)) in self.channels.iter().enumerate() {
                    put_channel(out, u16::try_from(number).unwrap_or(u16::MAX), *schema, channel);
                }
            }
            Code::Statistics => self.put_statistics(out),
            Code::AttachmentIndex => self.put_beside_index(out, code, Beside::Attachment),
            Code::MetadataIndex => self.put_beside_index(out, code, Beside::Metadata),
            _ => self.chunks.iter().for_each(|chunk| put_chunk_index(out, chunk, self.compression_word())),
        }
    }

    fn put_beside_index(&self, out: &mut Vec<u8>, code: Code, kind: Beside) {
        for (_, line) in self.besides.iter().filter(|(of, _)| *of == kind) {
            put_record(out, code, |out| out.extend_from_slice(line));
        }
    }

    fn put_statistics(&self, out: &mut Vec<u8>) {
        let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes();
        let (first, last) = self.all.unwrap_or((Timestamp(0), Timestamp(0)));
        put_record(out, Code::Statistics, |out| {
            out.extend_from_slice(&self.counts.values().sum::<u64>().to_le_bytes());
            out.extend_from_slice(&u16::try_from(self.schemas.len()).unwrap_or(u16::MAX).to_le_bytes());
            out.extend_from_slice(&count(self.channels.len()));
            for kind in [Beside::Attachment, Beside::Metadata] {
                out.extend_from_slice(&count(self.besides.iter().filter(|(of, _)| *of == kind).count()));
            }
            out.extend_from_slice(&count(self.chunks.len()));
            put_numbers(out, &[first.0, last.0]);
            put_length(out, self.counts.len() * 10);
            for (number, messages) in &self.counts {
                out.extend_from_slice(&number.to_le_bytes());
                out.extend_from_slice(&messages.to_le_bytes());
            }
        });
    }
}

/// Writes the footer and where the groups of a summary are, which begins at `start` of the file.
fn end_summary(summary: &mut Vec<u8>, start: u64, groups: &[(Code, u64, u64)]) {
    let offsets = start + summary.len() as u64;
    for (code, at, length) in groups.iter().filter(|(_, _, length)| *length > 0) {
        put_record(summary, Code::SummaryOffset, |out| {
            out.push(*code as u8);
            put_numbers(out, &[*at, *length]);
        });
    }
    put_record(summary, Code::Footer, |out| put_numbers(out, &[start, offsets]));
    // The checksum also covers the footer, whose length is known only now and includes the checksum's own bytes.
    let footer = summary.len() - 24;
    if let Some(place) = summary.get_mut(footer..footer + 8) {
        place.copy_from_slice(&20_u64.to_le_bytes());
    }
    let checksum = crc32fast::hash(summary);
    summary.extend_from_slice(&checksum.to_le_bytes());
}

fn beside_line(content: &BesideContent<'_>, position: u64, length: u64) -> Vec<u8> {
    let mut line = Vec::new();
    put_numbers(&mut line, &[position, length]);
    match content {
        BesideContent::File(file) => {
            put_numbers(&mut line, &[file.logged_at.0, file.created_at, file.data.len() as u64]);
            put_text(&mut line, &file.name);
            put_text(&mut line, &file.media_type);
        }
        BesideContent::Metadata { name, .. } => put_text(&mut line, name),
    }
    line
}

fn put_chunk_index(out: &mut Vec<u8>, chunk: &ChunkIndex, compression: &str) {
    put_record(out, Code::ChunkIndex, |out| {
        put_numbers(out, &[chunk.span.0.0, chunk.span.1.0, chunk.position, chunk.length]);
        put_length(out, chunk.indexes.len() * 10);
        for (number, position) in &chunk.indexes {
            out.extend_from_slice(&number.to_le_bytes());
            out.extend_from_slice(&position.to_le_bytes());
        }
        put_numbers(out, &[chunk.index_length]);
        put_text(out, compression);
        put_numbers(out, &[chunk.packed, chunk.size]);
    });
}

// Attachments and metadata of an MCAP file, kept as MCAP's own bytes without code and length, so that they come out as
// they went in.

/// Files them under this name; no topic of ROS begins like this.
pub const BESIDE: &str = "authros/attachments";

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Beside {
    /// A file, such as a calibration or a map.
    Attachment,
    /// Names with values about the recording.
    Metadata,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttachedFile<'a> {
    pub logged_at: Timestamp,
    /// Nanoseconds since 1970; 0 if unknown.
    pub created_at: u64,
    /// As written.
    pub name: Arc<str>,
    /// As written.
    pub media_type: Arc<str>,
    pub data: &'a [u8],
    /// CRC-32 of everything before it; 0 if there is none.
    pub checksum: u32,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BesideContent<'a> {
    File(AttachedFile<'a>),
    Metadata { name: Arc<str>, entries: Vec<(Arc<str>, Arc<str>)> },
}

impl AttachedFile<'_> {
    /// MCAP's own bytes, with a checksum.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.data.len() + 256);
        put_numbers(&mut out, &[self.logged_at.0, self.created_at]);
        put_text(&mut out, &self.name);
        put_text(&mut out, &self.media_type);
        put_numbers(&mut out, &[self.data.len() as u64]);
        out.extend_from_slice(self.data);
        let checksum = crc32fast::hash(&out);
        out.extend_from_slice(&checksum.to_le_bytes());
        out
    }
}

impl BesideContent<'_> {
    pub fn name(&self) -> &Arc<str> {
        match self {
            Self::File(file) => &file.name,
            Self::Metadata { name, .. } => name,
        }
    }
}

impl Beside {
    /// Stands for a message type.
    pub fn type_name(self) -> &'static str {
        self.names().1
    }

    /// Its code, what stands for a message type, and its word in a finding.
    fn names(self) -> (Code, &'static str, &'static str) {
        match self {
            Self::Attachment => (Code::Attachment, "authros/Attachment", "attachment"),
            Self::Metadata => (Code::Metadata, "authros/Metadata", "metadata record"),
        }
    }

    pub fn of_type(name: &str) -> Option<Self> {
        [Self::Attachment, Self::Metadata].into_iter().find(|kind| kind.type_name() == name)
    }

    pub fn channel(self) -> Channel {
        let about = BTreeMap::new();
        Channel { md5sum: "".into(), ..Channel::plain((BESIDE, self.type_name(), ""), Encoding::Beside(self), about) }
    }

    /// `None` if it is not exactly as MCAP has it.
    pub fn parse(self, bytes: &[u8]) -> Option<BesideContent<'_>> {
        let mut fields = Fields(bytes);
        let content = match self {
            Self::Attachment => BesideContent::File(AttachedFile {
                logged_at: Timestamp(fields.u64().filter(|time| *time <= LATEST)?),
                created_at: fields.u64()?,
                name: fields.text()?,
                media_type: fields.text()?,
                data: fields.u64().and_then(|length| fields.bytes(usize::try_from(length).ok()?))?,
                checksum: fields.u32()?,
            }),
            Self::Metadata => BesideContent::Metadata { name: fields.text()?, entries: fields.map()? },
        };
        fields.0.is_empty().then_some(content)
    }

    /// Whether its checksum matches; `None` if it has none.
    fn is_sound(content: &BesideContent<'_>, bytes: &[u8]) -> Option<bool> {
        match content {
            BesideContent::File(AttachedFile { checksum: 0, .. }) | BesideContent::Metadata { .. } => None,
            BesideContent::File(file) => {
                let covered = bytes.get(..bytes.len().saturating_sub(4)).unwrap_or_default();
                Some(crc32fast::hash(covered) == file.checksum)
            }
        }
    }

    /// From the beginning of its bytes.
    fn name_of(self, beginning: &[u8]) -> Arc<str> {
        let mut fields = Fields(beginning);
        let name = match self {
            Self::Attachment => fields.u64().and(fields.u64()).and_then(|_| fields.text()),
            Self::Metadata => fields.text(),
        };
        name.unwrap_or_default()
    }

    fn of_code(code: Code) -> Option<Self> {
        [Self::Attachment, Self::Metadata].into_iter().find(|kind| kind.code() == code)
    }

    fn code(self) -> Code {
        self.names().0
    }

    fn word(self) -> &'static str {
        self.names().2
    }
}

pub fn metadata_record(name: &str, entries: &[(&str, &str)]) -> Vec<u8> {
    let mut out = Vec::new();
    put_text(&mut out, name);
    put_map(&mut out, entries);
    out
}
