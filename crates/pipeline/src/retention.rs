//! Retention: ciphertext that no rule keeps any longer is named in a signed record, and deleted when that record is
//! confirmed on the chain. A function of the ledger: called again, it does what is left.

pub mod erasing;
mod held;
pub mod told;

use std::collections::HashMap;

use crate::model::{
    Address, Digest, Domain, Header, Keeping, RecordKind, RetentionReport, RetentionRule, Timestamp, TopicId,
};
use crate::store::{KeptTopic, OldRecord};

use held::Held;

use super::statement::{self, Speaker, Statement};
use super::{Owner, PipelineError, Plant};

/// The name that retention records are filed under; no ROS name begins like this.
pub const TOPIC: &str = "authros/retention";
/// Takes the place of a message type.
pub const TYPE: &str = "authros/Retention";
/// The most records named in one retention record.
const ROUND: usize = 1024;
/// Rounds after which records that were overtaken (still pending then) are searched for.
const ANEW: u32 = 600;

/// The rules in force for the owners of a site.
pub struct Retention {
    rules: Keeping,
    /// Where the search for each topic's oldest record begins.
    since: HashMap<(Address, i64), Timestamp>,
    /// The spans of topics held by incidents, as of the last round.
    held: HashMap<(Address, i64), Held>,
    rounds: u32,
}

/// The result of a round.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Round {
    /// Topics and how many of their records were named.
    pub named: Vec<(String, u64)>,
    /// Records whose ciphertext was deleted.
    pub deleted: u64,
}

impl Retention {
    /// Rules not applied yet.
    pub fn new(rules: Keeping) -> Self {
        Self { rules, since: HashMap::new(), held: HashMap::new(), rounds: 0 }
    }

    /// Names the records of an owner that are no longer kept, and deletes those that were named and whose retention
    /// record is anchored. One caller at a time.
    ///
    /// # Errors
    /// Errors of sealing, vault and ledger; what is done so far stays.
    pub fn round(&mut self, plant: &Plant, owner: &Owner) -> Result<Round, PipelineError> {
        self.rounds += 1;
        if self.rounds.is_multiple_of(ANEW) {
            self.since.clear();
            self.held.clear();
        }
        let mut done = Round { named: Vec::new(), deleted: delete(plant, owner)? };
        let incidents = plant.ledger.incidents(owner.address)?;
        for topic in plant.ledger.kept_topics(owner.address)? {
            self.hold((owner.address, topic.key), Held::of(&topic.name, &incidents));
            if !topic.is_named() {
                continue;
            }
            let Some(rule) = self.rules.of(&topic.name) else { continue };
            let named = self.name(plant, owner, &topic, &rule)?;
            done.named.extend((named > 0).then_some((topic.name, named)));
        }
        Ok(done)
    }

    /// If an incident was opened, closed or removed, the oldest record is searched from the beginning again.
    fn hold(&mut self, place: (Address, i64), held: Held) {
        let known = self.held.entry(place).or_default();
        if known.spans != held.spans {
            *known = held;
            self.since.remove(&place);
        }
    }

    fn name(
        &mut self,
        plant: &Plant,
        owner: &Owner,
        topic: &KeptTopic,
        rule: &RetentionRule,
    ) -> Result<u64, PipelineError> {
        let place = (owner.address, topic.key);
        let since = self.since.get(&place).copied().unwrap_or_default();
        let due = due(plant, topic, rule, since, self.held.entry(place).or_default())?;
        let Some(last) = due.last().map(|record| record.captured_at) else { return Ok(0) };
        let mut whole = Vec::with_capacity(due.len());
        for record in due {
            match header_of(plant, record.digest)? {
                Some(header) => whole.push((record, header)),
                None => missing(plant, record.digest),
            }
        }
        let count = whole.len() as u64;
        if count > 0 && !report(plant, owner, topic, rule, whole)? {
            return Ok(0);
        }
        self.since.insert(place, last);
        Ok(count)
    }
}

/// The oldest records that neither the rule nor an incident keeps: too old, or beyond the budget.
fn due(
    plant: &Plant,
    topic: &KeptTopic,
    rule: &RetentionRule,
    since: Timestamp,
    held: &mut Held,
) -> Result<Vec<OldRecord>, PipelineError> {
    let now = Timestamp::now();
    let mut excess = rule.bytes.map_or(0, |budget| topic.bytes.saturating_sub(budget));
    if excess > 0 {
        excess = excess.saturating_sub(held.bytes(plant, topic, now)?);
    }
    let age = rule.age.map(|age| u64::try_from(age.as_nanos()).unwrap_or(u64::MAX));
    let oldest_kept = age.map_or(Timestamp(0), |age| Timestamp(now.0.saturating_sub(age)));
    let until = if excess > 0 { now } else { oldest_kept };
    let mut rest = excess;
    let mut due = Vec::new();
    for free in held.between((since, until)) {
        due.extend(plant.ledger.oldest(topic, free, ROUND - due.len())?);
        if due.len() >= ROUND {
            break;
        }
    }
    let kept = due.iter().position(|record| {
        let stays = record.captured_at >= oldest_kept && rest == 0;
        rest = rest.saturating_sub(record.bytes);
        stays
    });
    due.truncate(kept.unwrap_or(due.len()));
    Ok(due)
}

/// The public header of the stored bytes, if these are still what was anchored.
fn header_of(plant: &Plant, digest: Digest) -> Result<Option<Vec<u8>>, PipelineError> {
    let Some(blob) = plant.vault.get(digest)? else { return Ok(None) };
    let right = Digest(plant.provider.sm3(&[&blob])) == digest;
    let length = Header::parse(&blob).ok().map(|(_, length)| length).filter(|_| right);
    Ok(length.and_then(|length| blob.get(..length)).map(<[u8]>::to_vec))
}

fn missing(plant: &Plant, digest: Digest) {
    let text = format!(
        "record {digest} is not deleted by retention: its ciphertext is missing or altered, but no retention record \
         names it; inspect it with `authros shared check`"
    );
    plant.observer.alert(true, text);
}

/// The rolling hash over digests; see [`RetentionReport`].
pub fn rolling(
    plant: &Plant,
    domain: &Domain,
    owner: Address,
    topic: TopicId,
    digests: impl IntoIterator<Item = Digest>,
) -> Digest {
    let start = plant.provider.sm3(&[b"AuthROS/retained/1", &domain.0, &owner.0, &topic.0]);
    Digest(digests.into_iter().fold(start, |rolling, digest| plant.provider.sm3(&[&rolling, &digest.0])))
}

/// `false`: there are no keys to seal with now.
fn report(
    plant: &Plant,
    owner: &Owner,
    topic: &KeptTopic,
    rule: &RetentionRule,
    records: Vec<(OldRecord, Vec<u8>)>,
) -> Result<bool, PipelineError> {
    let Some(keys) = owner.sealing() else { return Ok(false) };
    let place = keys.topic(TOPIC).ok_or_else(|| PipelineError::Uncovered(TOPIC.to_owned()))?;
    let seqs = || records.iter().map(|(record, _)| record.seq);
    let digests = records.iter().map(|(record, _)| record.digest);
    let body = RetentionReport {
        topic_id: topic.topic_id,
        topic: topic.name.clone(),
        rule: rule.to_string(),
        first_seq: seqs().min().unwrap_or(0),
        last_seq: seqs().max().unwrap_or(0),
        count: records.len() as u64,
        bytes: records.iter().map(|(record, _)| record.bytes).sum(),
        rolling: rolling(plant, &keys.domain, owner.address, topic.topic_id, digests),
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
    statement::put(plant, &speaker, statement, |row| plant.ledger.give_up(topic, row, records))?;
    plant.observer.records_changed();
    Ok(true)
}

/// Overwrites records that their owners told this gateway to erase, and that are still here; returns how many. One caller at
/// a time.
///
/// # Errors
/// Errors of vault and ledger; called again, it does what is left.
pub fn delete_told(plant: &Plant) -> Result<u64, PipelineError> {
    let digests = plant.ledger.told_to_delete(ROUND)?;
    if !digests.is_empty() {
        plant.ledger.scour_local_copies(&digests)?;
        plant.vault.scour(&digests)?;
        plant.ledger.deleted(&digests)?;
        plant.observer.records_changed();
    }
    Ok(digests.len() as u64)
}

/// Deletes records named in anchored retention records; returns how many. One caller at a time.
///
/// # Errors
/// Errors of vault and ledger; called again, it does what is left.
pub fn delete(plant: &Plant, owner: &Owner) -> Result<u64, PipelineError> {
    let digests = plant.ledger.to_delete(owner.address, ROUND)?;
    if digests.is_empty() {
        return Ok(0);
    }
    // The local copies first: otherwise the vault would be refilled from them.
    let erased = plant.ledger.erased_among(&digests)?;
    if !erased.is_empty() {
        plant.ledger.scour_local_copies(&erased)?;
        plant.vault.scour(&erased)?;
    }
    plant.ledger.drop_local_copies(&digests)?;
    plant.vault.discard(&digests)?;
    plant.ledger.deleted(&digests)?;
    plant.observer.records_changed();
    Ok(digests.len() as u64)
}
