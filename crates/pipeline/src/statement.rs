//! Records that the site writes for an owner: sealed, stored, anchored and verified like captured messages.

use std::collections::BTreeMap;

use crate::crypto::{SealRequest, SmKeyPair, TopicKey, seal, signer_id};
use crate::epoch::{EpochKeys, TopicKeys};
use crate::model::{Address, Digest, Domain, FilterId, Head, RecordKind, Timestamp, TopicId};
use crate::store::{NewRecord, StoreError};
use crate::{Plant, Result, model::head::Compression};

#[derive(Debug, Clone, Copy)]
pub struct Statement<'a> {
    pub kind: RecordKind,
    /// The name it is filed under; no ROS name begins like this (`authros/…`).
    pub topic: &'a str,
    /// Takes the place of a message type.
    pub type_name: &'a str,
    pub body: &'a [u8],
}

/// Durable when this returns. `None` if the keys do not cover its name. One caller at a time per owner and topic.
pub fn state(plant: &Plant, owner: Address, keys: &EpochKeys, statement: Statement<'_>) -> Result<Option<Digest>> {
    let Some(topic) = keys.topic(statement.topic) else { return Ok(None) };
    append(plant, &Speaker::of(keys, owner, &topic), statement).map(Some)
}

/// The same with the id of its type in the header, by which it is found without its key.
pub fn state_to_be_found(
    plant: &Plant,
    owner: Address,
    keys: &EpochKeys,
    statement: Statement<'_>,
) -> Result<Option<Digest>> {
    let Some(topic) = keys.topic(statement.topic) else { return Ok(None) };
    let filters = topic.filters(statement.type_name, &BTreeMap::new());
    append(plant, &Speaker { filters, ..Speaker::of(keys, owner, &topic) }, statement).map(Some)
}

pub struct Speaker<'a> {
    pub domain: Domain,
    pub owner: Address,
    pub signing: &'a SmKeyPair,
    pub epoch: u64,
    pub topic_id: TopicId,
    pub topic_key: &'a TopicKey,
    /// By which the record is found without its key.
    pub filters: Vec<FilterId>,
}

impl<'a> Speaker<'a> {
    pub fn of(keys: &'a EpochKeys, owner: Address, topic: &'a TopicKeys) -> Self {
        Self {
            domain: keys.domain,
            owner,
            signing: &keys.signing,
            epoch: keys.epoch,
            topic_id: topic.id,
            topic_key: &topic.key,
            filters: Vec::new(),
        }
    }
}

pub fn append(plant: &Plant, speaker: &Speaker<'_>, statement: Statement<'_>) -> Result<Digest> {
    put(plant, speaker, statement, |row| {
        let digest = row.digest;
        plant.ledger.records.append(vec![row]).map(|()| digest)
    })
}

pub fn put<T>(
    plant: &Plant,
    speaker: &Speaker<'_>,
    statement: Statement<'_>,
    acknowledge: impl FnOnce(NewRecord) -> Result<T, StoreError>,
) -> Result<T> {
    let Statement { kind, topic, type_name, body } = statement;
    let Speaker { domain, owner, signing, epoch, topic_id, topic_key, ref filters } = *speaker;
    let seq = plant.ledger.records.next_seq(owner, signer_id(&signing.public), topic_id)?;
    let head = Head {
        topic: topic.to_owned(),
        type_name: type_name.to_owned(),
        md5sum: String::new(),
        definition: Digest([0; 32]),
        caller_id: String::new(),
        boot_id: [0; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: BTreeMap::new(),
    };
    let request = SealRequest {
        domain,
        owner,
        signer: signing,
        epoch,
        topic_key,
        recorder: plant.ledger.records.recorder(),
        seq,
        topic_id,
        kind,
        filters: filters.clone(),
        captured_at: Timestamp::now(),
        head: &head,
        body,
    };
    let row = NewRecord::sealed(seal(plant.provider, &request)?).named(&head);
    Ok(plant.keep([row], |[row]| acknowledge(row))?)
}
