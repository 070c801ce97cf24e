//! A robot's ring on disk: sealed records of unwatched topics, until their owner asks for a span. The oldest file is
//! dropped at the limit of time or size, and its messages are counted.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::{self, File};
use std::io::{BufReader, ErrorKind, Read, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Digest, RecorderPrefix, RingLimits, RingSpan, Signature, Timestamp, TopicId};
use crate::{StoreError, files};

/// Files into which time and size are divided.
const PARTS: u32 = 16;
/// In bytes, unless one round is larger.
const LARGEST: u64 = 16 << 20;
/// Between fsyncs: only a power failure loses what came since.
const SYNC_EVERY: Duration = Duration::from_secs(1);
/// Nanoseconds; smaller corrections of the clock are no jump.
const SHORTEST_JUMP: i128 = 5_000_000_000;

/// Lines of count and topic of dropped messages.
const FALLEN: &str = "fallen";

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RingRecord {
    pub digest: Digest,
    /// r || s.
    pub signature: Signature,
    pub topic: String,
    pub type_name: String,
    pub captured_at: Timestamp,
    /// Of a message type.
    pub is_definition: bool,
    pub simulated: bool,
    /// In bytes.
    pub plain_length: u64,
    /// Header, sealed head and sealed body.
    pub blob: Vec<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RingFigures {
    pub messages: u64,
    pub bytes: u64,
    pub since: Option<Timestamp>,
    /// Messages dropped or refused since the ring began.
    pub fallen: u64,
}

pub type KnownDefinition = (TopicId, u64, Digest);

#[derive(Debug)]
pub struct DiskRing {
    folder: PathBuf,
    limits: RingLimits,
    recorder: RecorderPrefix,
    /// The last one is in use if there is a writer.
    segments: BTreeMap<u64, Segment>,
    writer: Option<File>,
    synced: Instant,
    numbers: HashMap<TopicId, u64>,
    /// In the file in use.
    definitions: HashSet<KnownDefinition>,
    fallen: BTreeMap<String, u64>,
    /// The last reading of the clock.
    looked: (Instant, Timestamp),
}

impl DiskRing {
    /// Records in it stay. `recorder` is new for each start, so that no number is given twice even after a power
    /// failure.
    pub fn open(folder: &Path, limits: RingLimits, recorder: RecorderPrefix) -> Result<Self, StoreError> {
        files::private_directory(folder)?;
        let mut ring = Self {
            folder: folder.to_owned(),
            limits,
            recorder,
            segments: BTreeMap::new(),
            writer: None,
            synced: Instant::now(),
            numbers: HashMap::new(),
            definitions: HashSet::new(),
            // An unreadable count starts anew: nothing depends on it.
            fallen: counts(&fs::read_to_string(folder.join(FALLEN)).unwrap_or_default()),
            looked: (Instant::now(), Timestamp::now()),
        };
        let now = ring.looked.1;
        let restored = ages_from(folder, now);
        for (number, path) in list(folder)? {
            let mut segment = Segment::open(path)?;
            let since = restored.filter(|(last, _)| number <= *last);
            segment.moved = since.map(|(_, opened)| segment.last.max(opened));
            ring.segments.insert(number, segment);
        }
        ring.tend(now)?;
        ring.make_room(0)?;
        Ok(ring)
    }

    pub fn set_limits(&mut self, limits: RingLimits) -> Result<(), StoreError> {
        self.limits = limits;
        let now = self.now();
        self.tend(now)?;
        self.make_room(0)
    }

    pub fn recorder(&self) -> RecorderPrefix {
        self.recorder
    }

    pub fn next_number(&self, topic: TopicId) -> u64 {
        self.numbers.get(&topic).map_or(1, |last| last + 1)
    }

    /// Whether the file in use has it.
    pub fn has_definition(&self, definition: &KnownDefinition) -> bool {
        self.writer.is_some() && self.definitions.contains(definition)
    }

    pub fn round_bytes(&self) -> u64 {
        self.limits.bytes / 8
    }

    pub fn is_too_large(&self, length: usize) -> bool {
        length as u64 > self.limits.bytes / 4
    }

    pub fn refuse(&mut self, topic: &str) {
        *self.fallen.entry(topic.to_owned()).or_default() += 1;
    }

    /// The clock's time. A jump since the last reading does not change the age of what the ring holds.
    pub fn now(&mut self) -> Timestamp {
        let (at, now) = (Instant::now(), Timestamp::now());
        let passed = i128::try_from(at.saturating_duration_since(self.looked.0).as_nanos()).unwrap_or(i128::MAX);
        let jump = i128::from(now.0) - i128::from(self.looked.1.0) - passed;
        self.looked = (at, now);
        if jump.abs() >= SHORTEST_JUMP {
            self.jumped(jump, now);
        }
        now
    }

    /// A jump by nanoseconds starts another file.
    fn jumped(&mut self, by: i128, now: Timestamp) {
        self.close();
        for segment in self.segments.values_mut() {
            let moved = (i128::from(segment.ages_from().0) + by).clamp(0, i128::from(now.0));
            segment.moved = u64::try_from(moved).ok().map(Timestamp);
        }
    }

    /// Drops files by age.
    pub fn tend(&mut self, now: Timestamp) -> Result<(), StoreError> {
        let time = u64::try_from(self.limits.time.as_nanos()).unwrap_or(u64::MAX);
        let due = Timestamp(now.0.saturating_sub(time));
        while let Some(oldest) = self.segments.values().next().filter(|oldest| oldest.ages_from() < due) {
            // Messages still to be written are younger.
            if self.writer.is_some() && self.segments.len() == 1 && oldest.messages.is_empty() {
                break;
            }
            self.drop_oldest()?;
        }
        Ok(())
    }

    /// Closes a full file and makes room; only then is it known which definitions the round needs.
    pub fn begin_round(&mut self, incoming: u64, now: Timestamp) -> Result<(), StoreError> {
        self.tend(now)?;
        let part = u64::try_from(self.limits.time.as_nanos() / u128::from(PARTS)).unwrap_or(u64::MAX);
        let most = (self.limits.bytes / u64::from(PARTS)).min(LARGEST);
        let full = |segment: &Segment| {
            !segment.messages.is_empty()
                && (segment.bytes + incoming > most || now.0.saturating_sub(segment.first.0) > part)
        };
        if self.writer.is_some() && self.segments.values().next_back().is_some_and(full) {
            self.close();
        }
        self.make_room(incoming)?;
        if self.writer.is_some() {
            return Ok(());
        }
        let number = self.segments.keys().next_back().map_or(1, |last| last + 1);
        let path = self.folder.join(format!("{number:016}.ring"));
        let mut file = files::open_private(&path)?;
        let begun = file.set_len(0).and_then(|()| file.write_all(&MAGIC));
        begun.map_err(|error| StoreError::home(&path, &error))?;
        self.segments.insert(number, Segment::new(path));
        self.writer = Some(file);
        self.definitions.clear();
        Ok(())
    }

    /// Uses up the numbers even on failure.
    pub fn append(
        &mut self,
        records: &[(RingRecord, u64, Option<KnownDefinition>, TopicId)],
    ) -> Result<(), StoreError> {
        let mut bytes = Vec::new();
        for (record, number, _, topic) in records {
            put(&mut bytes, record);
            let last = self.numbers.entry(*topic).or_default();
            *last = (*last).max(*number);
        }
        let Some((file, segment)) = self.writer.as_mut().zip(self.segments.values_mut().next_back()) else {
            return Err(StoreError::Closed);
        };
        if let Err(error) = file.write_all(&bytes) {
            // Half a record would hide those behind it.
            let undone = file.set_len(segment.bytes).and_then(|()| file.seek(SeekFrom::Start(segment.bytes)).map(drop));
            let failed = StoreError::home(&segment.path, &error);
            if undone.is_err() {
                self.close();
            }
            return Err(failed);
        }
        segment.bytes += bytes.len() as u64;
        for (record, _, definition, _) in records {
            segment.note(record.captured_at, &record.topic, record.is_definition);
            self.definitions.extend(definition);
        }
        // The records are in the ring: a later failure belongs to the next round, which tries again.
        if self.synced.elapsed() >= SYNC_EVERY && file.sync_data().is_ok() {
            self.synced = Instant::now();
        }
        drop(self.make_room(0));
        Ok(())
    }

    /// Drops the oldest file, if any, because the disk is nearly full.
    pub fn shrink(&mut self) -> Result<bool, StoreError> {
        let is_some = !self.segments.is_empty();
        self.drop_oldest()?;
        Ok(is_some)
    }

    /// Files that may contain records of a span, oldest first.
    pub fn parts_of(&self, span: &RingSpan) -> Vec<u64> {
        self.segments.iter().filter(|(_, segment)| segment.overlaps(span)).map(|(number, _)| *number).collect()
    }

    /// A file's records of a span with their definitions; empty if it was dropped meanwhile.
    pub fn select(&self, part: u64, span: &RingSpan) -> Result<Vec<RingRecord>, StoreError> {
        self.segments.get(&part).map_or(Ok(Vec::new()), |segment| segment.select(span))
    }

    pub fn figures(&self) -> RingFigures {
        let filled = || self.segments.values().filter(|segment| !segment.messages.is_empty());
        RingFigures {
            messages: filled().flat_map(|segment| segment.messages.values()).sum(),
            bytes: self.bytes(),
            since: filled().map(|segment| segment.first).min(),
            fallen: self.fallen.values().sum(),
        }
    }

    pub fn fallen(&self) -> &BTreeMap<String, u64> {
        &self.fallen
    }

    fn bytes(&self) -> u64 {
        self.segments.values().map(|segment| segment.bytes).sum()
    }

    fn close(&mut self) {
        // The system still writes what was not synced: only a power failure loses it.
        self.writer = None;
        self.definitions.clear();
    }

    /// Drops the oldest files until `incoming` bytes fit.
    fn make_room(&mut self, incoming: u64) -> Result<(), StoreError> {
        let least = usize::from(self.writer.is_some());
        while self.bytes() + incoming > self.limits.bytes && self.segments.len() > least {
            self.drop_oldest()?;
        }
        Ok(())
    }

    fn drop_oldest(&mut self) -> Result<(), StoreError> {
        if self.segments.len() == 1 {
            self.close();
        }
        let Some(oldest) = self.segments.first_entry() else { return Ok(()) };
        // The file first: on a full disk its space is needed to write the count.
        if let Err(error) = fs::remove_file(&oldest.get().path)
            && error.kind() != ErrorKind::NotFound
        {
            return Err(StoreError::home(&oldest.get().path, &error));
        }
        for (topic, count) in oldest.remove().messages {
            *self.fallen.entry(topic).or_default() += count;
        }
        let text: String = self.fallen.iter().map(|(topic, count)| format!("{count} {topic}\n")).collect();
        // The next drop writes all of it again.
        drop(files::atomic_write(&self.folder.join(FALLEN), text.as_bytes()));
        Ok(())
    }
}

fn counts(text: &str) -> BTreeMap<String, u64> {
    let line = |line: &str| {
        let (count, topic) = line.split_once(' ')?;
        Some((topic.to_owned(), count.parse().ok()?))
    };
    text.lines().filter_map(line).collect()
}

// A file: `0x89 "AuthRin" || 0x01`, then records of `length of the rest (4) || captured (8) || flags (1) || plain
// length (8) || topic || type || digest (32) || signature (64) || blob`, texts behind their length (2). Bytes after the
// last whole record were never completed.

const MAGIC: [u8; 9] = *b"\x89AuthRin\x01";
/// With all fields, bytes.
const LONGEST: u64 = 80 << 20;
/// Length, time, flags and plain length.
const FIXED: usize = 21;
const DEFINITION: u8 = 1;
const SIMULATED: u8 = 2;

#[derive(Debug)]
struct Segment {
    pub path: PathBuf,
    pub bytes: u64,
    pub first: Timestamp,
    pub last: Timestamp,
    /// Replaces the last capture as its age after a jump of the clock.
    pub moved: Option<Timestamp>,
    /// Without definitions.
    pub messages: BTreeMap<String, u64>,
}

struct Beginning {
    length: u64,
    captured_at: Timestamp,
    flags: u8,
    plain_length: u64,
    topic: String,
}

impl Beginning {
    /// Bytes after the topic.
    fn rest(&self) -> u64 {
        self.length.saturating_sub(FIXED as u64 - 4 + 2 + self.topic.len() as u64)
    }

    fn is_definition(&self) -> bool {
        self.flags & DEFINITION != 0
    }
}

impl Segment {
    pub fn new(path: PathBuf) -> Self {
        let (first, last) = (Timestamp(u64::MAX), Timestamp(0));
        Self { path, bytes: MAGIC.len() as u64, first, last, moved: None, messages: BTreeMap::new() }
    }

    /// Cuts off a record that was not completed.
    pub fn open(path: PathBuf) -> Result<Self, StoreError> {
        let file = files::open_private(&path)?;
        let failed = |error: std::io::Error| StoreError::home(&path, &error);
        let length = file.metadata().map_err(failed)?.len();
        let mut reader = BufReader::new(&file);
        let mut segment = Self::new(path.clone());
        let mut magic = [0; MAGIC.len()];
        let is_whole = length >= segment.bytes && reader.read_exact(&mut magic).is_ok();
        let ([name @ .., version], [known_name @ .., known]) = (magic, MAGIC);
        if is_whole && name == known_name && version > known {
            return Err(StoreError::Newer { file: path, found: version.into(), known: known.into() });
        }
        if !is_whole || magic != MAGIC {
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

    pub fn ages_from(&self) -> Timestamp {
        self.moved.unwrap_or(self.last)
    }

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

    pub fn overlaps(&self, span: &RingSpan) -> bool {
        self.first < span.until && self.last >= span.since && self.messages.keys().any(|topic| span.has_topic(topic))
    }

    /// In the order written; a topic's definitions come before its messages.
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

/// `None` if the file does not have the whole record. `left`: bytes left in the file.
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

fn fields(fixed: &[u8]) -> Result<(u64, Timestamp, u8, u64, u16), WireError> {
    let mut fields = Reader::new(fixed);
    let (length, captured_at) = (fields.u32("length")?, Timestamp(fields.u64("time")?));
    Ok((u64::from(length), captured_at, fields.u8("flags")?, fields.u64("plain length")?, fields.u16("topic")?))
}

fn signed(fields: &mut Reader<'_>) -> Result<(String, Digest, Signature), WireError> {
    let (type_name, digest) = (fields.text("type")?, Digest(fields.array("digest")?));
    Ok((type_name, digest, Signature(fields.array("signature")?)))
}

/// `None` if the record is malformed.
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

fn put(out: &mut Vec<u8>, record: &RingRecord) {
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

/// Numbered, oldest first.
fn list(folder: &Path) -> Result<Vec<(u64, PathBuf)>, StoreError> {
    let failed = |error: std::io::Error| StoreError::home(folder, &error);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let is_one = path.extension().is_some_and(|end| end == "ring");
        let number: Option<u64> = path.file_stem().and_then(|stem| stem.to_str()).and_then(|stem| stem.parse().ok());
        // The next file needs a number.
        found.extend(number.filter(|number| is_one && *number < u64::MAX).map(|number| (number, path)));
    }
    found.sort();
    Ok(found)
}

// A restored ring would be dropped by its age on opening, so it ages from the first opening after the restore.

/// The last file number from the backup and, once opened, when.
const RESTORED: &str = "restored";

/// Returns whether the folder has a ring.
pub fn note_restored(folder: &Path) -> Result<bool, StoreError> {
    if !folder.exists() {
        return Ok(false);
    }
    let Some((last, _)) = list(folder)?.pop() else { return Ok(false) };
    files::atomic_write(&folder.join(RESTORED), format!("{last}\n").as_bytes())?;
    Ok(true)
}

/// The last number from the backup, and the time from which files up to it age.
fn ages_from(folder: &Path, now: Timestamp) -> Option<(u64, Timestamp)> {
    let path = folder.join(RESTORED);
    let bytes = fs::read(&path).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    let mut words = text.split_whitespace();
    // If unreadable, everything counts as restored and stays longer.
    let last: u64 = words.next().and_then(|word| word.parse().ok()).unwrap_or(u64::MAX);
    if let Some(opened) = words.next().and_then(|word| word.parse().ok()) {
        // A clock that was ahead then must not keep records for ever.
        return Some((last, Timestamp(opened).min(now)));
    }
    // If this fails, the next opening counts as the first.
    drop(files::atomic_write(&path, format!("{last} {}\n", now.0).as_bytes()));
    Some((last, now))
}
