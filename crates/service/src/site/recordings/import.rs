//! An import: every message of a recording sealed with its own time. Files are known by SM3; the ledger notes which of
//! their topics are begun and complete, so that nothing is sealed twice and an interrupted import continues.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::follow::followed_as;
use super::{Claim, Holder, Run};
use crate::command::ImportWishes;
use crate::crypto::Sm3Hasher;
use crate::crypto::sm3::sm3;
use crate::model::{Address, Digest, ErrorKind, RecordKind, Timestamp, TopicPattern, clean, counted, grouped};
use crate::pipeline::importer::{RecordedNames, fault, kind_of};
use crate::pipeline::{CaptureSession, Importer, Network, Owner, Reader};
use crate::reply::{Failure, ImportView, ImportedTopic, LeftOut, Result, input, refused};
use crate::ros::recording::{BESIDE, Beside, Encoding, Findings, RecordedMessage, Recording, content_of};
use crate::ros::rosbag2::files_of;
use crate::site::{Recordings, blocking};
use crate::store::RecordQuery;
use crate::store::notes::{Imported, Standing, Standings};

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
        // Ends like a capture: by the same command.
        let control = Arc::new(CaptureSession::new(&[], None, Vec::new()));
        self.capture.note(&owner.profile, &control);
        let (run, stop) = (Arc::clone(&running.run), Arc::clone(&control));
        let read = blocking(self, move |recordings| read(recordings, &run, &stop));
        let ended = match self.parts.log.deed(&owner.profile, action, &file, read).await {
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

impl Recordings {
    pub(super) fn standings(&self, owner: Address, digest: Digest) -> Result<Standings> {
        Ok(self.parts.plant.ledger.notes.read(&Imported { owner, file: digest })?.unwrap_or_default())
    }

    /// Notes the standing of a file's topics, and a tag of its records; what is whole stays whole.
    pub(super) fn add_standings(
        &self,
        (owner, digest): (Address, Digest),
        tag: Option<&str>,
        topics: impl IntoIterator<Item = String>,
        standing: Standing,
    ) -> Result<()> {
        self.parts.plant.ledger.notes.change(&Imported { owner, file: digest }, |standings| {
            standings.tags.extend(tag.map(str::to_owned));
            for topic in topics {
                let known = standings.topics.entry(topic).or_insert(standing);
                *known = standing.max(*known);
            }
            Ok(())
        })
    }
}

#[derive(Debug, Default)]
struct Part {
    before: Standings,
    /// It was followed, so any of its messages may be sealed.
    is_followed: bool,
    met: BTreeSet<String>,
    /// Topics of which something is sealed now.
    begun: BTreeSet<String>,
}

pub(super) struct Parts<'a> {
    recordings: &'a Recordings,
    owner: Address,
    tag: String,
    sealed: SealedBefore<'a>,
    digests: BTreeMap<PathBuf, Digest>,
    /// Files with the same content are one.
    by_content: HashMap<Digest, Part>,
    again: bool,
}

impl<'a> Parts<'a> {
    /// `again` ignores what is known; `tag` is for the new records.
    pub fn new(
        recordings: &'a Recordings,
        sealed: SealedBefore<'a>,
        tag: &str,
        digests: BTreeMap<PathBuf, Digest>,
        again: bool,
    ) -> Result<Self> {
        let (owner, mut by_content) = (sealed.reader.reader.address, HashMap::<Digest, Part>::new());
        for (path, digest) in &digests {
            let part = by_content.entry(*digest).or_default();
            if again {
                continue;
            }
            let followed = followed_as(&recordings.parts.plant.ledger.notes, owner, path)?;
            // Two files with one content share their standings, and each may have been followed.
            let tags = std::mem::take(&mut part.before.tags);
            part.before = recordings.standings(owner, *digest)?;
            part.is_followed |= followed.is_some();
            part.before.tags.extend(tags.into_iter().chain(followed));
        }
        Ok(Self { recordings, owner, tag: tag.to_owned(), sealed, digests, by_content, again })
    }

    fn part(&mut self, file: &Path) -> Result<(Digest, &mut Part)> {
        let digest = self.digests.get(file).copied();
        digest
            .and_then(|digest| Some((digest, self.by_content.get_mut(&digest)?)))
            .ok_or_else(|| input(format!("{} appeared while its folder was read; repeat the import", file.display())))
    }

    /// Whether a message of a file is sealed already.
    pub fn is_sealed(&mut self, file: &Path, topic: &Arc<str>, message: &RecordedMessage) -> Result<bool> {
        let (digest, part) = self.part(file)?;
        if !part.met.contains(&**topic) {
            part.met.insert(topic.to_string());
        }
        let may_be = match part.before.topics.get(&**topic) {
            Some(Standing::Whole) => return Ok(true),
            Some(Standing::Begun) => true,
            None => part.is_followed,
        };
        let part = self.by_content.get(&digest).filter(|_| may_be);
        part.map_or(Ok(false), |part| self.sealed.take(topic, message, &part.before.tags))
    }

    /// Notes that a topic of a file is begun, before its first message goes to the sealer.
    pub fn begin(&mut self, file: &Path, topic: &str) -> Result<()> {
        let (digest, part) = self.part(file)?;
        if part.begun.contains(topic) {
            return Ok(());
        }
        part.begun.insert(topic.to_owned());
        if self.again {
            return Ok(());
        }
        let topics = std::iter::once(topic.to_owned());
        self.recordings.add_standings((self.owner, digest), Some(&self.tag), topics, Standing::Begun)
    }

    /// Topics of each file that are whole once everything is verified.
    pub fn whole(self) -> Vec<(Digest, BTreeSet<String>)> {
        if self.again {
            return Vec::new();
        }
        self.by_content.into_iter().map(|(digest, part)| (digest, part.met)).collect()
    }
}

const PAGE: usize = 1000;

/// How often a content was sealed, per value of the tag that names the file.
type Contents = HashMap<[u8; 32], HashMap<String, u64>>;

/// Finds messages of one recording among its owner's records.
pub(super) struct SealedBefore<'a> {
    reader: Reader<'a>,
    /// By topic and time: what was sealed there and not met yet. Two recordings may share both, so only records that
    /// name the file count, by content. MCAP metadata has no time of its own.
    met: HashMap<(Arc<str>, Option<Timestamp>), Contents>,
}

impl<'a> SealedBefore<'a> {
    pub fn new(reader: Reader<'a>) -> Self {
        Self { reader, met: HashMap::new() }
    }

    /// Whether a record with one of these tags seals this message; each record stands for one message.
    pub fn take(&mut self, topic: &Arc<str>, message: &RecordedMessage, tags: &BTreeSet<String>) -> Result<bool> {
        let encoding = message.channel.encoding;
        let time = (encoding != Encoding::Beside(Beside::Metadata)).then_some(message.time);
        let key = (Arc::clone(topic), time);
        if !self.met.contains_key(&key) {
            let contents = self.contents(topic, kind_of(encoding), time)?;
            self.met.insert(key.clone(), contents);
        }
        let left = self.met.get_mut(&key).and_then(|contents| contents.get_mut(&sm3(&[&message.body])));
        let left = left.and_then(|left| left.iter_mut().find(|(tag, left)| **left > 0 && tags.contains(*tag)));
        let Some((_, left)) = left else { return Ok(false) };
        *left -= 1;
        Ok(true)
    }

    fn contents(&self, topic: &str, kind: RecordKind, time: Option<Timestamp>) -> Result<Contents> {
        let mut contents = Contents::new();
        for found in self.reader.own_opened(at(topic, kind, time)) {
            let (_, opened) = found?;
            if let Some(tag) = opened.head.tags.get(RECORDING) {
                *contents.entry(sm3(&[&opened.body])).or_default().entry(tag.clone()).or_default() += 1;
            }
        }
        Ok(contents)
    }
}

/// Records of a topic and kind, captured at this moment or at any.
pub(super) fn at(topic: &str, kind: RecordKind, time: Option<Timestamp>) -> RecordQuery {
    RecordQuery {
        topic: Some(topic.to_owned()),
        kind: Some(kind),
        since: time,
        until: time.and_then(Timestamp::next),
        limit: PAGE,
        ..RecordQuery::default()
    }
}
