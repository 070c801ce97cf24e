//! One followed file: read as it grows, sealed in file order, and stated when it has ended.

use std::collections::{BTreeSet, VecDeque};
use std::fs::File;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use authros_evidence::recorded::{RecordedFile, TAG};

use super::super::import::SealedBefore;
use super::super::import::{Choosing, RECORDING};
use super::super::{Claim, Holder};
use super::folder::Waiting;
use super::place::Source;
use super::place::{self, FileKey, Hashed, Known};
use super::{Entry, Follower, beside, folder};
use crate::crypto::sm3::sm3;
use crate::model::{Digest, Timestamp, clean};
use crate::pipeline::Importer;
use crate::reply::{FollowedFile, Result, input};
use crate::ros::mcap::MAGIC;
use crate::ros::recording::{BESIDE, Beside, RecordedMessage};
use crate::store::notes::{FilePlace, FileStanding, Standing as Imported, Standings};

/// Limits of what is sealed before the ledger notes it.
const MOST_MESSAGES: usize = 4_000;
const MOST_BYTES: usize = 32 << 20;

const TICK: Duration = Duration::from_millis(3);

/// Longest wait for the last records of a run that was stopped.
const LAST: Duration = Duration::from_secs(10);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Round {
    Idle,
    /// Messages were sealed; there may be more.
    Moved,
    /// Nothing more is expected of it.
    Ended,
}

pub(super) struct Tape<'a> {
    follower: &'a Follower<'a>,
    pub key: FileKey,
    path: PathBuf,
    file: File,
    reader: Source,
    hashed: Hashed,
    /// How far it is sealed.
    pub place: FilePlace,
    is_kept: bool,
    choosing: Choosing,
    importer: Importer<'a>,
    sealed_before: SealedBefore<'a>,
    /// What imports have sealed of it, alone or with its folder; with the tags of its records, its own included.
    imported: Standings,
    /// An earlier run may have sealed messages up to this one.
    doubt: u64,
    batch: VecDeque<(Option<Arc<str>>, RecordedMessage)>,
    met: u64,
    latest: Option<Timestamp>,
    topics: BTreeSet<String>,
    length: u64,
    grew: Instant,
    pub view: FollowedFile,
    _claim: Claim,
}

impl<'a> Tape<'a> {
    /// Finds where a file continues; `None` if it is too short, `Waiting` while an import seals it.
    pub fn open(follower: &'a Follower<'a>, path: &Path, files: &[PathBuf]) -> Result<Option<Entry<'a>>> {
        let done = |view: FollowedFile| Ok(Some(Entry::ended(path, view, None)));
        let unreadable = |error: std::io::Error| input(format!("it cannot be read: {error}"));
        let (file, ledger) = (File::open(path).map_err(unreadable)?, &follower.recordings.parts.plant.ledger);
        let (length, name) = (file.metadata().map_err(unreadable)?.len(), follower.name_of(path));
        let mut view = FollowedFile { file: name.clone(), ..FollowedFile::default() };
        let (is_database, is_followed) = (folder::is_database(path), folder::is_followed_by(path, files));
        if !is_database && !begins_as_mcap(&file).map_err(unreadable)? {
            view.notes.push("it is not an MCAP file, despite its name: it does not begin as one".to_owned());
            return done(view);
        }
        let owner = follower.owner.address;
        let claim = match follower.recordings.claims.take(owner, &[path.to_owned()], Holder::Follower) {
            Ok(claim) => claim,
            Err((_, Holder::Import)) => return Ok(Some(Entry::Waiting(Waiting::default()))),
            Err((_, Holder::Follower)) => return Ok(Some(Entry::Same)),
        };
        let is_whole = is_database || length >= MAGIC.len() as u64 && is_followed;
        let (key, place, former) = match place::known(&ledger.notes, owner, &file, is_whole)? {
            Known::TooShort => return Ok(None),
            Known::Shrank(place) => {
                view.is_altered = true;
                view.notes.push(shrank(length, place.at));
                return done(view);
            }
            Known::Here(key, place, former) => (key, *place, former),
        };
        if place.standing != FileStanding::Open {
            return Ok(Some(settled(follower, path, (key, place), view)));
        }
        let former = former.map(|former| former.1);
        if place.begun == 0 && altered(follower, path, former, &mut view)? {
            return done(view);
        }
        let reader = match Source::open(path, length, is_followed) {
            Ok(reader) => reader,
            // It is closed, so it will not improve.
            Err(failure) if is_database => {
                view.notes.push(failure.message);
                return done(view);
            }
            Err(failure) => return Err(failure),
        };
        let mut tags = follower.wishes.tags.clone();
        tags.push((RECORDING.to_owned(), key.tag.clone()));
        let sealed_before = SealedBefore::new(follower.reader());
        let importer = follower.importer(tags);
        let mut tape = Self {
            follower,
            path: path.to_owned(),
            file,
            reader,
            hashed: Hashed::default(),
            doubt: place.begun,
            is_kept: true,
            choosing: Choosing::new(&follower.wishes.topics),
            importer,
            sealed_before,
            imported: Standings::default(),
            batch: VecDeque::new(),
            met: 0,
            latest: None,
            topics: BTreeSet::new(),
            length,
            grew: Instant::now(),
            view,
            place: FilePlace { name, chosen: place.chosen || !follower.wishes.topics.is_empty(), ..place },
            key,
            _claim: claim,
        };
        tape.find_import(length)?;
        Ok(Some(Entry::Open(Box::new(tape))))
    }

    /// A file without a writer when first met may have been imported.
    fn find_import(&mut self, length: u64) -> Result<()> {
        let mut tail = [0; 8];
        let unreadable = |error: std::io::Error| input(format!("it cannot be read: {error}"));
        self.file.read_exact_at(&mut tail, length.saturating_sub(8)).map_err(unreadable)?;
        let metadata = self.file.metadata().map_err(unreadable)?;
        self.imported.tags.insert(self.key.tag.clone());
        if tail != *MAGIC && folder::has_writer(metadata.dev(), metadata.ino()) {
            return Ok(());
        }
        let mut hashed = Hashed::default();
        hashed.advance(&self.file, length, Vec::new()).map_err(unreadable)?;
        let Standings { topics, tags } =
            self.follower.recordings.standings(self.follower.owner.address, hashed.digest())?;
        self.imported.topics = topics;
        self.imported.tags.extend(tags);
        Ok(())
    }

    pub fn round(&mut self, files: &[PathBuf]) -> Result<Round> {
        let unreadable = |error: std::io::Error| input(format!("{} cannot be read: {error}", self.view.file));
        let length = self.file.metadata().map_err(unreadable)?.len();
        if length < self.length.max(self.hashed.at) {
            self.view.is_altered = true;
            self.view.notes.push(shrank(length, self.hashed.at));
            return Ok(Round::Ended);
        }
        if length > self.length {
            (self.length, self.grew) = (length, Instant::now());
        }
        self.reader.grown(length);
        if self.batch.is_empty() {
            self.fill()?;
        }
        if !self.batch.is_empty() {
            self.seal()?;
            return Ok(Round::Moved);
        }
        if self.reader.is_finished() {
            self.state()?;
            return Ok(if self.place.standing == FileStanding::Open { Round::Idle } else { Round::Ended });
        }
        if self.place.at != self.hashed.at || !self.is_kept {
            self.keep()?;
        }
        if self.is_abandoned(files) {
            self.reader.close()?;
            return Ok(Round::Moved);
        }
        Ok(Round::Idle)
    }

    /// Not closed, but nobody writes it any more.
    fn is_abandoned(&self, files: &[PathBuf]) -> bool {
        let is_over = self.follower.wishes.until_closed || folder::is_followed_by(&self.path, files);
        let is_written =
            || self.file.metadata().is_ok_and(|metadata| folder::has_writer(metadata.dev(), metadata.ino()));
        is_over && self.grew.elapsed() >= folder::QUIET && !is_written()
    }

    /// Reads the next messages, except those already sealed.
    fn fill(&mut self) -> Result<()> {
        let mut bytes = 0;
        while self.batch.len() < MOST_MESSAGES && bytes < MOST_BYTES && self.follower.goes_on() {
            let Some(message) = self.reader.next_message()? else { break };
            self.met += 1;
            self.view.found += 1;
            self.latest = self.latest.max(Some(message.time));
            let topic = self.choosing.topic(&message);
            if let Some(topic) = topic.as_ref().filter(|topic| !self.topics.contains(&***topic)) {
                self.topics.insert(topic.to_string());
            }
            if self.met <= self.place.stored {
                self.view.already += u64::from(topic.is_some());
                continue;
            }
            bytes += message.body.len();
            self.batch.push_back((topic, message));
        }
        self.hash_to(self.reader.at())
    }

    fn hash_to(&mut self, at: u64) -> Result<()> {
        let spans = self.reader.take_chunks();
        let failed = |error: std::io::Error| input(format!("{} cannot be read: {error}", self.view.file));
        self.hashed.advance(&self.file, at, spans).map_err(failed)
    }

    /// Notes the plan before sealing: up to `begun` may be sealed when this run dies.
    fn begin_to(&mut self, begun: u64) -> Result<()> {
        self.place.begun = self.place.begun.max(begun);
        self.keep()
    }

    fn keep(&mut self) -> Result<()> {
        // What is not reread yet says less than what is kept.
        if self.hashed.at >= self.place.at {
            (self.place.at, self.place.digest) = (self.hashed.at, Some(self.hashed.digest()));
            self.place.chunks = self.hashed.chunks.len() as u64;
        }
        self.follower.recordings.parts.plant.ledger.notes.write(&self.key.note, &self.place)?;
        self.is_kept = true;
        Ok(())
    }

    fn seal(&mut self) -> Result<()> {
        self.begin_to(self.met)?;
        while let Some((topic, message)) = self.batch.front() {
            if !self.follower.goes_on() {
                return Ok(());
            }
            let number = self.met - self.batch.len() as u64 + 1;
            let known = match topic {
                Some(topic) => match self.imported.topics.get(&**topic) {
                    Some(Imported::Whole) => true,
                    None if number > self.doubt => false,
                    Some(Imported::Begun) | None => self.sealed_before.take(topic, message, &self.imported.tags)?,
                },
                None => false,
            };
            match self.batch.pop_front() {
                Some((Some(_), _)) if known => self.view.already += 1,
                Some((Some(topic), message)) => {
                    if !self.importer.take(message, &topic, &|| self.follower.goes_on()) {
                        return Ok(());
                    }
                    self.view.sealed += 1;
                }
                Some((None, _)) | None => {}
            }
        }
        if self.is_stored(|tape| tape.importer.is_acknowledged()) {
            (self.place.stored, self.is_kept) = (self.met, false);
        }
        Ok(())
    }

    /// `false` if this is to end first.
    fn is_stored(&self, is_so: impl Fn(&Self) -> bool) -> bool {
        while !is_so(self) {
            if !self.follower.goes_on() {
                return false;
            }
            std::thread::sleep(TICK);
        }
        true
    }

    /// Seals the statement about the whole file.
    fn state(&mut self) -> Result<()> {
        // A stopped batch is not the end.
        if self.place.stored < self.met {
            return Ok(());
        }
        self.hash_to(self.length)?;
        self.place.closed = self.reader.is_complete();
        let time = *self.place.stated_at.get_or_insert_with(|| self.latest.unwrap_or_else(Timestamp::now));
        self.place.ended_at = self.place.ended_at.or_else(|| Some(Timestamp::now()));
        let stated = RecordedFile {
            name: self.place.name.clone(),
            length: self.hashed.at,
            digest: self.hashed.digest(),
            is_closed: self.place.closed,
            chunks: self.hashed.chunks.clone(),
        };
        let body = stated.to_bytes();
        let statement = Digest(sm3(&[&body]));
        let message = RecordedMessage { channel: Arc::new(Beside::Metadata.channel()), time, sent: None, body };
        self.begin_to(self.met + 1)?;
        let topic: Arc<str> = BESIDE.into();
        if self.met >= self.doubt || !self.sealed_before.take(&topic, &message, &self.imported.tags)? {
            let mut tags = self.follower.wishes.tags.clone();
            tags.extend(
                [(RECORDING, self.key.tag.as_str()), TAG].map(|(key, value)| (key.to_owned(), value.to_owned())),
            );
            let mut importer = self.follower.importer(tags);
            let is_taken = importer.take(message, &topic, &|| self.follower.goes_on());
            if !is_taken || !self.is_stored(|_| importer.is_acknowledged()) {
                return Ok(());
            }
        }
        (self.place.stored, self.place.statement) = (self.met + 1, Some(statement));
        self.place.standing = FileStanding::Stated;
        self.keep()?;
        let (ledger, owner) = (&self.follower.recordings.parts.plant.ledger, self.follower.owner.address);
        place::put_name(&ledger.notes, owner, &self.path, &self.key)?;
        self.note_as_imported(stated.digest)
    }

    /// Leaves nothing for an import of the same file or folder to seal.
    fn note_as_imported(&self, digest: Digest) -> Result<()> {
        let is_whole = !self.place.chosen && self.importer.lost() == 0;
        let standing = if is_whole { Imported::Whole } else { Imported::Begun };
        let (file, tag) = ((self.follower.owner.address, digest), Some(self.key.tag.as_str()));
        self.follower.recordings.add_standings(file, tag, self.topics.iter().cloned(), standing)
    }

    /// Notes the progress at the end of a run. Waits for the sealer while the site goes on: the next import must find
    /// these messages among the records.
    pub fn leave(&mut self) {
        let since = Instant::now();
        let may_wait = || !self.follower.recordings.parts.life.is_stopping() && since.elapsed() < LAST;
        while !self.importer.is_acknowledged() && may_wait() {
            std::thread::sleep(TICK);
        }
        if !self.is_kept && self.batch.is_empty() {
            // The next run finds the rest among the records.
            drop(self.keep());
        }
    }

    pub fn report(&self) -> FollowedFile {
        let (findings, mut view) = (self.reader.findings(), self.view.clone());
        view.bytes = self.hashed.at;
        view.found += findings.messages_skipped();
        view.lost = self.importer.lost();
        view.left_out = self.choosing.left_out(findings);
        view.skipped = view.left_out.iter().map(|row| row.messages).sum();
        view.damages.clone_from(&findings.damages);
        view.more_damages = findings.more_damages;
        view.chunks = self.hashed.chunks.len() as u64;
        let has_ended = self.place.standing != FileStanding::Open;
        view.digest = self.place.digest.filter(|_| has_ended);
        view.is_closed = has_ended && self.place.closed;
        view
    }
}

/// Notes that another state of the file was sealed; `true` if its proof is of that one, so that this one is not sealed.
fn altered(follower: &Follower<'_>, path: &Path, former: Option<FilePlace>, view: &mut FollowedFile) -> Result<bool> {
    view.is_altered = former.is_some();
    let named = place::sealed_at(&follower.recordings.parts.plant.ledger.notes, follower.owner.address, path)?;
    let sealed = named.or(former.filter(|place| place.standing != FileStanding::Open));
    // Without its proof, another file may well have its name.
    let proven = sealed.filter(|_| beside(path).symlink_metadata().is_ok());
    view.is_altered |= proven.is_some();
    let note = match &proven {
        Some(place) => place::changed(place, &view.file),
        None => "its place on the disk held what was sealed before and is altered now, or another file that began alike: it is \
                 sealed from its beginning"
            .to_owned(),
    };
    view.notes.extend(Some(note).filter(|_| view.is_altered));
    Ok(proven.is_some())
}

/// A file that an earlier run completed.
fn settled<'a>(
    follower: &Follower<'a>,
    path: &Path,
    (key, place): (FileKey, FilePlace),
    mut view: FollowedFile,
) -> Entry<'a> {
    let messages = place.stored.saturating_sub(1);
    (view.bytes, view.found, view.already) = (place.at, messages, messages);
    (view.chunks, view.digest, view.is_closed) = (place.chunks, place.digest, place.closed);
    if place.standing == FileStanding::Stated {
        follower.prove(&key, &place, path);
    } else {
        view.proof = Some(clean(&beside(path).display().to_string(), 300));
    }
    Entry::ended(path, view, Some(place))
}

/// As far as there are bytes.
fn begins_as_mcap(file: &File) -> std::io::Result<bool> {
    let mut begin = [0; MAGIC.len()];
    let read = file.read_at(&mut begin, 0)?;
    let begin = begin.get(..read).unwrap_or_default();
    // Space reserved before anything is written.
    Ok(MAGIC.starts_with(begin) || begin.iter().all(|byte| *byte == 0))
}

fn shrank(length: u64, sealed: u64) -> String {
    clean(
        &format!(
            "it has only {length} bytes left of the {sealed} that were read: what was sealed stays sealed, and it is \
             not followed any further"
        ),
        300,
    )
}
