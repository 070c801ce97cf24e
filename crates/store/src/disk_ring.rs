//! The ring that a robot keeps on its disk, of topics that nobody watches: sealed records in files of their own, beside
//! ledger and vault. The oldest file goes when time or size is reached; what goes with it is counted. Nobody reads it
//! until its owner asks for a span.

mod restored;
mod segment;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::{self, File};
use std::io::{ErrorKind, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

pub use self::restored::note_restored;
use self::segment::{MAGIC, Segment};
use crate::model::{Digest, RecorderPrefix, RingLimits, RingSpan, Signature, Timestamp, TopicId};
use crate::store::{StoreError, files};

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
    /// Topic name.
    pub topic: String,
    /// Message type.
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
    /// Messages.
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
    ///
    /// # Errors
    /// [`StoreError::Home`] if the folder cannot be used.
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
        let restored = restored::ages_from(folder, now);
        for (number, path) in segment::list(folder)? {
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
    ///
    /// # Errors
    /// [`StoreError::Home`] if a file cannot be removed.
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
    ///
    /// # Errors
    /// [`StoreError::Home`] if a file cannot be removed.
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

    /// Prepares for a round of about so many bytes: a full file is closed, and room is made. Only then is it known
    /// which definitions have to go with the round.
    ///
    /// # Errors
    /// [`StoreError::Home`], [`StoreError::DiskFull`].
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
    ///
    /// # Errors
    /// [`StoreError::Home`], [`StoreError::DiskFull`]: then none of them is in the ring.
    pub fn append(
        &mut self,
        records: &[(RingRecord, u64, Option<KnownDefinition>, TopicId)],
    ) -> Result<(), StoreError> {
        let mut bytes = Vec::new();
        for (record, number, _, topic) in records {
            segment::put(&mut bytes, record);
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
    ///
    /// # Errors
    /// [`StoreError::Home`] if it cannot be removed.
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
    ///
    /// # Errors
    /// [`StoreError::Home`] if it cannot be read.
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
