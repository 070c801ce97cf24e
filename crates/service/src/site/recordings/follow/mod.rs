//! A folder whose recordings are sealed while a recorder writes them (decision 019). Files are only read. The ledger
//! keeps how far each is sealed, before and after the records of a round: after a crash, the messages in doubt are
//! searched among the records.

mod folder;
mod place;
mod tape;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use authros_evidence::Bundle;
use authros_evidence::recorded::TAG;
use tokio::sync::{mpsc, oneshot};

use self::folder::{Folder, Look, QUIET, Stamp, Waiting};
use self::place::{FileKey, Hashed, Known};
use self::tape::{Round, Tape};
use super::Run;
use super::import::at;
use super::import::{MOST_TAGS, RECORDING};
use crate::command::{EvidenceWishes, FollowWishes};
use crate::crypto::sm3::sm3;
use crate::model::{Address, Digest, ErrorKind, RecordKind, RecordState, Timestamp, clean, counted};
use crate::pipeline::{CaptureSession, Importer, Network, Owner, Reader};
use crate::reply::{AGAIN, Failure, FollowView, FollowedFile, NoticeLevel, Result, input, refused};
use crate::ros::recording::BESIDE;
use crate::site::{Recordings, blocking};
use crate::store::notes::{FilePlace, FileStanding};
use crate::store::{Notes, RecordRow};

const LOOK: Duration = Duration::from_millis(250);

const PROVING: Duration = Duration::from_millis(500);

/// The tag of a file's records if it was followed.
pub(super) fn followed_as(notes: &Notes, owner: Address, path: &Path) -> Result<Option<String>> {
    let file = File::open(path).map_err(|error| input(format!("{} cannot be read: {error}", path.display())))?;
    Ok(match place::known(notes, owner, &file, true)? {
        Known::Here(key, place, _) if place.begun > 0 => Some(key.tag),
        // What it was before it was altered.
        Known::Here(_, _, former) => former.map(|former| former.0.tag),
        Known::TooShort | Known::Shrank(_) => None,
    })
}

/// What all files of a folder need.
struct Follower<'a> {
    recordings: &'a Recordings,
    owner: &'a Arc<Owner>,
    network: &'a Network,
    wishes: &'a FollowWishes,
    control: &'a CaptureSession,
    /// Takes the proofs to be written.
    due: mpsc::UnboundedSender<Due>,
}

impl<'a> Follower<'a> {
    fn goes_on(&self) -> bool {
        !self.control.is_closed() && !self.recordings.parts.life.is_stopping()
    }

    fn reader(&self) -> Reader<'a> {
        Reader { plant: &self.recordings.parts.plant, network: self.network, reader: self.owner }
    }

    fn importer(&self, tags: Vec<(String, String)>) -> Importer<'a> {
        let (author, rules) = (Arc::clone(&self.owner.author), &self.recordings.parts.config.topic_rules);
        Importer::new(&self.recordings.rings, author, rules, tags).unfollowed()
    }

    fn name_of(&self, path: &Path) -> String {
        clean(&path.strip_prefix(&self.wishes.folder).unwrap_or(path).display().to_string(), 300)
    }

    fn tell(&self, level: NoticeLevel, text: &str) {
        self.recordings.parts.hub.notice(level, text);
    }

    /// Reports a problem with a file.
    fn warn(&self, name: &str, text: &str) {
        self.tell(NoticeLevel::Warning, &format!("{name}: {text}"));
    }
}

enum Entry<'a> {
    /// A database that its recorder may still write, or a file that an import seals now.
    Waiting(Waiting),
    Open(Box<Tape<'a>>),
    /// Another name of a followed file.
    Same,
    Ended(Box<Ended>),
}

/// A file sealed to its end, or one that cannot be followed.
struct Ended {
    file: FollowedFile,
    /// If it is sealed to its end.
    place: Option<FilePlace>,
    stamp: Option<Stamp>,
}

impl Entry<'_> {
    fn ended(path: &Path, file: FollowedFile, place: Option<FilePlace>) -> Self {
        Self::Ended(Box::new(Ended { file, place, stamp: Stamp::of(path) }))
    }
}

impl Ended {
    /// Checks whether it was written since, and still is what was sealed; what to say if not.
    fn look(&mut self, path: &Path) -> Option<String> {
        let place = self.place.as_ref().filter(|_| !self.file.is_altered)?;
        let stamp = Stamp::of(path).filter(|stamp| self.stamp != Some(*stamp))?;
        let (file, mut hashed) = (File::open(path).ok()?, Hashed::default());
        hashed.advance(&file, file.metadata().ok()?.len(), Vec::new()).ok()?;
        self.stamp = Some(stamp);
        if place.digest == Some(hashed.digest()) {
            return None;
        }
        let note = place::changed(place, &self.file.file);
        self.file.is_altered = true;
        self.file.notes.push(note.clone());
        Some(note)
    }
}

impl Recordings {
    /// Seals what is recorded into a folder, until it is closed, this is stopped, or the client has gone.
    pub async fn follow(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        wishes: FollowWishes,
        gone: oneshot::Receiver<()>,
    ) -> Result<FollowView> {
        if wishes.tags.len() > MOST_TAGS - 1 {
            return Err(input(format!("what is followed can have at most {most} tags", most = MOST_TAGS - 1)));
        }
        if owner.sealing().is_none() {
            self.profiles.register(owner).await?;
        }
        let network = self.reading.network_or_kept().await?;
        self.sealer.begin()?;
        let folder = resolved(&wishes.folder)?;
        let wishes = FollowWishes { folder: folder.clone(), ..wishes };
        let shown = clean(&folder.display().to_string(), 300);
        let _claim = self.claims.take_folder(owner.address, &folder).map_err(|_| {
            refused(format!(
                "{shown}, or a folder above or below it, is already being followed; end that first, or leave it to it"
            ))
        })?;
        let running = self.begin_run(&owner.profile, &folder, "following");
        // Ends like a capture: by the same command.
        let control = Arc::new(CaptureSession::new(&[], None, Vec::new()));
        self.capture.note(&owner.profile, &control);
        let followed = self.follow_and_prove(owner, network, wishes, (&running.run, &control), gone);
        let followed = self.parts.log.deed(&owner.profile, "follow recordings", &shown, followed).await;
        self.capture.forget(&control);
        followed
    }

    async fn follow_and_prove(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: Network,
        wishes: FollowWishes,
        (run, control): (&Arc<Run>, &Arc<CaptureSession>),
        mut gone: oneshot::Receiver<()>,
    ) -> Result<FollowView> {
        let (sender, mut due) = mpsc::unbounded_channel();
        let (author, run, stop) = (Arc::clone(owner), Arc::clone(run), Arc::clone(control));
        let reading = blocking(self, move |recordings| {
            let (owner, network, wishes, control) = (&author, &network, &wishes, &*stop);
            Ok(follow_folder(&Follower { recordings, owner, network, wishes, control, due: sender }, &run))
        });
        tokio::pin!(reading);
        let (mut waiting, mut proven, mut view) = (Vec::new(), BTreeMap::new(), None);
        let (mut is_released, mut tick) = (false, tokio::time::interval(PROVING));
        loop {
            tokio::select! {
                read = &mut reading, if view.is_none() => view = Some(read?),
                Some(one) = due.recv() => waiting.push(one),
                _ = &mut gone, if !is_released => {
                    is_released = true;
                    control.close();
                }
                _ = tick.tick() => self.prove(owner, &mut waiting, &mut proven).await,
            }
            while let Ok(one) = due.try_recv() {
                waiting.push(one);
            }
            let is_over = waiting.is_empty() || control.is_closed() || self.parts.life.is_stopping();
            if let Some(view) = view.take_if(|_| is_over) {
                return Ok(with_proofs(view, &waiting, &mut proven));
            }
        }
    }
}

fn with_proofs(mut view: FollowView, waiting: &[Due], proven: &mut BTreeMap<String, Proven>) -> FollowView {
    for file in &mut view.files {
        if let Some(Proven { record, proof, notes }) = proven.remove(&file.file) {
            (file.record, file.proof) = (record, proof);
            file.notes.extend(notes);
        }
        if waiting.iter().any(|due| due.name == file.file) {
            file.notes.push("its proof is not written yet; follow the folder again for it".to_owned());
        }
    }
    view
}

/// A path without links, as far as it exists.
fn resolved(path: &Path) -> Result<PathBuf> {
    let failed = |error: std::io::Error| input(format!("{} cannot be followed: {error}", path.display()));
    if path.is_file() {
        return Err(input(format!("{} is a file; import it with `authros bag import`", path.display())));
    }
    let mut there = path;
    while !there.exists() {
        there = there.parent().ok_or_else(|| input(format!("{} is not a folder", path.display())))?;
    }
    let rest = path.strip_prefix(there).unwrap_or(Path::new(""));
    let resolved = there.canonicalize().map_err(failed)?;
    Ok(if rest.as_os_str().is_empty() { resolved } else { resolved.join(rest) })
}

type Entries<'a> = BTreeMap<PathBuf, Entry<'a>>;

/// The folder's files, round by round.
fn follow_folder(follower: &Follower<'_>, run: &Run) -> FollowView {
    let shown = clean(&follower.wishes.folder.display().to_string(), 300);
    let mut folder = Folder::new(follower.wishes.folder.clone());
    let (mut entries, mut files) = (Entries::new(), Vec::new());
    let mut view = FollowView { folder: shown.clone(), ..FollowView::default() };
    let mut newest = Instant::now();
    loop {
        match folder.look() {
            Look::NotYet => follower.tell(NoticeLevel::Info, &format!("waiting for {shown} to appear")),
            Look::Gone => view.is_gone = true,
            Look::Unreadable(why) => follower.tell(NoticeLevel::Warning, &format!("{shown} cannot be read: {why}")),
            Look::Files(found) => {
                files = found.files;
                found.packed.iter().for_each(|path| tell_packed(follower, path, &entries));
            }
        }
        entries.retain(|path, entry| !matches!(entry, Entry::Waiting(_)) || files.contains(path));
        for path in &files {
            let is_new = matches!(entries.get(path), None | Some(Entry::Waiting(_)));
            if !view.is_gone && is_new && open(follower, path, &files, &mut entries) {
                newest = Instant::now();
            }
        }
        let moved = go_round(follower, &files, &mut entries);
        let sealed = entries.values().map(|entry| match entry {
            Entry::Open(tape) => tape.view.sealed,
            Entry::Ended(ended) => ended.file.sealed,
            Entry::Same | Entry::Waiting(_) => 0,
        });
        run.at(0, 0, sealed.sum());
        let is_open = entries.values().any(|entry| matches!(entry, Entry::Open(_) | Entry::Waiting(_)));
        let is_closed = || files.iter().all(|path| folder::has_description(path)) || newest.elapsed() >= QUIET;
        let has_ended = follower.wishes.until_closed && !entries.is_empty() && !is_open && is_closed();
        if !follower.goes_on() || !moved && (has_ended || view.is_gone) {
            view.ended_early = !has_ended;
            break;
        }
        if !moved {
            std::thread::sleep(LOOK);
        }
    }
    for path in in_recorded_order(&entries) {
        match entries.remove(&path) {
            Some(Entry::Open(mut tape)) => {
                tape.leave();
                view.files.push(tape.report());
            }
            Some(Entry::Ended(ended)) => view.files.push(ended.file),
            Some(Entry::Same | Entry::Waiting(_)) | None => {}
        }
    }
    view
}

/// A recorder that compresses whole files removes a database as soon as it is closed.
fn tell_packed(follower: &Follower<'_>, path: &Path, entries: &Entries<'_>) {
    if matches!(entries.get(&path.with_extension("")), None | Some(Entry::Waiting(_))) {
        let name = follower.name_of(path);
        follower.tell(
            NoticeLevel::Warning,
            &format!("{name} was compressed before it could be sealed: import the folder when the recording has ended"),
        );
    }
}

/// Opens a new file; returns whether it did.
fn open<'a>(follower: &'a Follower<'a>, path: &Path, files: &[PathBuf], entries: &mut Entries<'a>) -> bool {
    let name = follower.name_of(path);
    if folder::is_database(path) {
        let entry = entries.entry(path.to_owned()).or_insert_with(|| {
            let text = format!("{name} is sealed once it is closed: until then no other program may open it");
            follower.tell(NoticeLevel::Info, &text);
            Entry::Waiting(Waiting::default())
        });
        if let Entry::Waiting(waiting) = entry
            && !waiting.is_over(path, files)
        {
            return false;
        }
    }
    let entry = match Tape::open(follower, path, files) {
        Ok(Some(entry)) => entry,
        Ok(None) => return false,
        Err(failure) => {
            follower.warn(&name, &failure.message);
            return false;
        }
    };
    match &entry {
        Entry::Open(tape) => {
            follower.tell(NoticeLevel::Info, &format!("following {name}"));
            tape.view.notes.iter().for_each(|note| follower.warn(&name, note));
        }
        Entry::Ended(ended) => ended.file.notes.iter().for_each(|note| follower.warn(&name, note)),
        Entry::Waiting(_) => {
            let text = format!("{name} is being imported: it is followed when that has ended");
            follower.tell(NoticeLevel::Info, &text);
        }
        Entry::Same => {}
    }
    let is_met = !matches!(entry, Entry::Waiting(_));
    entries.insert(path.to_owned(), entry);
    is_met
}

fn in_recorded_order(entries: &Entries<'_>) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = entries.keys().cloned().collect();
    folder::sort(&mut paths);
    paths
}

/// One round of all open files; returns whether any moved. A failure is reported and retried.
fn go_round(follower: &Follower<'_>, files: &[PathBuf], entries: &mut Entries<'_>) -> bool {
    let mut moved = false;
    for path in in_recorded_order(entries) {
        let Some(entry) = entries.get_mut(&path) else { continue };
        let tape = match &mut *entry {
            Entry::Open(tape) => tape,
            Entry::Ended(ended) => {
                ended.look(&path).into_iter().for_each(|note| follower.warn(&follower.name_of(&path), &note));
                continue;
            }
            Entry::Same | Entry::Waiting(_) => continue,
        };
        match tape.round(files) {
            Ok(Round::Idle) => {}
            Ok(Round::Moved) => moved = true,
            Ok(Round::Ended) => {
                moved = true;
                follower.prove(&tape.key, &tape.place, &path);
                let file = tape.report();
                let level = if file.is_altered || !file.is_closed { NoticeLevel::Warning } else { NoticeLevel::Info };
                let how = match &file {
                    FollowedFile { is_altered: true, notes, .. } => notes.join("; "),
                    FollowedFile { is_closed: false, .. } => {
                        "nothing writes to it any more, and it was not closed".into()
                    }
                    _ => format!("has ended, {} sealed", counted(file.sealed + file.already, "message")),
                };
                follower.tell(level, &format!("{}: {how}", file.file));
                let place = Some(tape.place.clone()).filter(|place| place.standing != FileStanding::Open);
                *entry = Entry::ended(&path, file, place);
            }
            Err(failure) => {
                let (name, why) = (follower.name_of(&path), failure.message.trim_end_matches(AGAIN));
                follower.warn(&name, &format!("{why}; it continues automatically when it can"));
            }
        }
    }
    moved
}

const PROOF: &str = ".authros";

/// Written as soon as the statement's record is verified.
#[derive(Debug, Clone)]
pub(super) struct Due {
    /// In the folder, cleaned.
    pub name: String,
    path: PathBuf,
    key: FileKey,
    place: FilePlace,
    stated_at: Timestamp,
    statement: Digest,
}

#[derive(Debug, Default)]
pub(super) struct Proven {
    pub record: Option<String>,
    pub proof: Option<String>,
    pub notes: Vec<String>,
}

impl Follower<'_> {
    /// Requests the proof of a file, if it is stated.
    pub fn prove(&self, key: &FileKey, place: &FilePlace, path: &Path) {
        let (Some(stated_at), Some(statement)) = (place.stated_at, place.statement) else { return };
        let due = Due {
            name: self.name_of(path),
            path: path.to_owned(),
            key: key.clone(),
            place: place.clone(),
            stated_at,
            statement,
        };
        // Nobody writes proofs once following has ended.
        drop(self.due.send(due));
    }
}

impl Recordings {
    /// Writes the proofs that can be written; the others keep waiting.
    pub(super) async fn prove(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        waiting: &mut Vec<Due>,
        proven: &mut BTreeMap<String, Proven>,
    ) {
        let mut left = Vec::new();
        for due in std::mem::take(waiting) {
            match self.prove_one(owner, &due).await {
                Ok(None) => left.push(due),
                Ok(Some(one)) => {
                    let text = one.proof.as_ref().map(|proof| format!("{}: its proof is {proof}", due.name));
                    text.into_iter().for_each(|text| self.parts.hub.inform(&text));
                    proven.insert(due.name, one);
                }
                Err(failure) => {
                    let text = format!("its proof was not written: {}", failure.message);
                    self.parts.hub.warn(&format!("{}: {text}", due.name));
                    proven.insert(due.name, Proven { notes: vec![text], ..Proven::default() });
                }
            }
        }
        *waiting = left;
    }

    async fn prove_one(self: &Arc<Self>, owner: &Arc<Owner>, due: &Due) -> Result<Option<Proven>> {
        let (network, author, wanted) = (self.reading.network_or_kept().await?, Arc::clone(owner), due.clone());
        let row = blocking(self, move |recordings| {
            let reader = Reader { plant: &recordings.parts.plant, network: &network, reader: &author };
            statement(&reader, &wanted)
        });
        let row = row.await?.ok_or_else(|| input("the record that states its digests is gone"))?;
        match row.state {
            RecordState::Verified => {}
            RecordState::Tampered => {
                let text = format!("record {}, which states its digests, differs from what was anchored", row.id);
                return Err(Failure::new(ErrorKind::Tampered, text));
            }
            _ => return Ok(None),
        }
        let target = beside(&due.path);
        let mut one = Proven { record: Some(row.id.clone()), ..Proven::default() };
        if target.symlink_metadata().is_err() {
            let (file, records, reveal) = (target.clone(), vec![row.id.clone()], vec![row.id.clone()]);
            let wishes = EvidenceWishes { file, records, reveal, sure: true, ..EvidenceWishes::default() };
            one.notes = self.evidence.export(owner, wishes).await?.notes;
        }
        one.proof = Some(clean(&target.display().to_string(), 300));
        let due = due.clone();
        blocking(self, move |recordings| recordings.finish_proof(&due, &target, row.digest)).await?;
        Ok(Some(one))
    }

    /// Checks that the bundle is the file's, and notes that.
    fn finish_proof(&self, due: &Due, target: &Path, record: Digest) -> Result<()> {
        let is_its_own =
            Bundle::read(target, self.parts.plant.provider).is_ok_and(|bundle| bundle.records.contains_key(&record));
        if !is_its_own {
            return Err(input(format!(
                "{} is there and proves something else: another file, this one as it was before, or what another profile \
                 sealed of it; move it away and follow the folder again",
                target.display()
            )));
        }
        let done = FilePlace { standing: FileStanding::Proven, ..due.place.clone() };
        Ok(self.parts.plant.ledger.notes.write(&due.key.note, &done)?)
    }
}

pub(super) fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(PROOF);
    name.into()
}

fn statement(reader: &Reader<'_>, due: &Due) -> Result<Option<RecordRow>> {
    for found in reader.own_opened(at(BESIDE, RecordKind::Attachment, Some(due.stated_at))) {
        let (row, opened) = found?;
        let has = |key: &str, value: &str| opened.head.tags.get(key).is_some_and(|found| found == value);
        let is_it = has(RECORDING, &due.key.tag) && has(TAG.0, TAG.1);
        if is_it && Digest(sm3(&[&opened.body])) == due.statement {
            return Ok(Some(row));
        }
    }
    Ok(None)
}
