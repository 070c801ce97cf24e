//! Seals the records of a round in parallel: each independently, from the plan. Nothing here knows of the others,
//! writes anything, or depends on the order of threads.

use std::collections::BTreeMap;

use crate::crypto::compression::{Packed, pack};
use crate::crypto::pool::{each, helpers_for};
use crate::crypto::{SealRequest, seal};
use crate::model::head::{Compression, SIMULATED};
use crate::model::{Head, RecordKind, RecordState};
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::{PipelineError, Plant, importer, quarantine};
use crate::store::{Hold, NewRecord};

use super::plan::{Content, Task};

/// A sealed record on its way into vault and ledger.
pub struct Ready {
    /// The record with its bytes.
    pub row: NewRecord,
    /// Why it is quarantined, if it is.
    pub hold: Option<Hold>,
    /// Whether compressing it paid, if that was tried.
    pub paid: Option<bool>,
}

/// Seals a whole round, on as many cores as is worthwhile.
///
/// # Errors
/// The error of the first record, in order, that cannot be sealed.
pub fn seal_all(plant: &Plant, boot_id: [u8; 16], tasks: &[Task<'_>]) -> Result<Vec<Ready>, PipelineError> {
    let bytes = tasks.iter().map(|task| task.body().len()).sum();
    each(tasks, helpers_for(tasks.len(), bytes), |task| task.seal(plant, boot_id)).into_iter().collect()
}

impl Task<'_> {
    fn body(&self) -> &[u8] {
        match self.content {
            Content::Definition(_) => self.item.message.definition.as_bytes(),
            Content::Message(_) => &self.item.message.body,
        }
    }

    fn kind(&self) -> RecordKind {
        match self.content {
            Content::Definition(_) => RecordKind::Definition,
            Content::Message(_) => self.item.kind,
        }
    }

    fn pack(&self) -> Option<Packed> {
        match &self.content {
            Content::Definition(_) => pack(self.body(), None),
            Content::Message(tried) => tried.as_ref().and_then(|tried| tried.pack(&self.item.message)),
        }
    }

    fn seal(&self, plant: &Plant, boot_id: [u8; 16]) -> Result<Ready, PipelineError> {
        let (message, body, tags) = (&*self.item.message, self.body(), tags(self.item));
        let packed = self.pack();
        let filters = self.topic.filters(&message.type_name, &tags);
        let compression = packed.as_ref().map_or(Compression::None, |packed| packed.compression);
        let head = self.head(boot_id, compression, tags);
        let request = SealRequest {
            domain: self.keys.domain,
            owner: self.item.author.address,
            signer: &self.keys.signing,
            epoch: self.keys.epoch,
            topic_key: &self.topic.key,
            recorder: self.recorder,
            seq: self.seq,
            topic_id: self.topic.id,
            kind: self.kind(),
            filters,
            captured_at: message.captured_at,
            head: &head,
            body: packed.as_ref().map_or(body, |packed| &packed.bytes),
        };
        let sealed = seal(plant.provider, &request)?;
        let hold = self.item.doubt.map(|doubt| quarantine::hold(sealed.digest, doubt, &message.origin));
        let mut row = NewRecord::sealed(sealed).named(&head);
        if hold.is_some() {
            row.state = RecordState::Quarantined;
        }
        let tried = matches!(self.content, Content::Message(Some(_)));
        Ok(Ready { row, hold, paid: tried.then_some(packed.is_some()) })
    }

    fn head(&self, boot_id: [u8; 16], compression: Compression, tags: BTreeMap<String, String>) -> Head {
        let message = &*self.item.message;
        Head {
            topic: message.topic.to_string(),
            type_name: message.type_name.to_string(),
            md5sum: message.md5sum.to_string(),
            definition: self.definition,
            caller_id: message.caller_id.to_string(),
            boot_id,
            compression,
            plain_length: self.body().len() as u64,
            tags,
        }
    }
}

fn tags(item: &CapturedMessage) -> BTreeMap<String, String> {
    let mut tags: BTreeMap<String, String> =
        item.sessions.iter().flat_map(|session| session.tags().iter().cloned()).collect();
    tags.extend(item.message.tags.iter().cloned());
    if let Some(rule) = &item.rule {
        tags.extend(rule.all_tags());
    }
    if item.message.latching {
        tags.insert(importer::LATCHING.to_owned(), "1".to_owned());
    }
    if item.simulated {
        tags.insert(SIMULATED.0.to_owned(), SIMULATED.1.to_owned());
    }
    if let Some(doubt) = item.doubt {
        tags.insert(quarantine::TAG.to_owned(), doubt.word().to_owned());
    }
    tags
}
