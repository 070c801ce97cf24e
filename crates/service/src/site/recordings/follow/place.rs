//! How far a followed file is sealed, kept in the home's ledger, with the digests of all that was read and of each
//! chunk.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, ErrorKind};
use std::ops::Range;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::Path;

use authros_evidence::recorded::RecordedChunk;

use super::folder::is_database;
use crate::crypto::Sm3Hasher;
use crate::crypto::sm3::sm3;
use crate::model::{Address, Digest, clean, counted};
use crate::reply::{Result, input, internal};
use crate::ros::RosError;
use crate::ros::mcap::{MAGIC, McapReader};
use crate::ros::recording::{Findings, RecordedMessage, RecordingReader as _};
use crate::ros::rosbag2::Db3Reader;
use crate::store::Notes;
use crate::store::notes::{FilePlace, FileStanding, Followed, SealedUnderName};

/// Bytes that identify a file. A recorder's first chunk, with its times, begins within them.
const LEAD: usize = 1024;

/// Most files with the same beginning that used one place on the disk.
const MOST_AGAIN: u32 = 64;

pub(super) fn changed(place: &FilePlace, name: &str) -> String {
    let (name, messages) = (clean(name, 80), counted(place.stored.saturating_sub(1), "message"));
    let when = place.ended_at.map(|time| format!(" at {time}")).unwrap_or_default();
    format!(
        "it has changed since it was sealed{when}: what is sealed is {messages}, and {name}.authros proves the file \
             as it was then. If it should not have changed, restore that version from a copy; to seal it as it is now, \
             move {name}.authros away and follow the folder again"
    )
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct FileKey {
    pub note: Followed,
    pub tag: String,
}

/// By inode and first bytes. Not by device number, which may change with a restart of the machine.
fn key_of(owner: Address, inode: u64, lead: &[u8], again: u32) -> FileKey {
    let file = Digest(sm3(&[&inode.to_be_bytes(), &again.to_be_bytes(), lead]));
    FileKey { note: Followed { owner, file }, tag: file.to_hex().chars().take(16).collect() }
}

pub(super) enum Known {
    /// Too short to be identified; may grow.
    TooShort,
    /// New, or resumed; with the last of those that began alike and were here before.
    Here(FileKey, Box<FilePlace>, Option<Box<(FileKey, FilePlace)>>),
    Shrank(Box<FilePlace>),
}

/// Whether a file ends as a recorder ends it.
fn is_closed(file: &File, length: u64) -> bool {
    let mut end = [0; MAGIC.len()];
    let at = length.checked_sub(MAGIC.len() as u64).filter(|at| *at > 0);
    at.is_some_and(|at| file.read_exact_at(&mut end, at).is_ok()) && end == *MAGIC
}

pub(super) fn known(notes: &Notes, owner: Address, file: &File, is_whole: bool) -> Result<Known> {
    let unreadable = |error: std::io::Error| internal(format!("it cannot be read: {error}"));
    let metadata = file.metadata().map_err(unreadable)?;
    if metadata.len() < LEAD as u64 && !is_whole && !is_closed(file, metadata.len()) {
        return Ok(Known::TooShort);
    }
    let mut lead = vec![0; LEAD.min(usize::try_from(metadata.len()).unwrap_or(LEAD))];
    file.read_exact_at(&mut lead, 0).map_err(unreadable)?;
    let mut former = None;
    for again in 0..MOST_AGAIN {
        let key = key_of(owner, metadata.ino(), &lead, again);
        let Some(place) = notes.read(&key.note)? else {
            return Ok(Known::Here(key, Box::default(), former));
        };
        // A file sealed to its end does not go on.
        let is_over = place.standing != FileStanding::Open;
        if is_over && metadata.len() != place.at {
            former = Some(Box::new((key, place)));
            continue;
        }
        if metadata.len() < place.at {
            return Ok(Known::Shrank(Box::new(place)));
        }
        let mut hashed = Hashed::default();
        hashed.advance(file, place.at, Vec::new()).map_err(unreadable)?;
        if place.at == 0 || place.digest == Some(hashed.digest()) {
            return Ok(Known::Here(key, Box::new(place), None));
        }
        former = Some(Box::new((key, place)));
    }
    Err(internal("too many files with the same beginning were at its place"))
}

fn name_of(owner: Address, path: &Path) -> SealedUnderName {
    SealedUnderName { owner, path: Digest(sm3(&[path.as_os_str().as_encoded_bytes()])) }
}

/// Keeps which file was sealed to its end under a name.
pub(super) fn put_name(notes: &Notes, owner: Address, path: &Path, key: &FileKey) -> Result<()> {
    Ok(notes.write(&name_of(owner, path), &key.note.file)?)
}

/// The file sealed to its end under a name.
pub(super) fn sealed_at(notes: &Notes, owner: Address, path: &Path) -> Result<Option<FilePlace>> {
    let Some(file) = notes.read(&name_of(owner, path))? else { return Ok(None) };
    Ok(notes.read(&Followed { owner, file })?)
}

const BLOCK: usize = 256 * 1024;

/// A file hashed up to a place, which resumes there after a failed read.
#[derive(Default)]
pub(super) struct Hashed {
    whole: Sm3Hasher,
    pub at: u64,
    spans: VecDeque<Range<u64>>,
    chunk: Sm3Hasher,
    pub chunks: Vec<RecordedChunk>,
    buffer: Vec<u8>,
}

impl Hashed {
    pub fn digest(&self) -> Digest {
        Digest(self.whole.clone().finish())
    }

    /// `spans`: new chunks that end before `to`, in file order.
    pub fn advance(&mut self, file: &File, to: u64, spans: Vec<Range<u64>>) -> std::io::Result<()> {
        self.spans.extend(spans);
        while let Some(span) = self.spans.front().cloned() {
            self.feed(file, span.start.min(to), false)?;
            self.feed(file, span.end.min(to), true)?;
            if self.at < span.end {
                return Ok(());
            }
            self.spans.pop_front();
            let digest = Digest(std::mem::take(&mut self.chunk).finish());
            self.chunks.push(RecordedChunk { at: span.start, length: span.end - span.start, digest });
        }
        self.feed(file, to, false)
    }

    fn feed(&mut self, file: &File, to: u64, is_chunk: bool) -> std::io::Result<()> {
        self.buffer.resize(BLOCK, 0);
        while self.at < to {
            let wanted = usize::try_from(to - self.at).unwrap_or(BLOCK).min(BLOCK);
            let read = match file.read_at(self.buffer.get_mut(..wanted).unwrap_or_default(), self.at) {
                Ok(0) => return Err(std::io::Error::new(ErrorKind::UnexpectedEof, "it became shorter")),
                Ok(read) => read,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            let bytes = self.buffer.get(..read).unwrap_or_default();
            self.whole.update(bytes);
            if is_chunk {
                self.chunk.update(bytes);
            }
            self.at += read as u64;
        }
        Ok(())
    }
}

const BUFFER: usize = 256 * 1024;

/// Shortest piece of a database with a digest of its own, bytes, and the most pieces.
const PIECE: u64 = 1 << 20;
const MOST_PIECES: u64 = 1 << 16;

pub(super) enum Source {
    Growing(Box<McapReader<BufReader<File>>>),
    /// A `.db3` that nobody writes.
    Closed {
        reader: Box<Db3Reader>,
        is_finished: bool,
        /// Until they are taken.
        pieces: Vec<Range<u64>>,
        /// Its recorder closed it.
        is_complete: bool,
    },
}

impl Source {
    /// `is_followed`: a later file exists, or the recording was closed.
    pub fn open(path: &Path, length: u64, is_followed: bool) -> Result<Self> {
        if is_database(path) {
            let reader = Box::new(Db3Reader::open(path)?);
            return Ok(Self::Closed { reader, is_finished: false, pieces: pieces(length), is_complete: is_followed });
        }
        let file = File::open(path).map_err(|error| input(format!("it cannot be read: {error}")))?;
        Ok(Self::Growing(Box::new(McapReader::follow(BufReader::with_capacity(BUFFER, file))?)))
    }

    /// `None` at the end, or where the next message is incomplete.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage>, RosError> {
        match self {
            Self::Growing(reader) => reader.next_message(),
            Self::Closed { reader, is_finished, .. } => {
                let message = reader.next_message()?;
                *is_finished = message.is_none();
                Ok(message)
            }
        }
    }

    /// The new length, bytes.
    pub fn grown(&mut self, length: u64) {
        if let Self::Growing(reader) = self {
            reader.grown(length);
        }
    }

    /// Nobody writes it any more.
    pub fn close(&mut self) -> Result<(), RosError> {
        match self {
            Self::Growing(reader) => reader.close(),
            Self::Closed { .. } => Ok(()),
        }
    }

    /// Everything was read, and nothing more is expected.
    pub fn is_finished(&self) -> bool {
        match self {
            Self::Growing(reader) => reader.is_finished(),
            Self::Closed { is_finished, .. } => *is_finished,
        }
    }

    /// Its recorder closed it.
    pub fn is_complete(&self) -> bool {
        match self {
            Self::Growing(reader) => reader.has_footer(),
            Self::Closed { is_complete, .. } => *is_complete,
        }
    }

    pub fn at(&self) -> u64 {
        match self {
            Self::Growing(reader) => reader.progress().0,
            Self::Closed { reader, .. } => reader.progress().0,
        }
    }

    /// New chunks since the last call; for a database all its pieces at once.
    pub fn take_chunks(&mut self) -> Vec<Range<u64>> {
        match self {
            Self::Growing(reader) => reader.take_chunks(),
            Self::Closed { pieces, .. } => std::mem::take(pieces),
        }
    }

    pub fn findings(&self) -> &Findings {
        match self {
            Self::Growing(reader) => reader.findings(),
            Self::Closed { reader, .. } => reader.findings(),
        }
    }
}

/// Pieces of a file without chunks, so that the place of a difference can be named.
fn pieces(length: u64) -> Vec<Range<u64>> {
    let size = length.div_ceil(MOST_PIECES).next_multiple_of(PIECE).max(PIECE);
    (0..length.div_ceil(size)).map(|number| number * size..((number + 1) * size).min(length)).collect()
}

#[cfg(test)]
mod tests {
    use crate::crypto::sm3::sm3;
    use std::io::{Seek, SeekFrom, Write};

    use super::*;
    use crate::store::Ledger;

    struct Case {
        _home: tempfile::TempDir,
        ledger: Ledger,
        file: File,
    }

    const OWNER: Address = Address([7; 20]);

    impl Case {
        fn new() -> Self {
            let home = tempfile::tempdir().expect("a folder");
            let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opened");
            let path = home.path().join("run.mcap");
            let file = File::options().create_new(true).read(true).write(true).open(path).expect("created");
            Self { _home: home, ledger, file }
        }

        fn is_too_short(&self) -> bool {
            let length = self.file.metadata().expect("there").len();
            assert!(length < LEAD as u64, "{length}");
            matches!(known(&self.ledger.notes, OWNER, &self.file, false), Ok(Known::TooShort))
        }

        fn write(&mut self, bytes: &[u8]) {
            self.file.seek(SeekFrom::End(0)).and_then(|_| self.file.write_all(bytes)).expect("written");
        }

        fn here(&self) -> (FileKey, Box<FilePlace>, bool) {
            match known(&self.ledger.notes, OWNER, &self.file, false).expect("known") {
                Known::Here(key, place, former) => (key, place, former.is_some()),
                Known::TooShort | Known::Shrank(_) => panic!("it is not here"),
            }
        }

        /// Stores how many bytes were read.
        fn keep(&self, key: &FileKey, at: u64) {
            let mut hashed = Hashed::default();
            hashed.advance(&self.file, at, Vec::new()).expect("read");
            let place = FilePlace { at, stored: 5, begun: 9, digest: Some(hashed.digest()), ..FilePlace::default() };
            self.ledger.notes.write(&key.note, &place).expect("kept");
        }
    }

    #[test]
    fn a_file_goes_on_where_it_was_also_when_it_has_grown() {
        let mut case = Case::new();
        case.write(&[1; 1000]);
        assert!(matches!(known(&case.ledger.notes, OWNER, &case.file, false), Ok(Known::TooShort)));
        assert!(
            matches!(known(&case.ledger.notes, OWNER, &case.file, true), Ok(Known::Here(..))),
            "it is all there is"
        );
        case.write(&[2; 9000]);
        let (key, place, is_another) = case.here();
        assert_eq!((place.stored, is_another, key.tag.len()), (0, false, 16));
        case.keep(&key, 8000);
        case.write(&[3; 100]);
        let (same, place, is_another) = case.here();
        assert_eq!((same, place.stored, place.begun, is_another), (key, 5, 9, false));
    }

    #[test]
    fn what_was_altered_or_cut_off_is_not_taken_for_what_was_sealed() {
        let mut case = Case::new();
        case.write(&[1; 10_000]);
        let (key, ..) = case.here();
        case.keep(&key, 8000);
        case.file.write_all_at(&[9], 7999).expect("altered");
        let (other, place, is_another) = case.here();
        assert!(other != key && place.stored == 0 && is_another, "{place:?}");
        case.keep(&other, 9000);
        case.file.write_all_at(&[1], 7999).expect("as it was");
        assert_eq!(case.here().0, key);
        case.file.set_len(7000).expect("shorter");
        assert!(
            matches!(known(&case.ledger.notes, OWNER, &case.file, false), Ok(Known::Shrank(place)) if place.at == 8000)
        );
    }

    #[test]
    fn what_was_sealed_to_its_end_is_another_file_once_its_length_differs() {
        let mut case = Case::new();
        case.write(&[1; 5_000]);
        let (key, ..) = case.here();
        case.keep(&key, 5_000);
        let place = FilePlace { standing: FileStanding::Proven, ..*case.here().1 };
        case.ledger.notes.write(&key.note, &place).expect("kept");
        assert_eq!(case.here().0, key);
        for length in [5_001, 4_999] {
            case.file.set_len(length).expect("changed");
            let Ok(Known::Here(other, place, Some(former))) = known(&case.ledger.notes, OWNER, &case.file, true) else {
                panic!("{length}")
            };
            assert!(other != key && place.begun == 0 && former.0 == key && former.1.stored == 5, "{length}");
        }
    }

    #[test]
    fn a_short_file_is_waited_for_until_it_is_closed() {
        let mut case = Case::new();
        case.write(MAGIC);
        assert!(case.is_too_short(), "its first bytes are its last ones too");
        case.write(&[1; 300]);
        assert!(case.is_too_short());
        case.write(MAGIC);
        assert!(!case.is_too_short());
    }

    #[test]
    fn chunks_and_the_whole_are_hashed_in_one_pass_wherever_it_stops() {
        let bytes: Vec<u8> = (0..1_000_000_u32).map(|number| number.to_le_bytes()[0]).collect();
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("run.mcap");
        std::fs::write(&path, &bytes).expect("written");
        let file = File::open(&path).expect("open");
        let mut hashed = Hashed::default();
        hashed.advance(&file, 100, Vec::new()).expect("read");
        hashed.advance(&file, 700_000, vec![200..600_000, 600_000..700_000]).expect("read");
        assert_eq!(hashed.digest(), Digest(sm3(&[&bytes[..700_000]])));
        hashed.advance(&file, 1_000_000, std::iter::once(800_000..900_000).collect()).expect("read");
        assert_eq!(hashed.digest(), Digest(sm3(&[&bytes])));
        let found: Vec<_> = hashed.chunks.iter().map(|chunk| (chunk.at, chunk.digest)).collect();
        let expected = [(200, 600_000), (600_000, 700_000), (800_000, 900_000)];
        let expected = expected.map(|(from, to)| (from as u64, Digest(sm3(&[&bytes[from..to]]))));
        assert_eq!(found, expected);
        assert!(hashed.advance(&file, 1_000_001, Vec::new()).is_err(), "a file that is shorter");
    }
}

#[cfg(test)]
mod source_tests {
    use super::*;

    #[test]
    fn the_pieces_of_a_database_cover_it_and_are_not_too_many() {
        for length in [0, 1, PIECE, PIECE + 1, 300 << 30] {
            let pieces = pieces(length);
            assert!(pieces.len() as u64 <= MOST_PIECES, "{length}");
            assert_eq!(pieces.iter().map(|piece| piece.end - piece.start).sum::<u64>(), length);
            assert!(pieces.windows(2).all(|pair| pair[0].end == pair[1].start), "{length}");
        }
    }
}
