//! An import: every message of a recording sealed with its own time. Files are known by SM3; the ledger notes which of
//! their topics are begun and complete, so that nothing is sealed twice and an interrupted import continues.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::claims::{Claim, Holder};
use super::standings::{Parts, SealedBefore};
use super::{Recordings, Run};
use crate::crypto::Sm3Hasher;
use crate::model::{Digest, ErrorKind, RecordKind, TopicPattern, clean, counted, grouped};
use crate::pipeline::importer::RecordedNames;
use crate::pipeline::importer::{Importer, fault, kind_of};
use crate::pipeline::reader::Reader;
use crate::pipeline::{CaptureSession, Network, Owner};
use crate::ros::recording::{BESIDE, Findings, RecordedMessage, Recording, content_of};
use crate::ros::rosbag2::files_of;
use crate::service::command::ImportWishes;
use crate::service::failure::{input, refused};
use crate::service::reply::{Failure, ImportView, ImportedTopic, LeftOut, Result};
use crate::site::blocking;
use crate::store::notes::Standing;

/// Most tags a person may give; with the importer's own, far below a head's limit.
pub(super) const MOST_TAGS: usize = 24;

/// Tag with the beginning of the file's digest.
pub(in crate::site) const RECORDING: &str = "recording";

pub(super) struct ReadOut {
    pub view: ImportView,
    pub sessions: Vec<Arc<CaptureSession>>,
    /// Files, with the topics that are whole once everything is verified.
    pub whole: Vec<(Digest, BTreeSet<String>)>,
}

impl Recordings {
    pub async fn import_recording(self: &Arc<Self>, owner: &Arc<Owner>, wishes: ImportWishes) -> Result<ImportView> {
        if wishes.tags.len() > MOST_TAGS {
            return Err(input(format!("an import can have at most {MOST_TAGS} tags")));
        }
        if owner.sealing().is_none() {
            self.profiles.register(owner).await?;
        }
        // Without a chain nothing would ever be verified.
        let network = self.parts.link.network().await?;
        let (author, path) = (Arc::clone(owner), wishes.path.clone());
        // Until its records are verified, even if nobody waits for that any more.
        let claim = Arc::new(self.claim(owner, &path)?);
        let held = Arc::clone(&claim);
        let read = move |recordings: &Self, run: &Run, control: &CaptureSession| {
            let _held = held;
            recordings.read_recording(&author, &network, &wishes, run, control)
        };
        let imported = self.run_import(owner, &path, "import recording", read).await;
        drop(claim);
        imported
    }

    /// Nobody else of this home may seal these files meanwhile.
    fn claim(&self, owner: &Owner, path: &Path) -> Result<Claim> {
        self.claims.take(owner.address, &files_of(path)?, Holder::Import).map_err(|(file, holder)| {
            let file = clean(&file.display().to_string(), 300);
            refused(match holder {
                Holder::Import => format!("{file} is already being imported; wait for that to finish"),
                Holder::Follower => format!(
                    "{file} is being followed and sealed now; import it when the follower has said that it has ended, or end \
                     the follower first"
                ),
            })
        })
    }

    /// Reads with `read`, and waits until everything given to the sealer is verified.
    pub(super) async fn run_import(
        self: &Arc<Self>,
        owner: &Owner,
        path: &Path,
        action: &'static str,
        read: impl FnOnce(&Self, &Run, &CaptureSession) -> Result<ReadOut> + Send + 'static,
    ) -> Result<ImportView> {
        self.sealer.begin()?;
        let file = clean(&path.display().to_string(), 300);
        let running = self.begin_run(&owner.profile, path, "reading");
        self.parts.log.begin(owner, action, &file).await?;
        // Ends like a capture: by the same command.
        let control = Arc::new(CaptureSession::new(&[], None, Vec::new()));
        self.capture.note(&owner.profile, &control);
        let (run, stop) = (Arc::clone(&running.run), Arc::clone(&control));
        let read = blocking(self, move |recordings| read(recordings, &run, &stop)).await;
        let imported = self.parts.log.end(owner, action, &file, read).await;
        let ended = match imported {
            Ok(read) => self.settle_import(owner, read, &running.run).await,
            Err(failure) => Err(failure),
        };
        self.capture.forget(&control);
        ended
    }

    /// Waits until everything is verified; the topics are then complete.
    async fn settle_import(self: &Arc<Self>, owner: &Owner, read: ReadOut, run: &Run) -> Result<ImportView> {
        let ReadOut { mut view, sessions, whole } = read;
        run.step("verifying");
        let mut topics: BTreeMap<String, ImportedTopic> =
            std::mem::take(&mut view.topics).into_iter().map(|topic| (topic.topic.clone(), topic)).collect();
        for session in sessions {
            session.settled().await;
            for figures in session.figures() {
                let topic = topics.entry(figures.topic.clone()).or_default();
                topic.topic = figures.topic;
                topic.imported += figures.captured;
                topic.verified += figures.verified;
                view.lost += figures.lost;
            }
        }
        view.topics = topics.into_values().collect();
        let (beside, messages): (Vec<_>, Vec<_>) = view.topics.iter().partition(|topic| topic.topic == BESIDE);
        view.imported = messages.iter().map(|topic| topic.imported).sum();
        view.verified = messages.iter().map(|topic| topic.verified).sum();
        view.already = messages.iter().map(|topic| topic.already).sum();
        view.attachments = beside.iter().map(|topic| topic.imported + topic.already).sum();
        if !view.ended_early && view.lost == 0 {
            let address = owner.address;
            let note = move |recordings: &Self| {
                let add = |(digest, topics)| recordings.add_standings((address, digest), None, topics, Standing::Whole);
                whole.into_iter().try_for_each(add)
            };
            blocking(self, note).await?;
        }
        let ImportView { file, imported, already, .. } = &view;
        self.parts.hub.inform(&format!(
            "{file}: {} imported, {} already there",
            counted(*imported, "message"),
            grouped(*already)
        ));
        Ok(view)
    }

    /// Gives every wanted message to the sealer.
    fn read_recording(
        &self,
        owner: &Owner,
        network: &Network,
        wishes: &ImportWishes,
        run: &Run,
        control: &CaptureSession,
    ) -> Result<ReadOut> {
        let mut recording = Recording::open(&wishes.path)?;
        let goes_on = || !control.is_closed() && !self.parts.life.is_stopping();
        run.step("hashing");
        let (digest, digests) = digests_of(&wishes.path, run, &goes_on)?;
        let file: String = digest.to_hex().chars().take(16).collect();
        let mut tags = wishes.tags.clone();
        tags.push((RECORDING.to_owned(), file.clone()));
        let reader = Reader { plant: &self.parts.plant, network, reader: owner };
        let mut parts = Parts::new(self, SealedBefore::new(reader), &file, digests, wishes.again)?;
        run.step("importing");
        let mut importer = Importer::new(&self.rings, Arc::clone(&owner.author), &self.parts.config.topic_rules, tags);
        let mut choosing = Choosing::new(&wishes.topics);
        let (mut view, mut already) = (ImportView::default(), BTreeMap::<String, u64>::new());
        while let Some(message) = recording.next_message()? {
            view.found += 1;
            let Some(topic) = choosing.topic(&message) else { continue };
            let from = recording.file().unwrap_or(&wishes.path);
            if parts.is_sealed(from, &topic, &message)? {
                *already.entry(topic.to_string()).or_default() += 1;
                continue;
            }
            parts.begin(from, &topic)?;
            if !importer.take(message, &topic, &goes_on) {
                view.ended_early = true;
                break;
            }
            let (done, of) = recording.progress();
            run.at(done, of, importer.offered());
        }
        let findings = recording.findings();
        view.file = clean(&wishes.path.display().to_string(), 300);
        view.digest = Some(digest);
        view.left_out = choosing.left_out(findings);
        view.skipped = view.left_out.iter().map(|topic| topic.messages).sum::<u64>();
        view.found += findings.messages_skipped();
        view.unguarded = findings.unguarded;
        view.unfinished = findings.unfinished;
        view.damages.clone_from(&findings.damages);
        view.more_damages = findings.more_damages;
        let topic = |(topic, already)| ImportedTopic { topic, already, ..ImportedTopic::default() };
        view.topics = already.into_iter().map(topic).collect();
        Ok(ReadOut { view, sessions: importer.finish(), whole: parts.whole() })
    }
}

/// Names come from the file, so they are cleaned.
pub(super) fn left_out_list(counts: BTreeMap<(Arc<str>, &'static str), u64>) -> Vec<LeftOut> {
    let list = counts.into_iter().map(|((topic, why), messages)| LeftOut {
        topic: clean(&topic, 255),
        why: why.to_owned(),
        messages,
    });
    list.collect()
}

/// SM3 of a recording and of each of its files, unpacked. A folder's is over its files' names, lengths and digests.
fn digests_of(path: &Path, run: &Run, goes_on: &dyn Fn() -> bool) -> Result<(Digest, BTreeMap<PathBuf, Digest>)> {
    let unreadable = |error: std::io::Error| input(format!("{} cannot be read: {error}", path.display()));
    let mut opened = Vec::new();
    for file in files_of(path)? {
        let size = std::fs::metadata(&file).map_err(unreadable)?.len();
        opened.push((file, size));
    }
    let of = opened.iter().map(|(_, size)| size).sum();
    let (mut folder, mut digests, mut done) = (Sm3Hasher::new(), BTreeMap::new(), 0);
    let mut buffer = vec![0; 256 * 1024];
    for (name, size) in opened {
        let (mut file, mut hasher) = (content_of(&name)?, Sm3Hasher::new());
        loop {
            let read = file.read(&mut buffer).map_err(unreadable)?;
            let bytes = buffer.get(..read).unwrap_or_default();
            if bytes.is_empty() {
                break;
            }
            if !goes_on() {
                let text = "stopped before anything was imported; repeat the command";
                return Err(Failure::new(ErrorKind::Incomplete, text));
            }
            hasher.update(bytes);
            done += read as u64;
            run.at(done.min(of), of, 0);
        }
        let digest = Digest(hasher.finish());
        if name == path {
            return Ok((digest, BTreeMap::from([(name, digest)])));
        }
        let word = name.file_name().unwrap_or_default().as_encoded_bytes();
        folder.update(&(word.len() as u64).to_le_bytes());
        folder.update(word);
        folder.update(&size.to_le_bytes());
        folder.update(&digest.0);
        digests.insert(name, digest);
    }
    Ok((Digest(folder.finish()), digests))
}

#[derive(Debug)]
pub(super) struct Choosing {
    patterns: Vec<TopicPattern>,
    names: RecordedNames,
    left_out: BTreeMap<(Arc<str>, &'static str), u64>,
}

impl Choosing {
    /// Empty = all.
    pub fn new(patterns: &[TopicPattern]) -> Self {
        Self { patterns: patterns.to_vec(), names: RecordedNames::default(), left_out: BTreeMap::new() }
    }

    /// The topic to seal a message under; `None` if it is unwanted or left out.
    pub fn topic(&mut self, message: &RecordedMessage) -> Option<Arc<str>> {
        let recorded = &message.channel.topic;
        let is_message = kind_of(message.channel.encoding) == RecordKind::Data;
        let named = if is_message { self.names.resolve(recorded) } else { Ok(Arc::clone(recorded)) };
        // Patterns choose topics; attachments have none and belong to the whole recording.
        let matches = |name: &Arc<str>| self.patterns.iter().any(|pattern| pattern.matches(name));
        let is_chosen = || is_message && [Some(recorded), named.as_ref().ok()].into_iter().flatten().any(matches);
        if !self.patterns.is_empty() && !is_chosen() {
            return None;
        }
        match (named, fault(message)) {
            (Ok(topic), None) => Some(topic),
            (Err(why), _) | (_, Some(why)) => {
                *self.left_out.entry((Arc::clone(recorded), why)).or_default() += 1;
                None
            }
        }
    }

    /// Left out here and by the reader.
    pub fn left_out(&self, findings: &Findings) -> Vec<LeftOut> {
        let mut list = left_out_list(self.left_out.clone());
        list.extend_from_slice(&findings.unusable);
        list
    }
}
