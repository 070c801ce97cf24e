//! Records that the site itself writes for an owner: sealed, stored and acknowledged like captured messages, then
//! batched, anchored and verified by the same workers.

use crate::crypto::{SealRequest, seal};
use crate::model::head::Compression;
use crate::model::{Address, Digest, Head, RecordKind, RecordState, Timestamp};
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
    let Statement { kind, topic: name, type_name, body } = statement;
    plant.ledger.takes_records()?;
    let Some(topic) = keys.topic(name) else { return Ok(None) };
    let seq = plant.ledger.next_seq(owner, topic.id)?;
    let captured_at = Timestamp::now();
    let request = SealRequest {
        domain: keys.domain,
        owner,
        signer: &keys.signing,
        epoch: keys.epoch,
        topic_key: &topic.key,
        recorder: plant.ledger.recorder(),
        seq,
        topic_id: topic.id,
        kind,
        filters: Vec::new(),
        captured_at,
        head: &head(name, type_name, body.len()),
        body,
    };
    let sealed = seal(plant.provider, &request)?;
    let durable = plant.vault.durable();
    if durable {
        plant.vault.put(&[(sealed.digest, &sealed.blob)])?;
    }
    plant.ledger.append(vec![NewRecord {
        digest: sealed.digest,
        owner,
        topic_id: topic.id,
        seq,
        foreign: None,
        epoch: keys.epoch,
        kind,
        signer: keys.signer,
        signature: sealed.signature,
        filters: Vec::new(),
        topic: name.to_owned(),
        type_name: type_name.to_owned(),
        bytes: body.len() as u64,
        captured_at,
        simulated: false,
        state: if durable { RecordState::Stored } else { RecordState::Sealed },
        local_copy: (!durable).then_some(sealed.blob),
    }])?;
    Ok(Some(sealed.digest))
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
