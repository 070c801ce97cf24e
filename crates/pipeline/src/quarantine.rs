//! Quarantine records: what was quarantined, per topic and minute, anchored before anyone can pick and choose. They
//! have a topic of their own, so that only the sealer uses its numbers.

use crate::model::{Address, Digest, Domain, Doubt, QuarantineReport, RecordKind, RecorderId, Timestamp, TopicId};
use crate::statement::{self, Speaker, Statement};
use crate::store::{HeldMinute, Hold};
use crate::{Author, PipelineError, Plant, Result, pins, ros::Origin};

/// The name that quarantine records are filed under; no ROS name begins like this.
pub const TOPIC: &str = "authros/quarantine";
/// The tag in the sealed head of a quarantined message.
pub const TAG: &str = "quarantined";

/// The minute of a time, since 1970 UTC.
pub fn minute(at: Timestamp) -> u64 {
    at.0 / 60_000_000_000
}

pub fn hold(digest: Digest, doubt: Doubt, origin: &Origin) -> Hold {
    Hold { digest, reason: doubt.word(), publisher: pins::publisher_of(origin).to_string() }
}

/// The rolling hash over quarantined digests; see [`QuarantineReport`].
pub fn rolling(
    plant: &Plant,
    domain: &Domain,
    (owner, recorder): (Address, RecorderId),
    topic: TopicId,
    minute: u64,
    digests: impl IntoIterator<Item = Digest>,
) -> Digest {
    let minute = minute.to_be_bytes();
    let start = plant.provider.sm3(&[b"AuthROS/quarantined/1", &domain.0, &owner.0, &recorder.0, &topic.0, &minute]);
    let end = digests.into_iter().fold(start, |rolling, digest| plant.provider.sm3(&[&rolling, &digest.0]));
    Digest(end)
}

/// Seals a record for each (topic, minute) before minute `before`; returns how many. One caller at a time.
/// After an error, what is sealed so far stays.
pub fn report(plant: &Plant, author: &Author, before: u64) -> Result<usize> {
    let mut sealed = 0;
    while let Some(held) = plant.ledger.quarantine.unreported(author.address, before)? {
        if !report_one(plant, author, &held)? {
            break;
        }
        sealed += 1;
    }
    if sealed > 0 {
        plant.observer.records_changed();
    }
    Ok(sealed)
}

/// `false`: there are no keys to seal with yet.
fn report_one(plant: &Plant, author: &Author, held: &HeldMinute) -> Result<bool> {
    let Some(keys) = author.sealing() else { return Ok(false) };
    let recorder = plant.ledger.records.recorder().of_signer(&keys.signer);
    let seqs = || held.records.iter().map(|(seq, _)| *seq);
    let digests: Vec<Digest> = held.records.iter().map(|(_, digest)| *digest).collect();
    let stream = (author.address, recorder);
    let report = QuarantineReport {
        topic_id: held.topic_id,
        topic: held.topic.clone(),
        minute: held.minute,
        first_seq: seqs().min().unwrap_or(0),
        last_seq: seqs().max().unwrap_or(0),
        count: digests.len() as u64,
        rolling: rolling(plant, &keys.domain, stream, held.topic_id, held.minute, digests.iter().copied()),
    };
    let body = report.encode();
    let topic = keys.topic(TOPIC).ok_or_else(|| PipelineError::Uncovered(TOPIC.to_owned()))?;
    let speaker = Speaker::of(&keys, author.address, &topic);
    let statement =
        Statement { kind: RecordKind::Quarantine, topic: TOPIC, type_name: "authros/Quarantine", body: &body };
    statement::put(plant, &speaker, statement, |row| plant.ledger.quarantine.report(row, digests))?;
    Ok(true)
}

/// Deletes their ciphertext too. Their quarantine records must be on the chain first.
pub fn discard(plant: &Plant, digests: &[Digest]) -> Result<u64> {
    plant.ciphertext.discard(digests)?;
    let gone = plant.ledger.quarantine.discard(digests)?;
    plant.observer.records_changed();
    Ok(gone)
}

#[cfg(test)]
mod tests;
