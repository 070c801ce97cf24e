//! Recordings: files of messages with their times, by `rosbag record` and MCAP writers. Files are hostile: every length
//! is checked, and memory is bounded by [`LARGEST_CHUNK`].

mod described;
pub mod tags;

use std::io::{BufRead, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::{collections::BTreeMap, fs::File, path::Path, sync::Arc};

use serde::{Deserialize, Serialize};
use strum::{Display, EnumString, IntoStaticStr};

use crate::bag::{self, BagReader, BagWriter};
use crate::mcap::{self, McapReader, McapWriter};
use crate::model::{Timestamp, clean};
use crate::rosbag2::{Db3Reader, FolderReader, SQLITE, unpacked};
use crate::{Result, RosError, tcpros::LONGEST_MESSAGE};

pub use super::mcap::{AttachedFile, BESIDE, Beside, BesideContent};
pub use described::{Described, TYPE_HASH, TypeFacts};

/// Room for the longest message and those before it in its chunk, bytes.
pub const LARGEST_CHUNK: usize = LONGEST_MESSAGE + (64 << 20);

/// A chunk is closed at this size, as in `rosbag record`, bytes.
pub(super) const CHUNK_THRESHOLD: usize = 768 * 1024;

#[derive(Debug, Default)]
pub(super) struct Chunk {
    pub bytes: Vec<u8>,
    pub at: usize,
    pub position: u64,
    /// Whether its end is missing, which was already reported.
    pub cut: bool,
    /// Whether a checksum covered its bytes.
    pub guarded: bool,
}

impl Chunk {
    /// Its rest is unreadable. The next chunk reuses the memory.
    pub fn end(mut self, findings: &mut Findings, format: &str) -> Self {
        if !self.cut {
            let left = self.bytes.len() - self.at;
            let text = format!("the last {left} bytes of a chunk were skipped: they are not {format} records");
            findings.note(self.position, &text);
        }
        self.bytes.clear();
        Self { bytes: self.bytes, ..Self::default() }
    }
}

pub(super) const MOST_CHANNELS: usize = 16_384;

/// Of all channels' texts together.
pub(super) const MOST_CHANNEL_BYTES: usize = 64 << 20;

/// The topic in a bag's connection header, where that is not the connection's own; empty if it gives none.
pub const BAG_TOPIC: &str = "bag.topic";

/// The reason for leaving out a message that no record can hold.
pub const TOO_LARGE: &str = "it is larger than a record may be (64 MiB)";

/// Limits of a channel's further data, since it goes into the head of each record: bytes of one entry, entries, bytes
/// of all.
const LONGEST_ABOUT: usize = 8 * 1024;
const MOST_ABOUT: usize = 12;
const MOST_ABOUT_BYTES: usize = 32 * 1024;

/// A channel's further data within the limits, and whether that is all.
pub(super) fn kept_about(all: impl IntoIterator<Item = (Arc<str>, Arc<str>)>) -> (BTreeMap<Arc<str>, Arc<str>>, bool) {
    let (mut kept, mut whole, mut bytes) = (BTreeMap::new(), true, 0);
    for (key, value) in all {
        let size = key.len() + value.len();
        if size <= LONGEST_ABOUT && kept.len() < MOST_ABOUT && bytes + size <= MOST_ABOUT_BYTES {
            bytes += size;
            kept.insert(key, value);
        } else {
            whole = false;
        }
    }
    (kept, whole)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// As in ROS 1.
    Ros1,
    /// CDR, as in ROS 2; the schema is MCAP's `ros2msg` or `ros2idl`.
    Cdr { idl: bool },
    /// No message: MCAP's own bytes of an attachment or metadata.
    Beside(Beside),
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Channel {
    /// As written.
    pub topic: Arc<str>,
    pub type_name: Arc<str>,
    /// 32 hex characters; `*` if the recording has none.
    pub md5sum: Arc<str>,
    pub definition: Arc<str>,
    /// Empty if the recording has none.
    pub caller_id: Arc<str>,
    pub latching: bool,
    pub encoding: Encoding,
    /// Further data, bounded: MCAP's metadata such as the QoS offered, other fields of a bag's connection header.
    /// `latching` is here if it is not `1`, [`BAG_TOPIC`] if a bag's header names another topic or none.
    pub about: BTreeMap<Arc<str>, Arc<str>>,
}

impl Channel {
    /// Topic, type and definition, without a publisher's own data.
    pub(super) fn plain(
        (topic, type_name, definition): (&str, &str, &str),
        encoding: Encoding,
        about: BTreeMap<Arc<str>, Arc<str>>,
    ) -> Self {
        let (topic, type_name, definition) = (topic.into(), type_name.into(), definition.into());
        let (md5sum, caller_id, latching) = ("*".into(), "".into(), false);
        Self { topic, type_name, md5sum, definition, caller_id, latching, encoding, about }
    }

    pub(super) fn size(&self) -> usize {
        let texts = [&self.topic, &self.type_name, &self.md5sum, &self.definition, &self.caller_id];
        let about = self.about.iter().map(|(key, value)| key.len() + value.len());
        texts.iter().map(|text| text.len()).chain(about).sum::<usize>() + 128
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sent {
    pub time: Timestamp,
    pub sequence: u32,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedMessage {
    pub channel: Arc<Channel>,
    pub time: Timestamp,
    /// If the recording says so.
    pub sent: Option<Sent>,
    pub body: Vec<u8>,
}

const MOST_DAMAGES: usize = 64;

/// Further topics share one row without a name.
const MOST_UNUSABLE: usize = 256;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Damage {
    /// Offset in the file, bytes.
    pub position: u64,
    /// The skipped part and the reason, cleaned.
    pub text: String,
}

/// Messages of one topic that cannot be used, for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unusable {
    /// Cleaned; empty if the file does not name it.
    pub topic: String,
    pub why: String,
    pub messages: u64,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Findings {
    /// In order; only the first are listed.
    pub damages: Vec<Damage>,
    /// The number of further ones.
    pub more_damages: u64,
    /// By topic and reason.
    pub unusable: Vec<Unusable>,
    /// Messages, attachments and metadata that no checksum covers: an alteration would not show.
    pub unguarded: u64,
    /// The recorder was killed before it wrote the index: a missing end would not show.
    pub unfinished: bool,
}

impl Findings {
    pub(crate) fn note(&mut self, position: u64, text: &str) {
        if self.damages.len() < MOST_DAMAGES {
            self.damages.push(Damage { position, text: clean(text, 300) });
        } else {
            self.more_damages += 1;
        }
    }

    pub(crate) fn leave_out(&mut self, topic: &str, why: &str) {
        self.leave_out_many(topic, why, 1);
    }

    fn leave_out_many(&mut self, topic: &str, why: &str, messages: u64) {
        let (topic, why) = (clean(topic, 255), clean(why, 200));
        if let Some(row) = self.unusable.iter_mut().find(|row| row.topic == topic && row.why == why) {
            row.messages += messages;
        } else if self.unusable.len() < MOST_UNUSABLE {
            self.unusable.push(Unusable { topic, why, messages });
        } else if let Some(row) = self.unusable.last_mut() {
            let why = String::from("there are too many topics and reasons to list");
            *row = Unusable { topic: String::new(), why, messages: row.messages + messages };
        }
    }

    /// Adds the findings of one file of several.
    pub(crate) fn add(&mut self, name: &str, of_file: &Self) {
        for damage in &of_file.damages {
            self.note(damage.position, &format!("{name}: {}", damage.text));
        }
        self.more_damages += of_file.more_damages;
        for row in &of_file.unusable {
            self.leave_out_many(&row.topic, &row.why, row.messages);
        }
        self.unguarded += of_file.unguarded;
        self.unfinished |= of_file.unfinished;
    }

    pub fn messages_skipped(&self) -> u64 {
        self.unusable.iter().map(|row| row.messages).sum()
    }

    /// Compares the counts of the file's index with the real ones, if nothing else reports a loss.
    pub(crate) fn compare(&mut self, end: u64, what: &str, counted: Option<u64>, met: u64) {
        let Some(counted) = counted.filter(|counted| self.damages.is_empty() && *counted != met) else { return };
        self.note(end, &format!("the file's index counts {counted} {what}, but {met} could be read"));
    }

    pub fn is_whole(&self) -> bool {
        self.damages.is_empty() && self.unusable.is_empty()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Display, EnumString, IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case", parse_err_ty = String, parse_err_fn = not_a_compression)]
pub enum ChunkCompression {
    #[default]
    None,
    Bz2,
    Lz4,
    Zstd,
}

fn not_a_compression(text: &str) -> String {
    format!("'{}' is not a compression; choose none, bz2, lz4 or zstd", clean(text, 40))
}

impl ChunkCompression {
    pub fn word(self) -> &'static str {
        self.into()
    }
}

/// Returns whether a checksum of the compression covered all bytes. At most `limit` bytes come out, memory grows only
/// with them, and `out` keeps them on an error.
pub(crate) fn unpack(
    compression: ChunkCompression,
    source: impl BufRead,
    limit: usize,
    out: &mut Vec<u8>,
) -> Result<bool, String> {
    match compression {
        ChunkCompression::None => drain(source, limit, out).map(|()| false),
        // Every block and the whole have a CRC.
        ChunkCompression::Bz2 => drain(bzip2::bufread::BzDecoder::new(source), limit, out).map(|()| true),
        ChunkCompression::Lz4 => unpack_lz4(source, limit, out),
        ChunkCompression::Zstd => unpack_zstd(source, limit, out),
    }
}

/// Replaces a decoder's own words.
pub(crate) const SPOILT: &str = "its compressed data is damaged";

/// Passes on the disk's own words, but no decoder's.
pub(crate) fn why(error: &std::io::Error) -> String {
    if error.raw_os_error().is_some() { error.to_string() } else { SPOILT.to_owned() }
}

/// The frame's descriptor says which checksums it has; the decoder compares those.
fn unpack_lz4(mut source: impl BufRead, limit: usize, out: &mut Vec<u8>) -> Result<bool, String> {
    /// Magic number (4), then flags: bit 4 for checksums of blocks, bit 2 for one of the content.
    const CHECKSUMS: u8 = 0b0001_0100;
    let mut lead = Vec::with_capacity(5);
    source.by_ref().take(5).read_to_end(&mut lead).map_err(|error| why(&error))?;
    let covered = lead.get(4).is_some_and(|flags| flags & CHECKSUMS != 0);
    drain(lz4_flex::frame::FrameDecoder::new(lead.as_slice().chain(source)), limit, out).map(|()| covered)
}

/// The decoder computes the content's checksum; the caller compares it.
fn unpack_zstd(source: impl BufRead, limit: usize, out: &mut Vec<u8>) -> Result<bool, String> {
    let window = u64::try_from(LARGEST_CHUNK).unwrap_or(u64::MAX);
    let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size(source, window);
    let mut decoder = decoder.map_err(|_| SPOILT)?;
    drain(&mut decoder, limit, out)?;
    let decoder = decoder.into_frame_decoder();
    match decoder.get_checksum_from_data() {
        Some(told) if decoder.get_calculated_checksum() == Some(told) => Ok(true),
        Some(_) => Err(String::from("the unpacked data does not match its zstd checksum")),
        None => Ok(false),
    }
}

/// The start of every zstd frame; no CDR message begins so.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// rosbag2 with `compression_mode: MESSAGE` makes a zstd frame of each message. The record seals the message itself.
pub(crate) fn unpacked_body(encoding: Encoding, body: Vec<u8>) -> Result<Vec<u8>, String> {
    if !matches!(encoding, Encoding::Cdr { .. }) || !body.starts_with(&ZSTD) {
        return Ok(body);
    }
    let mut unpacked = Vec::new();
    unpack(ChunkCompression::Zstd, body.as_slice(), LONGEST_MESSAGE, &mut unpacked)
        .map_err(|error| format!("it is compressed with zstd and cannot be unpacked: {error}"))?;
    Ok(unpacked)
}

fn drain(source: impl Read, limit: usize, out: &mut Vec<u8>) -> Result<(), String> {
    let most = u64::try_from(limit).unwrap_or(u64::MAX).saturating_add(1);
    source.take(most).read_to_end(out).map_err(|error| why(&error))?;
    if out.len() > limit {
        out.truncate(limit);
        return Err(format!("it holds more than the {limit} bytes it claims"));
    }
    Ok(())
}

pub(crate) fn pack(compression: ChunkCompression, bytes: &[u8]) -> Result<Vec<u8>, String> {
    match compression {
        ChunkCompression::None => Ok(bytes.to_vec()),
        ChunkCompression::Bz2 => {
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
            encoder.write_all(bytes).map_err(|error| error.to_string())?;
            encoder.finish().map_err(|error| error.to_string())
        }
        ChunkCompression::Lz4 => {
            // ROS's own reader supports only independent blocks, and requires the checksum of the whole.
            let frame = lz4_flex::frame::FrameInfo::new()
                .block_mode(lz4_flex::frame::BlockMode::Independent)
                .block_size(lz4_flex::frame::BlockSize::Max1MB)
                .content_checksum(true);
            let mut encoder = lz4_flex::frame::FrameEncoder::with_frame_info(frame, Vec::new());
            encoder.write_all(bytes).map_err(|error| error.to_string())?;
            encoder.finish().map_err(|error| error.to_string())
        }
        ChunkCompression::Zstd => {
            Ok(ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest))
        }
    }
}

/// Fewer bytes at the end of the file.
pub(crate) fn read_at(file: &mut (impl BufRead + Seek), at: u64, length: u64) -> std::io::Result<Vec<u8>> {
    go_to(file, at)?;
    let mut bytes = Vec::new();
    file.by_ref().take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Keeps the read-ahead.
pub(crate) fn go_to(file: &mut (impl BufRead + Seek), at: u64) -> std::io::Result<()> {
    let here = file.stream_position()?;
    let step = i64::try_from(at).and_then(|at| i64::try_from(here).map(|here| at - here));
    file.seek_relative(step.unwrap_or(i64::MAX))
}

const BUFFER: usize = 256 * 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum RecordingFormat {
    Bag,
    Mcap,
    /// A folder of rosbag2 with one MCAP file.
    Rosbag2,
}

impl RecordingFormat {
    pub fn word(self) -> &'static str {
        self.into()
    }

    pub fn takes(self, compression: ChunkCompression) -> bool {
        match self {
            Self::Bag => compression != ChunkCompression::Zstd,
            Self::Mcap | Self::Rosbag2 => compression != ChunkCompression::Bz2,
        }
    }

    pub fn holds(self, encoding: Encoding) -> bool {
        match self {
            Self::Mcap => true,
            Self::Bag => encoding == Encoding::Ros1,
            Self::Rosbag2 => encoding != Encoding::Ros1,
        }
    }
}

/// Names a file that is no recording, by its beginning.
fn other_than_a_recording(magic: &[u8]) -> String {
    let version = [&b"#ROSBAG V"[..], b"#ROSRECORD V"].iter().find_map(|lead| magic.strip_prefix(*lead));
    match version {
        Some(version) => {
            let version: Vec<u8> = version.iter().copied().take_while(|byte| !byte.is_ascii_whitespace()).collect();
            let version = crate::model::clean(&String::from_utf8_lossy(&version), 8);
            format!("a bag of version {version}; only 2.0 is supported, convert it with `rosbag fix` of ROS 1")
        }
        None if magic.is_empty() => "an empty file".to_owned(),
        None if magic.starts_with(&[0x1f, 0x8b]) => packed("gzip", "gunzip -k"),
        None if magic.starts_with(b"BZh") => packed("bzip2", "bunzip2 -k"),
        None if magic.starts_with(b"rosbag2_bagfile_") => {
            "the description of a folder of rosbag2; import the folder".to_owned()
        }
        None => "not a recording: neither a bag, MCAP nor .db3".to_owned(),
    }
}

fn packed(format: &str, command: &str) -> String {
    format!("compressed with {format}; unpack it with `{command}` and import what comes out")
}

/// A file at its beginning, and its first bytes.
fn begin(path: &Path) -> Result<(BufReader<File>, Vec<u8>)> {
    let unreadable = |error: std::io::Error| RosError::recording(&format!("{}: {error}", path.display()));
    let mut file = BufReader::with_capacity(BUFFER, File::open(path).map_err(unreadable)?);
    let mut magic = Vec::new();
    file.by_ref().take(16).read_to_end(&mut magic).map_err(unreadable)?;
    file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
    Ok((file, magic))
}

/// The content that identifies a file; unpacked, if it is compressed as a whole: a recorder compresses closed files,
/// which may have been sealed before.
pub fn content_of(path: &Path) -> Result<File> {
    let (file, magic) = begin(path)?;
    let whole = if magic.starts_with(&ZSTD) { unpacked(path).ok() } else { None };
    // The reader of the recording reports a failure to unpack.
    Ok(whole.and_then(|whole| whole.reopen().ok()).unwrap_or_else(|| file.into_inner()))
}

pub trait RecordingReader {
    /// `None` at the end. Damage is not an error: see [`Self::findings`].
    fn next_message(&mut self) -> Result<Option<RecordedMessage>>;

    /// So far; of a folder's open files, later.
    fn findings(&self) -> &Findings;

    /// Bytes read so far, as far as messages have any, and all bytes.
    fn progress(&self) -> (u64, u64);

    /// A folder's file that the last message is from, as `rosbag2::files_of` names it; `None` for a single file.
    fn file(&self) -> Option<&Path> {
        None
    }
}

pub type Recording = dyn RecordingReader + Send;

impl Recording {
    /// A file of any format, or a folder of rosbag2.
    pub fn open(path: &Path) -> Result<Box<Self>> {
        if path.is_dir() { Ok(Box::new(FolderReader::open(path)?)) } else { Self::open_file(path) }
    }

    /// Unpacks a file compressed as a whole into a temporary file, which is deleted at the end.
    pub(crate) fn open_file(path: &Path) -> Result<Box<Self>> {
        let (file, magic) = begin(path)?;
        if !magic.starts_with(&ZSTD) {
            return Self::of(path, file, &magic);
        }
        drop(file);
        let whole = unpacked(path)?;
        let (file, magic) = begin(whole.path())?;
        // It is open by now, so its name is no longer needed.
        Self::of(whole.path(), file, &magic)
    }

    fn of(path: &Path, file: BufReader<File>, magic: &[u8]) -> Result<Box<Self>> {
        if magic.starts_with(mcap::MAGIC) {
            return Ok(Box::new(McapReader::open(file)?));
        }
        if magic.starts_with(bag::MAGIC) {
            return Ok(Box::new(BagReader::open(file)?));
        }
        if magic.starts_with(SQLITE) {
            return Ok(Box::new(Db3Reader::open(path)?));
        }
        Err(RosError::recording(&format!("{} is {}", path.display(), other_than_a_recording(magic))))
    }
}

pub enum RecordingWriter {
    Bag(Box<BagWriter<BufWriter<File>>>),
    Mcap(Box<McapWriter<BufWriter<File>>>),
}

impl RecordingWriter {
    pub fn begin(format: RecordingFormat, compression: ChunkCompression, file: File) -> Result<Self> {
        let out = BufWriter::with_capacity(BUFFER, file);
        Ok(match format {
            RecordingFormat::Bag => Self::Bag(Box::new(BagWriter::begin(out, compression)?)),
            RecordingFormat::Mcap | RecordingFormat::Rosbag2 => {
                Self::Mcap(Box::new(McapWriter::begin(out, compression)?))
            }
        })
    }

    pub fn write(&mut self, channel: &Arc<Channel>, time: Timestamp, sent: Option<Sent>, body: &[u8]) -> Result<()> {
        match (self, sent) {
            (Self::Bag(writer), _) => writer.write(channel, time, body),
            (Self::Mcap(writer), Some(sent)) => writer.write_sent(channel, time, sent, body),
            (Self::Mcap(writer), None) => writer.write(channel, time, body),
        }
    }

    pub fn finish(self) -> Result<()> {
        let out = match self {
            Self::Bag(writer) => writer.finish()?,
            Self::Mcap(writer) => writer.finish()?,
        };
        let file = out.into_inner().map_err(|error| RosError::unwritable(error.into_error()))?;
        file.sync_all().map_err(RosError::unwritable)
    }
}

#[cfg(test)]
mod open_tests {
    use super::*;

    #[test]
    fn other_files_are_named_as_what_they_are() {
        let said = other_than_a_recording(b"#ROSRECORD V1.2\n");
        assert!(said.contains("version 1.2") && said.contains("rosbag fix"), "{said}");
        assert!(other_than_a_recording(b"#ROSBAG V1.1\n").contains("version 1.1"));
        assert_eq!(other_than_a_recording(b""), "an empty file");
        assert_eq!(other_than_a_recording(b"PK\x03\x04"), "not a recording: neither a bag, MCAP nor .db3");
        assert!(other_than_a_recording(&[0x1f, 0x8b, 8]).contains("gunzip"));
        assert!(other_than_a_recording(b"BZh91AY&SY").contains("bunzip2"));
        assert!(other_than_a_recording(b"rosbag2_bagfile_information:").contains("import the folder"));
    }

    #[test]
    fn a_file_compressed_as_a_whole_is_known_by_what_comes_out_of_it() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let path = directory.path().join("run_0.mcap.zstd");
        let level = ruzstd::encoding::CompressionLevel::Fastest;
        let packed = ruzstd::encoding::compress_to_vec(&b"what was recorded"[..], level);
        let cut = packed.get(..packed.len() / 2).expect("its half").to_vec();
        for (bytes, known) in [(packed, b"what was recorded".to_vec()), (cut.clone(), cut)] {
            std::fs::write(&path, bytes).expect("written");
            let mut content = Vec::new();
            content_of(&path).expect("there").read_to_end(&mut content).expect("read");
            assert_eq!(content, known);
        }
    }

    #[test]
    fn a_folder_is_a_recording_only_with_its_description_and_what_it_lacks_is_said() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let said = || Recording::open(directory.path()).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(said().contains("without metadata.yaml") && said().contains("reindex"), "{}", said());
        std::fs::write(directory.path().join("metadata.yaml"), "a: 1").expect("written");
        assert!(said().contains("does not describe a recording"), "{}", said());
        let text = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n  - a.mcap\n  \
                    message_count: 7\n  files:\n  - path: a.mcap\n    message_count: 7\n";
        std::fs::write(directory.path().join("metadata.yaml"), text).expect("written");
        std::fs::write(directory.path().join("b.db3"), "").expect("written");
        let mut recording = Recording::open(directory.path()).expect("opened");
        while recording.next_message().expect("read").is_some() {}
        let told: Vec<_> = recording.findings().damages.iter().map(|damage| damage.text.clone()).collect();
        assert!(told.iter().any(|text| text.contains("b.db3 is in the folder")), "{told:?}");
        assert!(told.iter().any(|text| text.contains("a.mcap was left out (7 messages)")), "{told:?}");
    }
}

#[cfg(test)]
mod altered_tests;
#[cfg(test)]
mod beside_tests;
#[cfg(test)]
mod tests;
