//! What an import or a follower that did not end has sealed of a file already, identified by the file, the time
//! and the content.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use super::import::RECORDING;
use crate::crypto::sm3::sm3;
use crate::model::{Address, RecordKind, Timestamp};
use crate::pipeline::importer::kind_of;
use crate::pipeline::reader::Reader;
use crate::ros::recording::{Beside, Encoding, RecordedMessage};
use crate::service::reply::Failure;
use crate::store::RecordQuery;

/// Records requested from the ledger at a time.
const PAGE: usize = 1000;

/// How often a content was sealed, with each value of the tag that names the file.
type Contents = HashMap<[u8; 32], HashMap<String, u64>>;

/// Looks up messages of one recording among its owner's records.
pub(super) struct SealedBefore<'a> {
    reader: Reader<'a>,
    /// For each topic and time met: what was sealed there and not met yet. Two recordings may have the same topics and
    /// times, so only records that name the file count, and only by their content. Metadata of MCAP has no time of its own:
    /// what it gets depends on whether the end of the file was known.
    met: HashMap<(Arc<str>, Option<Timestamp>), Contents>,
}

impl<'a> SealedBefore<'a> {
    /// For the owner who reads.
    pub fn new(reader: Reader<'a>) -> Self {
        Self { reader, met: HashMap::new() }
    }

    /// Whose records it looks among.
    pub fn owner(&self) -> Address {
        self.reader.reader.address
    }

    /// Whether this message of a file is sealed, by records with one of these tags; each stands for one message.
    pub fn take(
        &mut self,
        topic: &Arc<str>,
        message: &RecordedMessage,
        tags: &BTreeSet<String>,
    ) -> Result<bool, Failure> {
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

    fn contents(&self, topic: &str, kind: RecordKind, time: Option<Timestamp>) -> Result<Contents, Failure> {
        let mut query = RecordQuery {
            owner: Some(self.reader.reader.address),
            topic: Some(topic.to_owned()),
            kind: Some(kind),
            since: time,
            until: time.map(|time| Timestamp(time.0.saturating_add(1))),
            limit: PAGE,
            ..RecordQuery::default()
        };
        let mut contents = Contents::new();
        loop {
            let page = self.reader.plant.ledger.records.list(&query)?;
            for row in &page.rows {
                let Some(opened) = self.reader.own_contents(row)? else { continue };
                if let Some(tag) = opened.head.tags.get(RECORDING) {
                    *contents.entry(sm3(&[&opened.body])).or_default().entry(tag.clone()).or_default() += 1;
                }
            }
            query.after = page.next;
            if query.after.is_none() {
                return Ok(contents);
            }
        }
    }
}
