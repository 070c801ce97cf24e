//! Records that the site itself writes for an owner: sealed, stored and acknowledged like captured messages, then
//! batched, anchored and verified by the same workers.

use crate::crypto::{SealRequest, SmKeyPair, TopicKey, seal, signer_id};
use crate::model::head::Compression;
use crate::model::{Address, Digest, Domain, Head, RecordKind, RecordState, Timestamp, TopicId};
use crate::store::NewRecord;

use super::epoch::EpochKeys;
use super::{PipelineError, Plant};

/// What is stated.
#[derive(Debug, Clone, Copy)]
pub struct Statement<'a> {
    /// What sort of record.
    pub kind: RecordKind,
    /// The name it is filed under; no ROS name begins like it (`authros/…`).
    pub topic: &'a str,
    /// What stands in place of a message type.
    pub type_name: &'a str,
    /// What is sealed.
    pub body: &'a [u8],
}

/// Seals and stores a statement of `owner`; durable when this returns. `None` where the keys do not cover its name.
/// One caller at a time per owner and topic.
///
/// # Errors
/// Of vault and ledger; nothing is acknowledged then.
pub fn state(
    plant: &Plant,
    owner: Address,
    keys: &EpochKeys,
    statement: Statement<'_>,
) -> Result<Option<Digest>, PipelineError> {
    plant.ledger.takes_records()?;
    let Some(topic) = keys.topic(statement.topic) else { return Ok(None) };
    let speaker = Speaker {
        domain: keys.domain,
        owner,
        signing: &keys.signing,
        epoch: keys.epoch,
        topic_id: topic.id,
        topic_key: &topic.key,
    };
    let row = put(plant, &speaker, statement)?;
    let digest = row.digest;
    plant.ledger.append(vec![row])?;
    Ok(Some(digest))
}

/// In whose name a statement is sealed, and under what.
pub struct Speaker<'a> {
    /// The network.
    pub domain: Domain,
    /// Whose record it is.
    pub owner: Address,
    /// Signs it.
    pub signing: &'a SmKeyPair,
    /// The epoch it tells of in its header.
    pub epoch: u64,
    /// Pseudonym of the name it is filed under.
    pub topic_id: TopicId,
    /// Seals it.
    pub topic_key: &'a TopicKey,
}

/// Seals a statement and puts it where the vault is durable; gives the row, which is to be acknowledged next.
///
/// # Errors
/// Of sealing, vault and ledger.
pub fn put(plant: &Plant, speaker: &Speaker<'_>, statement: Statement<'_>) -> Result<NewRecord, PipelineError> {
    let Statement { kind, topic, type_name, body } = statement;
    let Speaker { domain, owner, signing, epoch, topic_id, topic_key } = *speaker;
    let seq = plant.ledger.next_seq(owner, topic_id)?;
    let captured_at = Timestamp::now();
    let request = SealRequest {
        domain,
        owner,
        signer: signing,
        epoch,
        topic_key,
        recorder: plant.ledger.recorder(),
        seq,
        topic_id,
        kind,
        filters: Vec::new(),
        captured_at,
        head: &head(topic, type_name, body.len()),
        body,
    };
    let sealed = seal(plant.provider, &request)?;
    let durable = plant.vault.durable();
    if durable {
        plant.vault.put(&[(sealed.digest, &sealed.blob)])?;
    }
    Ok(NewRecord {
        digest: sealed.digest,
        owner,
        topic_id,
        seq,
        foreign: None,
        epoch,
        kind,
        signer: signer_id(&signing.public),
        signature: sealed.signature,
        filters: Vec::new(),
        topic: topic.to_owned(),
        type_name: type_name.to_owned(),
        bytes: body.len() as u64,
        captured_at,
        simulated: false,
        state: if durable { RecordState::Stored } else { RecordState::Sealed },
        local_copy: (!durable).then_some(sealed.blob),
    })
}

fn head(topic: &str, type_name: &str, length: usize) -> Head {
    Head {
        topic: topic.to_owned(),
        type_name: type_name.to_owned(),
        md5sum: String::new(),
        definition: Digest([0; 32]),
        caller_id: String::new(),
        boot_id: [0; 16],
        compression: Compression::None,
        plain_length: length as u64,
        tags: std::collections::BTreeMap::new(),
    }
}
