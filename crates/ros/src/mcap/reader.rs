//! Reads MCAP chunk by chunk, in file order. A chunk is unpacked and checked before any of its messages is returned; a
//! damaged one is skipped as a whole.

mod growing;

use std::collections::{BTreeSet, HashMap};
use std::io::{BufRead, Read, Seek, SeekFrom};
use std::sync::Arc;

use self::growing::Growing;
use super::{BESIDE, Beside, BesideContent};
use super::{ChannelRecord, Code, Fields, LATEST, LEAD, MAGIC, Schema, TAIL, schema};
use crate::recording::{
    Channel, Chunk, ChunkCompression, Findings, LARGEST_CHUNK, MOST_CHANNEL_BYTES, MOST_CHANNELS, RecordedMessage,
    RecordingReader, Sent, TOO_LARGE, go_to, kept_about, read_at, unpack, unpacked_body,
};
use crate::{Result, RosError, model::Timestamp, tcpros::LONGEST_MESSAGE};

/// Of other records than messages and chunks, bytes; they may hold a definition.
const LONGEST_RECORD: u64 = 2 << 20;

/// Times, sizes, checksum, and the name of a compression; bytes.
const LONGEST_CHUNK_HEAD: u64 = 128;

/// Limit of chunk positions kept from the summary, to continue after damage.
const MOST_PLACES: usize = 1 << 20;

const BEGINNING: u64 = 1024;

struct ChunkHead {
    size: u64,
    checksum: u32,
    compression: Option<ChunkCompression>,
    data: u64,
    length: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// At the end, which is read first: it counts until the data describes the same.
    Summary,
    /// Among the data: it counts from there on.
    Data,
}

#[derive(Debug)]
struct KnownChannel {
    record: ChannelRecord,
    usable: Result<Arc<Channel>, String>,
}

/// A count in the summary, if any, and the real one.
#[derive(Debug, Default)]
struct Tally {
    counted: Option<u64>,
    met: u64,
}

#[derive(Debug)]
pub struct McapReader<R> {
    file: R,
    length: u64,
    position: u64,
    chunk: Chunk,
    schemas: HashMap<u16, Schema>,
    channels: HashMap<u16, KnownChannel>,
    texts: usize,
    places: BTreeSet<u64>,
    findings: Findings,
    /// Counts by the summary, and real ones.
    messages: Tally,
    besides: Tally,
    /// Time of the last message; before the first, the beginning by the summary.
    latest: Timestamp,
    ended: bool,
    /// Whether the file ends with a footer, by which a summary is found.
    has_footer: bool,
    growing: Growing,
}

impl<R: BufRead + Seek> RecordingReader for McapReader<R> {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>> {
        loop {
            if let Some(message) = self.next_in_chunk() {
                return Ok(Some(message));
            }
            if self.ended {
                let besides = ("attachments and metadata records", &mut self.besides);
                for (what, tally) in [("messages", &mut self.messages), besides] {
                    self.findings.compare(self.length, what, tally.counted.take(), tally.met);
                }
                return Ok(None);
            }
            if !self.may_go_on().map_err(RosError::unreadable)? {
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

impl<R: BufRead + Seek> McapReader<R> {
    pub fn open(file: R) -> Result<Self> {
        let mut reader = Self::begin(file)?;
        reader.read_summary().map_err(RosError::unreadable)?;
        Ok(reader)
    }

    fn begin(mut file: R) -> Result<Self> {
        let length = file.seek(SeekFrom::End(0)).map_err(RosError::unreadable)?;
        let position = MAGIC.len() as u64;
        let mut reader = Self {
            file,
            length,
            position,
            chunk: Chunk::default(),
            schemas: HashMap::new(),
            channels: HashMap::new(),
            texts: 0,
            places: BTreeSet::new(),
            findings: Findings::default(),
            messages: Tally::default(),
            besides: Tally::default(),
            latest: Timestamp(0),
            ended: false,
            has_footer: false,
            growing: Growing::default(),
        };
        if read_at(&mut reader.file, 0, position).map_err(RosError::unreadable)? != MAGIC {
            return Err(RosError::recording("it does not start like MCAP"));
        }
        Ok(reader)
    }

    fn look(&mut self, at: u64) -> std::io::Result<Option<(u8, u64)>> {
        let lead = read_at(&mut self.file, at, LEAD)?;
        let mut fields = Fields(&lead);
        Ok(fields.u8().zip(fields.u64()))
    }

    /// Learns schemas, channels and positions of chunks.
    fn read_summary(&mut self) -> std::io::Result<()> {
        let Some(footer) = self.length.checked_sub(TAIL).filter(|footer| *footer >= MAGIC.len() as u64) else {
            return Ok(());
        };
        let start = super::footer(&read_at(&mut self.file, footer, TAIL)?);
        self.has_footer = start.is_some();
        let Some((mut at, checksum)) = start.filter(|(start, _)| *start > 0) else { return Ok(()) };
        // The checksum covers the summary and the footer up to itself.
        if checksum != 0 && self.checksum_of(at, footer + LEAD + 16)? != checksum {
            self.findings.note(at, "the summary at the end is damaged (its checksum does not match); it was not used");
            return Ok(());
        }
        while at < footer {
            let Some((code, length)) = self.look(at)? else { break };
            if length > LONGEST_RECORD {
                break;
            }
            let content = read_at(&mut self.file, at + LEAD, length)?;
            let is_sound = match Code::from_repr(code) {
                Some(Code::ChunkIndex) => {
                    let mut fields = Fields(&content);
                    let place = fields.u64().and(fields.u64()).and(fields.u64());
                    self.places.extend(place.filter(|_| self.places.len() < MOST_PLACES));
                    place.is_some()
                }
                Some(Code::Statistics) => self.read_statistics(Fields(&content)),
                _ => self.learn(code, &content, Place::Summary),
            };
            if !is_sound {
                self.findings.note(at, "a record of the summary at the end is damaged");
            }
            at += LEAD + length;
        }
        if at != footer {
            self.findings.note(at, "the summary at the end is damaged: it does not end where the footer begins");
        }
        Ok(())
    }

    fn read_statistics(&mut self, mut fields: Fields<'_>) -> bool {
        self.messages.counted = fields.u64();
        let attached = fields.u16().and(fields.u32()).and(fields.u32());
        let metadata = fields.u32();
        self.besides.counted = attached.zip(metadata).map(|(files, records)| u64::from(files) + u64::from(records));
        let begins = fields.u32().and(fields.u64());
        self.latest = Timestamp(begins.filter(|time| *time <= LATEST).unwrap_or_default());
        begins.is_some()
    }

    fn checksum_of(&mut self, from: u64, until: u64) -> std::io::Result<u32> {
        let mut hasher = crc32fast::Hasher::new();
        go_to(&mut self.file, from)?;
        let mut left = self.file.by_ref().take(until.saturating_sub(from));
        loop {
            let bytes = left.fill_buf()?;
            if bytes.is_empty() {
                return Ok(hasher.finalize());
            }
            hasher.update(bytes);
            let used = bytes.len();
            left.consume(used);
        }
    }

    /// If messages had no checksum of their own, compares that of all data.
    fn end_data(&mut self, start: u64, length: u64) -> std::io::Result<()> {
        self.ended = true;
        if !self.has_footer {
            self.findings.note(self.length, "the file is damaged at its end: there is no footer behind the data");
        }
        let content = read_at(&mut self.file, start + LEAD, length.min(4))?;
        let checksum = Fields(&content).u32().filter(|checksum| *checksum != 0);
        let Some(checksum) = checksum.filter(|_| self.findings.unguarded > 0) else { return Ok(()) };
        if self.checksum_of(0, start)? == checksum {
            self.findings.unguarded = 0;
        } else {
            self.findings.note(start, "the data was altered: its checksum at the end does not match");
        }
        Ok(())
    }

    /// `false` if it is damaged. A later description counts from there on, and is damage if it differs: the same number
    /// would stand for two things.
    fn learn(&mut self, code: u8, content: &[u8], place: Place) -> bool {
        let fields = Fields(content);
        match Code::from_repr(code) {
            Some(Code::Schema) => {
                schema(fields).is_some_and(|(number, schema)| self.learn_schema(number, schema, place))
            }
            Some(Code::Channel) => ChannelRecord::parse(fields).is_some_and(|record| self.learn_channel(record, place)),
            _ => true,
        }
    }

    fn learn_schema(&mut self, number: u16, schema: Schema, place: Place) -> bool {
        if let Some(known) = self.schemas.get(&number) {
            if *known == schema {
                return true;
            }
            let text = format!("schema {number} is {} before and {} here", shown(&known.name), shown(&schema.name));
            self.contradiction(&text, place);
        }
        self.texts += schema.size();
        if self.texts > MOST_CHANNEL_BYTES {
            return false;
        }
        for channel in self.channels.values_mut().filter(|channel| channel.record.schema == number) {
            channel.usable = channel.record.with(Some(&schema)).map(Arc::new);
        }
        self.schemas.insert(number, schema);
        true
    }

    fn learn_channel(&mut self, record: ChannelRecord, place: Place) -> bool {
        let number = record.number;
        if let Some(known) = self.channels.get(&number) {
            if known.record == record {
                return true;
            }
            let (before, here) = (shown(&known.record.topic), shown(&record.topic));
            self.contradiction(&format!("channel {number} is {before} before and {here} here"), place);
        } else if self.channels.len() >= MOST_CHANNELS {
            return false;
        }
        self.texts += record.size();
        if self.texts > MOST_CHANNEL_BYTES {
            return false;
        }
        if !kept_about(record.others()).1 {
            self.findings.note(self.position, "a channel's metadata is too long to keep");
        }
        let usable = record.with(self.schemas.get(&record.schema)).map(Arc::new);
        self.channels.insert(number, KnownChannel { record, usable });
        true
    }

    fn contradiction(&mut self, text: &str, place: Place) {
        let rule = match place {
            Place::Summary => "the file contradicts itself",
            Place::Data => "the file contradicts itself; from here on the newer description counts",
        };
        self.findings.note(self.position, &format!("{text}: {rule}"));
    }

    /// Fills the chunk, or returns a message outside any chunk.
    fn advance(&mut self) -> std::io::Result<Option<RecordedMessage>> {
        let start = self.position;
        let Some((code, length)) = self.look(start)? else {
            let is_end = start >= self.length;
            let text = if is_end { "the file has no end record" } else { "the file ends in the middle of a record" };
            self.findings.note(start, &format!("{text}: the recorder did not close it, or it was cut off"));
            self.ended = true;
            return Ok(None);
        };
        let data = start + LEAD;
        let end = data.checked_add(length);
        let code = Code::from_repr(code);
        let missing = end.is_none_or(|end| end > self.length);
        if missing && code != Some(Code::Chunk) || code.is_none() && length > self.length {
            self.skip(start, "no record can be read here");
            return Ok(None);
        }
        self.position = end.unwrap_or(self.length).min(self.length);
        match code {
            Some(Code::Chunk) => {
                if self.growing.told {
                    self.growing.chunks.push(start..self.position);
                }
                self.read_chunk(start, missing)?;
            }
            Some(Code::DataEnd) => self.end_data(start, length)?,
            Some(Code::Footer) => self.ended = true,
            Some(Code::Message) if length <= LONGEST_MESSAGE as u64 + 64 => {
                let content = read_at(&mut self.file, data, length)?;
                return Ok(self.message(Fields(&content), false));
            }
            Some(code @ (Code::Attachment | Code::Metadata)) => {
                let Some(kind) = Beside::of_code(code) else { return Ok(None) };
                if length > LONGEST_MESSAGE as u64 {
                    let beginning = read_at(&mut self.file, data, BEGINNING)?;
                    let (word, name) = (kind.word(), shown(&kind.name_of(&beginning)));
                    self.besides.met += 1;
                    let most = format!("a record holds at most {LONGEST_MESSAGE}");
                    self.findings
                        .leave_out(BESIDE, &format!("the {word} {name} of {length} bytes is too large: {most}"));
                    return Ok(None);
                }
                let content = read_at(&mut self.file, data, length)?;
                return Ok(self.beside(kind, start, &content, false));
            }
            Some(Code::Schema | Code::Channel) if length <= LONGEST_RECORD => {
                let content = read_at(&mut self.file, data, length)?;
                if !self.learn(code.map_or(0, |code| code as u8), &content, Place::Data) {
                    self.findings.note(start, "a schema or channel that cannot be used was skipped");
                }
            }
            Some(Code::Message) => {
                self.messages.met += 1;
                let number = Fields(&read_at(&mut self.file, data, 2)?).u16();
                let channel = number.and_then(|number| self.channels.get(&number));
                self.findings.leave_out(channel.map_or("", |known| &*known.record.topic), TOO_LARGE);
            }
            Some(Code::Schema | Code::Channel) => {
                self.findings.note(start, &format!("a record of {length} bytes was skipped: it is too large"));
            }
            _ if self.places.contains(&start) => {
                self.findings.note(start, "the summary names a chunk here, but there is none; it was skipped");
            }
            _ => {}
        }
        Ok(None)
    }

    /// An attachment or metadata record, as it is in the file.
    fn beside(&mut self, kind: Beside, at: u64, content: &[u8], guarded: bool) -> Option<RecordedMessage> {
        self.besides.met += 1;
        let word = kind.word();
        let Some(parsed) = kind.parse(content) else {
            self.findings.note(at, &format!("a damaged {word} of {} bytes was skipped", content.len()));
            return None;
        };
        let sound = Beside::is_sound(&parsed, content);
        if sound == Some(false) {
            let text = format!("the {word} {} was skipped: its checksum does not match", shown(parsed.name()));
            self.findings.note(at, &text);
            return None;
        }
        self.findings.unguarded += u64::from(!guarded && sound.is_none());
        // Metadata has no time: it belongs to the record before it.
        let time = match parsed {
            BesideContent::File(file) => file.logged_at,
            BesideContent::Metadata { .. } => self.latest,
        };
        Some(RecordedMessage { channel: Arc::new(kind.channel()), time, sent: None, body: content.to_vec() })
    }

    fn message(&mut self, fields: Fields<'_>, guarded: bool) -> Option<RecordedMessage> {
        self.messages.met += 1;
        match self.read_message(fields) {
            Ok(message) => {
                self.findings.unguarded += u64::from(!guarded);
                self.latest = message.time;
                Some(message)
            }
            Err((topic, why)) => {
                self.findings.leave_out(&topic, &why);
                None
            }
        }
    }

    fn read_message(&self, mut fields: Fields<'_>) -> Result<RecordedMessage, (Arc<str>, String)> {
        const SHORT: &str = "its record is too short";
        let number = fields.u16().ok_or_else(|| ("".into(), SHORT.to_owned()))?;
        let unknown = || ("".into(), format!("its channel {number} is not described anywhere in the file"));
        let known = self.channels.get(&number).ok_or_else(unknown)?;
        let left_out = |why: String| (Arc::clone(&known.record.topic), why);
        let channel = known.usable.clone().map_err(left_out)?;
        let (Some(sequence), Some(logged), Some(sent)) = (fields.u32(), fields.u64(), fields.u64()) else {
            return Err(left_out(SHORT.to_owned()));
        };
        if logged > LATEST {
            return Err(left_out("its time lies after the year 2262".to_owned()));
        }
        let body = unpacked_body(channel.encoding, fields.0.to_vec()).map_err(left_out)?;
        let sent = Some(Sent { time: Timestamp(sent), sequence });
        Ok(RecordedMessage { channel, time: Timestamp(logged), sent, body })
    }

    /// Continues at the next chunk of the summary, and reports the skipped part.
    fn skip(&mut self, damaged: u64, why: &str) {
        let next = self.places.range(damaged + 1..).next().copied().filter(|next| *next < self.length);
        let end = next.unwrap_or(self.length);
        self.findings.note(damaged, &format!("{why}: {} bytes were skipped", end.saturating_sub(damaged)));
        self.position = end;
        self.ended = next.is_none();
    }

    fn chunk_head(&mut self, start: u64) -> std::io::Result<Option<ChunkHead>> {
        let bytes = read_at(&mut self.file, start + LEAD, LONGEST_CHUNK_HEAD)?;
        let mut fields = Fields(&bytes);
        let mut head = || {
            let (size, checksum) = (fields.u64().and(fields.u64()).and(fields.u64())?, fields.u32()?);
            let compression = match &*fields.text()? {
                "" => Some(ChunkCompression::None),
                "lz4" => Some(ChunkCompression::Lz4),
                "zstd" => Some(ChunkCompression::Zstd),
                _ => None,
            };
            let length = fields.u64()?;
            let data = start + LEAD + (bytes.len() - fields.0.len()) as u64;
            Some(ChunkHead { size, checksum, compression, data, length })
        };
        Ok(head())
    }

    fn read_chunk(&mut self, start: u64, missing: bool) -> std::io::Result<()> {
        let Some(head) = self.chunk_head(start)? else {
            self.skip(start, "the head of a chunk cannot be read");
            return Ok(());
        };
        let Some(compression) = head.compression else {
            self.findings.note(start, "a chunk with an unknown compression was skipped");
            return Ok(());
        };
        let ChunkHead { size, checksum, data, length, .. } = head;
        if size > LARGEST_CHUNK as u64 {
            self.findings.note(start, &format!("a chunk of {size} bytes was skipped; the limit is {LARGEST_CHUNK}"));
            return Ok(());
        }
        go_to(&mut self.file, data)?;
        let mut bytes = std::mem::take(&mut self.chunk.bytes);
        bytes.clear();
        let limit = usize::try_from(size).unwrap_or(usize::MAX);
        let unpacked = unpack(compression, self.file.by_ref().take(length), limit, &mut bytes);
        let sound = checksum == 0 || crc32fast::hash(&bytes) == checksum;
        let whole = unpacked.is_ok() && bytes.len() as u64 == size && sound;
        let followed = self.places.range(start + 1..).next().is_some_and(|next| *next < self.length);
        let guarded = checksum != 0 || unpacked.as_ref().is_ok_and(|guarded| *guarded);
        self.chunk = Chunk { bytes, at: 0, position: data, cut: missing && !whole, guarded };
        if whole && !missing {
            return Ok(());
        }
        if missing && !followed {
            let text = if self.chunk.bytes.is_empty() {
                "the file ends in the middle of a chunk that cannot be unpacked; its messages were not read"
            } else {
                "the file ends in the middle of a chunk; everything before that was read"
            };
            self.findings.note(start, text);
            self.position = self.length;
            return Ok(());
        }
        self.chunk.bytes.clear();
        let why = unpacked.err().unwrap_or_else(|| String::from("its checksum or length does not match"));
        if missing {
            self.skip(start, &format!("a chunk is damaged ({why})"));
            return Ok(());
        }
        let skipped = self.position - start;
        self.findings.note(start, &format!("a damaged chunk of {skipped} bytes was skipped: {why}"));
        Ok(())
    }

    fn next_in_chunk(&mut self) -> Option<RecordedMessage> {
        while self.chunk.at < self.chunk.bytes.len() {
            let chunk = std::mem::take(&mut self.chunk);
            let mut fields = Fields(chunk.bytes.get(chunk.at..).unwrap_or_default());
            let record = fields.record();
            let beside = record.and_then(|(code, _)| Code::from_repr(code)).and_then(Beside::of_code);
            let message = match (record, beside) {
                (Some((code, content)), _) if code == Code::Message as u8 => {
                    Some(self.message(Fields(content), chunk.guarded))
                }
                // MCAP has them outside of chunks, but they count anywhere.
                (Some((_, content)), Some(kind)) => Some(self.beside(kind, chunk.position, content, chunk.guarded)),
                (Some((code, content)), None) if self.learn(code, content, Place::Data) => Some(None),
                _ => None,
            };
            let at = chunk.bytes.len() - fields.0.len();
            let Some(message) = message else {
                self.chunk = chunk.end(&mut self.findings, "MCAP");
                return None;
            };
            self.chunk = Chunk { at, ..chunk };
            if message.is_some() {
                return message;
            }
        }
        None
    }
}

fn shown(name: &str) -> String {
    format!("'{}'", crate::model::clean(name, 80))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::ros::mcap::{put_length, put_record, put_text};

    fn put_schema(out: &mut Vec<u8>, number: u16, name: &str, encoding: &str, text: &str) {
        put_record(out, Code::Schema, |out| {
            out.extend_from_slice(&number.to_le_bytes());
            [name, encoding, text].iter().for_each(|field| put_text(out, field));
        });
    }

    fn put_channel(out: &mut Vec<u8>, number: u16, schema: u16, topic: &str, encoding: &str) {
        put_record(out, Code::Channel, |out| {
            out.extend_from_slice(&number.to_le_bytes());
            out.extend_from_slice(&schema.to_le_bytes());
            [topic, encoding].iter().for_each(|field| put_text(out, field));
            put_length(out, 0);
        });
    }

    fn put_message(out: &mut Vec<u8>, channel: u16, time: u64, body: &str) {
        put_record(out, Code::Message, |out| {
            out.extend_from_slice(&channel.to_le_bytes());
            out.extend_from_slice(&1_u32.to_le_bytes());
            [time, 7].iter().for_each(|time| out.extend_from_slice(&time.to_le_bytes()));
            out.extend_from_slice(body.as_bytes());
        });
    }

    /// Topic, type, definition and body of each message, and what was found beside them.
    fn read(records: impl FnOnce(&mut Vec<u8>)) -> (Vec<String>, Findings) {
        let mut bytes = MAGIC.to_vec();
        records(&mut bytes);
        put_record(&mut bytes, Code::DataEnd, |out| out.extend_from_slice(&[0; 4]));
        put_record(&mut bytes, Code::Footer, |out| out.extend_from_slice(&[0; 20]));
        bytes.extend_from_slice(MAGIC);
        let mut reader = McapReader::open(Cursor::new(bytes)).expect("MCAP");
        let mut messages = Vec::new();
        while let Some(message) = reader.next_message().expect("read") {
            let RecordedMessage { channel, body, .. } = message;
            let body = String::from_utf8(body).expect("text");
            messages.push(format!("{} {} {} {body}", channel.topic, channel.type_name, channel.definition));
        }
        (messages, reader.findings().clone())
    }

    fn texts(findings: &Findings) -> Vec<&str> {
        findings.damages.iter().map(|damage| damage.text.as_str()).collect()
    }

    #[test]
    fn a_channel_described_again_counts_from_there_on_and_is_damage_if_it_differs() {
        let (messages, findings) = read(|out| {
            put_schema(out, 1, "a/msg/B", "ros2msg", "int8 x");
            put_channel(out, 1, 1, "/left", "cdr");
            put_message(out, 1, 1, "left0");
            put_channel(out, 1, 1, "/left", "cdr");
            put_message(out, 1, 2, "left1");
            put_channel(out, 1, 1, "/right", "cdr");
            put_message(out, 1, 3, "right0");
        });
        let expected = ["/left a/msg/B int8 x left0", "/left a/msg/B int8 x left1", "/right a/msg/B int8 x right0"];
        assert_eq!(messages, expected);
        let told = texts(&findings);
        assert!(matches!(told[..], [one] if one.contains("channel 1 is '/left' before and '/right' here")), "{told:?}");
    }

    #[test]
    fn a_schema_described_again_counts_for_all_its_channels_from_there_on() {
        let (messages, findings) = read(|out| {
            put_schema(out, 3, "a/msg/B", "ros2msg", "int8 x");
            put_channel(out, 1, 3, "/t", "cdr");
            put_message(out, 1, 1, "0");
            put_schema(out, 3, "a/msg/C", "ros2msg", "int8 y");
            put_message(out, 1, 2, "1");
        });
        assert_eq!(messages, ["/t a/msg/B int8 x 0", "/t a/msg/C int8 y 1"]);
        let told = texts(&findings);
        assert!(matches!(told[..], [one] if one.contains("schema 3 is 'a/msg/B' before")), "{told:?}");
    }

    #[test]
    fn a_body_in_cdr_is_kept_without_a_definition_and_what_is_left_out_has_topic_reason_and_count() {
        let (messages, findings) = read(|out| {
            put_schema(out, 1, "std_msgs/msg/String", "", "");
            put_schema(out, 2, "Json", "jsonschema", "{}");
            put_channel(out, 1, 1, "/known", "cdr");
            put_channel(out, 2, 2, "/json", "json");
            put_channel(out, 3, 0, "/untyped", "cdr");
            put_channel(out, 4, 9, "/lost", "cdr");
            for (channel, time) in [(1, 1), (2, 1), (2, 2), (3, 1), (4, 1), (7, 1), (1, u64::MAX)] {
                put_message(out, channel, time, "x");
            }
        });
        assert_eq!(messages, ["/known std_msgs/msg/String  x"]);
        let rows: Vec<_> =
            findings.unusable.iter().map(|row| (row.topic.as_str(), row.why.as_str(), row.messages)).collect();
        let expected = [
            ("/json", "its encoding 'json' is not of ROS", 2),
            ("/untyped", "its channel names no type (schema 0)", 1),
            ("/lost", "its schema 9 is not in the file", 1),
            ("", "its channel 7 is not described anywhere in the file", 1),
            ("/known", "its time lies after the year 2262", 1),
        ];
        assert_eq!(rows, expected);
        assert_eq!((findings.messages_skipped(), findings.is_whole()), (6, false));
    }

    #[test]
    fn a_list_of_what_is_left_out_is_bounded() {
        let mut findings = Findings::default();
        (0..2000).for_each(|number| findings.leave_out(&format!("/t{number}"), "why"));
        assert_eq!((findings.messages_skipped(), findings.unusable.len()), (2000, 256));
    }
}
