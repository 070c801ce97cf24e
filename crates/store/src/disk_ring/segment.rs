//! A file of a ring: `0x89 "AuthRin" || 0x01`, then records. A record is `length of the rest (4) || captured (8) || 0, 1
//! for a definition, 2 if simulated (1) || plain length (8) || topic || type || digest (32) || signature (64) || blob`,
//! texts with their length (2) before them. What follows the last whole record was never written to its end.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use super::RingRecord;
use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Digest, RingSpan, Signature, Timestamp};
use crate::store::{StoreError, files};

/// First bytes of a file.
pub(super) const MAGIC: [u8; 9] = *b"\x89AuthRin\x01";
/// The longest record with what is noted beside it, bytes.
const LONGEST: u64 = 80 << 20;
/// Length, time, flags and plain length.
const FIXED: usize = 21;
/// Bit of a definition, and of a simulated robot's message.
const DEFINITION: u8 = 1;
const SIMULATED: u8 = 2;

/// What is known of a file.
#[derive(Debug)]
pub(super) struct Segment {
    pub path: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// Capture of its first and last record.
    pub first: Timestamp,
    pub last: Timestamp,
    /// From when on it ages in place of its last capture, because the clock has jumped since.
    pub moved: Option<Timestamp>,
    /// Messages of each topic, without definitions.
    pub messages: BTreeMap<String, u64>,
}

/// The beginning of a record in a file.
struct Beginning {
    length: u64,
    captured_at: Timestamp,
    flags: u8,
    plain_length: u64,
    topic: String,
}

impl Beginning {
    /// Bytes of the record behind its topic.
    fn rest(&self) -> u64 {
        self.length.saturating_sub(FIXED as u64 - 4 + 2 + self.topic.len() as u64)
    }

    fn is_definition(&self) -> bool {
        self.flags & DEFINITION != 0
    }
}

impl Segment {
    /// An empty one.
    pub fn new(path: PathBuf) -> Self {
        let (first, last) = (Timestamp(u64::MAX), Timestamp(0));
        Self { path, bytes: MAGIC.len() as u64, first, last, moved: None, messages: BTreeMap::new() }
    }

    /// What is in a file; what was not written to its end is cut off.
    ///
    /// # Errors
    /// [`StoreError::Home`] if it cannot be read or cut.
    pub fn open(path: PathBuf) -> Result<Self, StoreError> {
        let file = files::open_private(&path)?;
        let failed = |error: std::io::Error| StoreError::home(&path, &error);
        let length = file.metadata().map_err(failed)?.len();
        let mut reader = BufReader::new(&file);
        let mut segment = Self::new(path.clone());
        let mut magic = [0; MAGIC.len()];
        if length < segment.bytes || reader.read_exact(&mut magic).is_err() || magic != MAGIC {
            segment.bytes = 0;
        }
        while segment.bytes > 0 && segment.bytes < length {
            let Some(beginning) = beginning(&mut reader, length - segment.bytes).map_err(failed)? else { break };
            reader.seek_relative(i64::try_from(beginning.rest()).unwrap_or(i64::MAX)).map_err(failed)?;
            segment.bytes += 4 + beginning.length;
            segment.note(beginning.captured_at, &beginning.topic, beginning.is_definition());
        }
        if segment.bytes < length {
            file.set_len(segment.bytes).map_err(failed)?;
        }
        Ok(segment)
    }

    /// From when on it ages.
    pub fn ages_from(&self) -> Timestamp {
        self.moved.unwrap_or(self.last)
    }

    /// Counts a record that is in the file now.
    pub fn note(&mut self, captured_at: Timestamp, topic: &str, is_definition: bool) {
        if is_definition {
            return;
        }
        self.first = self.first.min(captured_at);
        self.last = self.last.max(captured_at);
        match self.messages.get_mut(topic) {
            Some(count) => *count += 1,
            None => drop(self.messages.insert(topic.to_owned(), 1)),
        }
    }

    /// Whether something in it may be of a span.
    pub fn overlaps(&self, span: &RingSpan) -> bool {
        self.first < span.until && self.last >= span.since && self.messages.keys().any(|topic| span.has_topic(topic))
    }

    /// The records of a span, in the order written; a topic's definitions go before them.
    ///
    /// # Errors
    /// [`StoreError::Home`] if it cannot be read.
    pub fn select(&self, span: &RingSpan) -> Result<Vec<RingRecord>, StoreError> {
        let file = files::read_private(&self.path)?;
        let failed = |error: std::io::Error| StoreError::home(&self.path, &error);
        let mut reader = BufReader::new(&file);
        reader.seek(SeekFrom::Start(MAGIC.len() as u64)).map_err(failed)?;
        let (mut at, mut found, mut definitions) = (MAGIC.len() as u64, Vec::new(), Vec::<RingRecord>::new());
        while at < self.bytes {
            let Some(beginning) = beginning(&mut reader, self.bytes - at).map_err(failed)? else { break };
            at += 4 + beginning.length;
            let (topic, rest) = (beginning.topic.clone(), beginning.rest());
            if beginning.is_definition() && span.has_topic(&topic) {
                definitions.extend(read(&mut reader, beginning).map_err(failed)?);
            } else if !beginning.is_definition() && span.has(&topic, beginning.captured_at) {
                found.extend(definitions.extract_if(.., |definition| definition.topic == topic));
                found.extend(read(&mut reader, beginning).map_err(failed)?);
            } else {
                reader.seek_relative(i64::try_from(rest).unwrap_or(i64::MAX)).map_err(failed)?;
            }
        }
        Ok(found)
    }
}

/// The beginning of the next record; `None` if the file does not hold all of it. `left` = bytes left in the file.
fn beginning(reader: &mut BufReader<&File>, left: u64) -> std::io::Result<Option<Beginning>> {
    let mut fixed = [0; FIXED + 2];
    if left < fixed.len() as u64 {
        return Ok(None);
    }
    reader.read_exact(&mut fixed)?;
    let Ok((length, captured_at, flags, plain_length, topic_length)) = fields(&fixed) else { return Ok(None) };
    let whole = FIXED as u64 - 4 + 2 + u64::from(topic_length);
    if length > LONGEST || length < whole || left < 4 + length {
        return Ok(None);
    }
    let mut topic = vec![0; usize::from(topic_length)];
    reader.read_exact(&mut topic)?;
    let Ok(topic) = String::from_utf8(topic) else { return Ok(None) };
    Ok(Some(Beginning { length, captured_at, flags, plain_length, topic }))
}

/// Length, time, flags, plain length and length of the topic.
fn fields(fixed: &[u8]) -> Result<(u64, Timestamp, u8, u64, u16), WireError> {
    let mut fields = Reader::new(fixed);
    let (length, captured_at) = (fields.u32("length")?, Timestamp(fields.u64("time")?));
    Ok((u64::from(length), captured_at, fields.u8("flags")?, fields.u64("plain length")?, fields.u16("topic")?))
}

/// Type, digest and signature.
fn signed(fields: &mut Reader<'_>) -> Result<(String, Digest, Signature), WireError> {
    let (type_name, digest) = (fields.text("type")?, Digest(fields.array("digest")?));
    Ok((type_name, digest, Signature(fields.array("signature")?)))
}

/// The rest of a record; `None` if it is malformed.
fn read(reader: &mut BufReader<&File>, beginning: Beginning) -> std::io::Result<Option<RingRecord>> {
    let mut rest = vec![0; usize::try_from(beginning.rest()).unwrap_or(0)];
    reader.read_exact(&mut rest)?;
    let mut fields = Reader::new(&rest);
    let Ok((type_name, digest, signature)) = signed(&mut fields) else { return Ok(None) };
    Ok(Some(RingRecord {
        digest,
        signature,
        type_name,
        captured_at: beginning.captured_at,
        is_definition: beginning.is_definition(),
        simulated: beginning.flags & SIMULATED != 0,
        plain_length: beginning.plain_length,
        blob: fields.rest().to_vec(),
        topic: beginning.topic,
    }))
}

/// Appends a record's bytes.
pub(super) fn put(out: &mut Vec<u8>, record: &RingRecord) {
    let begun = out.len();
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(&record.captured_at.0.to_be_bytes());
    let flag = |is: bool, bit: u8| if is { bit } else { 0 };
    out.push(flag(record.is_definition, DEFINITION) | flag(record.simulated, SIMULATED));
    out.extend_from_slice(&record.plain_length.to_be_bytes());
    put_text(out, &record.topic);
    put_text(out, &record.type_name);
    out.extend_from_slice(&record.digest.0);
    out.extend_from_slice(&record.signature.0);
    out.extend_from_slice(&record.blob);
    let length = u32::try_from(out.len() - begun - 4).unwrap_or(u32::MAX).to_be_bytes();
    out.iter_mut().skip(begun).zip(length).for_each(|(place, byte)| *place = byte);
}

/// The files of a folder with their numbers, the oldest first.
///
/// # Errors
/// [`StoreError::Home`] if it cannot be listed.
pub(super) fn list(folder: &Path) -> Result<Vec<(u64, PathBuf)>, StoreError> {
    let failed = |error: std::io::Error| StoreError::home(folder, &error);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let is_one = path.extension().is_some_and(|end| end == "ring");
        let number: Option<u64> = path.file_stem().and_then(|stem| stem.to_str()).and_then(|stem| stem.parse().ok());
        // The last number has none behind it for the next file.
        found.extend(number.filter(|number| is_one && *number < u64::MAX).map(|number| (number, path)));
    }
    found.sort();
    Ok(found)
}
