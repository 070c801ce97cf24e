//! Retention: ciphertext that no rule keeps any longer is named in a signed record, and deleted when that record is
//! confirmed on the chain. A function of the ledger: called again, it does what is left. Erasing takes the same way.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crate::authority::{Moment, SigningRight, key_of, may_sign};
use crate::crypto::{AccountSignature, EoaSecret, ErasedStatement, SmKeyPair, signer_id};
use crate::gateway::{ErasedRecord, ErasureNotice, Fetched};
use crate::model::{
    Address, Digest, Header, Keeping, PublicKey, RecordKind, RecordState, RecorderId, RetentionReport, RetentionRule,
    Timestamp, TopicId,
};
use crate::statement::{self, Speaker, Statement};
use crate::store::{
    Erasure, IncidentRow, KeptTopic, NewRecord, OldRecord, PlacedRecord, RecordRow, Retained, StatedErasure,
    StoreError, Unstated,
};
use crate::{Network, Owner, PipelineError, Plant, Result, chain_proofs::anchor_proof, epoch::EpochKeys};

/// The name that retention records are filed under; no ROS name begins like this.
pub const TOPIC: &str = "authros/retention";
/// Takes the place of a message type.
pub const TYPE: &str = "authros/Retention";
/// The most records named in one retention record.
const ROUND: usize = 1024;
/// Rounds after which records that were overtaken (still pending then) are searched for.
const ANEW: u32 = 600;

pub struct Retention {
    rules: Keeping,
    /// Where the search for each topic's oldest record begins.
    since: HashMap<(Address, i64), Timestamp>,
    /// The spans of topics held by incidents, as of the last round.
    held: HashMap<(Address, i64), Held>,
    rounds: u32,
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Round {
    pub named: Vec<(String, u64)>,
    pub deleted: u64,
}

impl Retention {
    pub fn new(rules: Keeping) -> Self {
        Self { rules, since: HashMap::new(), held: HashMap::new(), rounds: 0 }
    }

    /// Names records that are no longer kept, and deletes those whose retention record is anchored. One caller at a
    /// time.
    pub fn round(&mut self, plant: &Plant, owner: &Owner) -> Result<Round> {
        self.rounds += 1;
        if self.rounds.is_multiple_of(ANEW) {
            self.since.clear();
            self.held.clear();
        }
        let mut done = Round { named: Vec::new(), deleted: delete(plant, owner)? };
        let incidents = plant.ledger.incidents.list(owner.address)?;
        for topic in plant.ledger.retention.topics(owner.address)? {
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

    fn name(&mut self, plant: &Plant, owner: &Owner, topic: &KeptTopic, rule: &RetentionRule) -> Result<u64> {
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
        if count > 0 {
            let gone: Vec<_> = whole.iter().map(|(record, _)| (record.digest, record.seq, record.bytes)).collect();
            let about = (topic.topic_id, topic.name.clone(), rule.to_string());
            let store = |row| plant.ledger.retention.give_up(topic, row, whole);
            if report(plant, owner, about, &gone, store)?.is_none() {
                return Ok(0);
            }
            plant.observer.records_changed();
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
) -> Result<Vec<OldRecord>> {
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
        due.extend(plant.ledger.retention.oldest(topic, free, ROUND - due.len())?);
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
fn header_of(plant: &Plant, digest: Digest) -> Result<Option<Vec<u8>>> {
    let Some(blob) = plant.ciphertext.get(digest)? else { return Ok(None) };
    let right = Digest(plant.provider.sm3(&[&blob])) == digest;
    let length = Header::parse(&blob).ok().map(|(_, length)| length).filter(|_| right);
    Ok(length.and_then(|length| blob.get(..length)).map(<[u8]>::to_vec))
}

fn missing(plant: &Plant, digest: Digest) {
    let text = format!(
        "record {digest} is not deleted by retention: its ciphertext is missing or altered, but no retention record \
         names it; inspect it with `authros records check`"
    );
    plant.observer.alert(true, text);
}

/// Seals and stores the retention record of `gone` records of one topic: digest, number and length of each. Returns the
/// keys that sealed it; `None` if there are none now.
fn report(
    plant: &Plant,
    owner: &Owner,
    (topic_id, topic, rule): (TopicId, String, String),
    gone: &[(Digest, u64, u64)],
    store: impl FnOnce(NewRecord) -> Result<(), StoreError>,
) -> Result<Option<Arc<EpochKeys>>> {
    let Some(keys) = owner.sealing() else { return Ok(None) };
    let place = keys.topic(TOPIC).ok_or_else(|| PipelineError::Uncovered(TOPIC.to_owned()))?;
    let seqs = || gone.iter().map(|(_, seq, _)| *seq);
    let start = plant.provider.sm3(&[b"AuthROS/retained/1", &keys.domain.0, &owner.address.0, &topic_id.0]);
    let rolling = gone.iter().fold(start, |rolling, (digest, ..)| plant.provider.sm3(&[&rolling, &digest.0]));
    let report = RetentionReport {
        topic_id,
        topic,
        rule,
        first_seq: seqs().min().unwrap_or(0),
        last_seq: seqs().max().unwrap_or(0),
        count: gone.len() as u64,
        bytes: gone.iter().map(|(_, _, bytes)| bytes).sum(),
        rolling: Digest(rolling),
    };
    let speaker = Speaker::of(&keys, owner.address, &place);
    let body = report.encode();
    let statement = Statement { kind: RecordKind::Retention, topic: TOPIC, type_name: TYPE, body: &body };
    statement::put(plant, &speaker, statement, store)?;
    Ok(Some(keys))
}

/// Overwrites records that owners told this gateway to erase; returns how many. One caller at a time.
pub fn delete_told(plant: &Plant) -> Result<u64> {
    let digests = plant.ledger.erasures.told_to_delete(ROUND)?;
    if !digests.is_empty() {
        plant.ciphertext.scour(&digests)?;
        note_deleted(plant, &digests)?;
    }
    Ok(digests.len() as u64)
}

/// Deletes records named in anchored retention records; returns how many. One caller at a time.
pub fn delete(plant: &Plant, owner: &Owner) -> Result<u64> {
    let digests = plant.ledger.retention.to_delete(owner.address, ROUND)?;
    if !digests.is_empty() {
        let erased = plant.ledger.erasures.erased_among(&digests)?;
        plant.ciphertext.scour(&erased)?;
        plant.ciphertext.discard(&digests)?;
        note_deleted(plant, &digests)?;
    }
    Ok(digests.len() as u64)
}

fn note_deleted(plant: &Plant, digests: &[Digest]) -> Result<()> {
    plant.ledger.retention.deleted(digests)?;
    plant.observer.erased();
    plant.observer.records_changed();
    Ok(())
}

/// The longest reason, characters.
pub const LONGEST_REASON: usize = 500;

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

/// Names records, each of which [`can_be`] erased. What was named before an error stays so. One caller at a time.
pub fn name(plant: &Plant, owner: &Owner, rows: &[RecordRow], erasure: &Erasure) -> Result<Erased> {
    let mut topics: BTreeMap<(TopicId, RecorderId), Vec<&RecordRow>> = BTreeMap::new();
    for row in rows {
        topics.entry((row.topic_id, row.recorder)).or_default().push(row);
    }
    let mut done = Erased::default();
    for rows in topics.values().flat_map(|rows| rows.chunks(ROUND)) {
        let mut whole = Vec::with_capacity(rows.len());
        for row in rows {
            // What only a rule has named is still to be overwritten, by whom and why.
            let retained = plant.ledger.retention.find(row.digest)?;
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
            report_erased(plant, owner, whole, erasure)?;
        }
    }
    plant.observer.records_changed();
    Ok(done)
}

fn report_erased(plant: &Plant, owner: &Owner, records: Vec<(&RecordRow, Vec<u8>)>, erasure: &Erasure) -> Result<()> {
    let Some((first, _)) = records.first() else { return Ok(()) };
    let gone: Vec<_> = records.iter().map(|(row, _)| (row.digest, row.seq, row.bytes)).collect();
    let about = (first.topic_id, first.topic.clone(), erasure.to_string());
    let named: Vec<(Digest, Vec<u8>)> = records.into_iter().map(|(row, header)| (row.digest, header)).collect();
    let told = named.clone();
    let sealed = report(plant, owner, about, &gone, |row| plant.ledger.erasures.erase(row, erasure, named))?;
    let keys = sealed.ok_or_else(|| PipelineError::Uncovered(TOPIC.to_owned()))?;
    state(plant, (&keys.signing, &owner.eoa()), erasure, &told)
}

/// Signs for readers who never had these records, and for gateways that have copies, that they were erased.
fn state(plant: &Plant, keys: (&SmKeyPair, &EoaSecret), erasure: &Erasure, erased: &[(Digest, Vec<u8>)]) -> Result<()> {
    let mut statements = Vec::with_capacity(erased.len());
    for (digest, header) in erased {
        let Some(retained) = plant.ledger.retention.find(*digest)? else { continue };
        statements.push(stated(plant, keys, (digest, header), (retained.report, erasure.at))?);
    }
    Ok(plant.ledger.erasures.keep(statements)?)
}

pub fn stated(
    plant: &Plant,
    (signing, account): (&SmKeyPair, &EoaSecret),
    about: (&Digest, &[u8]),
    when: (Digest, Timestamp),
) -> Result<StatedErasure> {
    let statement = ErasedStatement::sign(plant.provider, signing, about, when)?;
    let signature = statement.sign_by_account(plant.provider, account, about)?;
    let account = Some(signature.0.to_vec());
    Ok(StatedErasure { digest: *about.0, statement: statement.encode(), account })
}

/// States erasures made under an earlier key again. Returns whether none is left; until then, call again.
pub fn restate(plant: &Plant, owner: &Owner, signing: &SmKeyPair) -> Result<bool> {
    let unstated = plant.ledger.erasures.unstated(owner.address, &signing.public, ROUND)?;
    let (keys, count) = ((signing, &owner.eoa()), unstated.len());
    let mut statements = Vec::with_capacity(count);
    for Unstated { digest, report, header, erasure } in unstated {
        statements.push(stated(plant, keys, (&digest, &header), (report, erasure.at))?);
    }
    plant.ledger.erasures.keep(statements)?;
    Ok(count < ROUND)
}

/// Whether a gone record whose retention record is not here was erased as its owner states, with a key that was the
/// owner's if a network is there to say so.
pub fn is_stated(plant: &Plant, network: Option<&Network>, digest: Digest, retained: &Retained) -> bool {
    let Some(bytes) = &retained.stated else { return false };
    let Ok(statement) = ErasedStatement::parse(bytes) else { return false };
    let Ok((header, _)) = Header::parse(&retained.header) else { return false };
    let signer = signer_id(&statement.signer);
    let is_owners = network.is_none_or(|network| network.directory.registered_as(signer) == Some(header.owner));
    let is_about = statement.report == retained.report;
    is_owners && is_about && statement.check(plant.provider, &digest, &retained.header).is_ok()
}

/// A stretch of time: its first moment, and the first one after it.
type Span = (Timestamp, Timestamp);

/// Later than any record.
const EVER: Timestamp = Timestamp(i64::MAX.cast_unsigned());

/// A message captured this long ago is in the ledger by now, if it ever gets there, nanoseconds.
const UNSETTLED: u64 = 60_000_000_000;

/// The spans of one topic held by incidents, and their bytes as far as they were counted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
struct Held {
    /// In order and disjoint.
    pub spans: Vec<Span>,
    bytes: u64,
    /// Everything captured before this is counted.
    counted: Timestamp,
}

impl Held {
    pub fn of(topic: &str, incidents: &[IncidentRow]) -> Self {
        let spans = incidents.iter().map(|incident| &incident.span).filter(|span| span.is_about(topic));
        Self { spans: merged(spans.map(|span| (span.since, span.until.unwrap_or(EVER))).collect()), ..Self::default() }
    }

    /// The bytes in the spans that retention has not deleted. What was captured a while ago is summed up only once.
    pub fn bytes(&mut self, plant: &Plant, topic: &KeptTopic, now: Timestamp) -> Result<u64> {
        let settled = Timestamp(now.0.saturating_sub(UNSETTLED)).max(self.counted);
        self.bytes += self.between_moments(plant, topic, (self.counted, settled))?;
        self.counted = settled;
        Ok(self.bytes + self.between_moments(plant, topic, (settled, EVER))?)
    }

    fn between_moments(&self, plant: &Plant, topic: &KeptTopic, (from, to): Span) -> Result<u64> {
        let mut bytes = 0;
        for &(since, until) in &self.spans {
            let stretch = (since.max(from), until.min(to));
            if stretch.0 < stretch.1 {
                bytes += plant.ledger.incidents.bytes_between(topic.key, stretch)?;
            }
        }
        Ok(bytes)
    }

    pub fn between(&self, (since, until): Span) -> Vec<Span> {
        let mut free = Vec::with_capacity(self.spans.len() + 1);
        let mut begin = since;
        for &(from, to) in &self.spans {
            free.push((begin, from.min(until)));
            begin = begin.max(to);
        }
        free.push((begin, until));
        free.retain(|(from, to)| from < to);
        free
    }
}

/// The same time without overlaps, in order.
fn merged(mut spans: Vec<Span>) -> Vec<Span> {
    spans.retain(|(since, until)| since < until);
    spans.sort_unstable();
    let mut merged: Vec<Span> = Vec::with_capacity(spans.len());
    for (since, until) in spans {
        match merged.last_mut().filter(|last| since <= last.1) {
            Some(last) => last.1 = last.1.max(until),
            None => merged.push((since, until)),
        }
    }
    merged
}

/// A record without its message: the header in place of its bytes. `None` if its signer is unknown.
pub fn left_of(plant: &Plant, network: &Network, row: &RecordRow, header: Vec<u8>) -> Result<Option<Fetched>> {
    let Some(signer) = key_of(plant, network, row)? else { return Ok(None) };
    let placed = plant.ledger.records.placed(row.digest)?;
    let proof = placed.and_then(anchor_proof).map(|proof| proof.encode()).unwrap_or_default();
    Ok(Some(Fetched { signer, signature: row.signature, proof, blob: header }))
}

/// `None` if nobody would accept it now: its owner has another key, it rests on no batch in a block, or its signer is
/// unknown.
pub fn notice_of(
    plant: &Plant,
    network: &Network,
    (digest, statement, account): (Digest, &[u8], &[u8]),
) -> Result<Option<ErasureNotice>> {
    let ledger = &plant.ledger;
    let (Ok(statement), Ok(account)) = (ErasedStatement::parse(statement), account.try_into()) else {
        return Ok(None);
    };
    let Some((row, place)) = ledger.records.placed(digest)?.map(PlacedRecord::anchor) else { return Ok(None) };
    let is_batched = place.is_some() && row.block.is_some();
    if !is_batched || !is_owners(network, row.owner, &statement.signer) {
        return Ok(None);
    }
    let is_of_here =
        |retained: &Retained| Header::parse(&retained.header).is_ok_and(|(header, _)| header.domain == network.domain);
    let Some(retained) = ledger.retention.find(digest)?.filter(is_of_here) else { return Ok(None) };
    let left = left_of(plant, network, &row, retained.header)?.map(|record| ErasedRecord { record, statement });
    Ok(left.map(|left| ErasureNotice { digest, account_signature: AccountSignature(account), left }))
}

pub fn is_owners(network: &Network, owner: Address, key: &PublicKey) -> bool {
    let now = Moment::newest(network.directory.now());
    matches!(may_sign(&network.directory, owner, signer_id(key), now), Ok(SigningRight::Owner(_)))
}

#[cfg(test)]
mod held_tests {
    use super::*;
    use crate::model::TopicPatterns;
    use crate::store::IncidentSpan;
    use proptest::prelude::*;

    fn at((since, until): (u64, u64)) -> Span {
        (Timestamp(since), Timestamp(until))
    }

    fn covers(spans: &[Span], moment: u64) -> bool {
        spans.iter().any(|(since, until)| (since.0..until.0).contains(&moment))
    }

    proptest! {
        #[test]
        fn every_moment_of_a_stretch_is_either_held_or_free(
            spans in proptest::collection::vec((0_u64..60, 0_u64..60), 0..8),
            stretch in (0_u64..60, 0_u64..60),
        ) {
            let spans: Vec<Span> = spans.into_iter().map(at).collect();
            let held = Held { spans: merged(spans.clone()), ..Held::default() };
            let free = held.between(at(stretch));
            for moment in 0..70 {
                prop_assert_eq!(covers(&held.spans, moment), covers(&spans, moment));
                let asked = (stretch.0..stretch.1).contains(&moment);
                prop_assert_eq!(covers(&free, moment), asked && !covers(&spans, moment));
            }
            prop_assert!(held.spans.windows(2).all(|two| two[0].1 < two[1].0));
        }
    }

    #[test]
    fn an_incident_is_about_the_topics_it_names_or_about_all() {
        let row = |name: &str, topics: &[&str], until| IncidentRow {
            name: name.parse().expect("a name"),
            span: IncidentSpan {
                since: Timestamp(5),
                until,
                topics: TopicPatterns(topics.iter().map(|topic| topic.parse().expect("a pattern")).collect()),
            },
            opened_at: Timestamp(5),
            closed_at: None,
            notes: Vec::new(),
        };
        let rows = [row("a", &["/odom"], Some(Timestamp(9))), row("b", &[], Some(Timestamp(7)))];
        assert_eq!(Held::of("/odom", &rows).spans, [at((5, 9))]);
        assert_eq!(Held::of("/scan", &rows).spans, [at((5, 7))]);
        assert_eq!(Held::of("/scan", &[row("c", &["/scan"], None)]).spans, [(Timestamp(5), EVER)]);
        let by_pattern = [row("d", &["/robot*/odom"], None)];
        assert_eq!(Held::of("/robot7/odom", &by_pattern).spans, [(Timestamp(5), EVER)]);
        assert!(Held::of("/robot7/scan", &by_pattern).spans.is_empty());
    }
}
