//! The definition that a message names: its own recorder wrote it, shortly before it, one of perhaps thousands. A
//! message of ROS 2 that names an empty one was captured before its definition was known; its type's hash then names
//! it, so a later record, or another recorder's, serves as well.

use std::collections::HashMap;
use std::sync::Arc;

use tokio::task::block_in_place;

use super::Reader;
use crate::crypto::OpenedRecord;
use crate::crypto::sm3::sm3;
use crate::model::{Address, Digest, Head, RecordKind, Timestamp, TopicId};
use crate::pipeline::Result;
use crate::ros::message::{is_built_in, type_hash};
use crate::ros::recording::TYPE_HASH;
use crate::ros::recording::tags::CHANNEL;
use crate::store::{RecordQuery, RecordRow};

/// The most definition records opened at each attempt.
const MOST_OPENED: usize = 200;
/// The most that each attempt lists from the ledger.
const MOST_LISTED: usize = 10_000;
/// The most texts that are kept.
const MOST_KEPT: usize = 1024;

/// What decides about a message's definition within an epoch: its owner, topic, digest, type and the type's hash.
type Key = (Address, TopicId, u64, Digest, String, Option<String>);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Opening {
    /// As every record that is read: with its anchor and its reader's rights.
    Anchored,
    /// As the owner's own, without the chain.
    Own,
}

/// Definitions found so far, so that opening many messages looks each one up once.
#[derive(Default)]
pub struct Definitions(HashMap<Key, Arc<str>>);

impl Definitions {
    pub async fn text(
        &mut self,
        reader: &Reader<'_>,
        row: &RecordRow,
        opened: &OpenedRecord,
        by: Opening,
    ) -> Result<Option<Arc<str>>> {
        let key = key(row, opened);
        match self.0.get(&key) {
            Some(known) => Ok(Some(Arc::clone(known))),
            None => Ok(reader.definition_text(row, opened, by).await?.map(|text| self.keep(key, text))),
        }
    }

    fn keep(&mut self, key: Key, text: String) -> Arc<str> {
        if self.0.len() >= MOST_KEPT {
            self.0.clear();
        }
        Arc::clone(self.0.entry(key).or_insert_with(|| text.into()))
    }
}

fn key(row: &RecordRow, opened: &OpenedRecord) -> Key {
    let head = &opened.head;
    (row.owner, row.topic_id, row.epoch, head.definition, head.type_name.clone(), hash_of(head))
}

/// The hash of a message's type, if its publisher or its recording gave it.
fn hash_of(head: &Head) -> Option<String> {
    head.tags.get(&format!("{CHANNEL}{TYPE_HASH}")).filter(|hash| !hash.is_empty()).cloned()
}

impl Reader<'_> {
    /// The text of the definition that an opened message names, from its owner's definition records, as its publisher
    /// gave it; for a message that names an empty one, a text that has its type's hash.
    pub async fn definition_text(&self, row: &RecordRow, opened: &OpenedRecord, by: Opening) -> Result<Option<String>> {
        let wanted = Wanted::of(opened);
        for query in wanted.attempts(row) {
            let listed = self.plant.ledger.records.list(&query)?.rows;
            let may_open = |candidate: &&RecordRow| by == Opening::Own || candidate.epoch == row.epoch;
            for candidate in listed.iter().filter(may_open).take(MOST_OPENED) {
                let found = match by {
                    Opening::Anchored => self.open(candidate).await.ok(),
                    Opening::Own => block_in_place(|| self.own_contents(candidate))?,
                };
                if let Some(found) = found.filter(|found| wanted.is_in(found)) {
                    return Ok(Some(String::from_utf8_lossy(&found.body).into_owned()));
                }
            }
        }
        Ok(wanted.otherwise())
    }
}

struct Wanted {
    /// `None` if the message names an empty one.
    digest: Option<Digest>,
    /// Type and hash, for a message that names an empty one and whose type is not built into this program.
    by_hash: Option<(String, String)>,
}

impl Wanted {
    fn of(opened: &OpenedRecord) -> Self {
        let head = &opened.head;
        let digest = (head.definition.0 != sm3(&[])).then_some(head.definition);
        let hash = hash_of(head).filter(|hash| digest.is_none() && !is_built_in(&head.type_name, hash));
        Self { digest, by_hash: hash.map(|hash| (head.type_name.clone(), hash)) }
    }

    /// By digest: the topic's definition records of the message's recorder from before it, all of that recorder, all
    /// there are; the newest first. By hash: those of the recorder from the message on, the oldest first, and then all.
    fn attempts(&self, row: &RecordRow) -> Vec<RecordQuery> {
        let all = RecordQuery {
            owner: Some(row.owner),
            topic_ids: Some(vec![row.topic_id]),
            kind: Some(RecordKind::Definition),
            limit: MOST_LISTED,
            newest_first: true,
            ..RecordQuery::default()
        };
        let of_recorder = RecordQuery { recorder: Some(row.recorder), ..all.clone() };
        if self.by_hash.is_some() {
            let after =
                RecordQuery { since: Some(row.captured_at), limit: MOST_OPENED, newest_first: false, ..of_recorder };
            return vec![after, all];
        }
        if self.digest.is_none() {
            return Vec::new();
        }
        let until = Timestamp(row.captured_at.0.saturating_add(1));
        let before = RecordQuery { until: Some(until), limit: MOST_OPENED, ..of_recorder.clone() };
        vec![before, of_recorder, all]
    }

    fn is_in(&self, found: &OpenedRecord) -> bool {
        let text = || std::str::from_utf8(&found.body).ok().filter(|text| !text.is_empty());
        match &self.by_hash {
            Some((type_name, hash)) => {
                found.head.type_name == *type_name
                    && text().is_some_and(|text| type_hash(type_name, text).is_ok_and(|found| found == *hash))
            }
            None => self.digest.is_some_and(|digest| sm3(&[&found.body]) == digest.0),
        }
    }

    fn otherwise(&self) -> Option<String> {
        self.digest.is_none().then(String::new)
    }
}
