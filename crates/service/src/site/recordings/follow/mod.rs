//! A folder whose recordings are sealed while a recorder writes them (decision 019). Files are only read. The ledger
//! keeps how far each is sealed, before and after the records of a round: after a crash, the messages in doubt are
//! searched among the records.

mod folder;
mod place;
mod proof;
mod source;
mod tape;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, oneshot};

use self::folder::{Folder, Look, QUIET, Stamp, Waiting};
use self::place::{Hashed, Known};
use self::proof::{Due, Proven};
use self::tape::{Round, Tape};
use super::import::MOST_TAGS;
use super::{Recordings, Run};
use crate::model::{Address, clean, counted};
use crate::pipeline::importer::Importer;
use crate::pipeline::reader::Reader;
use crate::pipeline::{CaptureSession, Network, Owner};
use crate::service::command::FollowWishes;
use crate::service::event::NoticeLevel;
use crate::service::failure::{AGAIN, input, refused};
use crate::service::reply::{FollowView, FollowedFile, Result};
use crate::site::blocking;
use crate::store::Notes;
use crate::store::notes::{FilePlace, FileStanding};

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
        self.parts.log.begin(owner, "follow recordings", &shown).await?;
        let running = self.begin_run(&owner.profile, &folder, "following");
        // Ends like a capture: by the same command.
        let control = Arc::new(CaptureSession::new(&[], None, Vec::new()));
        self.capture.note(&owner.profile, &control);
        let followed = self.follow_and_prove(owner, network, wishes, (&running.run, &control), gone).await;
        self.capture.forget(&control);
        self.parts.log.end(owner, "follow recordings", &shown, followed).await
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

/// The folder's files, round by round.
fn follow_folder(follower: &Follower<'_>, run: &Run) -> FollowView {
    let shown = clean(&follower.wishes.folder.display().to_string(), 300);
    let mut folder = Folder::new(follower.wishes.folder.clone());
    let (mut entries, mut files) = (BTreeMap::<PathBuf, Entry<'_>>::new(), Vec::new());
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
fn tell_packed(follower: &Follower<'_>, path: &Path, entries: &BTreeMap<PathBuf, Entry<'_>>) {
    if matches!(entries.get(&path.with_extension("")), None | Some(Entry::Waiting(_))) {
        let name = follower.name_of(path);
        follower.tell(
            NoticeLevel::Warning,
            &format!("{name} was compressed before it could be sealed: import the folder when the recording has ended"),
        );
    }
}

/// Opens a new file; returns whether it did.
fn open<'a>(
    follower: &'a Follower<'a>,
    path: &Path,
    files: &[PathBuf],
    entries: &mut BTreeMap<PathBuf, Entry<'a>>,
) -> bool {
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

fn in_recorded_order(entries: &BTreeMap<PathBuf, Entry<'_>>) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = entries.keys().cloned().collect();
    folder::sort(&mut paths);
    paths
}

/// One round of all open files; returns whether any moved. A failure is reported and retried.
fn go_round(follower: &Follower<'_>, files: &[PathBuf], entries: &mut BTreeMap<PathBuf, Entry<'_>>) -> bool {
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
