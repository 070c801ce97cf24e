//! Erasing records that a person chose: named in signed retention records first, like what a rule gives up. When these
//! are confirmed on the chain, the bytes are overwritten.

use std::collections::BTreeMap;

use crate::crypto::{EoaSecret, ErasedStatement, SmKeyPair, signer_id};
use crate::model::{Digest, Header, RecordKind, RecordState, RecorderId, RetentionReport, Timestamp, TopicId};
use crate::pipeline::statement::{self, Speaker, Statement};
use crate::pipeline::{Network, Owner, PipelineError, Plant};
use crate::store::{Erasure, RecordRow, Retained, StatedErasure, Unstated};

use super::{ROUND, TOPIC, TYPE, header_of, rolling};

/// The longest reason, characters.
pub const LONGEST_REASON: usize = 500;

/// What became of the chosen records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Erased {
    /// Named: their bytes go when the retention records are confirmed.
    pub named: u64,
    /// Their bytes are not here, or altered: they stay as they are.
    pub missing: u64,
}

/// Whether a record can be erased: an own message or attachment, verified, and not deleted yet.
pub fn can_be(row: &RecordRow) -> bool {
    row.kind.is_content() && row.state == RecordState::Verified && row.deleted_at.is_none()
}

/// Names these records of an owner, each of which [`can_be`] erased, as erased. One caller at a time.
///
/// # Errors
/// [`PipelineError::Uncovered`] without keys to seal with, errors of sealing, vault and ledger; what was named stays so.
pub fn name(plant: &Plant, owner: &Owner, rows: &[RecordRow], erasure: &Erasure) -> Result<Erased, PipelineError> {
    let mut topics: BTreeMap<(TopicId, RecorderId), Vec<&RecordRow>> = BTreeMap::new();
    for row in rows {
        topics.entry((row.topic_id, row.recorder)).or_default().push(row);
    }
    let mut done = Erased::default();
    for rows in topics.values().flat_map(|rows| rows.chunks(ROUND)) {
        let mut whole = Vec::with_capacity(rows.len());
        for row in rows {
            // What only a rule has named is still to be overwritten, by whom and why.
            let retained = plant.ledger.retained(row.digest)?;
            if retained.is_some_and(|retained| retained.deleted_at.is_some() || retained.erased.is_some()) {
                continue;
            }
            match header_of(plant, row.digest)? {
                Some(header) => whole.push((*row, header)),
                None => done.missing += 1,
            }
        }
        if !whole.is_empty() {
            done.named += whole.len() as u64;
            report(plant, owner, whole, erasure)?;
        }
    }
    plant.observer.records_changed();
    Ok(done)
}

/// Seals and stores the retention record of some records of one topic.
fn report(
    plant: &Plant,
    owner: &Owner,
    records: Vec<(&RecordRow, Vec<u8>)>,
    erasure: &Erasure,
) -> Result<(), PipelineError> {
    let uncovered = || PipelineError::Uncovered(TOPIC.to_owned());
    let keys = owner.sealing().ok_or_else(uncovered)?;
    let place = keys.topic(TOPIC).ok_or_else(uncovered)?;
    let Some((first, _)) = records.first() else { return Ok(()) };
    let seqs = || records.iter().map(|(row, _)| row.seq);
    let digests = records.iter().map(|(row, _)| row.digest);
    let body = RetentionReport {
        topic_id: first.topic_id,
        topic: first.topic.clone(),
        rule: erasure.to_string(),
        first_seq: seqs().min().unwrap_or(0),
        last_seq: seqs().max().unwrap_or(0),
        count: records.len() as u64,
        bytes: records.iter().map(|(row, _)| row.bytes).sum(),
        rolling: rolling(plant, &keys.domain, owner.address, first.topic_id, digests),
    }
    .encode();
    let speaker = Speaker {
        domain: keys.domain,
        owner: owner.address,
        signing: &keys.signing,
        epoch: keys.epoch,
        topic_id: place.id,
        topic_key: &place.key,
    };
    let statement = Statement { kind: RecordKind::Retention, topic: TOPIC, type_name: TYPE, body: &body };
    let named: Vec<(Digest, Vec<u8>)> = records.into_iter().map(|(row, header)| (row.digest, header)).collect();
    let told = named.clone();
    statement::put(plant, &speaker, statement, |row| plant.ledger.erase(row, erasure, named))?;
    state(plant, (&keys.signing, &owner.eoa()), erasure, &told)
}

/// Signs for readers who never had these records, and for gateways that have copies, that they were erased.
fn state(
    plant: &Plant,
    keys: (&SmKeyPair, &EoaSecret),
    erasure: &Erasure,
    erased: &[(Digest, Vec<u8>)],
) -> Result<(), PipelineError> {
    let mut statements = Vec::with_capacity(erased.len());
    for (digest, header) in erased {
        let Some(retained) = plant.ledger.retained(*digest)? else { continue };
        statements.push(stated(plant, keys, (digest, header), (retained.report, erasure.at))?);
    }
    Ok(plant.ledger.keep_erasures(statements)?)
}

/// What an owner states of one erased record, signed by d_C and by the account.
///
/// # Errors
/// [`PipelineError::Crypto`].
pub fn stated(
    plant: &Plant,
    (signing, account): (&SmKeyPair, &EoaSecret),
    about: (&Digest, &[u8]),
    when: (Digest, Timestamp),
) -> Result<StatedErasure, PipelineError> {
    let statement = ErasedStatement::sign(plant.provider, signing, about, when)?;
    let signature = statement.sign_by_account(plant.provider, account, about)?;
    let account = Some(signature.0.to_vec());
    Ok(StatedErasure { digest: *about.0, statement: statement.encode(), account })
}

/// States again what an owner had erased under an earlier key. Returns whether nothing is left to state; as long as there is,
/// it is to be called again.
///
/// # Errors
/// Errors of signing and the ledger; what was stated so far stays.
pub fn restate(plant: &Plant, owner: &Owner, signing: &SmKeyPair) -> Result<bool, PipelineError> {
    let unstated = plant.ledger.unstated(owner.address, &signing.public, ROUND)?;
    let (keys, count) = ((signing, &owner.eoa()), unstated.len());
    let mut statements = Vec::with_capacity(count);
    for Unstated { digest, report, header, erasure } in unstated {
        statements.push(stated(plant, keys, (&digest, &header), (report, erasure.at))?);
    }
    plant.ledger.keep_erasures(statements)?;
    Ok(count < ROUND)
}

/// Whether a record that is gone, and whose retention record is not here, was erased as its owner states: with a key that
/// was the owner's, if a network is there to say so.
pub fn is_stated(plant: &Plant, network: Option<&Network>, digest: Digest, retained: &Retained) -> bool {
    let Some(bytes) = &retained.stated else { return false };
    let Ok(statement) = ErasedStatement::parse(bytes) else { return false };
    let Ok((header, _)) = Header::parse(&retained.header) else { return false };
    let signer = signer_id(&statement.signer);
    let is_owners = network.is_none_or(|network| network.directory.registered_as(signer) == Some(header.owner));
    let is_about = statement.report == retained.report;
    is_owners && is_about && statement.check(plant.provider, &digest, &retained.header).is_ok()
}
