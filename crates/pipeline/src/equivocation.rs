//! Two signed records with the same number: a key that used one twice either lied or ran twice. The first record stays;
//! the other is refused, reported, and kept in the audit log with both signatures.

use crate::model::{Address, Digest, RecorderId, Signature, SignerId, Timestamp, TopicId};
use crate::store::notes::Equivocations;
use crate::store::{AuditEntry, NewRecord};

use super::{PipelineError, Plant, Result};

/// At most this many cases per recorder are reported; more prove nothing more.
const MOST: usize = 16;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Claim {
    pub owner: Address,
    /// SM3 of the key that signed it.
    pub signer: SignerId,
    pub recorder: RecorderId,
    pub topic: TopicId,
    pub number: u64,
    pub digest: Digest,
    pub signature: Signature,
}

impl Claim {
    /// `None` for a record numbered here.
    pub fn of(record: &NewRecord) -> Option<Self> {
        let recorder = record.foreign?.recorder;
        let (owner, signer, topic, number) = (record.owner, record.signer, record.topic_id, record.seq);
        Some(Self { owner, signer, recorder, topic, number, digest: record.digest, signature: record.signature })
    }
}

/// Reports a refused record whose number belongs to another one; both signatures must have been checked. Returns
/// whether this is such a case, reported before or not.
pub fn tell(plant: &Plant, claim: &Claim) -> Result<bool> {
    let held =
        plant.ledger.inspection.holder(claim.owner, (claim.signer, claim.recorder), claim.topic, claim.number)?;
    let Some(held) = held.filter(|held| *held != claim.digest) else { return Ok(false) };
    let Some(row) = plant.ledger.records.find(held)? else { return Ok(false) };
    let Claim { owner, signer, recorder, topic, number, digest, signature } = claim;
    let is_new = plant.ledger.notes.change(&Equivocations { recorder: *recorder }, |known| {
        let is_new = !known.contains(digest) && known.len() < MOST;
        if is_new {
            plant.ledger.audit.append(AuditEntry {
                at: Timestamp::now(),
                profile: owner.to_string(),
                action: "equivocation".to_owned(),
                subject: format!("number {number} of topic {topic}, recorder {recorder}, signer {signer}"),
                outcome: format!("{held} signed {}; {digest} signed {signature}", row.signature),
            })?;
            known.push(*digest);
        }
        Ok::<_, PipelineError>(is_new)
    })?;
    if !is_new {
        return Ok(true);
    }
    let text = format!(
        "equivocation: the key {signer} of {owner} signed two records with number {number} of topic {topic} (recorder \
         {recorder}): {held} is kept, {digest} refused; the audit log keeps both signatures. Either two copies of its \
         home are running, or it is cheating"
    );
    plant.observer.alert(true, text);
    Ok(true)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::crypto::{ProviderName, provider};
    use crate::model::{RecordKind, RecordState};
    use crate::pipeline::fixture::Notes;
    use crate::store::{AuditQuery, Ciphertext, Foreign, Ledger};

    fn record(digest: u8, seq: u64) -> NewRecord {
        let foreign = Foreign { recorder: RecorderId([7; RecorderId::LENGTH]), keeper: Address([9; 20]) };
        NewRecord {
            digest: Digest([digest; 32]),
            owner: Address([1; 20]),
            topic_id: TopicId([2; TopicId::LENGTH]),
            seq,
            foreign: Some(foreign),
            epoch: 1,
            kind: RecordKind::Data,
            signer: SignerId([3; 32]),
            signature: Signature([digest; 64]),
            filters: Vec::new(),
            topic: String::new(),
            type_name: String::new(),
            bytes: 1,
            captured_at: Timestamp(1),
            simulated: false,
            state: RecordState::Stored,
            blob: None,
        }
    }

    #[test]
    fn two_records_of_one_number_are_told_once_with_both_signatures() {
        let home = tempfile::tempdir().expect("a folder");
        let notes = Arc::new(Notes::default());
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        let plant = Plant {
            ciphertext: Ciphertext::of(&ledger),
            ledger,
            provider: provider(ProviderName::RustCrypto),
            observer: Arc::clone(&notes) as _,
        };
        plant.ledger.records.append(vec![record(1, 5)]).expect("taken");
        let claim = |digest, seq| Claim::of(&record(digest, seq)).expect("from elsewhere");
        assert!(plant.ledger.records.append(vec![record(2, 5)]).is_err(), "the number is taken");
        assert!(!tell(&plant, &claim(1, 5)).expect("asked"), "the same record is none");
        assert!(!tell(&plant, &claim(2, 6)).expect("asked"), "another number is none");
        for _ in 0..3 {
            assert!(tell(&plant, &claim(2, 5)).expect("asked"));
        }
        assert_eq!(notes.with("equivocation"), 1);
        let query = AuditQuery { action: Some("equivocation".to_owned()), limit: 9, ..AuditQuery::default() };
        let lines = plant.ledger.audit.list(&query).expect("listed");
        let [line] = lines.as_slice() else { panic!("one line: {lines:?}") };
        let both = [Signature([1; 64]), Signature([2; 64])].map(|signature| signature.to_string());
        assert!(both.iter().all(|signature| line.entry.outcome.contains(signature)), "{line:?}");
        for digest in 10..60 {
            assert!(tell(&plant, &claim(digest, 5)).expect("asked"));
        }
        assert_eq!(notes.with("equivocation"), MOST, "a flood of them is bounded");
    }
}
