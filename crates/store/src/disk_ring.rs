//! The ring that a robot keeps on its disk, of topics that nobody watches: sealed records in files of their own, beside
//! the store. The oldest file goes when time or size is reached; what goes with it is counted. Nobody reads it
//! until its owner asks for a span.

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

/// Into how many files time and size are divided.
const PARTS: u32 = 16;
/// The largest file, bytes, unless one round is larger.
const LARGEST: u64 = 16 << 20;
/// Between two fsyncs: a process that is killed loses nothing, a machine without power what came since.
const SYNC_EVERY: Duration = Duration::from_secs(1);
/// Nanoseconds; what a clock gains or loses less than that at once is no jump.
const SHORTEST_JUMP: i128 = 5_000_000_000;

/// The file with what fell out: lines of count and topic.
const FALLEN: &str = "fallen";

/// A record of a ring.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RingRecord {
    /// SM3 of its bytes.
    pub digest: Digest,
    /// The raw signature, r || s.
    pub signature: Signature,
    pub topic: String,
    pub type_name: String,
    /// When it was captured.
    pub captured_at: Timestamp,
    /// Whether it is the definition of a message type, not a message.
    pub is_definition: bool,
    /// Whether a simulated robot sent it.
    pub simulated: bool,
    /// Length of the plaintext, bytes.
    pub plain_length: u64,
    /// Header, sealed head and sealed body.
    pub blob: Vec<u8>,
}

/// What a ring holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RingFigures {
    pub messages: u64,
    /// Bytes on the disk.
    pub bytes: u64,
    /// Capture of the oldest message.
    pub since: Option<Timestamp>,
    /// Messages that fell out, or were too large, since the ring was begun.
    pub fallen: u64,
}

/// A definition that the file in use has.
pub type KnownDefinition = (TopicId, u64, Digest);

/// A ring on the disk.
#[derive(Debug)]
pub struct DiskRing {
    folder: PathBuf,
    limits: RingLimits,
    recorder: RecorderPrefix,
    /// By number; the last one is in use if there is a writer.
    segments: BTreeMap<u64, Segment>,
    writer: Option<File>,
    synced: Instant,
    /// The last number of each topic.
    numbers: HashMap<TopicId, u64>,
    /// The definitions in the file in use.
    definitions: HashSet<KnownDefinition>,
    /// Messages that are gone, by topic.
    fallen: BTreeMap<String, u64>,
    /// When the clock was last looked at, and what it said.
    looked: (Instant, Timestamp),
}

impl DiskRing {
    /// Opens the ring of a folder, or begins one. What is in it stays; new records are of `recorder`, which is new for
    /// each start: so no number is given twice, whatever was lost with the power.
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
            // What cannot be read begins anew: it is a count of what is gone, and nothing rests on it.
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

    /// How much it keeps from now on; what is too much falls out.
    pub fn set_limits(&mut self, limits: RingLimits) -> Result<(), StoreError> {
        self.limits = limits;
        let now = self.now();
        self.tend(now)?;
        self.make_room(0)
    }

    /// The recorder of what is added.
    pub fn recorder(&self) -> RecorderPrefix {
        self.recorder
    }

    /// The next number of a topic.
    pub fn next_number(&self, topic: TopicId) -> u64 {
        self.numbers.get(&topic).map_or(1, |last| last + 1)
    }

    /// Whether the file in use has this definition already.
    pub fn has_definition(&self, definition: &KnownDefinition) -> bool {
        self.writer.is_some() && self.definitions.contains(definition)
    }

    /// The most bytes of a round, unless it is a single message.
    pub fn round_bytes(&self) -> u64 {
        self.limits.bytes / 8
    }

    /// Whether a message of this length is too large for the ring.
    pub fn is_too_large(&self, length: usize) -> bool {
        length as u64 > self.limits.bytes / 4
    }

    /// Counts a message that was not taken in.
    pub fn refuse(&mut self, topic: &str) {
        *self.fallen.entry(topic.to_owned()).or_default() += 1;
    }

    /// The time by this machine's clock. If that has jumped since it was last looked at, what is in the ring is no older and
    /// no younger for it.
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

    /// The clock gained or lost so many nanoseconds at once and says `now`. From here on there is another file.
    fn jumped(&mut self, by: i128, now: Timestamp) {
        self.close();
        for segment in self.segments.values_mut() {
            let moved = (i128::from(segment.ages_from().0) + by).clamp(0, i128::from(now.0));
            segment.moved = u64::try_from(moved).ok().map(Timestamp);
        }
    }

    /// What falls out by its age falls out.
    pub fn tend(&mut self, now: Timestamp) -> Result<(), StoreError> {
        let time = u64::try_from(self.limits.time.as_nanos()).unwrap_or(u64::MAX);
        let due = Timestamp(now.0.saturating_sub(time));
        while let Some(oldest) = self.segments.values().next().filter(|oldest| oldest.ages_from() < due) {
            // Nothing of a file is older than the messages that are not in it yet.
            if self.writer.is_some() && self.segments.len() == 1 && oldest.messages.is_empty() {
                break;
            }
            self.drop_oldest()?;
        }
        Ok(())
    }

    /// Prepares for a round of about this many bytes: a full file is closed, and room is made. Only then is it known
    /// which definitions have to go with the round.
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
        if self.writer.is_none() {
            self.begin_file()?;
        }
        Ok(())
    }

    /// Adds records. Their numbers are used up in any case.
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
        // They are in the ring now. What fails from here on is tried again with the next round, and is that one's error.
        if self.synced.elapsed() >= SYNC_EVERY && file.sync_data().is_ok() {
            self.synced = Instant::now();
        }
        drop(self.make_room(0));
        Ok(())
    }

    /// Drops the oldest file although nothing is due: the disk is nearly full. Returns whether there was one.
    pub fn shrink(&mut self) -> Result<bool, StoreError> {
        let is_some = !self.segments.is_empty();
        self.drop_oldest()?;
        Ok(is_some)
    }

    /// The files in which something of a span may be, the oldest first.
    pub fn parts_of(&self, span: &RingSpan) -> Vec<u64> {
        self.segments.iter().filter(|(_, segment)| segment.overlaps(span)).map(|(number, _)| *number).collect()
    }

    /// What one file has of a span, with the definitions needed; nothing if it has fallen out meanwhile.
    pub fn select(&self, part: u64, span: &RingSpan) -> Result<Vec<RingRecord>, StoreError> {
        self.segments.get(&part).map_or(Ok(Vec::new()), |segment| segment.select(span))
    }

    /// What it holds, and what it has lost.
    pub fn figures(&self) -> RingFigures {
        let filled = || self.segments.values().filter(|segment| !segment.messages.is_empty());
        RingFigures {
            messages: filled().flat_map(|segment| segment.messages.values()).sum(),
            bytes: self.bytes(),
            since: filled().map(|segment| segment.first).min(),
            fallen: self.fallen.values().sum(),
        }
    }

    /// Messages that fell out, by topic.
    pub fn fallen(&self) -> &BTreeMap<String, u64> {
        &self.fallen
    }

    fn bytes(&self) -> u64 {
        self.segments.values().map(|segment| segment.bytes).sum()
    }

    fn close(&mut self) {
        // What is not on the disk yet is in the system's memory: only a machine without power loses it.
        self.writer = None;
        self.definitions.clear();
    }

    fn begin_file(&mut self) -> Result<(), StoreError> {
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

    /// The oldest files fall out until so many more bytes fit.
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
        // The file before its count: on a full disk nothing can be written until it is gone.
        match fs::remove_file(&oldest.get().path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(StoreError::home(&oldest.get().path, &error));
            }
            Ok(()) | Err(_) => {}
        }
        for (topic, count) in oldest.remove().messages {
            *self.fallen.entry(topic).or_default() += count;
        }
        let text: String = self.fallen.iter().map(|(topic, count)| format!("{count} {topic}\n")).collect();
        // The next file that falls out writes all of it again.
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

// A file of a ring: `0x89 "AuthRin" || 0x01`, then records. A record is `length of the rest (4) || captured (8) || 0, 1
// for a definition, 2 if simulated (1) || plain length (8) || topic || type || digest (32) || signature (64) || blob`,
// texts with their length (2) before them. What follows the last whole record was never written to its end.

/// First bytes of a file.
const MAGIC: [u8; 9] = *b"\x89AuthRin\x01";
/// The longest record with what is noted beside it, bytes.
const LONGEST: u64 = 80 << 20;
/// Length, time, flags and plain length.
const FIXED: usize = 21;
/// Bit of a definition, and of a simulated robot's message.
const DEFINITION: u8 = 1;
const SIMULATED: u8 = 2;

/// What is known of a file.
#[derive(Debug)]
struct Segment {
    pub path: PathBuf,
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
    pub fn new(path: PathBuf) -> Self {
        let (first, last) = (Timestamp(u64::MAX), Timestamp(0));
        Self { path, bytes: MAGIC.len() as u64, first, last, moved: None, messages: BTreeMap::new() }
    }

    /// What is in a file; what was not written to its end is cut off.
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

/// The files of a folder with their numbers, the oldest first.
fn list(folder: &Path) -> Result<Vec<(u64, PathBuf)>, StoreError> {
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

// A ring that came out of a backup: what is in it was captured before, and would fall out by its age the moment it is
// opened. It ages from the first opening after that instead: there is as much time to ask for it as its limits say.

/// The file that says so: the last number of the files that came out of the backup, and, once the ring was opened, when.
const RESTORED: &str = "restored";

/// Notes that all files of a ring come out of a backup; returns whether there is one.
pub fn note_restored(folder: &Path) -> Result<bool, StoreError> {
    if !folder.exists() {
        return Ok(false);
    }
    let Some((last, _)) = list(folder)?.pop() else { return Ok(false) };
    files::atomic_write(&folder.join(RESTORED), format!("{last}\n").as_bytes())?;
    Ok(true)
}

/// The last number that came out of a backup, and from when on all up to it age, where later than their capture.
fn ages_from(folder: &Path, now: Timestamp) -> Option<(u64, Timestamp)> {
    let path = folder.join(RESTORED);
    let bytes = fs::read(&path).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    let mut words = text.split_whitespace();
    // If that cannot be read, all that is there came out of the backup: it stays longer, nothing is lost.
    let last: u64 = words.next().and_then(|word| word.parse().ok()).unwrap_or(u64::MAX);
    if let Some(opened) = words.next().and_then(|word| word.parse().ok()) {
        // A clock that was ahead then, and is set right now, keeps nothing for ever.
        return Some((last, Timestamp(opened).min(now)));
    }
    // Without this line the next opening counts as the first: they stay longer, nothing is lost.
    drop(files::atomic_write(&path, format!("{last} {}\n", now.0).as_bytes()));
    Some((last, now))
}
