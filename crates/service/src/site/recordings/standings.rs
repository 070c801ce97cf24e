//! What is sealed already of a recording's files: alone, with their folder, or while recorded. A file is known by its
//! SM3, a message by file, time and content.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Recordings;
use super::follow::followed_as;
use super::import::RECORDING;
use crate::crypto::sm3::sm3;
use crate::model::{Address, Digest, RecordKind, Timestamp};
use crate::pipeline::importer::kind_of;
use crate::pipeline::reader::Reader;
use crate::ros::recording::{Beside, Encoding, RecordedMessage};
use crate::service::failure::input;
use crate::service::reply::Result;
use crate::store::RecordQuery;
use crate::store::notes::{Imported, Standing, Standings};

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
